"""The trial that a kernel is given where nobody asks for another: about a second of work."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import REACHED
from holdfast.analysis.safety.validation import DISTURBED, check_promise
from holdfast.analysis.safety.verdict import Promise
from holdfast.execution.resources import Progress
from holdfast.maths.definitions.system import System

WORK = 3_000_000
"""Samples of runs in two states, of starts inside and around them, against every disturbance."""

MOST, FEWEST = 200, 40
"""Starts inside; fewer where runs are long, then shorter runs."""


@dataclass(frozen=True)
class Trial:
    """The starts inside, the horizon [s] and the time for which inputs are held [s]."""

    runs: int
    horizon: float
    sample_time: float

    @property
    def settings(self) -> dict[str, Any]:
        """For `check_promise`."""
        return {"runs": self.runs, "horizon": self.horizon, "sample_time": self.sample_time}


def default_trial(system: System, value: ValueFunction) -> Trial:
    """The trial of a value function that takes about a second, the same on every machine.

    Inputs are held for a step of its march, in which no state crosses more than a cell, so that the
    trial depends on no unit of time. A look-up in n states reads 2^n nodes, for the value and its n
    slopes. The horizon is that of the value function, or, where FEWEST starts for as long are too
    much work, as long as can be afforded; a goal is to be reached in the whole horizon.
    """
    report, states = value.report, len(value.grid.axes)
    hold = report.reached_s / max(report.steps, 1)
    kinds = len(DISTURBED) if system.disturbances else 1
    look_up = 2**states * (states + 1) / 12
    samples = WORK / (2 * kinds * max(look_up, 1.0))
    runs = int(min(MOST, max(FEWEST, samples * hold / report.horizon_s)))
    horizon = report.horizon_s
    if report.kind not in REACHED:
        horizon = min(horizon, samples * hold / runs)
    return Trial(runs, horizon, hold)


def default_promise(
    system: System, value: ValueFunction, progress: Progress | None = None
) -> Promise | None:
    """The promise of a value function by `default_trial`; None where what it claims is not known.

    Raises `SimulationError` where it cannot be tried, as `check_promise`.
    """
    if value.claim is None:
        return None
    trial = default_trial(system, value).settings
    region, goal = value.claim.region, value.claim.goal
    return check_promise(system, value, region, goal=goal, progress=progress, **trial)
