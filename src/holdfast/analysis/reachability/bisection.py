"""How much of something a kernel stands: what was tried, and the limit between what it showed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.solve import set_on_grid
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import SimulationError
from holdfast.maths.definitions.region import Region

SCANNED = 9
"""Values tried over the interval where a larger one need not leave less."""

DOUBLED = 5
"""How often the upper end is doubled while everything holds."""


class Answer(Enum):
    """What a trial has shown."""

    HELD = "the set is what it has to be"
    LOST = "it is not"
    UNDECIDED = "it is by now, and has not converged within the horizon"


@dataclass(frozen=True)
class Tried:
    """One value that was tried.

    least: the value that has to be above zero, the largest of V, or the least of V where it has to
    be kept. fraction: of the grid's box in the set; not a number where something that had to be
    kept is lost, since the march may have ended there. warm: begun from the kernel of a smaller
    bound. reached: simulated time [s].
    """

    value: float
    answer: Answer
    least: float
    fraction: float
    converged: bool
    warm: bool
    steps: int
    reached: float
    wall_time: float

    def summary(self) -> dict[str, Any]:
        shown = {**self.__dict__, "answer": self.answer.name.lower()}
        return shown | {"fraction": None if math.isnan(self.fraction) else self.fraction}


@dataclass(frozen=True)
class Margin:
    """The trials of a search, in ascending order, and what follows from them.

    keeps: whether the set has to contain something, or only not to be empty; monotone: whether a
    larger value can only take away, by the bounds of the disturbances themselves; settings: those
    of the scenario at `low`; end: the largest value that the bounds of the system allow.
    """

    title: str
    scenario: str
    key: str
    name: str
    unit: str
    keeps: bool
    horizon: float
    forever: bool
    tolerance: float
    monotone: bool
    trials: tuple[Tried, ...]
    settings: tuple[str, ...] = ()
    end: float = math.inf

    @property
    def low(self) -> float | None:
        """The largest value up to which every one that was tried holds."""
        return _last_held(self.trials)

    @property
    def high(self) -> float | None:
        """The least value above `low` that is lost."""
        return _first_lost(self.trials, self.low)

    @property
    def undecided(self) -> tuple[float, ...]:
        """The values for which the horizon was too short."""
        return tuple(t.value for t in self.trials if t.answer is Answer.UNDECIDED)

    @property
    def holds_again(self) -> tuple[float, ...]:
        """Values that hold above one that is lost: what is asked for is not monotone."""
        lost = [t.value for t in self.trials if t.answer is Answer.LOST]
        return tuple(
            t.value for t in self.trials if t.answer is Answer.HELD and lost and t.value > lost[0]
        )

    @property
    def answered(self) -> bool:
        """Whether the limit is known within the tolerance."""
        low, high = self.low, self.high
        return low is not None and high is not None and _close(low, high, self.tolerance)

    def summary(self) -> dict[str, Any]:
        """For margin.json."""
        fields = (
            "title", "scenario", "key", "name", "unit", "keeps", "forever", "tolerance",
            "monotone", "low", "high", "answered",
        )  # fmt: skip
        return {
            **{n: getattr(self, n) for n in fields},
            "horizon_s": self.horizon,
            "undecided": list(self.undecided),
            "holds_again": list(self.holds_again),
            "trials": [t.summary() for t in self.trials],
        }


def search(
    attempt: Callable[[float, float, float], Tried],
    low: float,
    high: float,
    tolerance: float,
    *,
    monotone: bool,
    end: float,
) -> tuple[Tried, ...]:
    """Try values until the limit is known within `tolerance`, or cannot be.

    attempt: called with a value, the share of the work that is done, and its own. monotone: the
    ends alone are tried before the bisection, else values all over the interval. end: the upper
    end is doubled up to there while everything holds.

    With undecided values in between the limit is followed from both sides, so that they are as few
    as they can be.
    """
    trials: dict[float, Tried] = {}
    expected = (2 if monotone else SCANNED) + _halvings(
        high - low if monotone else (high - low) / (SCANNED - 1), tolerance
    )

    def ordered() -> list[Tried]:
        return [trials[v] for v in sorted(trials)]

    def tried(value: float) -> Answer:
        if value not in trials:
            total = max(expected, len(trials) + 1)
            trials[value] = attempt(value, len(trials) / total, 1 / total)
        return trials[value].answer

    def narrowed(below: float, above: float, alike: Callable[[Answer], bool]) -> None:
        while not _close(below, above, tolerance):
            middle = 0.5 * (below + above)
            if alike(tried(middle)):
                below = middle
            else:
                above = middle

    for k in range(DOUBLED + 1):
        values = [low, high] if monotone else list(np.linspace(low, high, SCANNED))
        held = [tried(float(v)) is Answer.HELD for v in values]
        if not all(held) or high >= end or k == DOUBLED:
            break
        low, high = high, min(2 * high, end)
    last = _last_held(ordered())
    if last is None or last == max(trials):
        return tuple(ordered())
    narrowed(last, min(v for v in trials if v > last), lambda a: a is Answer.HELD)
    last = _last_held(ordered())
    lost = _first_lost(ordered(), last)
    if last is not None and lost is not None:
        between = [v for v in trials if last < v < lost]
        if between:
            narrowed(max(between), lost, lambda a: a is not Answer.LOST)
    return tuple(ordered())


class Kept:
    """What the set has to contain: states, all of regions; without any it must not be empty."""

    def __init__(
        self, grid: Grid, states: npt.ArrayLike = (), regions: Sequence[Region] = ()
    ) -> None:
        self.states = np.asarray(states, dtype=np.float64).reshape(-1, len(grid.axes))
        self.nodes: npt.NDArray[np.bool_] = np.zeros(grid.shape, dtype=bool)
        for region in regions:
            inside = set_on_grid(region, grid).values() > 0
            if not inside.any():
                raise SimulationError(
                    f"no node of the grid is in region '{region.name}'",
                    remedy="take a finer grid, or a state",
                )
            self.nodes |= inside

    @property
    def asked(self) -> bool:
        return bool(len(self.states) or self.nodes.any())

    def least(self, value: ValueFunction) -> float:
        """Above zero if the set is what it has to be; not a number outside the grid."""
        values = value.values()
        if not self.asked:
            return float(values.max())
        found = np.concatenate([value.at(self.states), values[self.nodes]])
        return float(found.min())

    def lost(self, value: ValueFunction) -> bool:
        return not self.least(value) > 0


def _last_held(trials: Sequence[Tried]) -> float | None:
    held = None
    for t in trials:
        if t.answer is not Answer.HELD:
            break
        held = t.value
    return held


def _first_lost(trials: Sequence[Tried], above: float | None) -> float | None:
    lost = [t.value for t in trials if t.answer is Answer.LOST]
    return next((v for v in lost if above is None or v > above), None)


def _close(below: float, above: float, tolerance: float) -> bool:
    return above - below <= tolerance * (1 + 1e-9)


def _halvings(width: float, tolerance: float) -> int:
    return max(0, math.ceil(math.log2(width / tolerance) - 1e-9))
