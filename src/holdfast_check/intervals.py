"""Intervals whose ends are numbers of Arb with 80 bits, rounded outward; texts as operations.

An interval is a pair of ends. Of one that is unknown both are not a number, so that every
comparison with it is false; none has one such end alone (`_known`). Every operation gives narrower
intervals for narrower ones.
"""

from __future__ import annotations

import ast
import functools
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from math import comb
from typing import Any

from flint import arb, fmpq

MOST_POWER, LONGEST_NUMBER, GROWTH = 64, 10_000, 0.0995

Interval = tuple[Any, Any]
Row = list[Interval]

ZERO, NAN = arb(0), arb("nan")
UNKNOWN: Interval = (NAN, NAN)
BOTH: Interval = (arb(-1), arb(1))


class TextError(Exception):
    """What is wrong with the text of an expression."""


def point(number: Any) -> Interval:
    return interval(number, number)


def interval(low: Any, high: Any) -> Interval:
    return _known(arb(low), arb(high))


def _known(low: Any, high: Any) -> Interval:
    """Between the ends of two balls; unknown if one is no number, as 0 times infinity is."""
    low, high = low.lower(), high.upper()
    return (low, high) if low <= high else UNKNOWN


def add(a: Interval, b: Interval) -> Interval:
    return _known(a[0] + b[0], a[1] + b[1])


def sub(a: Interval, b: Interval) -> Interval:
    return _known(a[0] - b[1], a[1] - b[0])


def neg(a: Interval) -> Interval:
    return -a[1], -a[0]


def mul(a: Interval, b: Interval) -> Interval:
    """Of two quantities, which may be other numbers of one interval."""
    (p, q), (r, s) = a, b
    if p >= ZERO:
        low, high = (p if r >= ZERO else q) * r, (q if s >= ZERO else p) * s
    elif q <= ZERO:
        low, high = (p if s >= ZERO else q) * s, (q if r >= ZERO else p) * r
    elif r >= ZERO:
        low, high = p * s, q * s
    elif s <= ZERO:
        low, high = q * r, p * r
    else:
        ends = p * s, q * r, p * r, q * s
        low, high = min(ends[:2]), max(ends[2:])
    return _known(low, high)


def inverse(a: Interval) -> Interval:
    return _known(1 / a[1], 1 / a[0]) if a[0] > ZERO or a[1] < ZERO else UNKNOWN


def power(a: Interval, n: int) -> Interval:
    low, high = a
    if n % 2 or low >= ZERO:
        return _known(low**n, high**n)
    if high <= ZERO:
        return _known(high**n, low**n)
    return _known(ZERO, max(-low, high) ** n) if low < ZERO else UNKNOWN


def root(a: Interval) -> Interval:
    return _known(a[0].sqrt(), a[1].sqrt()) if a[0] >= ZERO else UNKNOWN


def hull(*parts: Interval) -> Interval:
    """UNKNOWN if a part is."""
    if not all(low <= high for low, high in parts):
        return UNKNOWN
    return min(low for low, _ in parts), max(high for _, high in parts)


def common(a: Interval, b: Interval) -> Interval:
    """What two intervals of one number share; one of them where the other is unknown."""
    if not b[0] <= b[1]:
        return a
    if not a[0] <= a[1]:
        return b
    return max(a[0], b[0]), min(a[1], b[1])


def within(a: Interval, b: Interval) -> bool:
    return bool(b[0] <= a[0]) and bool(a[1] <= b[1])


def size(a: Interval) -> Interval:
    low, high = a
    if low >= ZERO or high <= ZERO:
        return a if low >= ZERO else neg(a)
    return (ZERO, max(-low, high)) if low < ZERO else UNKNOWN


def sign(a: Interval) -> Interval:
    return point(1) if a[0] >= ZERO else point(-1) if a[1] <= ZERO else BOTH


def grown(q: Interval) -> Interval:
    more = (q[1] - q[0]) * arb(GROWTH)
    return interval(q[0] - more, q[1] + more)


def down(q: Interval) -> float:
    """A float that is at most the lower end."""
    value = float(q[0])
    return value if arb(value) <= q[0] else math.nextafter(value, -math.inf)


def up(q: Interval) -> float:
    return -down(neg(q))


