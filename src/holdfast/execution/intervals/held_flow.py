"""Where a held input can lead from a box of states, for any disturbance within its bounds.

For xdot = f(x, u, d) with u held for T, d in D at every instant, from a box X with the middle c,
in steps tau = T / m of each leg. States are in N + C (X - c) + E: N the trajectory of c with the
middle d0 of D and C what carries X - c along, at first c, the identity and E = 0. At every step:

1. A box B with Y + [0, tau] f(B, u, D) inside B, Y the states at its begin, contains all states on
   the way (E. Picard): the first of some guesses, each the way of the one before made wider by a
   part, that does. The inclusion is checked, not assumed.
2. N goes on by its Taylor polynomial of second order in time, with the third coefficient over B; of
   first order where rates have kinks.
3. The others differ from it by e with edot = A e + w, A in df/dx (B, u, D), w in W =
   df/dd (B, u, D) (D - d0): with M = I + tau A + tau^2/2 A A, C goes on to M C and E to
   M E + tau W + tau^2/2 A W + tau^3/6 (A A) (A e + W), e in a box of differences on the way.
4. The states at its end are in N + C (X - c) + E, in Y + tau f(B, u, D) and in B.
5. A constraint c <= 0 is kept on the way if it is all over B; or if its rate has one sign, or the
   lines of its least and greatest rate from both ends meet at or below zero, and it holds at the
   ends that decide. Of least(a, b) one may be kept, of greatest(a, b) both.

States that are measured with errors up to e, and an input that arrives up to a delay late, are sets
too: X and the states at the end are wider by e, and the way begins with a leg of that delay, on
which the input is any that may be under way. The inputs of a law are those that it may give all
over the box that is measured (`law_ranges.py`).

Every operation is of intervals that are rounded outward, and the operations are those of
`holdfast-check`, in its order (`tape.py`), which rounds less: what is kept here is valid there.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.errors import DefinitionError
from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.intervals.enclosure import (
    FITS,
    Interval,
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
    smallest,
)
from holdfast.execution.intervals.enclosures import STANDARD, Enclosure, Motion, enclosures
from holdfast.execution.intervals.enclosures.base import times
from holdfast.execution.intervals.law_ranges import LawRanges
from holdfast.execution.intervals.tape import Tape
from holdfast.execution.leaf import Leaves, compiled_leaves
from holdfast.maths.definitions.law import LawCases
from holdfast.maths.expressions.functions import greatest, least
from holdfast.maths.expressions.traversal import exact, symbols_of

GUESSES = 6
"""How many boxes are tried for the way."""

SLACK = 1e-12
"""By which part of the way the states at its end are wider, of a law and with a delay: the middle
of the law's inputs, and of the states when an input arrives, is that of an enclosure, of which the
checker has its own."""

Known = dict[str, Interval]


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
    law: what gives the inputs, None where they are tried. steps: into how many parts enclosures
    divide the hold. enclosure: the name of that kind of them. halves: how often a checker may halve
    a cell (`Enclosure.halves`).
    """

    hold: float
    errors: tuple[float, ...] = ()
    delay: float = 0.0
    under_way: tuple[tuple[float, float], ...] = ()
    law: LawCases | None = None
    steps: int = 1
    enclosure: str = STANDARD
    halves: int = 0


