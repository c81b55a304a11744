"""Intervals as pairs of steps, and the interval extension of expressions: boxes in, intervals out.

The floats next to a result of IEEE 754 in rounding to nearest come from arithmetic alone
(S. M. Rump, P. Zimmermann, S. Boldo, G. Melquiond, Computing predecessor and successor in rounding
to nearest, BIT 49, 2009): with phi = 2^-53 (1 + 2^-52) and eta the least subnormal number

    x - (phi |x| + eta) <= predecessor of x,      x + (phi |x| + eta) >= successor of x

A sum that is subnormal or zero is exact, as it is a multiple of eta: so x - 2^-52 |x| and
x + 2^-52 |x| contain the real sum that rounds to x, and the difference of equal numbers is 0.

An end that is not a number says that nothing is known; every comparison with it is false.

Rows of intervals and operations on them are made of the same steps.

Elementary functions have errors that are proved here.

Sine, cosine and exponential of a float are Taylor polynomials after a reduction of the argument:

    sum of k terms, Horner's scheme:  |error| <= 2 k u S + remainder,   u = 2^-53,

with S the sum of the absolute values of the terms (N. J. Higham, Accuracy and Stability of
Numerical Algorithms, 2002, section 5.1; terms in u^2 are in the rounding up). The constants below
are these bounds. Angles and logarithms are verified: an approximation is as far from the truth as
its sine or exponential says. Other functions are made of these. Intervals follow from the ends, and
from the extremes between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.arithmetic import elementary
from holdfast.execution.arithmetic.steps import (
    FLOAT,
    Steps,
    Value,
    bits,
    ceil,
    choose,
    floor,
    from_bits,
    greatest_of,
    least_of,
    rint,
    root,
)
from holdfast.execution.arithmetic.steps import greatest as greatest_number
from holdfast.execution.arithmetic.steps import least as least_number
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import Lowering
from holdfast.execution.leaf import compiled_leaves

PHI = 2.0**-53 * (1 + 2.0**-52)
ETA = 5e-324
ULP = 2.0**-52
TURN = 6.283185307179587
"""The float above 2 pi."""


def below(x: Value) -> Value:
    """A float below every real number that rounds to x."""
    return x - (abs(x) * PHI + ETA)


def above(x: Value) -> Value:
    """A float above every real number that rounds to x."""
    return x + (abs(x) * PHI + ETA)


def below_sum(x: Value) -> Value:
    """A float that is at most a real sum that rounds to x."""
    return x - abs(x) * ULP


def above_sum(x: Value) -> Value:
    """A float that is at least a real sum that rounds to x."""
    return x + abs(x) * ULP


@dataclass(frozen=True, eq=False)
class Interval:
    """[low, high]. number: the one that it is, if that is known before anything is computed."""

    low: Value
    high: Value
    number: float | None = None

    @property
    def steps(self) -> Steps:
        return self.low.steps

    @staticmethod
    def point(steps: Steps, number: float) -> Interval:
        """One float."""
        value = steps.constant(number, FLOAT)
        return Interval(value, value, number)

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low, None if self.number is None else -self.number)

    def copy(self) -> Interval:
        """Another quantity of the same interval: a product of the two is no square."""
        return Interval(self.low, self.high)

    def __add__(self, other: Interval) -> Interval:
        if self.number == 0:
            return other
        if other.number == 0:
            return self
        return Interval(below_sum(self.low + other.low), above_sum(self.high + other.high))

    def __sub__(self, other: Interval) -> Interval:
        if other.number == 0:
            return self
        if self.number == 0:
            return -other
        return Interval(below_sum(self.low - other.high), above_sum(self.high - other.low))

    def __mul__(self, other: Interval) -> Interval:
        if self is other:
            return self.power(2)
        if other.number is not None:
            self, other = other, self
        if self.number is not None:
            return other._times(self.number)
        products = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return Interval(below(smallest(*products)), above(largest(*products)))

    def _times(self, number: float) -> Interval:
        if number == 0:
            return Interval.point(self.steps, 0.0)
        if number == 1:
            return self
        if number == -1:
            return -self
        low, high = (self.low, self.high) if number > 0 else (self.high, self.low)
        return Interval(below(low * number), above(high * number))

    def __truediv__(self, other: Interval) -> Interval:
        return self * other.inverse()

    def inverse(self) -> Interval:
        """1 / x; nothing is known of it where x may be 0."""
        may_be = ~((self.low > 0.0) | (self.high < 0.0))
        return unknown_where(may_be, Interval(below(1.0 / self.high), above(1.0 / self.low)))

    def __abs__(self) -> Interval:
        high = largest(-self.low, self.high)
        low = choose(self.low >= 0.0, self.low, choose(self.high <= 0.0, -self.high, 0.0))
        return unknown_where(self.unknown, Interval(low, high))

    @property
    def unknown(self) -> Value:
        """Whether an end is not a number."""
        return self.low.differs(self.low) | self.high.differs(self.high)

    def not_negative(self) -> Interval:
        """Of a quantity that never is: its low end is at least 0."""
        return Interval(largest(self.low, self.steps.constant(0.0, FLOAT)), self.high)

    def power(self, exponent: int) -> Interval:
        """x^n for a whole number n above 0."""
        if exponent == 1:
            return self
        if exponent % 2 == 0:
            size = abs(self)
            return Interval(
                _product(size.low, exponent, below), _product(size.high, exponent, above)
            ).not_negative()
        # odd powers grow
        return Interval(
            _signed_product(self.low, exponent, below), _signed_product(self.high, exponent, above)
        )

    def root(self) -> Interval:
        """The square root; nothing is known of it where x may be negative."""
        roots = Interval(below(root(self.low)), above(root(self.high))).not_negative()
        return unknown_where(~(self.low >= 0.0), roots)

    def widened(self, by: Value | float) -> Interval:
        """With every number that is within `by` of one of these."""
        return Interval(below_sum(self.low - by), above_sum(self.high + by))

    def within(self, low: Value | float, high: Value | float) -> Interval:
        """The part between two numbers, of a quantity that is always there."""
        return Interval(
            choose(self.low < low, low, self.low), choose(self.high > high, high, self.high)
        )


def smallest(*values: Value) -> Value:
    """The least; not a number if one is not."""
    least = values[0]
    for value in values[1:]:
        least = least_number(least, value)
    return least


def largest(*values: Value) -> Value:
    """The greatest; not a number if one is not."""
    greatest = values[0]
    for value in values[1:]:
        greatest = greatest_number(greatest, value)
    return greatest


def hull(*parts: Interval) -> Interval:
    """The least interval that contains the parts."""
    return Interval(smallest(*(p.low for p in parts)), largest(*(p.high for p in parts)))


def chosen(condition: Value, a: Interval, b: Interval) -> Interval:
    """a where the condition is true, else b."""
    return Interval(choose(condition, a.low, b.low), choose(condition, a.high, b.high))


def unknown_where(condition: Value, x: Interval) -> Interval:
    """x, of which nothing is known where the condition is true."""
    nan = float("nan")
    return Interval(choose(condition, nan, x.low), choose(condition, nan, x.high))


def _product(x: Value, exponent: int, rounded: object) -> Value:
    """x^n of x >= 0, each product rounded one way."""
    product = x
    for _ in range(exponent - 1):
        product = rounded(product * x)  # type: ignore[operator]
    return product


def _signed_product(x: Value, exponent: int, rounded: object) -> Value:
    """x^n for an odd n, rounded one way: its size towards the same side, or away from it."""
    if exponent == 1:
        return x
    size = abs(x)
    toward, away = (above, below) if rounded is above else (below, above)
    positive = _product(size, exponent, toward)
    negative = -_product(size, exponent, away)
    return choose(x >= 0.0, positive, negative)


GROWTH, FITS = 0.1, 0.099
"""The part of its width by which a guess of the way is wider, and within which what it leads to has
to be: the checker takes a number between."""

Row = list[Interval]


def pairs(steps: Steps, rows: Sequence[str]) -> Row:
    ends = [steps.input(name) for name in rows]
    return [Interval(a, b) for a, b in zip(ends[0::2], ends[1::2], strict=True)]


def constant(steps: Steps, low: float, high: float) -> Interval:
    if low == high:
        return Interval.point(steps, float(low))
    return Interval(steps.constant(float(low), FLOAT), steps.constant(float(high), FLOAT))


def middle(x: Interval) -> Interval:
    value = 0.5 * (x.low + x.high)
    return Interval(value, value)


def number(steps: Steps, value: float) -> Interval:
    return Interval.point(steps, value)


def share(steps: Steps, whole: int) -> Interval:
    """One part of so many."""
    return number(steps, float(whole)).inverse()


def grown(x: Interval, by: float = GROWTH) -> Interval:
    """Wider by a part of its width."""
    return x.widened((x.high - x.low) * by)


def common(a: Interval, b: Interval) -> Interval:
    """What both contain; one of them where the other is not known."""
    low = choose(a.low.differs(a.low), b.low, choose(b.low > a.low, b.low, a.low))
    high = choose(a.high.differs(a.high), b.high, choose(b.high < a.high, b.high, a.high))
    return Interval(low, high)


def dot(row: Row, x: Row, steps: Steps) -> Interval:
    total = Interval.point(steps, 0.0)
    for a, b in zip(row, x, strict=True):
        total = total + a * b
    return total


def every(steps: Steps, conditions: Sequence[Value]) -> Value:
    all_true = steps.constant(0.0, FLOAT) <= 0.0
    for condition in conditions:
        all_true = all_true & condition
    return all_true


FARTHEST = 1e5
"""Angles beyond it are not reduced: nothing is known of their sine but that it is one."""

SINE_ERROR = 1e-14
"""Of the sine and the cosine of a float up to FARTHEST.