def dot(a: Sequence[Interval | None], b: Sequence[Interval | None]) -> Interval:
    """A sum of products; what None or 0 is a factor of does not count, unknown or not."""
    parts = [mul(p, q) for p, q in zip(a, b, strict=True) if _counts(p) and _counts(q)]  # type: ignore[arg-type]
    return functools.reduce(add, parts) if parts else (ZERO, ZERO)


def _counts(a: Interval | None) -> bool:
    return a is not None and not (a[0] == ZERO == a[1])


def _grows(function: Callable[[Any], Any]) -> Callable[[Interval], Interval]:
    return lambda x: _known(function(x[0]), function(x[1]))


exponential, arctangent, hyperbolic = map(_grows, (arb.exp, arb.atan, arb.tanh))


def logarithm(x: Interval) -> Interval:
    return _grows(arb.log)(x) if x[0] > ZERO else UNKNOWN


def _between(x: Interval, first: Any, turn: Any) -> bool:
    """Whether some first + k turn may lie in x."""
    low, high = ((end - first * arb.pi()) / (turn * arb.pi()) for end in x)
    return not bool(high.upper().floor() < low.lower().ceil())


def _wave(function: Callable[[Any], Any], crest: Any) -> Callable[[Interval], Interval]:
    def value(x: Interval) -> Interval:
        if not x[0] <= x[1]:
            return UNKNOWN
        low, high = hull(*(_known(q, q) for q in map(function, x)))
        if not low <= high:
            return BOTH
        down, up = _between(x, crest + 1, 2), _between(x, crest, 2)
        return arb(-1) if down else max(low, arb(-1)), arb(1) if up else min(high, arb(1))

    return value


sine, cosine = _wave(arb.sin, arb(1) / 2), _wave(arb.cos, arb(0))


def tangent(x: Interval) -> Interval:
    if not x[0] <= x[1] or _between(x, arb(1) / 2, 1):
        return UNKNOWN
    return _grows(arb.tan)(x)


def turns(y: Interval, x: Interval) -> bool:
    """Whether the angle of (x, y) may jump."""
    return not (x[0] > ZERO or y[0] > ZERO or y[1] < ZERO)


def angle(y: Interval, x: Interval, *_: Any) -> Interval:
    if not (x[0] <= x[1] and y[0] <= y[1]):
        return UNKNOWN
    if turns(y, x):
        return -arb.pi().upper(), arb.pi().upper()
    ends = itertools.starmap(arb.atan2, itertools.product(y, x))
    return hull(*(_known(q, q) for q in ends))


def length(x: Interval, y: Interval, *_: Any) -> Interval:
    return root(add(power(x, 2), power(y, 2)))


def wrap(x: Interval) -> Interval:
    if not x[0] <= x[1]:
        return UNKNOWN
    first, last = ((end / (2 * arb.pi()) - arb(1) / 2).ceil() for end in x)
    if first.is_exact() and last.is_exact() and first == last:
        k = 2 * arb.pi() * first
        return _known(x[0] - k, x[1] - k)
    return -arb.pi().upper(), arb.pi().upper()


def least(a: Interval, b: Interval) -> Interval:
    return UNKNOWN if hull(a, b) is UNKNOWN else (min(a[0], b[0]), min(a[1], b[1]))


def greatest(a: Interval, b: Interval) -> Interval:
    return UNKNOWN if hull(a, b) is UNKNOWN else (max(a[0], b[0]), max(a[1], b[1]))


FUNCTIONS: Mapping[str, tuple[int, Callable[..., Interval]]] = {
    "sin": (1, sine), "cos": (1, cosine), "tan": (1, tangent), "atan": (1, arctangent),
    "exp": (1, exponential), "log": (1, logarithm), "tanh": (1, hyperbolic), "sqrt": (1, root),
    "Abs": (1, size), "magnitude": (1, size), "wrap": (1, wrap), "atan2": (2, angle),
    "angle": (3, angle), "length": (3, length), "least": (2, least), "greatest": (2, greatest),
}  # fmt: skip
"""What a text may call: how many arguments, and the function."""
NAMES = {*FUNCTIONS, "pi"}


def _scaled(a: Interval, by: Any, over: int = 1) -> Interval:
    return a if by == over else mul(a, point(arb(fmpq(by, over))))


