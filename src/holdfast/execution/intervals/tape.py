"""Expressions as a list of operations: their values over boxes, their slopes, and series in time.

The operations are those of the text of the expressions, in its order, and every one of them is
isotone: narrower intervals give narrower ones. A program that reads the same text and rounds less,
such as `holdfast-check`, has enclosures that lie in these.

Of a function g of x the Taylor coefficients g_j = g^(j)(x) / j! give slopes, g_1 x', and series:

    (g o x)_1 = g_1 x_1,   (g o x)_2 = g_1 x_2 + g_2 x_1^2,
    (g o x)_3 = g_1 x_3 + 2 g_2 x_1 x_2 + g_3 x_1^3

Functions with a kink have slopes, which where both sides may be are those of both, and no series.
Of a slope where a function may jump nothing is known.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import comb
from typing import Any

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.execution.arithmetic.steps import FLOAT, Steps
from holdfast.execution.intervals import enclosure
from holdfast.execution.intervals.enclosure import (
    FUNCTIONS,
    Interval,
    IntervalLowering,
    chosen,
    hull,
    unknown_where,
)
from holdfast.maths.expressions.traversal import plain_text

Known = Mapping[str, Interval]
Row = list[Interval]
Slopes = list[Interval | None]
"""None where an operation does not depend on what it is derived by."""

SMOOTH = ("sin", "cos", "tan", "atan", "exp", "log", "tanh", "power", "inverse", "root")
"""Functions of one number with a series."""

_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*"}


@dataclass(frozen=True)
class Operation:
    """A function of earlier operations, by their numbers. of: a name, a number, an exponent."""

    name: str
    arguments: tuple[int, ...] = ()
    of: Any = None


class Tape:
    """Expressions; operations that are the same are one.

    Raises `DefinitionError` for functions without an enclosure.
    """

    def __init__(self, expressions: Iterable[Any]) -> None:
        self.operations: list[Operation] = []
        self._numbers: dict[Operation, int] = {}
        self.results = [self._of(ast.parse(plain_text(e), mode="eval").body) for e in expressions]

    @property
    def smooth(self) -> bool:
        """Whether all of it has series."""
        plain = ("number", "pi", "symbol", "negative", *_OPERATORS.values(), *SMOOTH)
        return all(o.name in plain for o in self.operations)

    def values(self, steps: Steps, ranges: Known) -> Row:
        """Of every operation."""
        row: Row = []
        for o in self.operations:
            row.append(_value(steps, o, [row[k] for k in o.arguments], ranges))
        return row

    def slopes(self, values: Row, by: Known) -> Slopes:
        """Of every operation, along numbers that change at these rates."""
        all_slopes: Slopes = []
        for o, value in zip(self.operations, values, strict=True):
            if o.name == "symbol":
                all_slopes.append(by.get(o.of))
                continue
            slopes = [all_slopes[k] for k in o.arguments]
            none = all(s is None for s in slopes)
            all_slopes.append(
                None if none else _slope(o, value, [values[k] for k in o.arguments], slopes)
            )
        return all_slopes

    def of(self, row: Sequence[Any]) -> list[Any]:
        """What is said of the expressions, from what is said of every operation."""
        return [row[k] for k in self.results]

    def series(self, steps: Steps, ranges: Known, moving: Sequence[str], terms: int) -> list[Row]:
        """Coefficients in time of a trajectory with these rates of the moving quantities.

        x_0 is known, x_(k+1) = f(x)_k / (k + 1): a row for each quantity. Raises `ValueError` where
        the rates have no series.
        """
        values = self.values(steps, ranges)
        series: list[list[Interval | None]] = [[v] for v in values]
        coefficients = [[ranges[name]] for name in moving]
        for k in range(terms - 1):
            share = Interval.point(steps, float(k + 1)).inverse()
            for row, rate in zip(coefficients, self.of(series), strict=True):
                row.append(_or_zero(steps, rate[k]) * share)
            rows = dict(zip(moving, coefficients, strict=True))
            for o, expansion in zip(self.operations, series if k + 2 < terms else [], strict=False):
                if o.name == "symbol":
                    expansion.append(rows[o.of][k + 1] if o.of in rows else None)
                else:
                    expansion.append(_term(steps, o, [series[j] for j in o.arguments], k + 1))
        return coefficients

    def _of(self, body: ast.expr) -> int:
        """The number of a text's last operation: sums of any length, without recursion."""
        waiting: list[tuple[ast.expr, bool]] = [(body, False)]
        done: list[int] = []
        while waiting:
            node, ready = waiting.pop()
            parts = _parts(node)
            if parts and not ready:
                waiting.append((node, True))
                waiting += [(part, False) for part in reversed(parts)]
                continue
            arguments = [done.pop() for _ in parts][::-1]
            done.append(self._operation(node, arguments))
        return done[0]

    def _operation(self, node: ast.expr, arguments: list[int]) -> int:
        match node:
            case ast.Constant(value=int(whole)):
                return self._new("number", of=Fraction(whole))
            case ast.Name(id="pi"):
                return self._new("pi")
            case ast.Name(id=name):
                return self._new("symbol", of=name)
            case ast.UnaryOp():
                return self._new("negative", *arguments)
            case ast.BinOp(op=ast.Pow(), right=right):
                return self._power(arguments[0], Fraction(ast.unparse(right).replace(" ", "")))
            case ast.BinOp(op=ast.Div()):
                return self._new("*", arguments[0], self._new("inverse", arguments[1]))
            case ast.BinOp(op=operation):
                return self._new(_OPERATORS[type(operation)], *arguments)
            case ast.Call(func=ast.Name(id="sqrt")):
                return self._new("root", *arguments)
            case ast.Call(func=ast.Name(id=name)) if name in FUNCTIONS:
                return self._new(name, *arguments)
        raise DefinitionError(f"'{ast.unparse(node):.60}' has no proved enclosure")

    def _power(self, base: int, exponent: Fraction) -> int:
        whole, half = divmod(int(abs(2 * exponent)), 2)
        power = self._new("power", base, of=whole) if whole else None
        if half:
            root = self._new("root", base)
            power = root if power is None else self._new("*", power, root)
        assert power is not None
        return power if exponent > 0 else self._new("inverse", power)

    def _new(self, name: str, *arguments: int, of: Any = None) -> int:
        """Numbers of numbers are folded, squares and first powers told by what they are."""
        parts = [self.operations[k] for k in arguments]
        if parts and all(p.name == "number" for p in parts):
            number = _folded(name, [p.of for p in parts], of)
            if number is not None:
                return self._new("number", of=number)
        if name == "*" and arguments[0] == arguments[1]:
            return self._new("power", arguments[0], of=2)
        if name == "power" and of == 1:
            return arguments[0]
        operation = Operation(name, arguments, of)
        if operation not in self._numbers:
            self._numbers[operation] = len(self.operations)
            self.operations.append(operation)
        return self._numbers[operation]


