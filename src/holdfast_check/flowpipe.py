"""Where a box of states leads, in Taylor models, and whether constraints hold on the way.

States, and inputs that are held, are in p(xi) + Q r: p a polynomial of the numbers xi of the box,
each in [-1, 1], and r any in a box R, of what p leaves out; Q has more columns than there are
states (a zonotope). At every step of length tau

1. P(xi, s), s from 0 to 1, is a polynomial that begins with p, from some Picard iterations;
2. D bounds its defect, f(P, u, d) - P_s / tau, over all xi, s and disturbances d;
3. e = x - P has e' in A e + D with A in df/dx (P + [0, 1] e, u, d): a box J with
   Q R + [0, tau] (A J + D) inside J has it all the way (E. Picard);
4. with M = I + tau A + tau^2/2 A A the step ends in P(xi, 1) + M Q R + tau D + tau^2/2 A D
   + tau^3/6 A A (A J + D): the middle of M turns the columns of Q, all else are new ones. Where
   these are too many, the smaller ones are put into a parallelepiped (R. Lohner, A. Girard).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb, arb_mat, fmpq

from holdfast_check.held import Limit, total
from holdfast_check.intervals import (
    ZERO,
    Expression,
    Interval,
    Row,
    Tape,
    add,
    dot,
    grown,
    hull,
    interval,
    inverse,
    mul,
    point,
    power,
    sub,
    within,
)
from holdfast_check.law import Law, Option
from holdfast_check.reading import NotValidError, Values
from holdfast_check.taylor import NONE, Model, Models, NoModelError, Polynomial, rounded

GUESSES, COLUMNS = 12, 16
MOST_MONOMIALS, MOST_DEGREE, FINEST, MOST_HALVED = 400, 12, 40, 60

Matrix = list[Row]
Column = list[Any]


@dataclass
class States:
    """States and inputs in p + Q r."""

    polynomials: list[Polynomial]
    columns: list[Column]
    rest: Row

    @functools.cached_property
    def off(self) -> Row:
        """What they may differ from p by."""
        rows = range(len(self.polynomials))
        return [dot([point(c[i]) for c in self.columns], self.rest) for i in rows]


@dataclass
class Step:
    """Where a step ends; constraint: the first that may fail on it. left: by how much polynomials
    miss a trajectory. way: all on the way."""

    ends: States
    constraint: int | None
    left: Row
    way: Row


class Flowpipe:
    """The flow of the rates of a header from a box, by its law from sample to sample.

    What is carried along: states, parameters that may be any of a range, and inputs; the latter two
    are still between samples.
    """

    def __init__(self, h: Values) -> None:
        self.states, self.inputs = ([q["name"] for q in h[k]] for k in ("states", "inputs"))
        ranged = [(q["name"], *q["range"]) for q in h["parameters"]]
        unsure = [q for q in ranged if q[1] < q[2]]
        self.carried = [*self.states, *(name for name, *_ in unsure), *self.inputs]
        still = [Expression("0")] * (len(self.carried) - len(self.states))
        self.rates = Tape([*h["rates"], *still])
        self.constraints, self.target = (
            [Limit(c["expression"]) for c in h[k]] for k in ("constraints", "target")
        )
        self.hold, self.holds = h["hold"], h["holds"]
        self.errors = [interval(-e, e) for e in h["errors"]] + [NONE] * len(unsure)
        self.law = Law(h["law"], self.inputs)
        self.box = [*h["start"], *(ends for _, *ends in unsure)]
        self.wide = [k for k, (a, b) in enumerate(self.box) if a < b]
        degree, times = h["degrees"]
        some = min(degree, times) >= 1 and max(degree, times) <= MOST_DEGREE
        if not some or math.comb(len(self.wide) + degree, degree) * (times + 1) > MOST_MONOMIALS:
            raise NotValidError("the degrees of the polynomials are none, or large")
        self.models = Models(len(self.wide), degree, times)
        self.times = times
        free = [(q["name"], *q["range"]) for q in h["disturbances"]]
        fixed = [q for q in ranged if q[1] == q[2]]
        self.ranges = {name: interval(a, b) for name, a, b in (*free, *fixed)}
        self.free = {name: self.models.constant(q) for name, q in self.ranges.items()}
        self.still = {name: (p, NONE) for name, (p, _) in self.free.items()}
        self.disturbed = any(a < b for _, a, b in free)

    def begun(self, box: Sequence[tuple[Fraction, Fraction]]) -> States:
        """A part of the box."""
        polynomials: list[Polynomial] = []
        rest: Row = []
        for k, (low, high) in enumerate(box):
            middle, half = (arb(fmpq(*q.as_integer_ratio())) for q in
                            ((low + high) / 2, (high - low) / 2))  # fmt: skip
            p = {0: middle}
            if k in self.wide:
                p[self.models.variable[self.wide.index(k)]] = half
            exact, away = rounded(p)
            polynomials.append(exact)
            rest.append(away)
        polynomials += [{} for _ in self.inputs]
        rest += [NONE for _ in self.inputs]
        return States(polynomials, _ones(len(polynomials)), rest)

    def named(self, box: Sequence[tuple[Fraction, Fraction]]) -> str:
        """A part of the box, to be read."""
        every = zip(self.carried, box, strict=False)
        return ", ".join(f"{name} = {float(a):g} to {float(b):g}" for name, (a, b) in every)

    def at(self, x: States, off: Row) -> dict[str, Model]:
        """What is known where p, and this that it leaves out, are; inputs are not."""
        every = zip(self.carried[: len(self.box)], x.polynomials, off, strict=False)
        return self.free | {name: (p, e) for name, p, e in every}

    def over(self, at: dict[str, Model]) -> dict[str, Interval]:
        return {name: self.models.range(q) for name, q in at.items()}

    def failing(self, limits: Sequence[Limit], at: dict[str, Model]) -> int | None:
        """The first that may be above 0."""
        return next((k for k, c in enumerate(limits) if not self._kept(c, at)), None)

    def _leaving(self, x: States, at: dict[str, Model], during: Row) -> int | None:
        """The first constraint that may be above 0 on the way."""
        way = self.ranges | dict(zip(self.carried, during, strict=True))
        for k, c in enumerate(self.constraints):
            if self._kept(c, at):
                continue
            rates = dict(zip(self.carried, self.rates.of(self.rates.values(way)), strict=True))
            ((rate,),) = c.tape.slopes(c.tape.values(way), [rates])
            if not ((rate or NONE)[1] <= ZERO and self._kept(c, self.at(x, x.off))):
                return k  # it does not only fall from what it is at first
        return None

    def _kept(self, c: Limit, at: dict[str, Model]) -> bool:
        """Whether c <= 0: one part of a least is, all of a greatest are, or all over its range."""
        if c.parts:
            several = (self._kept(part, at) for part in c.parts)
            if all(several) if c.expression.all_parts else any(several):
                return True
        (value,) = self.models.values(c.tape, at)
        return bool(self.models.range(value)[1] <= ZERO)

    def after(self, x: States, length: Fraction) -> Step | None:
        """A step, a part of a hold; None where no box of the states on the way is found."""
        step = mul(point(self.hold), point(arb(fmpq(*length.as_integer_ratio()))))
        n, way = len(self.carried), self._polynomials(x, step)
        defect = self._defect(way, self.free, step)
        around = self._around(way, x.off, defect, step)
        if around is None:
            return None
        a, off = around
        half, sixth = mul(power(step, 2), point(0.5)), mul(power(step, 3), inverse(point(6)))
        twice = [[dot(row, [other[j] for other in a]) for j in range(n)] for row in a]
        moving = [add(dot(row, off), d) for row, d in zip(a, defect, strict=True)]
        lead = [[total(point(int(i == j)), mul(step, a[i][j]), mul(half, twice[i][j]))
                 for j in range(n)] for i in range(n)]  # fmt: skip
        ends = [rounded(self.models.ended((p, NONE))[0]) for p in way]
        third = [mul(sixth, dot(row, moving)) for row in twice]
        rest = [
            total(ends[i][1], mul(step, defect[i]), mul(half, dot(a[i], defect)), third[i])
            for i in range(n)
        ]
        plain = self._defect(way, self.still, step) if self.disturbed else defect
        left = [add(mul(step, d), q) for d, q in zip(plain, third, strict=True)]
        during = [self.models.range(q) for q in zip(way, off, strict=True)]
        fails = self._leaving(x, self.at(States(way, [], []), off), during)
        return Step(_turned([p for p, _ in ends], lead, x, rest), fails, left, during)

    def _defect(self, way: list[Polynomial], free: dict[str, Model], step: Interval) -> Row:
        m, per = self.models, inverse(step)
        at = free | {name: (p, NONE) for name, p in zip(self.carried, way, strict=True)}
        every = zip(m.values(self.rates, at), way, strict=True)
        return [m.range(m.sub(r, m.scaled((m.derivative(p), NONE), per))) for r, p in every]

    def _polynomials(self, x: States, step: Interval) -> list[Polynomial]:
        """P: any would do, these are near the trajectories from p."""
        way = x.polynomials
        for times in range(self.times):
            m = self.models.until(times)
            at = self.still | {n: (p, NONE) for n, p in zip(self.carried, way, strict=True)}
            rates = m.values(self.rates, at)
            more = [m.scaled((m.integral(r[0]), NONE), step)[0] for r in rates]
            way = [rounded(m.add((p, NONE), (q, NONE))[0])[0]
                   for p, q in zip(x.polynomials, more, strict=True)]  # fmt: skip
        return way

    def _around(
        self, way: list[Polynomial], off: Row, defect: Row, step: Interval
    ) -> tuple[Matrix, Row] | None:
        """Slopes of the rates near P, and a box of what the states on the way differ from it by."""
        during, ranges = (ZERO, step[1]), [self.models.range((p, NONE)) for p in way]
        one = [{name: point(1)} for name in self.carried]
        guess = [add(q, mul(during, d)) for q, d in zip(off, defect, strict=True)]
        for _ in range(GUESSES):
            guess = [hull(NONE, grown(q)) for q in guess]
            near = [add(q, e) for q, e in zip(ranges, guess, strict=True)]
            values = self.rates.values(self.ranges | dict(zip(self.carried, near, strict=True)))
            columns = self.rates.slopes(values, one)
            a = [[column[i] or NONE for column in columns] for i in range(len(way))]
            now = [total(q, mul(during, add(dot(row, guess), d)))
                   for q, row, d in zip(off, a, defect, strict=True)]  # fmt: skip
            if all(map(within, now, guess)):
                return a, now
            guess = now
        return None

    def after_sample(self, x: States, mode: int) -> list[tuple[States, int]]:
        """What may be after a sample: the states with an input, and the mode of the law."""
        if not self.law.modes:
            return [(x, mode)]
        off = [add(e, more) for e, more in zip(x.off, self.errors, strict=False)]
        seen = self.at(x, off)
        places = self.over(seen)
        # slopes are those on all of the way from p to what is measured
        near = self.over(self.at(x, [hull(NONE, e) for e in off]))
        tables = self.law.all_known(near)
        beside = {k: self.models.constant(q) for k, q in tables.items() if k not in seen}
        choices = []
        for option in self.law.modes[mode]:
            if option.program is not None or option.free:
                raise NotValidError("a flowpipe has no law with a safeguard, or that is free")
            when = self.models.values(option.asks, seen | beside)
            signs = [self.models.range(v) for v in when]
            if not any(v[0] > ZERO for v in signs):
                choices.append((self._with(x, option, tables, beside), option.to))
            if all(v[1] < ZERO for v in signs):
                return choices
        if not self.law.covered(places, mode):
            raise NotValidError("the law does nothing in a part of it")
        return choices

    def _with(
        self, x: States, option: Option, tables: dict[str, Interval], beside: dict[str, Model]
    ) -> States:
        """u = k(x): of p a polynomial, of what it leaves out by the slopes of k."""
        n, inputs = len(self.box), len(self.inputs)
        tape, exact = option.gives, self.at(x, [NONE] * len(self.box))
        values = self.models.values(tape, exact | beside)
        one = [{name: point(1)} for name in self.carried[:n]]
        columns = tape.slopes(tape.values(tables), one)
        slopes = [[column[j] or NONE for column in columns] for j in range(inputs)]
        lead = [[point(int(i == j)) for j in range(n + inputs)] for i in range(n)]
        lead += [row + [NONE] * inputs for row in slopes]
        rest = [NONE] * n
        ends = x.polynomials[:n]
        for (p, away), row in zip(values, slopes, strict=True):
            q, more = rounded(self.models.ended((p, NONE))[0])
            ends.append(q)
            rest.append(total(away, more, dot(row, self.errors)))
        return _turned(ends, lead, x, rest)

    def follow(self, box: Sequence[tuple[Fraction, Fraction]], every: Sequence[int]) -> None:
        """Raises `NotValidError` unless all from this part of the box do what is said."""
        levels = iter(every)
        waiting = [(0, self.law.initial, self.begun(box))]
        while waiting:
            sample, mode, x = waiting.pop()
            if sample == self.holds:
                if (k := self.failing(self.target, self.at(x, x.off))) is not None:
                    raise NotValidError(f"at the end the target's {k} may be missed")
                continue
            for begun, to in self.after_sample(x, mode):
                waiting.append((sample + 1, to, self._through(begun, sample, levels)))
        if next(levels, None) is not None:
            raise NotValidError("it has more steps than lead to the end")

    def _through(self, x: States, sample: int, levels: Iterator[int]) -> States:
        passed = Fraction(0)
        while passed < 1:
            level = next(levels, FINEST + 1)
            passed += (length := Fraction(1, 1 << min(level, FINEST + 1)))
            when = f"until {float((sample + passed) * Fraction(self.hold)):g} s"
            if level > FINEST or passed > 1:
                raise NotValidError(f"{when}: the steps do not make up the holds")
            step = self.after(x, length)
            if step is None:
                raise NotValidError(f"{when}: no box of the states on the way was found")
            if step.constraint is not None:
                raise NotValidError(f"{when}: constraint {step.constraint} may fail on the way")
            x = step.ends
        return x


def _turned(ends: list[Polynomial], lead: Matrix, x: States, rest: Row) -> States:
    """p + lead Q R + rest, with columns of its own."""
    n = len(ends)
    middle = [[((q[0] + q[1]) / 2).mid() for q in row] for row in lead]
    spread = [[sub(q, point(c)) for q, c in zip(*rows, strict=True)]
              for rows in zip(lead, middle, strict=True)]  # fmt: skip
    more = [add(q, dot(row, x.off)) for q, row in zip(rest, spread, strict=True)]
    columns: list[Column] = []
    for column, r in zip(x.columns, x.rest, strict=True):
        turned = [sum((m * c for m, c in zip(row, column, strict=True)), ZERO) for row in middle]
        columns.append([q.mid() for q in turned])
        away = [mul(interval(-q.rad(), q.rad()), r) for q in turned]
        more = [add(q, e) for q, e in zip(more, away, strict=True)]
    every = [(c, r) for c, r in zip([*columns, *_ones(n)], [*x.rest, *more], strict=True)
             if not r[0] == ZERO == r[1]]  # fmt: skip
    if len(every) > COLUMNS * n:
        every.sort(key=_length, reverse=True)
        smaller = every[COLUMNS * n // 2 :]
        frame = _frame([c for c, _ in smaller])
        try:
            inverted = arb_mat(n, n, [column[i] for i in range(n) for column in frame]).inv()
        except ZeroDivisionError:
            raise NoModelError("directions that cannot be told from each other") from None
        back = [[interval(inverted[i, j], inverted[i, j]) for j in range(n)] for i in range(n)]
        across = [[dot(row, list(map(point, c))) for row in back] for c, _ in smaller]
        reach = [dot([c[i] for c in across], [r for _, r in smaller]) for i in range(n)]
        every = [*every[: COLUMNS * n // 2], *zip(frame, reach, strict=True)]
    return States(ends, [c for c, _ in every], [r for _, r in every])


def _ones(n: int) -> list[Column]:
    return [[arb(int(i == j)) for i in range(n)] for j in range(n)]


def _length(column: tuple[Column, Interval]) -> float:
    """How far one reaches; what is unknown counts as none, and stays unknown."""
    size = math.hypot(*map(float, column[0])) * float((column[1][1] - column[1][0]).mid())
    return size if math.isfinite(size) else 0.0


def _frame(columns: list[Column]) -> list[Column]:
    """Columns that are orthogonal, but for rounding, the first along the first of these."""
    n = len(columns[0])
    units: list[list[float]] = []
    for column in ([float(q) for q in c] for c in [*columns, *_ones(n)]):
        left = column
        for _ in range(2):
            for unit in units:
                part = sum(p * q for p, q in zip(left, unit, strict=True))
                left = [p - part * q for p, q in zip(left, unit, strict=True)]
        size = math.hypot(*left)
        if len(units) < n and 0 < 1e-3 * math.hypot(*column) < size < math.inf:
            units.append([q / size for q in left])
    return [list(map(arb, unit)) for unit in units]


def parts(h: Values, pipe: Flowpipe) -> Iterator[tuple[list[tuple[Fraction, Fraction]], int]]:
    """The parts of a box, and how many steps are taken from each.

    Each number of the splits, from 0 on, halves one of its wide sides; a part that is not halved
    has its number of steps there, with a minus.
    """
    waiting = [([(Fraction(a), Fraction(b)) for a, b in pipe.box], 0)]
    for split in h["splits"]:
        if not waiting or split >= len(pipe.wide):
            break
        part, halved = waiting.pop()
        if halved > MOST_HALVED:
            break
        if split < 0:
            yield part, -split
            continue
        side = pipe.wide[split]
        low, high = part[side]
        for half in ((low + high) / 2, high), (low, (low + high) / 2):
            some = [half if k == side else q for k, q in enumerate(part)]
            waiting.append((some, halved + 1))
    else:
        if not waiting:
            return
    raise NotValidError("the parts of the box are not as it says")