def _derivatives(name: str, of: Any, x: Interval) -> Iterator[Interval]:
    """g^(j)(x) / j! of a smooth function, for j = 1, 2, 3."""
    match name:
        case "power":
            for j in (1, 2, 3):
                yield _scaled(power(x, of - j), comb(of, j)) if of > j else point(int(of == j))
        case "inverse":
            for j in (1, 2, 3):
                yield _scaled(power(inverse(x), j + 1), (-1) ** j)
        case "sqrt":
            for n, by in ((1, 2), (3, -8), (5, 16)):
                yield inverse(_scaled(power(root(x), n), by))
        case "exp":
            for over in (1, 2, 6):
                yield _scaled(exponential(x), 1, over)
        case "log":
            for n in (1, 2, 3):
                yield _scaled(power(inverse(x), n), (-1) ** (n + 1), n)
        case "sin" | "cos":
            a, b = (sine(x), cosine(x)) if name == "sin" else (cosine(x), neg(sine(x)))
            yield b
            yield _scaled(a, -1, 2)
            yield _scaled(b, -1, 6)
        case "tan" | "tanh":
            k = 1 if name == "tan" else -1
            t = FUNCTIONS[name][1](x)
            w, third = (add(point(1), _scaled(power(t, 2), n)) for n in (k, 3 * k))
            yield w
            yield _scaled(mul(t, w), k)
            yield _scaled(mul(w, third), k, 3)
        case "atan":
            v = inverse(add(point(1), power(x, 2)))
            yield v
            yield neg(mul(x, power(v, 2)))
            yield _scaled(mul(power(v, 3), sub(_scaled(power(x, 2), 3), point(1))), 1, 3)


# -- texts as operations -----------------------------------------------------------------------

PLAIN: dict[str, Callable[..., Interval]] = {
    "+": add,
    "-": sub,
    "*": mul,
    "negative": neg,
    "inverse": inverse,
}
SMOOTH = ("sin", "cos", "tan", "atan", "exp", "log", "tanh", "sqrt", "power", "inverse")
KNOWN: Mapping[str, Callable[..., Interval]] = {
    **PLAIN,
    **{name: function for name, (_, function) in FUNCTIONS.items()},
}
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*"}
_CHARACTERS = re.compile(r"[A-Za-z0-9_+\-*/(), ]*")

Operation = tuple[str, tuple[int, ...], Any]
"""A name, the numbers of its arguments, and an exponent, a number or a name."""