def _parts(node: ast.expr) -> list[ast.expr]:
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return [inner]
        case ast.BinOp(left=left, op=ast.Pow()):
            return [left]
        case ast.BinOp(left=left, right=right):
            return [left, right]
        case ast.Call(args=arguments):
            return arguments
    return []


def _folded(name: str, numbers: Sequence[Fraction], of: Any) -> Fraction | None:
    match name, numbers:
        case "+", [a, b]:
            return a + b
        case "-", [a, b]:
            return a - b
        case "*", [a, b]:
            return a * b
        case "negative", [a]:
            return -a
        case "inverse", [a] if a:
            return 1 / a
        case "power", [a]:
            return Fraction(a**of)
    return None


# -- values, slopes and terms of one operation ---------------------------------------------------


def _value(steps: Steps, o: Operation, x: Row, ranges: Known) -> Interval:
    match o.name:
        case "number":
            return number(steps, o.of)
        case "pi":
            low, high = enclosure.PI_LOW, enclosure.PI_HIGH
            return Interval(steps.constant(low, FLOAT), steps.constant(high, FLOAT))
        case "symbol":
            return ranges[o.of]
        case "negative":
            return -x[0]
        case "+":
            return x[0] + x[1]
        case "-":
            return x[0] - x[1]
        case "*":
            return x[0] * x[1]
        case name if name in SMOOTH:
            return _coefficients(steps, o, x[0], 0)[0]
        case "length" | "angle":  # the last argument is for slopes
            return FUNCTIONS[o.name](*x[:2])
    interval: Interval = FUNCTIONS[o.name](*x)
    return interval


