"""Rows of intervals and operations on them, as steps."""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose
from holdfast.execution.intervals.interval import Interval

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
