"""The trial that a kernel is given where nobody asks for another: about a second of work."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import sympy as sp

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import REACHED, decided
from holdfast.analysis.safety.sampled_value import sampled_value
from holdfast.analysis.safety.validation import DISTURBED, check_promise
from holdfast.analysis.safety.verdict import Promise
from holdfast.execution.resources import Progress
from holdfast.maths.definitions.law import Law
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


FALLS = 0.04
"""The share of what is left above the level of a filter by which the value may fall in a sample."""


def default_trial(system: System, value: ValueFunction, sample_time: float | None = None) -> Trial:
    """The trial of a value function that takes about a second, the same on every machine.

    Inputs are held for `sample_time` [s], by default for an Euler step of its march, in which no
    state crosses a cell, so that the trial depends on no unit of time. A look-up in n states
    reads 2^n nodes, for the value and its n slopes. The horizon is that of the value function, or,
    where FEWEST starts for as long are too much work, as long as can be afforded; a goal is to be
    reached in the whole horizon.
    """
    report, states = value.report, len(value.grid.axes)
    hold = report.euler_step if sample_time is None else sample_time
    kinds = len(DISTURBED) if system.disturbances else 1
    look_up = 2**states * (states + 1) / 12
    samples = WORK / (2 * kinds * max(look_up, 1.0))
    runs = int(min(MOST, max(FEWEST, samples * hold / report.horizon_s)))
    horizon = report.horizon_s
    if report.kind not in REACHED:
        horizon = min(horizon, samples * hold / runs)
    horizon = max(1, math.floor(horizon / hold * (1 + 1e-9))) * hold
    return Trial(runs, min(horizon, max(report.horizon_s, hold)), hold)


def default_promise(
    system: System,
    value: ValueFunction,
    progress: Progress | None = None,
    sample_time: float | None = None,
) -> Promise | None:
    """The promise of a value function by `default_trial`; None where what it claims is not known.

    Where the sampled game is solved, the law is the safety filter around inputs of zero: at a ridge
    of V the optimal inputs keep less than the kernel, and the filter is what a vehicle runs.

    Raises `SimulationError` where it cannot be tried, as `check_promise`.
    """
    if value.claim is None:
        return None
    trial = default_trial(system, value, sample_time)
    region, goal = value.claim.region, value.claim.goal
    options: dict[str, Any] = {"goal": goal, "progress": progress, **trial.settings}
    if value.report.converged and sampled_value(decided(system, value), value, trial.sample_time):
        options |= {"law": at_rest(system), "rate": FALLS / trial.sample_time}
    return check_promise(system, value, region, **options)


def at_rest(system: System) -> Law:
    """Inputs of zero, or those nearest to it within the bounds."""
    zeros = dict.fromkeys(system.input_names, sp.S.Zero)
    return Law(name=f"inputs of {system.name} at zero", reads=(), outputs=zeros)