def number(steps: Steps, exact: Fraction) -> Interval:
    """A number: itself if it is a float, and else between two neighbours."""
    value: Any = IntervalLowering(steps, {}).value(sp.Rational(exact.numerator, exact.denominator))
    return value


def _coefficients(steps: Steps, o: Operation, x: Interval, most: int) -> Row:
    """g_0, ..., g_most of a smooth function at x."""

    def some(*each: Any) -> Row:
        return [make() for make in each[: most + 1]]

    def times(a: Interval, b: Interval, c: float = 1.0, parts: int = 1) -> Interval:
        return a * b * number(steps, Fraction(c) / parts)

    one = Interval.point(steps, 1.0)
    match o.name:
        case "power":
            n = int(o.of)
            return some(*(lambda j=j: _share_of_power(steps, x, n, j) for j in range(4)))
        case "inverse":
            i = x.inverse()
            signed = (1.0, -1.0, 1.0, -1.0)
            return some(*(lambda j=j: i.power(j + 1) * Interval.point(steps, signed[j])
                          for j in range(4)))  # fmt: skip
        case "root":
            r = x.root()
            return some(
                lambda: r,
                lambda: (r * Interval.point(steps, 2.0)).inverse(),
                lambda: (r.power(3) * Interval.point(steps, -8.0)).inverse(),
                lambda: (r.power(5) * Interval.point(steps, 16.0)).inverse(),
            )
        case "exp":
            e = enclosure.exponential_of(x)
            return some(
                lambda: e, lambda: e, lambda: times(e, one, 1, 2), lambda: times(e, one, 1, 6)
            )
        case "log":
            return some(
                lambda: enclosure.logarithm(x),
                x.inverse,
                lambda: times(x.inverse().power(2), one, -1, 2),
                lambda: times(x.inverse().power(3), one, 1, 3),
            )
        case "sin" | "cos":
            s, c = enclosure.sine(x), enclosure.cosine(x)
            a, b = (s, c) if o.name == "sin" else (c, -s)
            return some(
                lambda: a, lambda: b, lambda: times(a, one, -1, 2), lambda: times(b, one, -1, 6)
            )
        case "tan" | "tanh":
            sign = 1.0 if o.name == "tan" else -1.0
            t = FUNCTIONS[o.name](x)
            w = one + t.power(2) * Interval.point(steps, sign)
            third = one + t.power(2) * Interval.point(steps, sign * 3)
            return some(
                lambda: t, lambda: w, lambda: times(t, w, sign), lambda: times(w, third, sign, 3)
            )
    v = (one + x.power(2)).inverse()  # of atan
    return some(
        lambda: enclosure.arctangent(x),
        lambda: v,
        lambda: times(x, v.power(2), -1),
        lambda: times(v.power(3), x.power(2) * Interval.point(steps, 3.0) - one, 1, 3),
    )


def _share_of_power(steps: Steps, x: Interval, n: int, j: int) -> Interval:
    """comb(n, j) x^(n - j)."""
    if j >= n:
        return Interval.point(steps, float(j == n))
    return x.power(n - j) * Interval.point(steps, float(comb(n, j)))