The quarter turns n <= 63662 times the first two parts of pi/2, of 33 bits, are exact; the two
subtractions round by less than u (0.79 + 0.79) < 1.8e-16; the third part and the rest of pi/2 are
below 2.03e-21, times n 1.3e-16. The polynomials have at most ten terms in y^2, |y| < 0.79: with the
rounding of y^2 and of the coefficients 31 u cosh(0.79) < 4.6e-15; the remainders are below
0.79^19/19! < 1e-19.
"""

EXPONENTIAL_ERROR = 1e-14
"""Relative, of the exponential of a float where it is no extreme one.

|k| <= 1075; k times the first part of ln 2, of 32 bits, is exact; the subtractions and the product
round by less than 2 u 0.36 + 1075 u 2e-10 < 9e-17, and the rest of ln 2 is below 3e-26, times k
4e-23. Fifteen terms, |r| < 0.36, and their coefficients: 31 u exp(0.36) < 5e-15 of at least
exp(-0.36) > 0.69, which is 7.2e-15; the remainder is 0.36^15/15! < 2e-19.
"""

QUARTER = elementary.QUARTER
PI_LOW, PI_HIGH = 3.141592653589793, 3.1415926535897936
"""Pi lies between these two floats."""


# -- of floats ----------------------------------------------------------------------------


def _sine_and_cosine(x: Value) -> tuple[Value, Value]:
    """Approximations within SINE_ERROR for |x| <= FARTHEST."""
    n = rint(x * elementary.TURNS)
    y = (x - n * QUARTER[0]) - n * QUARTER[1]
    s = y * y
    sine = y * _series(s, [(-1) ** k / math.factorial(2 * k + 1) for k in range(9)])
    cosine = _series(s, [(-1) ** k / math.factorial(2 * k) for k in range(10)])
    quarter = bits(n + elementary.ROUNDER) & 3
    odd = (quarter & 1).equals(1)
    a, b = choose(odd, cosine, sine), choose(odd, sine, cosine)
    return (
        from_bits(bits(a) ^ ((quarter & 2) << 62)),
        from_bits(bits(b) ^ (((quarter + 1) & 2) << 62)),
    )


def _series(x: Value, coefficients: list[float]) -> Value:
    """Horner's scheme."""
    total: Value = x.steps.constant(coefficients[-1], FLOAT)
    for c in reversed(coefficients[:-1]):
        total = total * x + c
    return total


