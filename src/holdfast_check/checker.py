"""`holdfast-check FILE`: whether a certificate proves what it says.

A certificate names a vehicle's rates f(x, u, d), bounds of d, constraints c(x) <= 0, a grid of
cells, and for each cell of a set an input. It is valid if for each such cell X, its input u held
for T and any disturbance within the bounds

1. c <= 0 all over X;
2. a box B contains every state on the way: X + [0, T] f(B, u, D) lies inside B;
3. c <= 0 on the way: all over B, or from both ends by the least and greatest rate of c over B;
4. every state at the end lies in cells of the set (of a level one lower, for a finite horizon).

Then the set is never left. Where a law gives the inputs, an entry is a cell and the mode of the law
before the sample, and all that the law may do all over the cell leads to entries. Numbers are balls
of Arb (python-flint) with 80 bits. The states at the end are a Taylor polynomial of the middle and
what others differ from it by (mean value form).
"""

from __future__ import annotations

import argparse
import ast
import base64
import bisect
import contextlib
import functools
import hashlib
import itertools
import json
import keyword
import math
import random
import struct
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
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


Choice = tuple[list["Expression"], list["Expression"], int, Sequence[tuple[Any, ...]]]
"""Conditions, inputs, the mode of a law afterwards, and what inputs that are left free may be."""
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


def _sign(x: Any) -> Any:
    return arb(1) if x >= 0 else arb(-1) if x <= 0 else ball(-1, 1)


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
KINKS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "magnitude": (abs, _sign), "Abs": (abs, _sign),
    "tanh": (arb.tanh, lambda x: 1 - x.tanh() ** 2),
}  # fmt: skip
"""Functions that have a slope here, and no series of more terms."""
JUMPS: dict[str, Callable[..., Any]] = {
    "wrap": _wrapped, "angle": _angle, "atan2": _angle,
    "length": lambda x, y, *_: (x**2 + y**2).sqrt(),
}  # fmt: skip
"""Functions of balls that have no slope everywhere."""
SMOOTH = ("sin", "cos", "tan", "atan", "exp", "log", "sqrt")
PLAIN = {n: getattr(arb, n) for n in SMOOTH} | {n: k[0] for n, k in KINKS.items()} | CHOICES | JUMPS
NAMES = {*PLAIN, "pi"}


def applied(name: str, *x: Any) -> Any:
    """A function of balls, or of Taylor series: those of two terms have the slopes of kinks too."""
    if not any(isinstance(v, arb_series) for v in x):
        return PLAIN[name](*map(arb, x))
    if name in SMOOTH:
        return getattr(x[0], name)()
    if name in JUMPS or flint.ctx.cap > 2:
        raise ValueError
    terms = [v if isinstance(v, arb_series) else arb_series([v]) for v in x]
    if name in CHOICES:
        a, b = terms
        return arb_series([CHOICES[name](a[0], b[0]), a[1].union(b[1])])
    value, slope = KINKS[name]
    return arb_series([value(terms[0][0]), slope(terms[0][0]) * terms[0][1]])


def _times(a: Any, b: Any) -> Any:
    """A product; of two balls by their ends, which is narrower than that of middles and radii."""
    if any(isinstance(q, arb_series) or q.is_exact() or not q.is_finite() for q in (a, b)):
        return a * b
    ends = itertools.product((a.lower(), a.upper()), (b.lower(), b.upper()))
    return functools.reduce(arb.union, itertools.starmap(mul, ends))


OPERATIONS = {ast.Add: add, ast.Sub: sub, ast.Mult: _times, ast.Div: truediv}


class Expression:
    """A text of names, whole numbers, + - * / **, and functions."""

    def __init__(self, tree: ast.expr) -> None:
        self.tree = tree
        names = {n.id for n in ast.walk(self.tree) if isinstance(n, ast.Name)}
        self.names = names - NAMES

    def parts(self) -> tuple[str, list[Expression]] | None:
        """The arguments of a least or a greatest."""
        match self.tree:
            case ast.Call(func=ast.Name(id="least" | "greatest" as name), args=[_, _] as both):
                return name, [Expression(a) for a in both]
        return None

    def at(self, values: Values) -> Any:
        """Raises `ValueError` for a function that has no Taylor series, or no slope."""
        return self._value(self.tree, values)

    def _value(self, node: ast.expr, values: Values) -> Any:
        match node:
            case ast.Constant(value=int(number)) if type(number) is int:
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
        if isinstance(base, arb_series) or whole % 2 or not base.is_finite():
            found = functools.reduce(_times, whole * [base], arb(1))
        else:
            low, high = abs(base).lower().max(arb(0)), abs(base).upper()
            found = (low**whole).union(high**whole)
        if half:
            found = found * applied("sqrt", base)
        return 1 / found if twice < 0 else found


