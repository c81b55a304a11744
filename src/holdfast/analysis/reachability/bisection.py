"""Bisection for the largest admissible value of a parameter, such as a disturbance bound."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.solve import set_on_grid
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import SimulationError
from holdfast.maths.definitions.region import Region

SCANNED = 9
"""Number of values tried over the interval if the answer need not be monotone."""

DOUBLED = 5
"""Largest number of doublings of the upper end while all trials succeed."""


class Answer(Enum):
    """The outcome of a trial."""

    HELD = "the set meets the requirement"
    LOST = "the set does not meet the requirement"
    UNDECIDED = "the set meets the requirement so far, but has not converged within the horizon"


class Trial(Protocol):
    """What a search asks of the result for one value."""

    @property
    def value(self) -> float: ...

    @property
    def answer(self) -> Answer: ...


T = TypeVar("T", bound=Trial)


@dataclass(frozen=True)
class Tried:
    """A trial of one value.

    least: the value that has to be above zero, either the largest V, or the least V at the states
    to keep. fraction: of the grid's box in the set; NaN if a state to keep is lost, since the march
    may have ended there. warm: started from the kernel of a smaller bound (warm start). reached:
    simulated time [s].
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
    """The trials of a search, in ascending order, and the resulting limits.

    keeps: whether the set has to contain given states, or only not to be empty. monotone: whether a
    larger value can only shrink the set, by the bounds of the disturbances themselves. settings:
    those of the scenario at `low`. end: the largest value that the bounds of the system allow.
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
        """The largest tried value such that it and all smaller tried ones hold."""
        return last_held(self.trials)

    @property
    def high(self) -> float | None:
        """The least value above `low` that is lost."""
        return first_lost(self.trials, self.low)

    @property
    def undecided(self) -> tuple[float, ...]:
        """The values with too short a horizon for an answer."""
        return tuple(t.value for t in self.trials if t.answer is Answer.UNDECIDED)

    @property
    def holds_again(self) -> tuple[float, ...]:
        """Values that hold above one that is lost: the answer is not monotone."""
        lost = [t.value for t in self.trials if t.answer is Answer.LOST]
        return tuple(
            t.value for t in self.trials if t.answer is Answer.HELD and lost and t.value > lost[0]
        )

    @property
    def answered(self) -> bool:
        """Whether the limit is known within the tolerance."""
        low, high = self.low, self.high
        return low is not None and high is not None and close(low, high, self.tolerance)

    def summary(self) -> dict[str, Any]:
        """The content of margin.json."""
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
    attempt: Callable[[float, float, float], T],
    low: float,
    high: float,
    tolerance: float,
    *,
    monotone: bool,
    end: float,
) -> tuple[T, ...]:
    """Try values until the limit is known within `tolerance`, or cannot be.

    attempt: called with a value, the finished share of the work, and the share of this trial.
    monotone: only the ends are tried before the bisection, otherwise values all over the interval.
    end: the limit of doubling the upper end while all trials hold.

    If undecided values lie in between, the limit is approached from both sides, so that as few as
    possible remain.
    """
    trials: dict[float, T] = {}
    expected = (2 if monotone else SCANNED) + _halvings(
        high - low if monotone else (high - low) / (SCANNED - 1), tolerance
    )

    def ordered() -> list[T]:
        return [trials[v] for v in sorted(trials)]

    def tried(value: float) -> Answer:
        if value not in trials:
            total = max(expected, len(trials) + 1)
            trials[value] = attempt(value, len(trials) / total, 1 / total)
        return trials[value].answer

    def narrowed(below: float, above: float, alike: Callable[[Answer], bool]) -> None:
        while not close(below, above, tolerance):
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
    last = last_held(ordered())
    if last is None or last == max(trials):
        return tuple(ordered())
    narrowed(last, min(v for v in trials if v > last), lambda a: a is Answer.HELD)
    last = last_held(ordered())
    lost = first_lost(ordered(), last)
    if last is not None and lost is not None:
        between = [v for v in trials if last < v < lost]
        if between:
            narrowed(max(between), lost, lambda a: a is not Answer.LOST)
    return tuple(ordered())


class Kept:
    """The states and regions that the set has to contain; without any it must not be empty."""

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
        """A number above zero if the set contains them; NaN outside the grid."""
        values = value.values()
        if not self.asked:
            return float(values.max())
        found = np.concatenate([value.at(self.states), values[self.nodes]])
        return float(found.min())

    def lost(self, value: ValueFunction) -> bool:
        return not self.least(value) > 0


def last_held(trials: Sequence[Trial]) -> float | None:
    """The largest value such that it and all smaller ones hold, of trials in ascending order."""
    held = None
    for t in trials:
        if t.answer is not Answer.HELD:
            break
        held = t.value
    return held


def first_lost(trials: Sequence[Trial], above: float | None) -> float | None:
    """The least value above another that is lost."""
    lost = [t.value for t in trials if t.answer is Answer.LOST]
    return next((v for v in lost if above is None or v > above), None)


def close(below: float, above: float, tolerance: float) -> bool:
    """Whether two values are within a tolerance."""
    return above - below <= tolerance * (1 + 1e-9)


def _halvings(width: float, tolerance: float) -> int:
    return max(0, math.ceil(math.log2(width / tolerance) - 1e-9))
