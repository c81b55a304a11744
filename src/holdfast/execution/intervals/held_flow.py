"""Where a held input can lead from a box of states, for any disturbance within its bounds.

For xdot = f(x, u, d) with u held for T, d in D at every instant, from a box X with the middle c:

1. A box B with X + [0, T] f(B, u, D) inside B contains all states on the way (E. Picard; the
   inclusion is checked, not assumed), and so does X + [0, T] f(B, u, D).
2. The trajectory of c with the middle d0 of D ends in its Taylor polynomial of second order at c,
   with T^3/6 times the third derivative over B; of first order where rates have kinks.
3. The others differ from it by e with edot = A e + w, A in df/dx (B, u, D), w in W =
   df/dd (B, u, D) (D - d0): at the end (I + T A + T^2/2 A^2)(X - c) + T W + T^2/2 A W +
   T^3/6 A^2 (A E + W), with E a box of e on the way.
4. A constraint c <= 0 at both ends of the hold is kept between if its rate has one sign, or if the
   lines of the least and the greatest rate from its ends meet at or below zero.

Every operation is of intervals that are rounded outward. Rates with jumps have no df/dx: then the
end is X + T f(B, u, D), and a constraint is looked at over all of B.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.intervals.enclosure import IntervalLowering
from holdfast.execution.intervals.interval import Interval, smallest
from holdfast.execution.leaf import compiled_leaves
from holdfast.maths.expressions.traversal import derivatives

JUMPS = ("sgn", "sign", "select", "wrap", "angle", "atan2", "floor", "ceiling", "length")
"""Functions that are not continuous everywhere, or of which the slope is not exact."""

KINKS = ("magnitude", "Abs", "least", "greatest", "Min", "Max")
"""Continuous functions of which the slope jumps: rates with them have no third derivative."""

GROWTH = 0.1
"""The part of its width by which a first guess of the way is wider."""

Row = list[Interval]
Truths = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Held:
    """What is certain of a held input from each box, shapes (boxes, states).

    low, high: all states at the end. way_low, way_high: all states on the way. kept: whether the
    way exists and the constraints hold on it, given that they hold at both ends.
    """

    low: Array
    high: Array
    way_low: Array
    way_high: Array
    kept: Truths


class HeldFlow:
    """The flow of rates with held inputs, and constraints on the way.

    rates, constraints (c <= 0): expressions of the states, inputs, disturbances. disturbances,
    parameters: symbol -> (least, greatest). Raises `DefinitionError` for a function without a
    proved enclosure, and for symbols that are not given.
    """

    def __init__(
        self,
        rates: Sequence[Any],
        constraints: Sequence[Any],
        states: Sequence[Any],
        inputs: Sequence[Any],
        disturbances: Mapping[Any, tuple[float, float]],
        parameters: Mapping[Any, tuple[float, float]],
        hold: float,
    ) -> None:
        self.states, self.inputs = list(states), list(inputs)
        self.rates, self.constraints = ([exact(e) for e in g] for g in (rates, constraints))
        wide = {s: ends for s, ends in parameters.items() if ends[0] < ends[1]}
        self.disturbances = {**disturbances, **wide}  # constant ones, which is one way of varying
        self.parameters = {s: ends for s, ends in parameters.items() if s not in wide}
        self.hold = hold
        smooth = not any(_has(JUMPS, e) for e in self.rates)
        flow = self._flow_leaf(smooth)
        self._leaves = compiled_leaves({"flow": flow, "inside": self._inside_leaf()})

    def inside(self, low: Array, high: Array) -> Truths:
        """Whether the constraints surely hold in all of each box, shape (boxes,)."""
        ends = np.stack([low, high], axis=2).reshape(len(low), -1)
        found: Truths = self._leaves.values("inside", len(low), 1, ends)[:, 0] > 0
        return found

    def held(self, low: Array, high: Array, inputs: Array) -> Held:
        """What one input for each box leads to; inputs: shape (boxes, inputs)."""
        n = len(self.states)
        ends = np.stack([low, high], axis=2).reshape(len(low), -1)
        given = np.concatenate([ends, inputs], axis=1)
        found = self._leaves.values("flow", len(low), 4 * n + 1, given)
        kept = found[:, 4 * n] > 0
        return Held(
            found[:, 0:n], found[:, n : 2 * n], found[:, 2 * n : 3 * n], found[:, 3 * n : 4 * n],
            kept,
        )  # fmt: skip

    # -- leaves ------------------------------------------------------------------------------

    def _inside_leaf(self) -> Leaf:
        steps = Steps(expanded=True)
        rows = [f"q{i}" for i in range(2 * len(self.states))]
        x = _pairs(steps, rows)
        values = self._values(steps, self.constraints, x, [], {})
        sure = _all(steps, [v.high <= 0.0 for v in values])
        return Leaf(steps, {"q": rows}, [choose(sure, 1.0, 0.0)])

    def _flow_leaf(self, smooth: bool) -> Leaf:
        steps = Steps(expanded=True)
        n = len(self.states)
        rows = [f"q{i}" for i in range(2 * n + len(self.inputs))]
        x = _pairs(steps, rows[: 2 * n])
        u = [Interval(v, v) for v in (steps.input(name) for name in rows[2 * n :])]
        d = {s: _constant(steps, *ends) for s, ends in self.disturbances.items()}
        way, sure = self._way(steps, x, u, d)
        step = _constant(steps, self.hold, self.hold)
        rates = self._values(steps, self.rates, way, u, d)
        plain = [q + step * r for q, r in zip(x, rates, strict=True)]
        end = plain
        if smooth:
            better = self._end(steps, x, way, u, d, step)
            end = [_common(a, b) for a, b in zip(plain, better, strict=True)]
        end = [_common(a, b) for a, b in zip(end, way, strict=True)]
        kept = [sure]
        for c in self.constraints:
            kept.append(self._kept(steps, c, x, end, way, u, d, step))
        return Leaf(
            steps,
            {"q": rows},
            [
                *(e.low for e in end), *(e.high for e in end),
                *(w.low for w in way), *(w.high for w in way),
                choose(_all(steps, kept), 1.0, 0.0),
            ],
        )  # fmt: skip

    def _values(
        self, steps: Steps, of: Sequence[Any], x: Row, u: Row, d: Mapping[Any, Interval]
    ) -> Row:
        known: dict[Any, Any] = {
            **{s: _constant(steps, *ends) for s, ends in self.parameters.items()},
            **dict(zip(self.states, x, strict=True)),
            **dict(zip(self.inputs, u, strict=False)),
            **d,
        }
        lowering = IntervalLowering(steps, known)
        return [_of(lowering, e) for e in of]

    def _way(self, steps: Steps, x: Row, u: Row, d: Mapping[Any, Interval]) -> tuple[Row, Value]:
        """A box of all states on the way, and whether that is proved."""
        during = _constant(steps, 0.0, self.hold)

        def moved(at: Row) -> Row:
            rates = self._values(steps, self.rates, at, u, d)
            return [q + during * r for q, r in zip(x, rates, strict=True)]

        guess = [_grown(q) for q in moved(moved(x))]
        found = moved(guess)
        inside = [(f.low >= g.low) & (f.high <= g.high) for f, g in zip(found, guess, strict=True)]
        return found, _all(steps, inside)

    def _end(
        self, steps: Steps, x: Row, way: Row, u: Row, d: Mapping[Any, Interval], step: Interval
    ) -> Row:
        """All states at the end, from the trajectory of the middle and what differs from it."""
        n = len(x)
        middle = [_middle(q) for q in x]
        still = {s: _middle(q) for s, q in d.items()}
        slopes = [derivatives(r, self.states) for r in self.rates]
        flat = [slope[s] for slope in slopes for s in self.states]
        second = self._along(self.rates)
        kinks = any(_has(KINKS, e) for e in self.rates)
        half, sixth = step.power(2) * _number(steps, 0.5), step.power(3) * _share(steps, 6)
        rates = self._values(steps, self.rates, middle, u, still)
        if kinks:
            rest = [half * r for r in self._values(steps, second, way, u, still)]
        else:
            bent = self._values(steps, second, middle, u, still)
            last = self._values(steps, self._along(second), way, u, still)
            rest = [half * b + sixth * r for b, r in zip(bent, last, strict=True)]
        values = self._values(steps, flat, way, u, d)
        a = [values[n * i : n * (i + 1)] for i in range(n)]
        # A(s) A(r) of two instants: entries that are one expression may differ, and make no square
        later = [[entry.copy() for entry in row] for row in a]
        twice = [[_dot(a[i], [row[j] for row in later], steps) for j in range(n)] for i in range(n)]
        carried = [derivatives(r, list(d)) for r in self.rates]
        by = [self._values(steps, [c[s] for s in d], way, u, d) for c in carried]
        off = [q - _middle(q) for q in d.values()]
        w = [_dot(row, off, steps) for row in by]
        e0 = [q - c for q, c in zip(x, middle, strict=True)]
        # differences of two states on the way, one of which is that of the middle
        e = [q - q for q in way]
        during = _constant(steps, 0.0, self.hold)
        for _ in range(2):  # all on the way from e0, by their own rates
            moving = [_dot(row, e, steps) + more for row, more in zip(a, w, strict=True)]
            e = [_common(o, s + during * r) for o, s, r in zip(e, e0, moving, strict=True)]
        moving = [_dot(row, e, steps) + more for row, more in zip(a, w, strict=True)]
        found = []
        for i in range(n):
            total = middle[i] + step * rates[i] + rest[i]
            for j in range(n):
                grown = step * a[i][j] + half * twice[i][j]
                total = total + (_number(steps, 1.0) + grown if i == j else grown) * e0[j]
            total = total + step * w[i] + half * _dot(a[i], w, steps)
            found.append(total + sixth * _dot(twice[i], moving, steps))
        return found

    def _along(self, of: Sequence[Any]) -> list[Any]:
        """The derivatives along the rates, the inputs and the disturbances held."""
        slopes = [derivatives(e, self.states) for e in of]
        return [
            sp.Add(*(slope[s] * r for s, r in zip(self.states, self.rates, strict=True)
                     if slope[s] != 0))
            for slope in slopes
        ]  # fmt: skip

    def _kept(
        self,
        steps: Steps,
        c: Any,
        x: Row,
        end: Row,
        way: Row,
        u: Row,
        d: Mapping[Any, Interval],
        step: Interval,
    ) -> Value:
        """Whether c <= 0 on the way, given that it is at both ends."""
        (whole,) = self._values(steps, [c], way, u, d)
        kept = whole.high <= 0.0
        if _has(JUMPS, c):
            return kept
        slopes = derivatives(c, self.states)
        rate = sp.Add(*(slopes[s] * r for s, r in zip(self.states, self.rates, strict=True)))
        (moving,) = self._values(steps, [rate], way, u, d)
        kept = kept | (moving.low >= 0.0) | (moving.high <= 0.0)
        (first,) = self._values(steps, [c], x, u, d)
        (last,) = self._values(steps, [c], end, u, d)
        zero = steps.constant(0.0, FLOAT)
        c0 = Interval(*(2 * (smallest(first.high, zero),)))
        c1 = Interval(*(2 * (smallest(last.high, zero),)))
        up, down = (Interval(v, v) for v in (moving.high, moving.low))
        meet = c0 + up * (c1 - c0 - step * down) * (up - down).inverse()
        return kept | (meet.high <= 0.0)


def exact(e: Any) -> sp.Expr:
    """With floats as the rational numbers that they are: derivatives of these are exact."""
    e = sp.sympify(e)
    return e.xreplace({f: sp.Rational(f) for f in e.atoms(sp.Float)})


def _of(lowering: IntervalLowering, e: Any) -> Interval:
    found: Any = lowering.value(sp.sympify(e))
    return found


def _has(names: Sequence[str], e: sp.Expr) -> bool:
    return any(type(p).__name__ in names for p in sp.preorder_traversal(e))


def _pairs(steps: Steps, rows: Sequence[str]) -> Row:
    ends = [steps.input(name) for name in rows]
    return [Interval(a, b) for a, b in zip(ends[0::2], ends[1::2], strict=True)]


def _constant(steps: Steps, low: float, high: float) -> Interval:
    if low == high:
        return Interval.point(steps, float(low))
    return Interval(steps.constant(float(low), FLOAT), steps.constant(float(high), FLOAT))


def _middle(x: Interval) -> Interval:
    value = 0.5 * (x.low + x.high)
    return Interval(value, value)


def _number(steps: Steps, value: float) -> Interval:
    return Interval.point(steps, value)


def _share(steps: Steps, whole: int) -> Interval:
    """One part of so many."""
    return _number(steps, float(whole)).inverse()


def _grown(x: Interval) -> Interval:
    """Wider by a part of its width."""
    return x.widened((x.high - x.low) * GROWTH)


def _common(a: Interval, b: Interval) -> Interval:
    """What both contain; one of them where the other is not known."""
    low = choose(a.low.differs(a.low), b.low, choose(b.low > a.low, b.low, a.low))
    high = choose(a.high.differs(a.high), b.high, choose(b.high < a.high, b.high, a.high))
    return Interval(low, high)


def _dot(row: Row, x: Row, steps: Steps) -> Interval:
    total = Interval.point(steps, 0.0)
    for a, b in zip(row, x, strict=True):
        total = total + a * b
    return total


def _all(steps: Steps, conditions: Sequence[Value]) -> Value:
    found = steps.constant(0.0, FLOAT) <= 0.0
    for condition in conditions:
        found = found & condition
    return found
