"""`holdfast-check FILE`: whether a certificate proves what it says.

A certificate names a vehicle's rates f(x, u, d), bounds of d, constraints c(x) <= 0, a grid of
cells, and for each cell of a set an input. It is valid if for each such cell X, its input u held
for T and any disturbance within the bounds

1. c <= 0 all over X;
2. a box B contains every state on the way: X + [0, T] f(B, u, D) lies inside B;
3. c <= 0 on the way: all over B, or from both ends by the least and greatest rate of c over B;
4. every state at the end lies in cells of the set (of a level one lower, for a finite horizon).

Then the set is never left. Numbers are balls of Arb (python-flint) with 80 bits. The states at the
end are a Taylor polynomial of the middle and what others differ from it by (mean value form).
"""

from __future__ import annotations

import argparse
import ast
import bisect
import functools
import hashlib
import itertools
import json
import math
import random
import struct
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from operator import add, mul, sub, truediv
from typing import Any

import flint
from flint import arb, arb_series

MAGIC = "holdfast-certificate 1"
BITS = 80
NOT_VALID, NOT_READ, LEAST_CHANCE = 1, 2, 1e-3


Balls = list[Any]
Values = dict[str, Any]


class NotValidError(Exception):
    """Where and why a certificate does not prove what it says."""


Entries = list[tuple[int, int, int]]
"""Cells, the numbers of their inputs, and levels: 0 is for ever."""


def read(path: str) -> tuple[Values, Entries]:
    """What a file says. Raises `NotValidError` if a bit of it is not as it was written."""
    with open(path, "rb") as file:
        content = file.read()
    first, _, rest = content.partition(b"\n")
    words = first.decode("ascii", "replace").split(" ")
    if " ".join(words[:2]) != MAGIC or len(words) != 3:
        raise NotValidError(f"{path} is not a certificate of this version")
    if hashlib.sha256(rest).hexdigest() != words[2]:
        raise NotValidError(f"{path} was changed: its digest is not that of its content")
    text, _, packed = rest.partition(b"\n")
    header = json.loads(text, object_pairs_hook=_once)
    count = header["entries"]
    numbers = zlib.decompressobj().decompress(packed, 10 * count + 1)
    if len(numbers) != 10 * count or count < 1:
        raise NotValidError(f"{path} has not the {count} entries that it says")
    return header, list(struct.iter_unpack("<IHI", numbers))


def _once(pairs: Any) -> Values:
    if len(dict(pairs)) < len(pairs):
        raise NotValidError("a key of the header stands twice")
    return dict(pairs)


def ball(low: float, high: float) -> Any:
    return arb(low).union(arb(high))


@dataclass
class Slope:
    """A ball and the balls of its derivatives by some quantities."""

    value: Any
    by: Balls

    def __add__(self, other: Any) -> Slope:
        o = _slope(other, len(self.by))
        return Slope(self.value + o.value, [a + b for a, b in zip(self.by, o.by, strict=True)])

    def __neg__(self) -> Slope:
        return Slope(-self.value, [-a for a in self.by])

    def __sub__(self, other: Any) -> Slope:
        return self + (-_slope(other, len(self.by)))

    def __rsub__(self, other: Any) -> Slope:
        return -self + other

    __radd__ = __add__

    def __mul__(self, other: Any) -> Slope:
        o = _slope(other, len(self.by))
        slopes = [a * o.value + self.value * b for a, b in zip(self.by, o.by, strict=True)]
        return Slope(self.value * o.value, slopes)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Slope:
        o = _slope(other, len(self.by))
        return self * o.chain(1 / o.value, -1 / (o.value * o.value))

    def __rtruediv__(self, other: Any) -> Slope:
        return _slope(other, len(self.by)) / self

    def __pow__(self, n: int) -> Slope:
        return self.chain(self.value**n, n * self.value ** (n - 1))

    def chain(self, value: Any, slope: Any) -> Slope:
        """A function of this, of that value and slope."""
        return Slope(value, [slope * a for a in self.by])