def _slope(o: Operation, value: Interval, x: Row, slopes: Slopes) -> Interval:
    """Of one operation, of whose arguments one at least moves."""
    steps = value.steps
    first, *others = slopes
    match o.name:
        case "negative":
            assert first is not None
            return -first
        case "+" | "-":
            (second,) = others
            return _added(first, -second if second is not None and o.name == "-" else second)
        case "*":
            parts = (None if s is None else s * q for s, q in zip(slopes, x[::-1], strict=True))
            return _added(*parts)
        case name if name in SMOOTH:
            assert first is not None
            return _coefficients(steps, o, x[0], 1)[1] * first
        case "Abs" | "magnitude":
            assert first is not None
            return enclosure.sign(x[0]) * first
        case "least" | "greatest" | "Min" | "Max" if len(x) == 2:
            a, b = x if o.name in ("least", "Min") else x[::-1]  # where a <= b it is the first
            p, q = (_or_zero(steps, s) for s in slopes)
            return chosen(a.high <= b.low, p, chosen(b.high <= a.low, q, hull(p, q)))
        case "length":
            both = Interval(steps.constant(-1.0, FLOAT), steps.constant(1.0, FLOAT))
            by = [chosen(value.low > 0.0, (q * value.inverse()).within(-1.0, 1.0), both)
                  for q in x[:2]]  # fmt: skip
            return _added(*(None if s is None else b * s for b, s in zip(by, slopes, strict=False)))
        case "angle" | "atan2":
            over = (x[0].power(2) + x[1].power(2)).inverse()
            by = [x[1] * over, -(x[0] * over)]
            slope = _added(
                *(None if s is None else b * s for b, s in zip(by, slopes, strict=False))
            )
            jumps = ~((x[1].low > 0.0) | (x[0].low > 0.0) | (x[0].high < 0.0))
            return unknown_where(jumps, slope)
        case "wrap":
            assert first is not None
            jumps = (value.low <= -enclosure.PI_LOW) & (value.high >= enclosure.PI_LOW)
            return unknown_where(jumps, first)
    nan = float("nan")
    return Interval(steps.constant(nan, FLOAT), steps.constant(nan, FLOAT))


def _term(steps: Steps, o: Operation, x: list[list[Interval | None]], k: int) -> Interval | None:
    """The coefficient k in time of one operation, from those of its arguments."""
    match o.name:
        case "number" | "pi":
            return None
        case "negative":
            return None if x[0][k] is None else -x[0][k]  # type: ignore[operator]
        case "+" | "-":
            a, b = x[0][k], x[1][k]
            b = -b if b is not None and o.name == "-" else b
            return None if a is None and b is None else _added(a, b)
        case "*":
            pairs = ((x[0][j], x[1][k - j]) for j in range(k + 1))
            parts = [a * b for a, b in pairs if a is not None and b is not None]
            return _added(*parts) if parts else None
        case name if name in SMOOTH:
            return _composed(_coefficients(steps, o, x[0][0], k), x[0], k)  # type: ignore[arg-type]
    raise ValueError(f"{o.name} has no series")


def _composed(g: Row, x: list[Interval | None], k: int) -> Interval | None:
    def product(*factors: Interval | None) -> Interval | None:
        if None in factors:
            return None
        multiplied, *others = (f for f in factors if f is not None)
        for other in others:
            multiplied = multiplied * other
        return multiplied

    parts = [product(g[1], x[k])]
    if k == 2:
        parts.append(product(g[2], _powered(x[1], 2)))
    if k == 3:
        two = Interval.point(g[0].steps, 2.0)
        parts += [product(g[2], two, x[1], x[2]), product(g[3], _powered(x[1], 3))]
    return None if parts == [None] * len(parts) else _added(*parts)


def _powered(x: Interval | None, exponent: int) -> Interval | None:
    return None if x is None else x.power(exponent)


def _added(*parts: Interval | None) -> Interval:
    total: Interval | None = None
    for part in parts:
        if part is not None:
            total = part if total is None else total + part
    assert total is not None
    return total


def _or_zero(steps: Steps, x: Interval | None) -> Interval:
    return Interval.point(steps, 0.0) if x is None else x