def _sines(x: Value) -> tuple[Interval, Interval]:
    """The sine and the cosine of a float."""
    s, c = _sine_and_cosine(x)
    near = abs(x) <= FARTHEST
    intervals = []
    for value in (s, c):
        inside = Interval(value, value).widened(SINE_ERROR).within(-1.0, 1.0)
        intervals.append(chosen(near, inside, _both_sides(x)))
    return intervals[0], intervals[1]


def _both_sides(x: Value) -> Interval:
    return Interval(x.steps.constant(-1.0, FLOAT), x.steps.constant(1.0, FLOAT))


def _power_of_e(x: Value) -> Interval:
    """The exponential of a float."""
    inside = least_of(greatest_of(x, -745.0), 709.0)
    k = rint(inside * elementary.INVERSE_LN2)
    r = (inside - k * elementary.LN2[0]) - k * elementary.LN2[1]
    value = elementary.scaled(_series(r, [1 / math.factorial(j) for j in range(15)]), k)
    low = value - (value * EXPONENTIAL_ERROR + 2 * ETA)
    high = value + (value * EXPONENTIAL_ERROR + 2 * ETA)
    zero, infinite = x.steps.constant(0.0, FLOAT), x.steps.constant(math.inf, FLOAT)
    low = choose(x < -745.0, zero, choose(low > 0.0, low, 0.0))
    power = Interval(low, choose(x > 709.0, infinite, high))
    return unknown_where(x.differs(x), power)