class HeldFlow:
    """The flow of rates with held inputs, and constraints on the way.

    rates, constraints (c <= 0): expressions of the states, inputs, disturbances. target: those that
    hold where the vehicle has to arrive. disturbances, parameters: symbol -> (least, greatest).
    guesses: how many boxes are tried for the way. Raises `DefinitionError` for a function without a
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
        sampling: Sampling | float,
        target: Sequence[Any] = (),
        guesses: int = GUESSES,
    ) -> None:
        self.states, self.inputs, self.guesses = list(states), list(inputs), guesses
        self.sampling = sampling if isinstance(sampling, Sampling) else Sampling(sampling)
        self.free = {s.name: ends for s, ends in {**disturbances, **parameters}.items()}
        self.law = None
        if self.sampling.law is not None:
            measured = {**disturbances, **parameters}
            self.law = LawRanges(self.sampling.law, self.states, self.inputs, measured)
        self._enclosure = enclosures()[self.sampling.enclosure]
        self.errors = self.sampling.errors or (0.0,) * len(self.states)
        declared = {*self.states, *self.inputs, *disturbances, *parameters}
        if odd := symbols_of([exact(e) for e in (*rates, *constraints, *target)]) - declared:
            raise DefinitionError(f"the expression uses '{min(map(str, odd))}'")
        self._names = [s.name for s in self.states]
        self._rates = Tape(rates)
        self._constraints = [_Limit(exact(c)) for c in constraints]
        leaves = {"inside": self._inside_leaf(constraints)}
        if target:
            leaves["arrived"] = self._inside_leaf([*constraints, *target])
        self._leaves = compiled_leaves(leaves)
        self._lean = True
        self._of_steps: dict[tuple[int, bool, bool], Leaves] = {}

    @property
    def digest(self) -> str:
        """Of all that decides what is certain."""
        hold, delay, steps = self.sampling.hold, self.sampling.delay, self.sampling.steps
        leaves = " ".join(self._leaf(k, begins=True).digest for k in range(len(self._legs)))
        return f"{self._leaves.digest} {leaves} {hold} {delay} {steps}"

    def without_constraints(self) -> HeldFlow:
        """Where inputs lead, and nothing of constraints on the way."""
        flow = copy.copy(self)
        flow._constraints, flow._of_steps, flow._lean = [], {}, False
        return flow

    def in_steps(self, steps: int) -> HeldFlow:
        """The same, with holds divided into so many steps."""
        flow = copy.copy(self)
        flow.sampling = replace(self.sampling, steps=steps)
        return flow

    def inside(self, low: Array, high: Array) -> Truths:
        """Whether the constraints surely hold where each box is measured, shape (boxes,)."""
        return self._sure("inside", low, high)

    def arrived(self, low: Array, high: Array) -> Truths:
        """Whether those of the target surely hold too where each box is measured: corners (boxes,
        states), answers (boxes,)."""
        return self._sure("arrived", low, high)

    def _sure(self, leaf: str, low: Array, high: Array) -> Truths:
        sure: Truths = self._leaves.values(leaf, len(low), 1, _ends(low, high))[:, 0] > 0
        return sure

    def held(self, low: Array, high: Array, inputs: Array, most: Array | None = None) -> Held:
        """What one input for each box leads to; inputs: shape (boxes, inputs).

        most: of a law any input from `inputs` to these.
        """
        n, count = len(self.states), len(low)
        if self.law is not None:
            inputs = _ends(inputs, inputs if most is None else most)
        changing, still = (2 * n * rows for rows in self._enclosure.sizes(n))
        wide = 2 * n if self._alone else 4 * n + changing  # numbers of a set that a step changes
        box, holds = _ends(low, high), np.ones(count, dtype=bool)
        way_low, way_high = np.full((count, n), np.inf), np.full((count, n), -np.inf)
        last = len(self._legs) - 1, self.sampling.steps - 1
        for leg in range(len(self._legs)):
            now = np.concatenate([box, inputs], axis=1)
            for turn in range(self.sampling.steps):
                begins = turn == 0
                width = wide + 2 * n + 2 + (still if begins else 0)
                rows = self._leaf(leg, begins=begins).values(
                    "flow", count, width, now, self._step(leg)
                )
                box, way = rows[:, : 2 * n], rows[:, wide : wide + 2 * n]
                ends = way[:, 0::2], way[:, 1::2]
                if self._alone:
                    way_low, way_high = ends
                else:
                    way_low, way_high = np.minimum(way_low, ends[0]), np.maximum(way_high, ends[1])
                holds &= rows[:, wide + 2 * n + (not self._alone and (leg, turn) == last)] > 0
                if (leg, turn) == last:
                    break
                if begins:
                    off = rows[:, wide + 2 * n + 2 :]
                now = np.concatenate([rows[:, :wide], off, inputs], axis=1)
        low, high = box[:, 0::2], box[:, 1::2]
        for axis, error in enumerate(self.errors):
            if error:
                low[:, axis] = np.nextafter(low[:, axis] - error, -np.inf)
                high[:, axis] = np.nextafter(high[:, axis] + error, np.inf)
        if self.law is not None or self.sampling.delay:
            room = SLACK * (way_high - way_low)
            low, high = low - room, high + room
        return Held(low, high, way_low, way_high, holds)

    # -- leaves ------------------------------------------------------------------------------

    @property
    def _alone(self) -> bool:
        """Whether there is one step alone, of which less is to be known."""
        return self._lean and self.sampling.steps == len(self._legs) == 1

    @property
    def _legs(self) -> list[bool]:
        """For each leg whether its inputs are those that may be under way."""
        return [True, False] if self.sampling.delay else [False]

    def _inside_leaf(self, constraints: Sequence[Any]) -> Leaf:
        steps, tape = Steps(expanded=True), Tape(constraints)
        rows = [f"q{i}" for i in range(2 * len(self.states))]
        x = self._with_errors(steps, pairs(steps, rows))
        values = tape.of(tape.values(steps, self._at(x, self._free(steps))))
        sure = every(steps, [v.high <= 0.0 for v in values])
        return Leaf(steps, {"q": rows}, [choose(sure, 1.0, 0.0)])

    def _free(self, steps: Steps) -> Known:
        return {name: constant(steps, *ends) for name, ends in self.free.items()}

    def _at(self, x: Row, free: Known) -> Known:
        return {**free, **dict(zip(self._names, x, strict=True))}

    def _with_errors(self, steps: Steps, x: Row) -> Row:
        """What may be where x is measured."""
        return [q + constant(steps, -e, e) if e else q for q, e in zip(x, self.errors, strict=True)]

    def _leaf(self, leg: int, *, begins: bool) -> Leaves:
        """Of one step of a leg, compiled when it is needed."""
        which = leg, begins, self._alone
        if which not in self._of_steps:
            self._of_steps[which] = compiled_leaves({"flow": self._flow_leaf(leg, begins=begins)})
        return self._of_steps[which]

    def _step(self, leg: int) -> Array:
        """The ends of how long a step of a leg is."""
        sampling, steps = self.sampling, self.sampling.steps
        last, sides = leg == len(self._legs) - 1, np.array([-np.inf, np.inf])
        whole = np.full(2, sampling.hold if last else sampling.delay)
        if last and sampling.delay:
            whole = np.nextafter(whole - sampling.delay, sides)
        return whole if steps == 1 else np.nextafter(whole / steps, sides)

    def _flow_leaf(self, leg: int, *, begins: bool) -> Leaf:
        """Of one step: the first, which begins with a box, or a further one of a leg."""
        n, steps = len(self.states), Steps(expanded=True)
        wide = 2 * n if begins else 2 * n * (2 + sum(self._enclosure.sizes(n)))
        of_inputs = len(self.inputs) * (1 if self.law is None else 2)
        rows = [f"q{i}" for i in range(wide + of_inputs)]
        if begins:
            seen = pairs(steps, rows[:wide])
            box = seen if leg else self._with_errors(steps, seen)
            before = self._enclosure.begun(steps, box, [middle(q) for q in seen])
        else:
            ends = pairs(steps, rows[:wide])
            first, second, *others = (ends[k : k + n] for k in range(0, len(ends), n))
            before = self._enclosure.of(steps, first, second, others)
        ranges = self._free(steps) | self._inputs_of(steps, rows[wide:], self._legs[leg])
        (step,) = pairs(steps, ("t0", "t1"))
        after, way, sure = self._after(steps, before, ranges, step)
        at = [self._at(box, ranges) for box in (before.box, way, after.box)]
        rates = self._rates.of(self._rates.values(steps, at[1]))
        moving = dict(zip(self._names, rates, strict=True))
        conditions = [self._kept(steps, c, at, moving, step) for c in self._constraints]
        flags = [
            choose(every(steps, [sure, *some]), 1.0, 0.0) for some in zip(*conditions, strict=True)
        ]
        flags = flags or 2 * [choose(sure, 1.0, 0.0)]
        if self._alone:
            results = [*_both(after.box), *_both(way), flags[1]]
        else:
            changing = [after.box, after.nominal, *after.rows()[0]]
            still = before.rows()[1] if begins else []
            results = [*_all(changing), *_both(way), *flags, *_all(still)]
        return Leaf(steps, {"q": rows, "t": ["t0", "t1"]}, results, frozenset("t"))

    def _inputs_of(self, steps: Steps, rows: Sequence[str], under_way: bool) -> Known:
        if under_way:
            intervals = [constant(steps, *ends) for ends in self.sampling.under_way]
        elif self.law is not None:
            intervals = pairs(steps, rows)
        else:
            intervals = [Interval(v, v) for v in map(steps.input, rows)]
        return {s.name: q for s, q in zip(self.inputs, intervals, strict=True)}

    def _after(
        self, steps: Steps, x: Enclosure, ranges: Known, step: Interval
    ) -> tuple[Enclosure, Row, Value]:
        """The states after a step, all on the way, and whether these are proved."""
        way, sure = self._way(steps, x.box, ranges, step)
        n = len(way)
        values = self._rates.values(steps, self._at(way, ranges))
        rates = self._rates.of(values)
        plain = [q + step * r for q, r in zip(x.box, rates, strict=True)]
        free = {name: q for name, q in ranges.items() if q.low is not q.high}  # others do not vary
        still = {**ranges, **{name: middle(q) for name, q in free.items()}}
        one = number(steps, 1.0)
        columns = [self._rates.of(self._rates.slopes(values, {s: one})) for s in self._names]
        carried = [self._rates.of(self._rates.slopes(values, {s: one})) for s in free]
        zero = number(steps, 0.0)
        a = [[zero if column[i] is None else column[i] for column in columns] for i in range(n)]
        nominal = self._nominal(steps, x.nominal, way, a, still, step)
        half, sixth = step.power(2) * number(steps, 0.5), step.power(3) * share(steps, 6)
        # A(s) A(r) of two instants: entries that are one expression may differ, and make no square
        later = [[entry.copy() if entry.number is None else entry for entry in row] for row in a]
        twice = [[dot(a[i], [row[j] for row in later], steps) for j in range(n)] for i in range(n)]
        offs = [q - still[name] for name, q in free.items()]
        by = [[zero if c[i] is None else c[i] for c in carried] for i in range(n)]
        w = [dot(row, offs, steps) for row in by]
        e0 = x.spread(steps)
        e = [q - q.copy() for q in way]  # of two states on the way
        during = Interval(steps.constant(0.0, FLOAT), step.high)
        for _ in range(2):  # all on the way from e0, by their own rates
            moving = [q + more for q, more in zip(times(a, e, steps), w, strict=True)]
            e = [common(o, s + during * r) for o, s, r in zip(e, e0, moving, strict=True)]
        moving = [q + more for q, more in zip(times(a, e, steps), w, strict=True)]
        m = [[(one if i == j else zero) + step * a[i][j] + half * twice[i][j] for j in range(n)]
             for i in range(n)]  # fmt: skip
        added = (
            [step * q for q in w],
            [half * bent for bent in times(a, w, steps)],
            [sixth * last for last in times(twice, moving, steps)],
        )
        after = x.after(Motion(steps, nominal, m, added))
        ends = after.hull(steps)
        box = [common(common(p, q), b) for p, q, b in zip(plain, ends, way, strict=True)]
        return after.inside(steps, box), way, sure

    def _way(self, steps: Steps, x: Row, ranges: Known, step: Interval) -> tuple[Row, Value]:
        """A box of all states on the way, and whether that is proved."""
        during = Interval(steps.constant(0.0, FLOAT), step.high)

        def moved(at: Row) -> Row:
            rates = self._rates.of(self._rates.values(steps, self._at(at, ranges)))
            return [q + during * r for q, r in zip(x, rates, strict=True)]

        before = moved(moved(x))
        ways: list[tuple[Row, Value]] = []
        for _ in range(self.guesses):
            way = moved([grown(q) for q in before])
            room = [grown(q, FITS) for q in before]  # the checker's guess is a bit smaller
            inside = ((w.low >= g.low) & (w.high <= g.high) for w, g in zip(way, room, strict=True))
            ways.append((way, every(steps, list(inside))))
            before = way
        way, sure = ways[-1]
        for earlier, fits in reversed(ways[:-1]):
            way = [
                Interval(choose(fits, e.low, w.low), choose(fits, e.high, w.high))
                for e, w in zip(earlier, way, strict=True)
            ]
            sure = sure | fits
        return way, sure

    def _nominal(
        self, steps: Steps, at: Row, way: Row, a: list[Row], still: Known, step: Interval
    ) -> Row:
        """The trajectory of the middle after a step, from a box of it."""
        start, over = self._at(at, still), self._at(way, still)
        if not self._rates.smooth:
            first, during = (self._rates.of(self._rates.values(steps, k)) for k in (start, over))
            half, bent = step.power(2) * number(steps, 0.5), times(a, during, steps)
            return [q + step * r + half * b for q, r, b in zip(at, first, bent, strict=True)]
        first = self._rates.series(steps, start, self._names, 3)
        rest = self._rates.series(steps, over, self._names, 4)
        second, third = step.power(2), step.power(3)
        return [
            c[0] + step * c[1] + second * c[2] + third * r[3]
            for c, r in zip(first, rest, strict=True)
        ]

    def _kept(
        self, steps: Steps, c: _Limit, at: Sequence[Known], moving: Known, step: Interval
    ) -> tuple[Value, Value]:
        """Whether c <= 0 at (start, way, end), where it is at the start: if nothing is known of the
        end, and if it is there too."""
        first, over, last = (c.tape.values(steps, assumed) for assumed in at)
        parts = [self._part_kept(steps, p, at, moving, step) for p in c.parts] if not c.all else []
        both = [self._kept(steps, p, at, moving, step) for p in c.parts] if c.all else []
        ways = self._ways(steps, c, (first, over, last), moving, step)
        conditions = []
        for k, assumed in enumerate((False, True)):
            holds = ways(True, assumed)
            if parts:
                holds = holds | ~every(steps, [~p for p in parts])
            if both:
                holds = holds | every(steps, [p[k] for p in both])
            conditions.append(holds)
        return conditions[0], conditions[1]

    def _part_kept(
        self, steps: Steps, c: _Limit, at: Sequence[Known], moving: Known, step: Interval
    ) -> Value:
        """The same of a part, of which nothing is known at the ends."""
        values = tuple(c.tape.values(steps, ranges) for ranges in at)
        holds = self._ways(steps, c, values, moving, step)(False, False)
        parts = [self._part_kept(steps, p, at, moving, step) for p in c.parts]
        if parts:
            some = every(steps, parts) if c.all else ~every(steps, [~p for p in parts])
            holds = holds | some
        return holds

    def _ways(
        self, steps: Steps, c: _Limit, values: Sequence[Row], moving: Known, step: Interval
    ) -> Callable[[bool, bool], Value]:
        """Whether a constraint is kept by itself, of what is known of its ends."""
        first, whole, last = (c.tape.of(v)[0] for v in values)
        (rate,) = c.tape.of(c.tape.slopes(values[1], moving))
        rate = number(steps, 0.0) if rate is None else rate
        zero = steps.constant(0.0, FLOAT)
        c0, c1 = (Interval(*(2 * (smallest(q.high, zero),))) for q in (first, last))
        up, down = (Interval(v, v) for v in (rate.high, rate.low))
        meet = c0 + up * (c1 - c0 - step * down) * (up - down).inverse()
        falls, rises, under = rate.high <= 0.0, rate.low >= 0.0, meet.high <= 0.0

        def holds(*assumed: bool) -> Value:
            begins, ends = (
                zero <= 0.0 if sure else q.high <= 0.0
                for sure, q in zip(assumed, (first, last), strict=True)
            )
            between = (falls & begins) | (rises & ends) | (begins & ends & under)
            return (whole.high <= 0.0) | between

        return holds


class _Limit:
    """A constraint, and those that a least or a greatest is made of; all: of a greatest."""

    def __init__(self, e: Any) -> None:
        self.tape, self.all = Tape([e]), isinstance(e, greatest)
        self.parts = [_Limit(a) for a in e.args] if isinstance(e, least | greatest) else []


def _ends(low: Array, high: Array) -> Array:
    """Columns of both ends in turn."""
    return np.stack([low, high], axis=2).reshape(len(low), 2 * low.shape[1])


def _both(row: Row) -> list[Value]:
    """Both ends of each in turn."""
    return [end for q in row for end in (q.low, q.high)]


def _all(rows: Sequence[Row]) -> list[Value]:
    return _both([q for row in rows for q in row])
