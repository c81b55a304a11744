"""Intervals as pairs of steps, rounded outward: they contain every real value of an operation.

The floats next to a result of IEEE 754 in rounding to nearest come from arithmetic alone
(S. M. Rump, P. Zimmermann, S. Boldo, G. Melquiond, Computing predecessor and successor in rounding
to nearest, BIT 49, 2009): with phi = 2^-53 (1 + 2^-52) and eta the least subnormal number

    x - (phi |x| + eta) <= predecessor of x,      x + (phi |x| + eta) >= successor of x

A sum that is subnormal or zero is exact, as it is a multiple of eta: so x - 2^-52 |x| and
x + 2^-52 |x| contain the real sum that rounds to x, and the difference of equal numbers is 0.

An end that is not a number says that nothing is known; every comparison with it is false.

Rows of intervals and operations on them are made of the same steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from holdfast.execution.arithmetic.basics import greatest, least
from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose, root

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
        found = Interval(below(root(self.low)), above(root(self.high))).not_negative()
        return unknown_where(~(self.low >= 0.0), found)

    def widened(self, by: Value | float) -> Interval:
        """With every number that is within `by` of one of these."""
        return Interval(below_sum(self.low - by), above_sum(self.high + by))

    def within(self, low: float, high: float) -> Interval:
        """The part between two numbers, of a quantity that is always there."""
        return Interval(
            choose(self.low < low, low, self.low), choose(self.high > high, high, self.high)
        )


def smallest(*values: Value) -> Value:
    """The least; not a number if one is not."""
    found = values[0]
    for value in values[1:]:
        found = least(found, value)
    return found


def largest(*values: Value) -> Value:
    """The greatest; not a number if one is not."""
    found = values[0]
    for value in values[1:]:
        found = greatest(found, value)
    return found


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
    found = x
    for _ in range(exponent - 1):
        found = rounded(found * x)  # type: ignore[operator]
    return found


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
    found = steps.constant(0.0, FLOAT) <= 0.0
    for condition in conditions:
        found = found & condition
    return found
