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

States that are measured with errors up to e, and an input that arrives up to a delay late, are sets
too: X and the states at the end are wider by e, and the way begins with a leg of that delay, on
which the input is any that may be under way. The inputs of a law are those that it may give all
over the box that is measured (`law_ranges.py`).

Every operation is of intervals that are rounded outward. Rates with jumps have no df/dx: then the
end is X + T f(B, u, D), and a constraint is looked at over all of B.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.intervals.enclosure import IntervalLowering
from holdfast.execution.intervals.interval import Interval, hull, smallest
from holdfast.execution.intervals.law_ranges import LawRanges
from holdfast.execution.intervals.rows import (
    Row,
    common,
    constant,
    dot,
    every,
    grown,
    middle,
    number,
    pairs,
    share,
)
from holdfast.execution.leaf import compiled_leaves
from holdfast.maths.definitions.law_cases import LawCases
from holdfast.maths.expressions.traversal import derivatives, exact

JUMPS = ("sgn", "sign", "select", "wrap", "angle", "atan2", "floor", "ceiling", "length")
"""Functions that are not continuous everywhere, or of which the slope is not exact."""

KINKS = ("magnitude", "Abs", "least", "greatest", "Min", "Max")
"""Continuous functions of which the slope jumps: rates with them have no third derivative."""

Truths = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Held:
    """What is certain of a held input from each box, shapes (boxes, states).

    low, high: all states that may be measured at the end. way_low, way_high: all states on the way.
    kept: whether the way exists and the constraints hold on it, given that they hold at both ends.
    """

    low: Array
    high: Array
    way_low: Array
    way_high: Array
    kept: Truths


@dataclass(frozen=True)
class Sampling:
    """How a vehicle is sampled: how long inputs are held [s], and what is not exact about it.

    errors: by how much each state may be measured wrong. delay: by how long an input may come late
    [s], at most. under_way: the least and the greatest of each input that may still be under way.
    law: what gives the inputs, None where they are tried.
    """

    hold: float
    errors: tuple[float, ...] = ()
    delay: float = 0.0
    under_way: tuple[tuple[float, float], ...] = ()
    law: LawCases | None = None