def _logarithm(x: Value) -> Interval:
    """Of a float above 0: of z = log x rounded, log x = z + log(x e^-z)."""
    z = elementary.logarithm(x)
    near = Interval(x, x) * _power_of_e(-z) - Interval.point(x.steps, 1.0)
    off = largest(abs(near.low), abs(near.high))
    off = off * (1 + 1e-6) + ETA  # |log(1 + d)| <= |d| / (1 - |d|)
    interval = Interval(z, z).widened(off)
    extreme = ~((x > 1e-300) & (x < 1e300) & (off < 1e-7))
    return unknown_where(extreme, interval)


def _direction(y: Value, x: Value) -> Interval:
    """The angle of (x, y), two floats that are not both 0, in [-pi, pi].

    With an approximation z the truth is z + d with sin d = (y cos z - x sin z) / |(x, y)|, and
    cos d > 0 is checked.
    """
    z = elementary.angle_of(y, x)
    s, c = _sines(z)
    a, b = Interval(x, x), Interval(y, y)
    across, along = b * c - a * s, a * c + b * s
    size = (a.power(2) + b.power(2)).not_negative().root()
    off = largest(abs(across.low), abs(across.high)) / size.low * (1 + 1e-6) + ETA
    sure = (along.low > 0.0) & (off < 1e-7)
    extreme = ~((size.low > 1e-140) & (size.high < 1e140) & sure)
    return unknown_where(extreme, Interval(z, z).widened(off))


# -- of intervals -------------------------------------------------------------------------


def sine(x: Interval) -> Interval:
    """Between the sines of the ends, and to 1 and -1 where they are between."""
    return _wave(x, 0.25, _sines(x.low)[0], _sines(x.high)[0])


def cosine(x: Interval) -> Interval:
    return _wave(x, 0.0, _sines(x.low)[1], _sines(x.high)[1])


def _wave(x: Interval, crest: float, first: Interval, last: Interval) -> Interval:
    """A wave with crests at (crest + k) turns, from its values at the ends."""
    between = hull(first, last)
    up, down = _reached(x, crest), _reached(x, crest + 0.5)
    whole = ~(x.high - x.low < 6.28)
    far = ~((abs(x.low) <= FARTHEST) & (abs(x.high) <= FARTHEST))
    wave = Interval(
        choose(down | whole | far, -1.0, between.low), choose(up | whole | far, 1.0, between.high)
    )
    return unknown_where(x.unknown, wave)


def _reached(x: Interval, share: float) -> Value:
    """Whether some angle of (share + k) turns may be in the interval: surely, if one is."""
    turn = 1 / (2 * math.pi)
    low, high = x.low * turn - share, x.high * turn - share
    room_low, room_high = (abs(v) * 1e-14 + 1e-14 for v in (low, high))
    return floor(high + room_high) >= ceil(low - room_low)