class Expression:
    """A text of names, whole numbers, + - * / **, and functions."""

    def __init__(self, text: Any) -> None:
        if not _CHARACTERS.fullmatch(text):  # no comments, and nothing that looks like another sign
            raise TextError("it has a character that no expression has")
        try:
            self.tree = ast.parse(text, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise TextError("it is no expression") from None
        self.text = text
        self.names = {o[2] for o in Tape([self]).operations if o[0] == "symbol"}
        self.parts: list[Expression] = []
        match self.tree:  # the arguments of a least or a greatest
            case ast.Call(func=ast.Name(id="least" | "greatest"), args=both):
                self.parts = [Expression(ast.unparse(part)) for part in both]

    @property
    def all_parts(self) -> bool:
        """Whether all of the parts have to hold."""
        match self.tree:
            case ast.Call(func=ast.Name(id="greatest")):
                return True
        return False


class Tape:
    """Expressions as operations, those that are the same once."""

    def __init__(self, expressions: Sequence[Expression]) -> None:
        self.operations: list[Operation] = []
        self._numbers: dict[Operation, int] = {}
        self.results = [self._of(e.tree) for e in expressions]
        plain = ("number", "pi", "symbol", *PLAIN, *SMOOTH)
        self.smooth = all(name in plain for name, *_ in self.operations)

    @property
    def is_zero(self) -> bool:
        """Whether the first expression is the number 0."""
        name, _, of = self.operations[self.results[0]]
        return name == "number" and of == 0

    def values(self, ranges: Mapping[str, Interval]) -> Row:
        """Of every operation."""
        row: Row = []
        for name, arguments, of in self.operations:
            if name == "power":
                row.append(power(row[arguments[0]], of))
            elif arguments:
                row.append(KNOWN[name](*[row[k] for k in arguments]))
            else:
                row.append(ranges[of] if name == "symbol" else constant(of))
        return row

    def of(self, every: Sequence[Any]) -> list[Any]:
        return [every[k] for k in self.results]

    def slopes(self, values: Row, along: Sequence[Mapping[str, Interval]]) -> list[list[Any]]:
        """Of the expressions, along numbers that change at these rates; None does not change."""
        columns: list[list[Any]] = [[] for _ in along]
        for (name, arguments, of), value in zip(self.operations, values, strict=True):
            x, by = [values[k] for k in arguments], None
            for every, rates in zip(columns, along, strict=True):
                slopes = [every[k] for k in arguments]
                if not any(slopes):
                    every.append(rates.get(of) if name == "symbol" else None)
                    continue
                if by is None:
                    by = _partials(name, of, value, x)
                if name in ("least", "greatest"):
                    every.append(_of_one(name, x, [s or (ZERO, ZERO) for s in slopes]))
                else:
                    some = [(b, s) for b, s in zip(by, slopes, strict=False) if s is not None]
                    every.append(dot([b for b, _ in some], [s for _, s in some]))
        return [self.of(every) for every in columns]

    def series(self, begin: Mapping[str, Interval], moving: Sequence[str], terms: int) -> list[Row]:
        """Coefficients in time of a trajectory with these rates: x_(k+1) = f(x)_k / (k + 1)."""
        values = self.values(begin)
        series: list[list[Any]] = [[v] for v in values]
        states = {name: [begin[name]] for name in moving}
        g = [list(_derivatives(name, of, values[arguments[0]])) if name in SMOOTH else []
             for name, arguments, of in self.operations]  # fmt: skip
        for k in range(1, terms):
            for row, rate in zip(states.values(), self.of(series), strict=True):
                row.append(mul(rate[k - 1] or (ZERO, ZERO), inverse(point(k))))
            if k + 1 == terms:
                break
            for (name, arguments, of), entry, by in zip(self.operations, series, g, strict=True):
                x = [series[j] for j in arguments]
                entry.append(
                    states[of][k] if name == "symbol" and of in states else _term(name, x, by, k)
                )
        return list(states.values())

    def comes_back(self, angle: str) -> bool:
        """Whether an angle stands as a summand inside sines and cosines alone."""
        summand: list[bool] = []
        for name, arguments, of in self.operations:
            some = any(summand[k] for k in arguments) or (name == "symbol" and of == angle)
            if some and arguments and name not in ("+", "-", "negative", "sin", "cos"):
                return False
            summand.append(some and name not in ("sin", "cos"))
        return not any(self.of(summand))

    def _of(self, body: ast.expr) -> int:
        waiting: list[tuple[ast.expr, bool]] = [(body, False)]
        done: list[int] = []
        while waiting:
            node, ready = waiting.pop()
            parts = _parts(node)
            if parts and not ready:
                waiting += [(node, True), *((part, False) for part in reversed(parts))]
                continue
            arguments = [done.pop() for _ in parts][::-1]
            done.append(self._operation(node, arguments))
        return done[0]

    def _operation(self, node: ast.expr, arguments: list[int]) -> int:
        match node:
            case ast.Constant(value=int(number)) if type(number) is int:
                return self._new("number", of=Fraction(number))
            case ast.Name(id="pi"):
                return self._new("pi")
            case ast.Name(id=name) if name not in NAMES:
                return self._new("symbol", of=name)
            case ast.UnaryOp(op=ast.USub()):
                return self._new("negative", *arguments)
            case ast.BinOp(op=ast.Pow(), right=exponent):
                return self._power(arguments[0], exponent)
            case ast.BinOp(op=ast.Div()):
                return self._new("*", arguments[0], self._new("inverse", arguments[1]))
            case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() as operation):
                return self._new(_OPERATORS[type(operation)], *arguments)
            case ast.Call(func=ast.Name(id=name), keywords=[]) if name in FUNCTIONS:
                if len(arguments) == FUNCTIONS[name][0]:
                    return self._new(name, *arguments)
        raise TextError("it has something that no expression has")

    def _power(self, base: int, exponent: ast.expr) -> int:
        try:
            twice = 2 * Fraction(ast.unparse(exponent).replace(" ", ""))
        except ValueError:
            raise TextError("it has an exponent that is no number") from None
        if twice.denominator != 1 or not 0 < abs(twice) <= 2 * MOST_POWER:
            raise TextError(f"the exponent {twice / 2} is no half of a whole number, or large")
        whole, half = divmod(abs(int(twice)), 2)
        parts = [self._new("power", base, of=whole)] if whole else []
        parts += [self._new("sqrt", base)] if half else []
        index = self._new("*", *parts) if len(parts) > 1 else parts[0]
        return index if twice > 0 else self._new("inverse", index)

    def _new(self, name: str, *arguments: int, of: Any = None) -> int:
        """Numbers of numbers are a number, a product of a thing with itself is its square."""
        numbers = [of for name, _, of in map(self.operations.__getitem__, arguments)
                   if name == "number"]  # fmt: skip
        if arguments and len(numbers) == len(arguments):
            number = _folded(name, numbers, of)
            if number is not None:
                name, arguments, of = "number", (), number
        if name == "*" and arguments[0] == arguments[1]:
            return self._new("power", arguments[0], of=2)
        if name == "power" and of == 1:
            return arguments[0]
        operation = name, arguments, of
        if operation not in self._numbers:
            self._numbers[operation] = len(self.operations)
            self.operations.append(operation)
        return self._numbers[operation]