def _slope(x: Any, count: int) -> Slope:
    return x if isinstance(x, Slope) else Slope(arb(x), [arb(0)] * count)


class NoSlopeError(Exception):
    """A function that has no Taylor series, or no slope."""


def _sign(x: Any) -> Any:
    return arb(1) if x >= 0 else arb(-1) if x <= 0 else ball(-1, 1)


SLOPES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "sin": lambda x: (x.sin(), x.cos()), "cos": lambda x: (x.cos(), -x.sin()),
    "tan": lambda x: (x.tan(), 1 + x.tan() ** 2), "atan": lambda x: (x.atan(), 1 / (1 + x**2)),
    "exp": lambda x: (x.exp(), x.exp()), "log": lambda x: (x.log(), 1 / x),
    "tanh": lambda x: (x.tanh(), 1 - x.tanh() ** 2),
    "sqrt": lambda x: (x.sqrt(), 1 / (2 * x.sqrt())),
    "magnitude": lambda x: (abs(x), _sign(x)), "Abs": lambda x: (abs(x), _sign(x)),
}  # fmt: skip
"""Functions of a ball with their slopes."""


def _wrapped(x: Any) -> Any:
    if not x.is_finite():
        return x
    turns = (x / (2 * arb.pi()) - arb(1) / 2).ceil()
    return x - 2 * arb.pi() * turns if turns.is_exact() else arb.pi() * ball(-1, 1)


def _angle(y: Any, x: Any, *_: Any) -> Any:
    if not (x.is_finite() and y.is_finite()):
        return x - x + y
    if not (x > 0 or y > 0 or y < 0):
        return arb.pi() * ball(-1, 1)
    ends = itertools.product((y.lower(), y.upper()), (x.lower(), x.upper()))
    return functools.reduce(arb.union, itertools.starmap(arb.atan2, ends))


CHOICES = {"least": arb.min, "greatest": arb.max}
JUMPS: dict[str, Callable[..., Any]] = {
    "wrap": _wrapped, "angle": _angle, "atan2": _angle,
    "length": lambda x, y, *_: (x**2 + y**2).sqrt(),
}  # fmt: skip
"""Functions of balls that have no slope everywhere."""


def applied(name: str, *x: Any) -> Any:
    """A function of balls, of balls with slopes, or of Taylor series."""
    series = any(isinstance(v, arb_series) for v in x)
    if series and (name in CHOICES or name in JUMPS or not hasattr(x[0], name)):
        raise NoSlopeError
    if name in JUMPS:
        if any(isinstance(v, Slope) for v in x):
            raise NoSlopeError
        return JUMPS[name](*map(arb, x))
    if name in CHOICES:
        if slopes := [v for v in x if isinstance(v, Slope)]:
            a, b = (_slope(v, len(slopes[0].by)) for v in x)
            by = [p.union(q) for p, q in zip(a.by, b.by, strict=True)]
            return Slope(CHOICES[name](a.value, b.value), by)
        return CHOICES[name](*map(arb, x))
    (v,) = x
    if isinstance(v, Slope):
        return v.chain(*SLOPES[name](v.value))
    return getattr(v, name)() if series else SLOPES[name](arb(v))[0]


OPERATIONS = {ast.Add: add, ast.Sub: sub, ast.Mult: mul, ast.Div: truediv}


