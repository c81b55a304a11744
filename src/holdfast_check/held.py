"""Where a held input leads from a box of states, and whether constraints hold on the way.

States are in N + C (X - c) + E: N the trajectory of the middle c, C what carries X - c along. A
hold is divided into steps tau; at each of them

1. a box B with Y + [0, tau] f(B, u, D) inside B, Y the states at its begin, has all on the way;
2. N goes on by its Taylor polynomial with a remainder over B;
3. with A in df/dx (B, u, D), W in df/dd (B, u, D) (D - d0) and M = I + tau A + tau^2/2 A A,
   C goes on to M C and E to M E + tau W + tau^2/2 A W + tau^3/6 A A (A e + W).

What every step adds to E goes on to M times it as well: E is also the sum of these.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from holdfast_check.intervals import (
    ZERO,
    Expression,
    Interval,
    Row,
    Tape,
    add,
    common,
    dot,
    grown,
    inverse,
    mul,
    point,
    power,
    sub,
    within,
)

GUESSES = 40

Known = Mapping[str, Interval]


@dataclass
class Limit:
    """A constraint c <= 0, and those that a least or a greatest is made of."""

    expression: Expression

    def __post_init__(self) -> None:
        self.tape = Tape([self.expression])
        self.parts = [Limit(part) for part in self.expression.parts]

    def over(self, ranges: Known) -> Interval:
        return self.tape.of(self.tape.values(ranges))[0]


@dataclass
class States:
    """A box, and N + C (X - c) + E with off = X - c."""

    box: Row
    nominal: Row
    carried: list[Row]
    rest: Row
    off: Row
    parts: list[tuple[list[Row], Row]] | None
    """Of E: what carries on, and what it was when it was added; None if not followed closely."""


class HeldFlow:
    """Rates, constraints, the names of states, and into how many steps holds are divided."""

    def __init__(
        self, rates: Sequence[Expression], states: Sequence[str], constraints: Sequence[Expression],
        steps: int,
    ) -> None:  # fmt: skip
        self.rates, self.states, self.steps = Tape(rates), list(states), steps
        self.limits = [Limit(c) for c in constraints]
        self.expressions = [*rates, *constraints]

    def held(
        self, box: Row, middle: Row, legs: Sequence[tuple[Interval, Known, Known]],
        *, closely: bool = False,
    ) -> tuple[Row | None, int | None]:  # fmt: skip
        """The states at the end, or None if no box of those on the way is found; and the first
        constraint that may fail on the way.

        legs: how long each is, what is known on it, and the middle of that. closely: what each step
        adds to E is carried on by itself too, so that turning widens it less.
        """
        n, last = len(box), len(legs) * self.steps
        one = [[point(int(i == j)) for j in range(n)] for i in range(n)]
        turns = itertools.count(1)
        for leg, (whole, ranges, still) in enumerate(legs):
            center = [point(((q[0] + q[1]) / 2).mid()) for q in box] if leg else middle
            off = [sub(q, c) for q, c in zip(box, center, strict=True)]
            x = States(box, center, one, [point(0)] * n, off, [] if closely else None)
            step = mul(whole, inverse(point(self.steps)))
            for turn in itertools.islice(turns, self.steps):
                way = self._way(x.box, ranges, step)
                if way is None:
                    return None, None
                before, x = x, self._after(x, way, ranges, still, step)
                at = [{**ranges, **dict(zip(self.states, q, strict=True))}
                      for q in (before.box, way, x.box)]  # fmt: skip
                moving = dict(zip(self.states, self._rates(way, ranges), strict=True))
                for k, c in enumerate(self.limits):
                    if not _kept(c, at, moving, step, begins=True, ends=turn == last):
                        return x.box, k
            box = x.box
        return box, None

    def _rates(self, x: Row, rest: Known) -> Row:
        return self.rates.of(self.rates.values({**rest, **dict(zip(self.states, x, strict=True))}))

    def _way(self, x: Row, ranges: Known, step: Interval) -> Row | None:
        """A box that contains every state on the way."""
        during = ZERO, step[1]

        def moved(at: Row) -> Row:
            rates = self._rates(at, ranges)
            return [add(q, mul(during, r)) for q, r in zip(x, rates, strict=True)]

        way = moved(moved(x))
        for _ in range(GUESSES):
            guess = [grown(q) for q in way]
            way = moved(guess)
            if all(map(within, way, guess)):
                return way
        return None

    def _after(self, x: States, way: Row, ranges: Known, still: Known, step: Interval) -> States:
        n = len(way)
        values = self.rates.values({**ranges, **dict(zip(self.states, way, strict=True))})
        rates = self.rates.of(values)
        plain = [add(q, mul(step, r)) for q, r in zip(x.box, rates, strict=True)]
        free = [name for name, q in ranges.items() if q[0] < q[1]]
        columns = self.rates.slopes(values, [{name: point(1)} for name in (*self.states, *free)])
        a = [[column[i] for column in columns[:n]] for i in range(n)]
        offs = [sub(ranges[name], still[name]) for name in free]
        w = [dot([column[i] for column in columns[n:]], offs) for i in range(n)]
        half, sixth = mul(power(step, 2), point(0.5)), mul(power(step, 3), inverse(point(6)))
        nominal = self._nominal(x.nominal, way, a, still, step)
        twice = [[dot(row, [other[j] for other in a]) for j in range(n)] for row in a]
        e0 = [add(dot(row, x.off), r) for row, r in zip(x.carried, x.rest, strict=True)]
        e = [sub(q, q) for q in way]  # of two states on the way
        for _ in range(2):
            moving = [add(dot(row, e), more) for row, more in zip(a, w, strict=True)]
            e = [common(o, add(s, mul((ZERO, step[1]), r)))
                 for o, s, r in zip(e, e0, moving, strict=True)]  # fmt: skip
        moving = [add(dot(row, e), more) for row, more in zip(a, w, strict=True)]
        m = [[_entry(i == j, step, a[i][j], half, twice[i][j]) for j in range(n)] for i in range(n)]
        added = [[mul(step, w[i]), mul(half, dot(a[i], w)), mul(sixth, dot(twice[i], moving))]
                 for i in range(n)]  # fmt: skip
        rest = [total(dot(row, x.rest), *more) for row, more in zip(m, added, strict=True)]
        parts = x.parts
        one = [[point(int(i == j)) for j in range(n)] for i in range(n)]
        if parts is not None:
            parts = [*((_product(m, by), q) for by, q in parts), (one, [total(*q) for q in added])]
            sums = (total(*(dot(by[i], q) for by, q in parts)) for i in range(n))
            rest = [common(r, q) for r, q in zip(rest, sums, strict=True)]
        carried = _product(m, x.carried)
        ends = [total(c, dot(row, x.off), r)
                for c, row, r in zip(nominal, carried, rest, strict=True)]  # fmt: skip
        box = [common(common(p, q), b) for p, q, b in zip(plain, ends, way, strict=True)]
        if parts is not None:  # on from a point of the box, whose way is in the next B as well
            mids = (min(max(((q[0] + q[1]) / 2).mid(), b[0]), b[1])
                    for q, b in zip(nominal, box, strict=True))  # fmt: skip
            around, nominal = nominal, [point(q) for q in mids]
            more = [sub(q, c) for q, c in zip(around, nominal, strict=True)]
            rest, parts = (
                [add(q, r) for q, r in zip(rest, more, strict=True)],
                [*parts, (one, more)],
            )
        return States(box, nominal, carried, rest, x.off, parts)

    def _nominal(self, at: Row, way: Row, a: list[Row], still: Known, step: Interval) -> Row:
        """The trajectory of the middle after a step, from a box of it."""
        here, over = ({**still, **dict(zip(self.states, q, strict=True))} for q in (at, way))
        second, third = power(step, 2), power(step, 3)
        if not self.rates.smooth:
            first, during = (self.rates.of(self.rates.values(k)) for k in (here, over))
            half = mul(second, point(0.5))
            return [total(q, mul(step, r), mul(half, dot(row, during)))
                    for q, r, row in zip(at, first, a, strict=True)]  # fmt: skip
        begun, rest = (
            self.rates.series(here, self.states, 3),
            self.rates.series(over, self.states, 4),
        )
        return [total(c[0], mul(step, c[1]), mul(second, c[2]), mul(third, r[3]))
                for c, r in zip(begun, rest, strict=True)]  # fmt: skip


def _kept(
    c: Limit, at: Sequence[Known], moving: Known, step: Interval, *, begins: bool, ends: bool
) -> bool:
    """Whether c <= 0 at (start, way, end); begins, ends: whether that is known of these."""
    if c.parts:
        every = c.expression.all_parts
        some = (_kept(p, at, moving, step, begins=every and begins, ends=every and ends)
                for p in c.parts)  # fmt: skip
        if all(some) if every else any(some):
            return True
    values = c.tape.values(at[1])
    if c.tape.of(values)[0][1] <= 0:
        return True
    ((rate,),) = c.tape.slopes(values, [moving])
    low, high = rate or (ZERO, ZERO)
    first, last = c.over(at[0]), c.over(at[2])
    begins, ends = begins or bool(first[1] <= 0), ends or bool(last[1] <= 0)
    if (high <= 0 and begins) or (low >= 0 and ends):
        return True
    if not (low < high and begins and ends):
        return False
    c0, c1, down, up = map(point, (min(first[1], ZERO), min(last[1], ZERO), low, high))
    until = sub(sub(c1, c0), mul(step, down))
    return bool(add(c0, mul(mul(up, until), inverse(sub(up, down))))[1] <= 0)


def _entry(
    same: bool, step: Interval, a: Interval | None, half: Interval, twice: Interval
) -> Interval:
    parts = [point(1)] if same else []
    parts += [mul(step, a)] if a else []
    return total(*parts, mul(half, twice))


def _product(m: list[Row], by: list[Row]) -> list[Row]:
    return [[dot(row, [other[j] for other in by]) for j in range(len(by))] for row in m]


def total(first: Interval, *others: Interval) -> Interval:
    for other in others:
        first = add(first, other)
    return first