def _parts(node: ast.expr) -> list[ast.expr]:
    match node:
        case ast.UnaryOp(operand=inner):
            return [inner]
        case ast.BinOp(left=left, op=ast.Pow()):
            return [left]
        case ast.BinOp(left=left, right=right):
            return [left, right]
        case ast.Call(args=arguments):
            return arguments
    return []


@functools.cache
def constant(number: Fraction | None) -> Interval:
    """A number, or pi."""
    q = arb.pi() if number is None else arb(fmpq(number.numerator, number.denominator))
    return interval(q, q)


def _folded(name: str, numbers: list[Fraction], of: Any) -> Fraction | None:
    long = sum(n.numerator.bit_length() + n.denominator.bit_length() for n in numbers)
    if long * (of or 1) > LONGEST_NUMBER:
        raise TextError("it has a number that is too long")
    match name, numbers:
        case "+" | "-", [a, b]:
            return a + b if name == "+" else a - b
        case "*", [a, b]:
            return a * b
        case "negative", [a]:
            return -a
        case "inverse", [a] if a:
            return 1 / a
        case "power", [a]:
            return Fraction(a**of)
    return None


def _partials(name: str, of: Any, value: Interval, x: Row) -> Row:
    """The derivatives of one operation by its arguments."""
    match name:
        case "negative":
            return [point(-1)]
        case "+" | "-":
            return [point(1), point(1 if name == "+" else -1)]
        case "*":
            return [x[1], x[0]]
        case "Abs" | "magnitude":
            return [sign(x[0])]
        case "length":
            some = value[0] > ZERO
            return [common(mul(q, inverse(value)), BOTH) if some else BOTH for q in x[:2]]
        case "angle" | "atan2" if not turns(x[0], x[1]):
            over = inverse(add(power(x[0], 2), power(x[1], 2)))
            return [mul(x[1], over), neg(mul(x[0], over))]
        case "wrap" if value[1] - value[0] < arb.pi():
            return [point(1)]
        case name if name in SMOOTH:
            return [next(_derivatives(name, of, x[0]))]
    return [UNKNOWN] * len(x)


def _of_one(name: str, x: Row, slopes: Row) -> Interval:
    """The slope of a least or a greatest: that of the one that it is, or between both."""
    (p, q), (a, b) = x, slopes
    below, above = (a, b) if name == "least" else (b, a)  # where the first is the least, or not
    return below if p[1] <= q[0] else above if q[1] <= p[0] else hull(a, b)


def _term(name: str, x: list[Any], g: Row, k: int) -> Any:
    """The coefficient k in time of one operation, from those of its arguments."""
    match name:
        case "+" | "-":
            a, b = x[0][k], x[1][k]
            b = neg(b) if b and name == "-" else b
            return add(a, b) if a and b else a or b
        case "*":
            return _sum(_product(x[0][j], x[1][k - j]) for j in range(k + 1))
        case "negative":
            return x[0][k] and neg(x[0][k])
        case name if name in SMOOTH:
            first, second = x[0][1], x[0][2] if k > 1 else None
            parts = [_product(g[0], x[0][k])]
            if k == 2:
                parts.append(_product(g[1], first and power(first, 2)))
            if k == 3:
                parts.append(_product(_product(g[1], point(2)), _product(first, second)))
                parts.append(_product(g[2], first and power(first, 3)))
            return _sum(parts)
    return None


def _product(a: Any, b: Any) -> Any:
    return mul(a, b) if a and b else None


def _sum(parts: Iterable[Any]) -> Any:
    some = [part for part in parts if part]
    return functools.reduce(add, some) if some else None
