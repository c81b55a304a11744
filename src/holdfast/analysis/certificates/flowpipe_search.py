"""How a flowpipe is found: steps as long as a tolerance lets them be, and a box in parts.

What is tried is what `holdfast-check` follows afterwards, by its own arithmetic: nothing is found
that it does not accept.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from holdfast.analysis.certificates.cells import Floats
from holdfast.analysis.certificates.the_checker import part_of_checker
from holdfast.errors import SimulationError

FINEST = 24
"""A step is the hold divided by 2^FINEST at least."""
NARROWED = 3
"""How often a step is halved because a constraint may fail on it, before the box is divided."""
GROWTH = 0.01
"""By what part of what the polynomials leave out a step may add to it."""
PATIENCE = 8
"""Steps before one twice as long is tried again."""

Part = list[tuple[Fraction, Fraction]]


class _StuckError(Exception):
    """What could not be proved from a part of the box, and the states there."""

    def __init__(self, said: str, states: Any) -> None:
        super().__init__(said)
        self.states = states


class Search:
    """A flowpipe of a header in the form of its file.

    tolerance: by how much a step may miss trajectories. most: into how many parts the box is
    divided. splits, levels: what the file has of the parts and of the steps.
    """

    def __init__(self, header: Mapping[str, Any], tolerance: float, most: int) -> None:
        reading = part_of_checker("reading")
        part_of_checker("checker").begin()
        self._intervals = part_of_checker("intervals")
        self._stopped = (reading.NotValidError, part_of_checker("taylor").NoModelError)
        blank = {"splits": [], "entries": 0}
        try:
            said = reading.formed({**header, **blank}, reading.FLOWPIPE, "the header")
            self.pipe = part_of_checker("flowpipe").Flowpipe(said)
        except reading.NotValidError as error:
            raise SimulationError(str(error)) from None
        self.tolerance, self.most, self._most_steps = tolerance, most, reading.LITTLE
        self.splits: list[int] = []
        self.levels: list[int] = []
        self._first = self._begin = 0
        self._rows: list[tuple[float, ...]] = []
        self._ends: list[list[tuple[float, float]]] = []

    @property
    def boxes(self) -> tuple[Floats, Floats, Floats]:
        """When, and between what, all states are."""
        n = len(self.pipe.states)
        rows = np.array(self._rows, dtype=float).reshape(-1, 2 + 2 * n)
        return rows[:, :2], rows[:, 2 : 2 + n], rows[:, 2 + n :]

    @property
    def ends(self) -> dict[str, tuple[float, float]]:
        """Between what all states are at the end."""
        ends = np.array(self._ends, dtype=float).reshape(-1, len(self.pipe.states), 2)
        return {
            name: (float(q[:, 0].min()), float(q[:, 1].max()))
            for name, q in zip(self.pipe.states, ends.swapaxes(0, 1), strict=True)
        }

    def run(
        self,
        middle: Callable[[dict[str, tuple[float, float]]], Search] | None = None,
        progress: Callable[[str, float], None] | None = None,
    ) -> tuple[bool, str]:
        """Whether it was found, and what could not be proved.

        middle: a search from the middle of a part of the box alone. Where that is stuck too, no
        smaller parts are tried.
        """
        pipe, count = self.pipe, 1
        whole = [(Fraction(a), Fraction(b)) for a, b in pipe.box]
        waiting: list[tuple[Part, float]] = [(whole, 1.0)]
        done = 0.0
        while waiting:
            part, share = waiting.pop()
            rows, ends = len(self._rows), len(self._ends)
            try:
                levels = self._from(part)
            except _StuckError as stuck:
                count += 1
                if count > self.most or not pipe.wide:
                    return False, f"from {pipe.named(part)} {stuck}"
                if middle is not None:
                    sides = [(float(a), float(b)) for a, b in part]
                    proved, why = middle(dict(zip(pipe.carried, sides, strict=False))).run()
                    if not proved:
                        return False, why
                del self._rows[rows:], self._ends[ends:]
                split = self._side(stuck.states)
                side = pipe.wide[split]
                self.splits.append(split)
                low, high = part[side]
                for half in ((low + high) / 2, high), (low, (low + high) / 2):
                    halved = [half if k == side else q for k, q in enumerate(part)]
                    waiting.append((halved, share / 2))
                continue
            self.splits.append(-len(levels))
            self.levels += levels
            done += share
            if progress is not None:
                progress("box", done)
        return True, ""

    def _from(self, part: Part) -> list[int]:
        """The levels of all steps from a part. Raises `_StuckError`."""
        pipe, levels = self.pipe, list[int]()
        self._begin = self._first
        waiting = [(0, pipe.law.initial, pipe.begun(part))]
        while waiting:
            sample, mode, x = waiting.pop()
            when = f"after {sample * pipe.hold:g} s"
            try:
                if sample == pipe.holds:
                    at = pipe.at(x, x.off)
                    if (k := pipe.failing(pipe.target, at)) is not None:
                        raise _StuckError(f"target {k} may be missed {when}", x)
                    ranges = pipe.over(at)
                    self._ends.append([self._outward(ranges[n]) for n in pipe.states])
                    continue
                for begun, to in pipe.after_sample(x, mode):
                    waiting.append((sample + 1, to, self._through(begun, sample, levels)))
            except self._stopped as error:
                raise _StuckError(f"{when}: {error}", x) from None
        return levels

    def _through(self, x: Any, sample: int, levels: list[int]) -> Any:
        """The states at the next sample."""
        pipe, passed, level = self.pipe, Fraction(0), self._begin
        since, coarsest = PATIENCE, FINEST  # that the tolerance alone has let be
        while passed < 1:
            step = None
            for finer in itertools.count(level):
                level, length = finer, Fraction(1, 1 << finer)
                step = pipe.after(x, length)
                when = f"{float((sample + passed) * Fraction(pipe.hold)):g} s"
                if step is not None and self._missed(step, x) <= self.tolerance:
                    coarsest = min(coarsest, level)
                    if step.constraint is None:
                        break
                    if level >= coarsest + NARROWED:
                        raise _StuckError(f"constraint {step.constraint} may fail after {when}", x)
                if level == FINEST:
                    raise _StuckError(f"the states after {when} are too many to be followed", x)
                since = 0
            if len(self.levels) + len(levels) == self._most_steps:  # more are not read
                raise _StuckError(f"more than {self._most_steps} steps are needed", x)
            assert step is not None
            self._drawn(step, sample, passed, length)
            x, passed, since = step.ends, passed + length, since + 1
            levels.append(level)
            self._first = levels[0]
            coarsest = FINEST if level <= coarsest else coarsest
            aligned = level > 0 and (passed * (1 << (level - 1))).denominator == 1
            if aligned and since >= PATIENCE:
                level -= 1
        self._begin = level
        return x

    def _missed(self, step: Any, x: Any) -> float:
        """By how much a step misses trajectories, beyond what was left out before it."""
        added, before = (max((float(q[1] - q[0]) for q in row), default=0.0)
                         for row in (step.left, x.off))  # fmt: skip
        return added - GROWTH * before if added < np.inf else np.inf

    def _drawn(self, step: Any, sample: int, passed: Fraction, length: Fraction) -> None:
        n = len(self.pipe.states)
        times = [float((sample + t) * Fraction(self.pipe.hold)) for t in (passed, passed + length)]
        low, high = zip(*map(self._outward, step.way[:n]), strict=True)
        self._rows.append((*times, *low, *high))

    def _outward(self, q: Any) -> tuple[float, float]:
        return float(self._intervals.down(q)), float(self._intervals.up(q))

    def _side(self, x: Any) -> int:
        """Which side of the box to halve: that of which the states depend in curves the most."""
        scores = np.zeros((2, len(self.pipe.wide)))
        for p in x.polynomials[: len(self.pipe.states)]:
            terms = [(self.pipe.models.exponents[k][:-1], abs(float(c))) for k, c in p.items()]
            scale = sum(size for powers, size in terms if any(powers)) or 1.0
            for powers, size in terms:
                if any(powers):
                    scores[int(sum(powers) == 1)] += np.array(powers) / sum(powers) * size / scale
        curved, straight = scores
        return int(np.argmax(curved if curved.max() > 1e-6 else straight))