def _expressions(texts: Iterable[str]) -> list[Expression]:
    return [Expression(ast.parse(text, mode="eval").body) for text in texts]


def _floats(texts: Iterable[str]) -> list[float]:
    return [float.fromhex(text) for text in texts]


class Checker:
    """The claims of a certificate, cell by cell."""

    def __init__(self, h: Values, entries: Entries) -> None:
        lists = ("rates", "constraints", "target", "edges", "errors", "candidates")
        if not all(type(h[k]) is list for k in lists) or set(map(type, h["periodic"])) - {bool}:
            raise NotValidError("the header has another form")
        self.edges, self.inputs = ([_floats(r) for r in h[k]] for k in ("edges", "candidates"))
        self.rates = _expressions(h["rates"])
        self.constraints = _expressions(c["expression"] for c in h["constraints"])
        self.target = _expressions(c["expression"] for c in h["target"])
        self.states, self.input_names = ([q["name"] for q in h[k]] for k in ("states", "inputs"))
        free = [*h["disturbances"], *h["parameters"]]
        self.bound_names = [q["name"] for q in free]
        ranges = [_floats(q["range"]) for q in free]
        if not all(-math.inf < a <= b < math.inf for a, b in ranges):
            raise NotValidError("a range is reversed or not finite")
        self.bounds = {n: ball(*r) for n, r in zip(self.bound_names, ranges, strict=True)}
        numbers = _floats([h["hold"], h["delay"], *h["errors"]])
        self.hold, self.delay, *self.errors = map(arb, numbers)
        self.kept: dict[tuple[int, int], int] = {}
        both = (*self.constraints, *self.target)
        self.ends = functools.cache(lambda cell: all(self._holds(c, cell) for c in both))
        self.shape, self.turning = [len(e) - 1 for e in self.edges], h["periodic"]
        self.total, depth = math.prod(self.shape), min(h.get("depth", 0), 31)
        self.widths = [2**k for k in range(depth + 1)]
        self.still = [t == "0" and e == 0 for t, e in zip(h["rates"], self.errors, strict=True)]
        self._choices(h["law"])
        self._well_formed(h["holds"], entries)
        first, ends = self.law["initial"], h["holds"] or 0
        last = {c for (c, k), v in self.kept.items() if k == first and (self.target or v == ends)}
        places = ((c, *self._place(c)) for c in last)
        whole = [w for c, w, place in places if c == max(last.intersection(self._numbers(place)))]
        if sum(wide ** len(self.shape) for wide in whole) != h["cells_kept"]:
            raise NotValidError("the cells of the horizon are not as many as it says")

    def _choices(self, law: Values) -> None:
        """What may be given: inputs that were tried, one each, or the options of a law's modes."""
        names, tried = _expressions(self.input_names), [tuple(map(arb, r)) for r in self.inputs]
        self.choices: list[list[Choice]] = [[([], names, 0, [row])] for row in tried]
        self.under_way = [ball(min(c), max(c)) for c in zip(*self.inputs, strict=True)]
        self.law = law or {"where": [], "modes": [], "initial": 0, "table": None}
        self.where = [(name, *_expressions([text])) for name, text in self.law["where"]]
        table = self.law["table"] or {"axes": [], "nodes": {}}
        self.axes = [(*_expressions([place]), *_floats(ends), n, turns)
                     for place, ends, n, turns in table["axes"]]  # fmt: skip
        every = list(itertools.product(*(range(n) for _, _, n, _ in table["axes"])))
        packed = {name: [zlib.decompress(base64.b64decode(end)) for end in ends]
                  for name, ends in table["nodes"].items()}  # fmt: skip
        self.nodes = {name: [dict(zip(every, struct.unpack(f"<{len(every)}d", end), strict=True))
                             for end in ends] for name, ends in packed.items()}  # fmt: skip
        if law:
            parts = [list(itertools.starmap(ball, itertools.pairwise(_floats(e))))
                     for e in law["parts"]]  # fmt: skip
            self.under_way = [ball(*_floats(ends)) for ends in law["under_way"]]
            self.choices = [[self._option(parts, *o) for o in mode] for mode in law["modes"]]
        both = [e for options in self.choices for when, u, *_ in options for e in (*when, *u)]
        self.told = [*both, *(e for _, e in self.where), *(place for place, *_ in self.axes)]

    def _option(self, parts: list[Balls], when: list[str], inputs: list[str], to: int) -> Choice:
        """Its conditions and inputs, the mode then, and what inputs that it leaves free may be."""
        both = [_expressions(when), _expressions(inputs)]
        free = any(e.names & {*self.input_names} for e in itertools.chain(*both))
        return both[0], both[1], to, list(itertools.product(*parts)) if free else [()]

    def _well_formed(self, most: int | None, entries: Entries) -> None:
        names = [*self.states, *self.input_names, *self.bound_names, *self.nodes, "time_in_mode"]
        names += [name for name, _ in self.where]
        known = {n for n in names if n.isascii() and n.isidentifier()} - {*NAMES, *keyword.kwlist}
        if len(known) < len(names):
            raise NotValidError("a name stands twice, is none, or is that of a function or number")
        for e in (*self.rates, *self.constraints, *self.target, *self.told):
            if odd := e.names - known:
                raise NotValidError(f"an expression uses the undeclared name {min(odd)}")
        given = {len(u) for options in self.choices for _, u, _, _ in options}
        if {len(self.rates), len(self.edges), len(self.errors)} != {len(self.states)}:
            raise NotValidError("there is not one rate, axis and error for each state")
        if {*given, *map(len, self.inputs)} != {len(self.input_names)}:
            raise NotValidError("an input has not one number for each name")
        for name, axis, turns in zip(self.states, self.edges, self.turning, strict=True):
            if not all(a < b for a, b in itertools.pairwise(axis)):
                raise NotValidError(f"the edges of {name} do not grow")
            if turns:
                self._turns(name, axis)
        whole = (most is None and not self.target) or (type(most) is int and most >= 1)
        times = self.hold.is_finite() and 0 <= self.delay < self.hold
        finite = all(map(math.isfinite, itertools.chain(*self.inputs)))
        finite = finite and all(e.is_finite() and e >= 0 for e in self.errors)
        if not (times and whole and self.constraints and finite and self.choices):
            raise NotValidError("the hold, the horizon, the constraints or the inputs are none")
        count, better = self.total * len(self.widths), min if self.target else max
        for cell, choice, level in entries:
            horizon = level == 0 if most is None else 1 <= level <= most
            if not (cell < count and choice < len(self.choices) and horizon):
                raise NotValidError(f"entry of cell {cell}: no such cell, input or level")
            place = cell, choice if self.law["modes"] else 0
            self.kept[place] = better(level, self.kept.get(place, level))

    def _turns(self, name: str, axis: list[float]) -> None:
        """An angle: all rates have it in sines and cosines alone, and a turn is in the axis."""
        if not arb(axis[-1]) - arb(axis[0]) >= 2 * arb.pi():
            raise NotValidError(f"the axis of {name} is less than a turn")
        for e in (*self.rates, *self.constraints, *self.target, *self.told):
            if not _turns_with(e.tree, name):
                raise NotValidError(f"{name} comes back after a turn, {ast.unparse(e.tree)} not")

    def entry(self, cell: int, choice: int, level: int) -> None:
        """Raises `NotValidError` unless this input, or the law, keeps this cell."""
        seen = [ball(a, b) for a, b in self._box(cell)]
        where = ", ".join(f"{n} = {q.str(4)}" for n, q in zip(self.states, seen, strict=True))
        where = f"cell {cell} ({where})"
        for k, c in enumerate(self.constraints):
            if not self._holds(c, cell):
                raise NotValidError(f"{where} is not inside constraint {k}")
        if next(self._given([q.mid() for q in seen], choice), None) is None:
            raise NotValidError(f"{where}: the law does nothing in the middle")
        for inputs, mode in self._given(seen, choice):
            x = self._with_errors(seen)
            legs = [(self.hold - self.delay, inputs)]
            if self.delay > 0:  # first any input that may be under way
                if not all(q.contains(u) for q, u in zip(self.under_way, inputs, strict=True)):
                    raise NotValidError(f"{where}: an input is none that may be under way")
                legs.insert(0, (self.delay, self.under_way))
            for leg, (hold, u) in enumerate(legs):
                fixed = {**self.bounds, **dict(zip(self.input_names, u, strict=True))}
                way = self._way(x, fixed, hold, where)
                end = self._end(x, way, fixed, hold)
                begun, ends = cell if leg == 0 else None, leg == len(legs) - 1
                for k, c in enumerate(self.constraints):
                    if not self._kept(c, begun, (x, way, end), fixed, hold, ends):
                        raise NotValidError(f"{where}: constraint {k} may fail on the way")
                x = end
            for led in self._cells(self._with_errors(x)):
                if led is None or not self._reached(led, mode, level):
                    raise NotValidError(f"{where} may lead to {led and led[0]}, which is not kept")

    def _given(self, seen: Balls, choice: int) -> Iterator[tuple[Balls, int]]:
        """All inputs that may be given with states measured there, and the mode of the law then.

        Of a law these are of the first option whose conditions hold.
        """
        at = self.bounds | dict(zip(self.states, seen, strict=True)) | {"time_in_mode": arb("nan")}
        at.update(self._looked_up(at))
        for name, e in self.where:
            at[name] = e.at(at)
        for when, inputs, to, parts in self.choices[choice]:
            sure = False
            for part in parts:
                at.update(zip(self.input_names, part, strict=bool(part)))
                if not any(e.at(at) > 0 for e in when):
                    yield [e.at(at) for e in inputs], to
                    sure |= all(e.at(at) < 0 for e in when)
            if sure:
                return

    def _looked_up(self, at: Values) -> Values:
        """The values of a law's table, between those at the nodes around a place."""
        blocks = []
        for place, low, step, n, turns in self.axes:
            q = (place.at(at) - low) / step
            first, last = (int(k) if turns else min(max(k, 0), n - 1)
                           for k in (math.floor(_down(q)), math.ceil(-_down(-q))))  # fmt: skip
            blocks.append([k % n for k in range(first, last + 1)])
        around = list(itertools.product(*blocks))
        return {name: functools.reduce(arb.union, (ball(low[k], high[k]) for k in around))
                for name, (low, high) in self.nodes.items()}  # fmt: skip

    def _place(self, cell: int) -> tuple[int, list[int]]:
        """The width of a cell in the smallest ones, and the place of the first of these in it."""
        doubled, rest = divmod(cell, self.total)
        wide, place = self.widths[doubled], list[int]()
        for count in reversed(self.shape):
            rest, k = divmod(rest, count)
            if k % wide or k + wide > count:
                raise NotValidError(f"there is no cell {cell}")
            place.insert(0, k)
        return wide, place

    def _numbers(self, place: Sequence[int]) -> Iterator[int]:
        """The cells of all sizes that one of the smallest is in, itself the first."""
        for doubled, wide in enumerate(self.widths):
            cell = doubled
            for k, count in zip(place, self.shape, strict=True):
                cell = cell * count + k - k % wide
            yield cell

    def _box(self, cell: int) -> list[tuple[float, float]]:
        wide, place = self._place(cell)
        return [(e[k], e[k + wide]) for e, k in zip(self.edges, place, strict=True)]

    def _with_errors(self, x: Balls) -> Balls:
        return [q + e * ball(-1, 1) for q, e in zip(x, self.errors, strict=True)]

    def _holds(self, c: Expression, cell: int) -> bool:
        """Whether c <= 0 all over where a cell is measured, or at the corner that c grows to."""
        if parts := c.parts():
            which = any if parts[0] == "least" else all
            return which(self._holds(part, cell) for part in parts[1])
        box = [(a - e, b + e) for (a, b), e in zip(self._box(cell), self.errors, strict=True)]
        x = [a.union(b) for a, b in box]
        with contextlib.suppress(ValueError):
            slopes = self._slopes(c, x, self.bounds, self.states)
            x = [b if s >= 0 else a if s <= 0 else q
                 for q, (a, b), s in zip(x, box, slopes, strict=True)]  # fmt: skip
        return bool(c.at({**self.bounds, **dict(zip(self.states, x, strict=True))}) <= 0)

    def _reached(self, cells: list[int], mode: int, level: int) -> bool:
        """Whether a cell is of the set, or part of one that is.

        Where time is counted, of a level one closer to its end.
        """
        known = [self.kept[cell, mode] for cell in cells if (cell, mode) in self.kept]
        if any(k < level if self.target else k >= level - 1 for k in known):
            return True
        # level 0: in the region, and in the target where there is one
        return (level == 1 or bool(self.target)) and self.ends(cells[0])

    def _rates(self, x: Balls, fixed: Values) -> Balls:
        values = {**fixed, **dict(zip(self.states, x, strict=True))}
        return [r.at(values) for r in self.rates]

    def _way(self, x: Balls, fixed: Values, hold: Any, where: str) -> Balls:
        """A box that contains every state on the way."""
        guess = x
        for grown in (1.1, 1.1, 1.2, 1.5, 2.0):
            rates = self._rates(guess, fixed)
            moved = [q + _during(hold, r) for q, r in zip(x, rates, strict=True)]
            if all(g.contains(m) for g, m in zip(guess, moved, strict=True)):
                return moved
            guess = [m + (m - m.mid()) * (grown - 1) for m in moved]
        raise NotValidError(f"{where}: no box of the states on the way was found")

    def _end(self, x: Balls, way: Balls, fixed: Values, h: Any) -> Balls:
        """Every state at the end."""
        plain = [q + h * r for q, r in zip(x, self._rates(way, fixed), strict=True)]
        middle, n = [q.mid() for q in x], len(x)
        still = {k: v.mid() for k, v in fixed.items()}
        free = [name for name, q in fixed.items() if not q.is_exact()]
        try:
            slopes = [self._slopes(r, way, fixed, [*self.states, *free]) for r in self.rates]
        except ValueError:
            return plain
        a = [row[:n] for row in slopes]
        try:
            first, rest = self._series(middle, still, 3), self._series(way, still, 4)
            nominal = [c[0] + c[1] * h + c[2] * h**2 + r[3] * h**3
                       for c, r in zip(first, rest, strict=True)]  # fmt: skip
        except ValueError:
            begun, during = self._rates(middle, still), self._rates(way, still)
            nominal = [c + h * f + h**2 / 2 * _dot(row, during)
                       for c, f, row in zip(middle, begun, a, strict=True)]  # fmt: skip
        off = [fixed[name] - still[name] for name in free]
        w = [_dot(row[n:], off) for row in slopes]
        e0 = [q - c for q, c in zip(x, middle, strict=True)]
        e = [q - q for q in way]  # of two states on the way: balls know no identity
        for _ in range(2):
            e = [s + _during(h, _dot(row, e) + more)
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
        flint.ctx.cap = 2
        values = {**fixed, **dict(zip(self.states, way, strict=True))}
        zero = arb_series([0])
        return [(e.at({**values, n: arb_series([values[n], 1])}) + zero)[1] for n in names]

    def _rate(self, c: Expression, way: Balls, fixed: Values) -> Any:
        """The derivative of an expression by time over a box: two enclosures, what both say."""
        rates = self._rates(way, fixed)
        slopes = _dot(self._slopes(c, way, fixed, self.states), rates)
        flint.ctx.cap = 2
        moving = {n: arb_series([q, r]) for n, q, r in zip(self.states, way, rates, strict=True)}
        return _common(slopes, (c.at({**fixed, **moving}) + arb_series([0]))[1])

    def _series(self, x: Balls, fixed: Values, terms: int) -> list[Balls]:
        """Taylor coefficients of the trajectory from x."""
        flint.ctx.cap = terms
        coefficients = [[q] for q in x]
        for k in range(terms - 1):
            values = {n: arb_series([v]) for n, v in fixed.items()}
            values |= {n: arb_series(c) for n, c in zip(self.states, coefficients, strict=True)}
            for c, r in zip(coefficients, self.rates, strict=True):
                c.append((r.at(values) + arb_series([0]))[k] / (k + 1))
        return coefficients

    def _kept(self, c: Expression, cell: Any, boxes: Any, fixed: Values, h: Any, ends: Any) -> bool:
        """Whether c <= 0 on (start, way, end), from a cell if there; ends: known at the end."""
        if parts := c.parts():
            which, known = (any, False) if parts[0] == "least" else (all, ends)
            if which(self._kept(p, cell, boxes, fixed, h, known) for p in parts[1]):
                return True
        places = [{**fixed, **dict(zip(self.states, q, strict=True))} for q in boxes]
        first, during, last = (c.at(place) for place in places)
        if during <= 0:
            return True
        begins = bool(first <= 0) if cell is None else self._holds(c, cell)
        ends = ends or bool(last <= 0)
        try:
            rate = self._rate(c, boxes[1], fixed)
        except ValueError:
            return False
        if rate <= 0 or rate >= 0:
            return begins if rate <= 0 else ends
        if not (rate.is_finite() and begins and ends):
            return False
        up, down = rate.upper(), rate.lower()
        c0, c1 = (v.upper().min(arb(0)) for v in (first, last))
        return bool(c0 + up * (c1 - c0 - h * down) / (up - down) <= 0)

    def _cells(self, end: Balls) -> Iterator[list[int] | None]:
        """The smallest cells that a box touches, and those they are in; None beyond the grid."""
        ranges = []
        each = zip(end, self.edges, self.turning, self.still, strict=True)
        for q, axis, turns, still in each:  # a state that is still does not leave the grid
            beyond = not (turns or still) and (_down(q) < axis[0] or -_down(-q) > axis[-1])
            if not q.is_finite() or beyond:
                yield None
                return
            around = math.floor((_down(q) - axis[0]) / (2 * math.pi)) if turns else 0
            places = set()
            for k in (around - 1, around, around + 1) if turns else (0,):
                low, high = _down(q - 2 * k * arb.pi()), -_down(2 * k * arb.pi() - q)
                first = max(bisect.bisect_left(axis, low) - 1, 0)
                places |= set(range(first, min(bisect.bisect_right(axis, high), len(axis) - 1)))
            if not places:  # so many turns that doubles do not count them
                yield None
                return
            ranges.append(sorted(places))
        yield from map(list, map(self._numbers, itertools.product(*ranges)))


def _turns_with(node: ast.AST, name: str) -> bool:
    """Whether an expression has an angle as a summand inside sines and cosines alone."""
    if not _has(node, name):
        return True
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("sin", "cos"):
        return _summand(node.args[0], name)
    inner = [n for n in ast.iter_child_nodes(node) if isinstance(n, ast.expr)]
    return bool(inner) and all(_turns_with(n, name) for n in inner)


def _has(node: ast.AST, name: str) -> bool:
    return any(isinstance(n, ast.Name) and n.id == name for n in ast.walk(node))


def _summand(node: ast.AST, name: str) -> bool:
    match node:
        case ast.BinOp(left=a, op=ast.Add() | ast.Sub(), right=b):
            return _has(a, name) != _has(b, name) and _summand(a if _has(a, name) else b, name)
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return _summand(inner, name)
    return isinstance(node, ast.Name)


def _during(hold: Any, rate: Any) -> Any:
    """[0, T] times a rate: no wider than it must be, unlike a product of balls."""
    return (hold * rate).union(arb(0))


def _dot(a: Balls, b: Balls) -> Any:
    return sum((_times(p, q) for p, q in zip(a, b, strict=True)), arb(0))


def _common(a: Any, b: Any) -> Any:
    """What two balls of one number have in common; one of them where the other says nothing."""
    if a.is_finite() and b.is_finite() and a.overlaps(b):
        return a.intersection(b)
    return a if a.is_finite() else b


def _down(q: Any) -> float:
    value = float(q.lower())
    return value if arb(value) <= q.lower() else math.nextafter(value, -math.inf)


def check(path: str, share: float = 1.0, seed: int = 0) -> str:
    """What was checked, in a sentence. Raises `NotValidError` where the certificate is wrong."""
    flint.ctx.prec = BITS
    header, every = read(path)
    checker, count = Checker(header, every), max(round(share * len(every)), 1)
    entries = every if share == 1 else random.Random(seed).sample(every, count)
    for k, entry in enumerate(entries):
        checker.entry(*entry)
        if k % 2000 == 1999 and sys.stderr.isatty():
            print(f"\r{k + 1} of {len(entries)} ", end="", file=sys.stderr)
    holds = header["holds"]
    how = "reach the target within" if checker.target else "for"
    lasts = "for ever" if holds is None else f"{how} {holds * float(checker.hold.mid()):g} s"
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