class HeldFlow:
    """The flow of rates with held inputs, and constraints on the way.

    rates, constraints (c <= 0): expressions of the states, inputs, disturbances. target: those that
    hold where the vehicle has to arrive. disturbances, parameters: symbol -> (least, greatest).
    Raises `DefinitionError` for a function without a proved enclosure, and for symbols that are not
    given.
    """

    def __init__(
        self,
        rates: Sequence[Any],
        constraints: Sequence[Any],
        states: Sequence[Any],
        inputs: Sequence[Any],
        disturbances: Mapping[Any, tuple[float, float]],
        parameters: Mapping[Any, tuple[float, float]],
        sampling: Sampling | float,
        target: Sequence[Any] = (),
    ) -> None:
        self.states, self.inputs = list(states), list(inputs)
        self.rates, self.constraints = ([exact(e) for e in g] for g in (rates, constraints))
        sampling = sampling if isinstance(sampling, Sampling) else Sampling(sampling)
        wide = {s: ends for s, ends in parameters.items() if ends[0] < ends[1]}
        self.disturbances = {**disturbances, **wide}  # constant ones, which is one way of varying
        self.parameters = {s: ends for s, ends in parameters.items() if s not in wide}
        self.sampling = sampling
        self.law = None
        if sampling.law is not None:
            measured = {**disturbances, **parameters}
            self.law = LawRanges(sampling.law, self.states, self.inputs, measured)
        self.errors = sampling.errors or (0.0,) * len(self.states)
        self.smooth = not any(_has(JUMPS, e) for e in self.rates)
        leaves = {"flow": self._flow_leaf(), "inside": self._inside_leaf(self.constraints)}
        if target:
            leaves["arrived"] = self._inside_leaf([*self.constraints, *map(exact, target)])
        self._leaves = compiled_leaves(leaves)
        self.digest = self._leaves.digest

    def inside(self, low: Array, high: Array) -> Truths:
        """Whether the constraints surely hold where each box is measured, shape (boxes,)."""
        return self._sure("inside", low, high)

    def arrived(self, low: Array, high: Array) -> Truths:
        """Whether those of the target surely hold too where each box is measured."""
        return self._sure("arrived", low, high)

    def _sure(self, leaf: str, low: Array, high: Array) -> Truths:
        ends = np.stack([low, high], axis=2).reshape(len(low), 2 * low.shape[1])
        found: Truths = self._leaves.values(leaf, len(low), 1, ends)[:, 0] > 0
        return found

    def held(self, low: Array, high: Array, inputs: Array, most: Array | None = None) -> Held:
        """What one input for each box leads to; inputs: shape (boxes, inputs).

        most: of a law any input from `inputs` to these.
        """
        n = len(self.states)
        ends = np.stack([low, high], axis=2).reshape(len(low), 2 * low.shape[1])
        if self.law is not None:
            both = (inputs, inputs if most is None else most)
            inputs = np.stack(both, axis=2).reshape(len(low), 2 * inputs.shape[1])
        given = np.concatenate([ends, inputs], axis=1)
        found = self._leaves.values("flow", len(low), 4 * n + 1, given)
        low, high, way_low, way_high = (found[:, k * n : (k + 1) * n] for k in range(4))
        return Held(low, high, way_low, way_high, found[:, 4 * n] > 0)

    # -- leaves ------------------------------------------------------------------------------

    def _inside_leaf(self, constraints: Sequence[Any]) -> Leaf:
        steps = Steps(expanded=True)
        rows = [f"q{i}" for i in range(2 * len(self.states))]
        x = self._with_errors(steps, pairs(steps, rows))
        values = self._values(steps, constraints, x, self._free(steps))
        sure = every(steps, [v.high <= 0.0 for v in values])
        return Leaf(steps, {"q": rows}, [choose(sure, 1.0, 0.0)])

    def _free(self, steps: Steps) -> Mapping[Any, Interval]:
        return {s: constant(steps, *ends) for s, ends in self.disturbances.items()}

    def _with_errors(self, steps: Steps, x: Row) -> Row:
        """What may be where x is measured, and measured where x is."""
        return [q + constant(steps, -e, e) if e else q for q, e in zip(x, self.errors, strict=True)]

    def _flow_leaf(self) -> Leaf:
        steps = Steps(expanded=True)
        n = len(self.states)
        rows = [f"q{i}" for i in range(2 * n + len(self.inputs) * (1 if self.law is None else 2))]
        seen = pairs(steps, rows[: 2 * n])
        if self.law is None:
            inputs = [Interval(v, v) for v in (steps.input(name) for name in rows[2 * n :])]
        else:
            inputs = pairs(steps, rows[2 * n :])
        x, kept = self._with_errors(steps, seen), []
        ways = []
        free = self._free(steps)
        legs = list(self._legs(steps, inputs))
        for k, (duration, u) in enumerate(legs):
            d = {**free, **u}
            way, sure = self._way(steps, x, d, duration)
            end = self._end(steps, x, way, d, duration)
            kept.append(sure)
            ways.append(way)
            for c in self.constraints:
                kept.append(self._kept(steps, c, (x, way, end), d, duration, k == len(legs) - 1))
            x = end
        ends = [self._with_errors(steps, x), [hull(*parts) for parts in zip(*ways, strict=True)]]
        found = [e for row in ends for e in (*(q.low for q in row), *(q.high for q in row))]
        return Leaf(steps, {"q": rows}, [*found, choose(every(steps, kept), 1.0, 0.0)])

    def _legs(self, steps: Steps, inputs: Row) -> Iterator[tuple[Interval, Mapping[Any, Interval]]]:
        """Durations, and the inputs on them: first any that may be under way."""
        hold = constant(steps, self.sampling.hold, self.sampling.hold)
        if self.sampling.delay:
            delay = constant(steps, self.sampling.delay, self.sampling.delay)
            ends = [constant(steps, *e) for e in self.sampling.under_way]
            yield delay, dict(zip(self.inputs, ends, strict=True))
            hold = hold - delay
        yield hold, dict(zip(self.inputs, inputs, strict=True))

    def _values(self, steps: Steps, of: Sequence[Any], x: Row, d: Mapping[Any, Interval]) -> Row:
        """Enclosures at states x, inputs and disturbances d."""
        known: dict[Any, Any] = {
            **{s: constant(steps, *ends) for s, ends in self.parameters.items()},
            **dict(zip(self.states, x, strict=True)),
            **d,
        }
        lowering = IntervalLowering(steps, known)
        return [_of(lowering, e) for e in of]

    def _way(
        self, steps: Steps, x: Row, d: Mapping[Any, Interval], step: Interval
    ) -> tuple[Row, Value]:
        """A box of all states on the way, and whether that is proved."""
        during = Interval(steps.constant(0.0, FLOAT), step.high)

        def moved(at: Row) -> Row:
            rates = self._values(steps, self.rates, at, d)
            return [q + during * r for q, r in zip(x, rates, strict=True)]

        guess = [grown(q) for q in moved(moved(x))]
        found = moved(guess)
        inside = [(f.low >= g.low) & (f.high <= g.high) for f, g in zip(found, guess, strict=True)]
        return found, every(steps, inside)

    def _end(
        self, steps: Steps, x: Row, way: Row, d: Mapping[Any, Interval], step: Interval
    ) -> Row:
        """All states at the end."""
        rates = self._values(steps, self.rates, way, d)
        end = [q + step * r for q, r in zip(x, rates, strict=True)]
        if self.smooth:
            better = self._mean_value_end(steps, x, way, d, step)
            end = [common(a, b) for a, b in zip(end, better, strict=True)]
        return [common(a, b) for a, b in zip(end, way, strict=True)]

    def _mean_value_end(
        self, steps: Steps, x: Row, way: Row, d: Mapping[Any, Interval], step: Interval
    ) -> Row:
        """All states at the end, from the trajectory of the middle and what differs from it."""
        n = len(x)
        center = [middle(q) for q in x]
        free = [s for s, q in d.items() if q.low is not q.high]  # others do not vary
        still = {**d, **{s: middle(d[s]) for s in free}}
        slopes = [derivatives(r, self.states) for r in self.rates]
        flat = [slope[s] for slope in slopes for s in self.states]
        second = self._along(self.rates)
        kinks = any(_has(KINKS, e) for e in self.rates)
        half, sixth = step.power(2) * number(steps, 0.5), step.power(3) * share(steps, 6)
        rates = self._values(steps, self.rates, center, still)
        if kinks:
            rest = [half * r for r in self._values(steps, second, way, still)]
        else:
            bent = self._values(steps, second, center, still)
            last = self._values(steps, self._along(second), way, still)
            rest = [half * b + sixth * r for b, r in zip(bent, last, strict=True)]
        values = self._values(steps, flat, way, d)
        a = [values[n * i : n * (i + 1)] for i in range(n)]
        # A(s) A(r) of two instants: entries that are one expression may differ, and make no square
        later = [[entry.copy() for entry in row] for row in a]
        twice = [[dot(a[i], [row[j] for row in later], steps) for j in range(n)] for i in range(n)]
        carried = [derivatives(r, free) for r in self.rates]
        by = [self._values(steps, [c[s] for s in free], way, d) for c in carried]
        off = [d[s] - still[s] for s in free]
        w = [dot(row, off, steps) for row in by]
        e0 = [q - c for q, c in zip(x, center, strict=True)]
        # differences of two states on the way, one of which is that of the middle
        e = [q - q for q in way]
        during = Interval(steps.constant(0.0, FLOAT), step.high)
        for _ in range(2):  # all on the way from e0, by their own rates
            moving = [dot(row, e, steps) + more for row, more in zip(a, w, strict=True)]
            e = [common(o, s + during * r) for o, s, r in zip(e, e0, moving, strict=True)]
        moving = [dot(row, e, steps) + more for row, more in zip(a, w, strict=True)]
        found = []
        for i in range(n):
            total = center[i] + step * rates[i] + rest[i]
            for j in range(n):
                part = step * a[i][j] + half * twice[i][j]
                total = total + (number(steps, 1.0) + part if i == j else part) * e0[j]
            total = total + step * w[i] + half * dot(a[i], w, steps)
            found.append(total + sixth * dot(twice[i], moving, steps))
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
        boxes: tuple[Row, Row, Row],
        d: Mapping[Any, Interval],
        step: Interval,
        ends: bool,
    ) -> Value:
        """Whether c <= 0 from the first of (start, way, end) on; where it `ends` that is known."""
        first, whole, last = (self._values(steps, [c], box, d)[0] for box in boxes)
        kept = whole.high <= 0.0
        if _has(JUMPS, c):
            return kept
        slopes = derivatives(c, self.states)
        rate = sp.Add(*(slopes[s] * r for s, r in zip(self.states, self.rates, strict=True)))
        (moving,) = self._values(steps, [rate], boxes[1], d)
        zero = steps.constant(0.0, FLOAT)
        c0 = Interval(*(2 * (smallest(first.high, zero),)))
        c1 = Interval(*(2 * (smallest(last.high, zero),)))
        up, down = (Interval(v, v) for v in (moving.high, moving.low))
        meet = c0 + up * (c1 - c0 - step * down) * (up - down).inverse()
        between = (moving.low >= 0.0) | (moving.high <= 0.0) | (meet.high <= 0.0)
        return kept | (between if ends else between & (last.high <= 0.0))


def _of(lowering: IntervalLowering, e: Any) -> Interval:
    found: Any = lowering.value(sp.sympify(e))
    return found


def _has(names: Sequence[str], e: sp.Expr) -> bool:
    return any(type(p).__name__ in names for p in sp.preorder_traversal(e))