class Expression:
    """A text of names, whole numbers, + - * / **, and functions."""

    def __init__(self, text: str) -> None:
        self.tree = ast.parse(text, mode="eval").body
        names = {n.id for n in ast.walk(self.tree) if isinstance(n, ast.Name)}
        self.names = names - {*SLOPES, *CHOICES, *JUMPS, "pi"}

    def at(self, values: Values) -> Any:
        return self._value(self.tree, values)

    def _value(self, node: ast.expr, values: Values) -> Any:
        match node:
            case ast.Constant(value=int(number)):
                return arb(number)
            case ast.Name(id=name):
                return arb.pi() if name == "pi" else values[name]
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                return -self._value(inner, values)
            case ast.BinOp(left=base, op=ast.Pow(), right=exponent):
                return self._power(self._value(base, values), exponent)
            case ast.BinOp(left=a, op=operation, right=b):
                return OPERATIONS[type(operation)](self._value(a, values), self._value(b, values))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return applied(name, *(self._value(a, values) for a in arguments))
        raise NotValidError(f"the expression has {ast.dump(node)}")

    def _power(self, base: Any, exponent: ast.expr) -> Any:
        twice = 2 * Fraction(ast.unparse(exponent).replace(" ", ""))
        if twice.denominator != 1:
            raise NotValidError(f"the exponent {twice / 2} is no half of a whole number")
        whole, half = divmod(abs(int(twice)), 2)
        series = isinstance(base, arb_series)
        found = arb(1) if series or not whole else base**whole
        for _ in range(whole if series else 0):
            found = found * base
        if half:
            found = found * applied("sqrt", base)
        return 1 / found if twice < 0 else found