def tangent(x: Interval) -> Interval:
    """Between the tangents of the ends; nothing is known where a pole may be between."""
    (s, c), (t, d) = _sines(x.low), _sines(x.high)
    pole = _reached(x, 0.25) | _reached(x, 0.75) | ~(x.high - x.low < 3.14)
    between = Interval((s / c).low, (t / d).high)
    return unknown_where(pole, between)


def exponential_of(x: Interval) -> Interval:
    """e^x."""
    return Interval(_power_of_e(x.low).low, _power_of_e(x.high).high)


def logarithm(x: Interval) -> Interval:
    """Nothing is known where x may be 0 or less."""
    interval = Interval(_logarithm(x.low).low, _logarithm(x.high).high)
    return unknown_where(~(x.low > 0.0), interval)


def direction(y: Interval, x: Interval) -> Interval:
    """atan2(y, x): from the corners; all angles where it may turn around."""
    corners = [_direction(b, a) for b in (y.low, y.high) for a in (x.low, x.high)]
    around = ~((x.low > 0.0) | (y.low > 0.0) | (y.high < 0.0))
    angles = hull(*corners)
    steps = x.steps
    every = Interval(steps.constant(-PI_HIGH, FLOAT), steps.constant(PI_HIGH, FLOAT))
    return unknown_where(x.unknown | y.unknown, chosen(around, every, angles))


def arctangent(x: Interval) -> Interval:
    one = x.steps.constant(1.0, FLOAT)
    return Interval(_direction(x.low, one).low, _direction(x.high, one).high)


def hyperbolic_tangent(x: Interval) -> Interval:
    """1 - 2 / (e^2x + 1), which grows."""
    ends = []
    for end in (x.low, x.high):
        e = exponential_of(Interval(end, end) * Interval.point(x.steps, 2.0))
        one = Interval.point(x.steps, 1.0)
        usual = one - Interval.point(x.steps, 2.0) * (e + one).inverse()
        large = abs(end) > 300.0
        ends.append(chosen(large, _both_sides(end), usual).within(-1.0, 1.0))
    return Interval(ends[0].low, ends[1].high)


def length(x: Interval, y: Interval) -> Interval:
    return (x.power(2) + y.power(2)).not_negative().root()


def wrapped(x: Interval) -> Interval:
    """x modulo 2 pi in (-pi, pi]; all of them where it may turn around."""
    steps = x.steps
    turn = 1 / (2 * math.pi)
    low, high = (v * turn - 0.5 for v in (x.low, x.high))
    room_low, room_high = (abs(v) * 1e-14 + 1e-14 for v in (low, high))
    first, last = ceil(low - room_low), ceil(high + room_high)
    pi = Interval(steps.constant(PI_LOW, FLOAT), steps.constant(PI_HIGH, FLOAT))
    turns = Interval(first, first) * pi * Interval.point(steps, 2.0)
    every = Interval(steps.constant(-PI_HIGH, FLOAT), steps.constant(PI_HIGH, FLOAT))
    unknown = ~(abs(x.low) <= FARTHEST) | ~(abs(x.high) <= FARTHEST)
    return unknown_where(x.unknown, chosen(~first.equals(last) | unknown, every, x - turns))


def sign_from_zero(x: Interval) -> Interval:
    """+1 for x >= 0, else -1."""
    return Interval(choose(x.low >= 0.0, 1.0, -1.0), choose(x.high < 0.0, -1.0, 1.0))


def sign(x: Interval) -> Interval:
    """+1, 0 or -1."""
    low = choose(x.low > 0.0, 1.0, choose(x.low >= 0.0, 0.0, -1.0))
    high = choose(x.high < 0.0, -1.0, choose(x.high <= 0.0, 0.0, 1.0))
    return Interval(low, high)


def select(x: Interval, a: Interval, b: Interval) -> Interval:
    """a for x >= 0, else b; both where x may be either."""
    return chosen(x.low >= 0.0, a, chosen(x.high < 0.0, b, hull(a, b)))


def least(a: Interval, b: Interval) -> Interval:
    return Interval(smallest(a.low, b.low), smallest(a.high, b.high))