class Checker:
    """The claims of a certificate, cell by cell."""

    def __init__(self, h: Values, entries: Entries) -> None:
        self.edges = [[float.fromhex(e) for e in axis] for axis in h["edges"]]
        self.inputs = [[float.fromhex(v) for v in row] for row in h["candidates"]]
        self.rates = [Expression(t) for t in h["rates"]]
        self.constraints = [Expression(c["expression"]) for c in h["constraints"]]
        self.states = [q["name"] for q in h["states"]]
        self.input_names = [q["name"] for q in h["inputs"]]
        free = [*h["disturbances"], *h["parameters"]]
        self.bound_names = [q["name"] for q in free]
        ranges = [[float.fromhex(v) for v in q["range"]] for q in free]
        if not all(-math.inf < a <= b < math.inf for a, b in ranges):
            raise NotValidError("a range is reversed or not finite")
        self.bounds = {n: ball(*r) for n, r in zip(self.bound_names, ranges, strict=True)}
        self.hold = arb(float.fromhex(h["hold"]))
        self.level: dict[int, int] = {}
        self.inside: dict[int, bool] = {}
        self.shape, self.turning = [len(e) - 1 for e in self.edges], h["periodic"]
        self._well_formed(h["holds"], entries)
        if len([v for v in self.level.values() if v == (h["holds"] or 0)]) != h["cells_kept"]:
            raise NotValidError("the cells of the horizon are not as many as it says")

    def _well_formed(self, most: int | None, entries: Entries) -> None:
        names = [*self.states, *self.input_names, *self.bound_names]
        known = set(names) - {*SLOPES, *CHOICES, *JUMPS, "pi"}
        if len(known) < len(names):
            raise NotValidError("a name stands twice, or is that of a function or number")
        for e in (*self.rates, *self.constraints):
            if odd := e.names - known:
                raise NotValidError(f"an expression uses the undeclared name {min(odd)}")
        if len(self.rates) != len(self.states) or len(self.edges) != len(self.states):
            raise NotValidError("there is not one rate and one axis for each state")
        for name, axis, turns in zip(self.states, self.edges, self.turning, strict=True):
            if not all(a < b for a, b in itertools.pairwise(axis)):
                raise NotValidError(f"the edges of {name} do not grow")
            if turns:
                self._turns(name, axis)
        numbers = [v for row in self.inputs for v in row]
        whole = most is None or (type(most) is int and most >= 1)
        if not (self.hold > 0 and whole and self.constraints and all(map(math.isfinite, numbers))):
            raise NotValidError("the hold, the horizon, the constraints or the inputs are none")
        total = math.prod(self.shape)
        for cell, choice, level in entries:
            if not (cell < total and choice < len(self.inputs)) or (level == 0) != (most is None):
                raise NotValidError(f"entry of cell {cell}: no such cell, input or level")
            self.level[cell] = max(level, self.level.get(cell, 0))

    def _turns(self, name: str, axis: list[float]) -> None:
        """An angle: all rates have it in sines and cosines alone, and a turn is in the axis."""
        if not arb(axis[-1]) - arb(axis[0]) >= 2 * arb.pi():
            raise NotValidError(f"the axis of {name} is less than a turn")
        for e in (*self.rates, *self.constraints):
            if not _turns_with(e.tree, name):
                raise NotValidError(f"{name} comes back after a turn, {ast.unparse(e.tree)} not")

    def entry(self, cell: int, choice: int, level: int) -> None:
        """Raises `NotValidError` unless this input keeps this cell."""
        x = self._box(cell)
        where = ", ".join(f"{n} = {q.str(4)}" for n, q in zip(self.states, x, strict=True))
        u = dict(zip(self.input_names, map(arb, self.inputs[choice]), strict=True))
        fixed = {**self.bounds, **u}
        if (broken := self._broken(x)) is not None:
            raise NotValidError(f"cell {cell} ({where}) is not inside constraint {broken}")
        way = self._way(x, fixed, f"cell {cell} ({where})")
        end = self._end(x, way, fixed)
        for k, c in enumerate(self.constraints):
            if not self._kept(c, x, end, way, fixed):
                raise NotValidError(f"cell {cell} ({where}): constraint {k} may fail on the way")
        for led in self._cells(end):
            if led is None or not self._reached(led, level):
                raise NotValidError(
                    f"cell {cell} ({where}) may lead to cell {led}, which is not kept"
                )

    def _box(self, cell: int) -> Balls:
        place: list[int] = []
        for count in reversed(self.shape):
            cell, k = divmod(cell, count)
            place.insert(0, k)
        return [ball(e[k], e[k + 1]) for e, k in zip(self.edges, place, strict=True)]

    def _broken(self, x: Balls) -> int | None:
        """The first constraint that does not surely hold all over a box."""
        values = {**self.bounds, **dict(zip(self.states, x, strict=True))}
        return next((k for k, c in enumerate(self.constraints) if not c.at(values) <= 0), None)

    def _reached(self, cell: int, level: int) -> bool:
        """Whether a cell is of the set, or of a level one lower; of level 0 is the region."""
        if level == 1 and cell not in self.level:
            if cell not in self.inside:
                self.inside[cell] = self._broken(self._box(cell)) is None
            return self.inside[cell]
        return self.level.get(cell, -1) >= max(level - 1, 0)

    def _during(self, rate: Any) -> Any:
        """[0, T] times a rate: no wider than it must be, unlike a product of balls."""
        return (self.hold * rate).union(arb(0))

    def _rates(self, x: Balls, fixed: Values) -> Balls:
        values = {**fixed, **dict(zip(self.states, x, strict=True))}
        return [r.at(values) for r in self.rates]

    def _way(self, x: Balls, fixed: Values, where: str) -> Balls:
        """A box that contains every state on the way."""
        guess = x
        for grown in (1.1, 1.1, 1.2, 1.5, 2.0):
            moved = [q + self._during(r) for q, r in zip(x, self._rates(guess, fixed), strict=True)]
            if all(g.contains(m) for g, m in zip(guess, moved, strict=True)):
                return moved
            guess = [m + (m - m.mid()) * (grown - 1) for m in moved]
        raise NotValidError(f"{where}: no box of the states on the way was found")

    def _end(self, x: Balls, way: Balls, fixed: Values) -> Balls:
        """Every state at the end."""
        plain = [q + self.hold * r for q, r in zip(x, self._rates(way, fixed), strict=True)]
        middle, n, h = [q.mid() for q in x], len(x), self.hold
        still = {k: v.mid() if k in self.bounds else v for k, v in fixed.items()}
        free = [name for name, q in self.bounds.items() if not q.is_exact()]
        try:
            slopes = [self._slopes(r, way, fixed, [*self.states, *free]) for r in self.rates]
        except NoSlopeError:
            return plain
        a = [row[:n] for row in slopes]
        try:
            first, rest = self._series(middle, still, 3), self._series(way, still, 4)
            nominal = [c[0] + c[1] * h + c[2] * h**2 + r[3] * h**3
                       for c, r in zip(first, rest, strict=True)]  # fmt: skip
        except NoSlopeError:
            begun, during = self._rates(middle, still), self._rates(way, still)
            nominal = [c + h * f + h**2 / 2 * _dot(row, during)
                       for c, f, row in zip(middle, begun, a, strict=True)]  # fmt: skip
        off = [self.bounds[name] - self.bounds[name].mid() for name in free]
        w = [_dot(row[n:], off) for row in slopes]
        e0 = [q - c for q, c in zip(x, middle, strict=True)]
        e = [q - q for q in way]  # of two states on the way: balls know no identity
        for _ in range(2):
            e = [s + self._during(_dot(row, e) + more)
                 for s, row, more in zip(e0, a, w, strict=True)]  # fmt: skip
        moving = [_dot(row, e) + more for row, more in zip(a, w, strict=True)]
        twice = [[_dot(row, [other[j] for other in a]) for j in range(n)] for row in a]
        found = []
        for i in range(n):
            grown = [h * a[i][j] + h**2 / 2 * twice[i][j] + int(i == j) for j in range(n)]
            total = nominal[i] + _dot(grown, e0) + h * w[i] + h**2 / 2 * _dot(a[i], w)
            total += h**3 / 6 * _dot(twice[i], moving)
            found.append(_common(_common(total, plain[i]), way[i]))
        return found

    def _slopes(self, e: Expression, way: Balls, fixed: Values, names: Sequence[str]) -> Balls:
        """The derivatives of an expression by these names over a box."""
        values = {**fixed, **dict(zip(self.states, way, strict=True))}
        for k, name in enumerate(names):
            values[name] = Slope(values[name], [arb(int(j == k)) for j in range(len(names))])
        return _slope(e.at(values), len(names)).by

    def _series(self, x: Balls, fixed: Values, terms: int) -> list[Balls]:
        """Taylor coefficients of the trajectory from x."""
        flint.ctx.cap = terms
        coefficients = [[q] for q in x]
        for k in range(terms - 1):
            values = {n: arb_series([v]) for n, v in fixed.items()}
            values |= {n: arb_series(c) for n, c in zip(self.states, coefficients, strict=True)}
            for c, r in zip(coefficients, self.rates, strict=True):
                found = r.at(values)
                told = found[k] if isinstance(found, arb_series) else (arb(found) if k == 0 else 0)
                c.append(arb(told) / (k + 1))
        return coefficients

    def _kept(self, c: Expression, x: Balls, end: Balls, way: Balls, fixed: Values) -> bool:
        """Whether c <= 0 on the way, given that it is at both ends."""
        places = [{**fixed, **dict(zip(self.states, q, strict=True))} for q in (way, x, end)]
        during, first, last = (c.at(place) for place in places)
        if during <= 0:
            return True
        try:
            rate = _dot(self._slopes(c, way, fixed, self.states), self._rates(way, fixed))
        except NoSlopeError:
            return False
        if rate >= 0 or rate <= 0:
            return True
        if not rate.is_finite():
            return False
        up, down = rate.upper(), rate.lower()
        c0, c1 = (v.upper().min(arb(0)) for v in (first, last))
        return bool(c0 + up * (c1 - c0 - self.hold * down) / (up - down) <= 0)

    def _cells(self, end: Balls) -> Iterator[int | None]:
        """The cells that a box touches; None beyond the grid."""
        ranges = []
        for q, axis, turns in zip(end, self.edges, self.turning, strict=True):
            if not q.is_finite() or (not turns and (_down(q) < axis[0] or -_down(-q) > axis[-1])):
                yield None
                return
            turn = 2 * arb.pi()
            around = math.floor((_down(q) - axis[0]) / (2 * math.pi)) if turns else 0
            places = set()
            for k in (around - 1, around, around + 1) if turns else (0,):
                low, high = _down(q - k * turn), -_down(k * turn - q)
                first = max(bisect.bisect_left(axis, low) - 1, 0)
                places |= set(range(first, min(bisect.bisect_right(axis, high), len(axis) - 1)))
            ranges.append(sorted(places))
        for place in itertools.product(*ranges):
            cell = 0
            for k, count in zip(place, self.shape, strict=True):
                cell = cell * count + k
            yield cell