def greatest(a: Interval, b: Interval) -> Interval:
    return Interval(largest(a.low, b.low), largest(a.high, b.high))


class IntervalLowering(Lowering):
    """Expressions as steps on the ends of intervals.

    A number that is a float is itself, another one lies between two neighbours. Raises
    `DefinitionError` for a function without an enclosure.
    """

    known: dict[sp.Basic, Any]

    def _number(self, e: sp.Basic) -> Any:
        value = float(e)
        if not math.isfinite(value) or (e.is_number and e == sp.Rational(value)):
            return Interval.point(self.steps, value)
        ends = (math.nextafter(value, sign * math.inf) for sign in (-1, 1))
        low, high = (self.steps.constant(end, "float") for end in ends)
        return Interval(low, high)

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> Any:
        x: Any = self.value(base)
        if exponent.is_Rational and (2 * exponent).is_Integer:
            whole, half = divmod(int(abs(2 * exponent)), 2)
            parts = ([x.power(whole)] if whole else []) + ([x.root()] if half else [])
            power = parts[0] * parts[1] if len(parts) > 1 else parts[0]
            return power if exponent > 0 else power.inverse()
        other: Any = self.value(exponent)
        return exponential_of(logarithm(x) * other)

    def _function(self, name: str, e: sp.Basic) -> Callable[..., Any]:
        if name not in FUNCTIONS:
            raise DefinitionError(f"function '{name}' has no proved enclosure: {e}")
        return FUNCTIONS[name]


def _folded(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    def apply(first: Any, *others: Any) -> Any:
        for other in others:
            first = function(first, other)
        return first

    return apply


FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sin": sine,
    "cos": cosine,
    "tan": tangent,
    "atan": arctangent,
    "atan2": direction,
    "angle": direction,
    "exp": exponential_of,
    "log": logarithm,
    "tanh": hyperbolic_tangent,
    "Abs": abs,
    "magnitude": abs,
    "Min": _folded(least),
    "Max": _folded(greatest),
    "least": least,
    "greatest": greatest,
    "sgn": sign_from_zero,
    "sign": sign,
    "select": select,
    "wrap": wrapped,
    "length": length,
}
"""Functions of expressions that have an enclosure."""


def interval_leaf(symbols: Sequence[sp.Symbol], expressions: Sequence[Any]) -> Leaf:
    """The leaf from the ends of the symbols, low and high in turn, to those of the expressions."""
    steps = Steps(expanded=True)
    rows = [f"q{i}" for i in range(2 * len(symbols))]
    inputs: dict[Any, Any] = {
        symbol: Interval(steps.input(rows[2 * i]), steps.input(rows[2 * i + 1]))
        for i, symbol in enumerate(symbols)
    }
    lowering = IntervalLowering(steps, inputs)
    intervals: list[Any] = [lowering.value(sp.sympify(e)) for e in expressions]
    return Leaf(steps, {"q": rows}, [end for i in intervals for end in (i.low, i.high)])


class Enclosure:
    """Intervals that contain all values of expressions over boxes of their symbols.

    Every rounding is counted. NaN says that nothing is known, such as of 1/x where x may be 0.
    Raises `DefinitionError` for a function without a proved enclosure and for other symbols.
    """

    def __init__(self, expressions: Sequence[Any], symbols: Sequence[Any]) -> None:
        self.count, self.width = len(expressions), len(symbols)
        self._leaves = compiled_leaves({"enclosure": interval_leaf(symbols, expressions)})

    def over(self, low: Array, high: Array) -> tuple[Array, Array]:
        """The ends of the expressions over boxes, shapes (boxes, expressions).

        low, high: the corners of the boxes, shapes (boxes, symbols).
        """
        low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        if low.shape != high.shape or low.ndim != 2 or low.shape[1] != self.width:
            raise SimulationError(
                f"corners have the shapes {low.shape} and {high.shape}",
                expected=f"(count, {self.width}), both",
            )
        ends = np.stack([low, high], axis=2).reshape(len(low), 2 * self.width)
        bounds = self._leaves.values("enclosure", len(low), 2 * self.count, ends)
        return bounds[:, 0::2], bounds[:, 1::2]