def _turns_with(node: ast.AST, name: str) -> bool:
    """Whether an expression has an angle in sums inside sines and cosines alone."""
    if not any(isinstance(n, ast.Name) and n.id == name for n in ast.walk(node)):
        return True
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("sin", "cos"):
        other = (ast.Mult, ast.Div, ast.Pow, ast.Call)
        return not any(isinstance(n, other) for n in ast.walk(node.args[0]))
    inner = [n for n in ast.iter_child_nodes(node) if isinstance(n, ast.expr)]
    return bool(inner) and all(_turns_with(n, name) for n in inner)


def _dot(a: Balls, b: Balls) -> Any:
    return sum((p * q for p, q in zip(a, b, strict=True)), arb(0))


def _common(a: Any, b: Any) -> Any:
    """What two balls of one number have in common; one of them where the other says nothing."""
    if not a.is_finite():
        return b
    return a.intersection(b) if b.is_finite() and a.overlaps(b) else a


def _down(q: Any) -> float:
    value = float(q.lower())
    return value if arb(value) <= q.lower() else math.nextafter(value, -math.inf)


def check(path: str, share: float = 1.0, seed: int = 0) -> str:
    """What was checked, in a sentence. Raises `NotValidError` where the certificate is wrong."""
    flint.ctx.prec = BITS
    header, every = read(path)
    checker, entries = Checker(header, every), every
    if share < 1:
        entries = random.Random(seed).sample(entries, max(round(share * len(entries)), 1))
    for k, entry in enumerate(entries):
        checker.entry(*entry)
        if k % 2000 == 1999 and sys.stderr.isatty():
            print(f"\r{k + 1} of {len(entries)} ", end="", file=sys.stderr)
    holds = header["holds"]
    lasts = "for ever" if holds is None else f"for {holds * float(checker.hold.mid()):g} s"
    told = f"{header['cells_kept']} cells {lasts}: {len(entries)} of {len(every)} entries hold"
    if len(entries) == len(every):
        return told
    worst = -math.expm1(math.log(LEAST_CHANCE) / len(entries))
    return (
        f"{told}, drawn with seed {seed}: with {100 * (1 - LEAST_CHANCE):g} % confidence "
        f"at most {100 * worst:.3g} % of them are wrong; this is no proof"
    )


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser("holdfast-check", description="Check a certificate.")
    parser.add_argument("file")
    parser.add_argument("--share", type=float, default=1.0, help="part of the entries to check")
    parser.add_argument("--seed", type=int, default=0, help="of the entries that are drawn")
    asked = parser.parse_args()
    if not 0 < asked.share <= 1:
        parser.error("--share: expected above 0, at most 1")
    try:
        told = check(asked.file, asked.share, asked.seed)
    except NotValidError as wrong:
        print(f"NOT valid: {wrong}")
        sys.exit(NOT_VALID)
    except Exception as error:  # whatever a file contains
        print(f"holdfast-check: {asked.file} cannot be read: {error!r}", file=sys.stderr)
        sys.exit(NOT_READ)
    except KeyboardInterrupt:
        sys.exit(130)
    print(f"{'valid' if asked.share == 1 else 'not refuted'}: {told}")
