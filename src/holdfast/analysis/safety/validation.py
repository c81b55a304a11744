"""Closed-loop (Monte Carlo) validation of a kernel: trajectories of its law from random states."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.analysis.reachability.grid import whole
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.memory_estimate import check_trials
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.adversary import CONSTANT, INSIDE, SWINGING, SWITCHING, schedules
from holdfast.analysis.safety.depth import inside_states, outer_states, outside_states
from holdfast.analysis.safety.safety_filter import (
    check_not_empty,
    decided,
    safety_law,
    sampled_margin,
    worst_disturbance,
)
from holdfast.analysis.safety.trial_runs import ALL, NO_DISTURBANCE, Runs, layers_of
from holdfast.analysis.safety.verdict import Beaten, Promise, Trials
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.simulate import simulate
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.maths.control.value_filter import ADVERSARY_AIM
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.games.sampled_inputs import without_closed_form

OF_VALUE, OF_MARGIN = "the gradient of the value", "the gradient of the constraints"
DISTURBED = (OF_VALUE, OF_MARGIN, CONSTANT, INSIDE, SWITCHING, SWINGING)
RESTARTS = "restarts from the nearest starts"

NEAREST, TRIES = 20, 10
"""Restarts: one start in this many, those that came nearest, and the tries of each."""


@checked
def check_promise(
    system: System,
    value: ValueFunction,
    region: Region | None,
    *,
    goal: Region | None = None,
    law: Law | Switching | None = None,
    runs: int = 1000,
    margin: float | None = None,
    horizon: float | None = None,
    sample_time: float = 0.02,
    rate: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Promise:
    """Simulate from `runs` random states of the kernel, and as many of the rest of `region`.

    Up to half as many more are in each layer of the kernel between these states and its edge: at
    least a cell inside, and within a cell of the edge. So the whole set is tried, and the shares of
    its volume are in the answer. Starts a cell inside may be lost by no more than a held input can
    lose, without a `margin`; those within a cell of the edge are counted.

    Every start is run against each of these disturbances, and counts as kept if it is kept against
    all: one that lowers the value, one that lowers the margin of the constraints, constant
    extremes, constants within the bounds, switching extremes, and random swings. The starts that
    came nearest to being lost are run again, against ten more switching disturbances.

    region: the constraints, None if a goal may be reached through any state. law: the law under the
    safety filter; None: the optimal inputs, under it where `safety_law` has the sampled game.
    margin [unit of V]: the depth of the starts inside the set; by default one cell and the loss of
    a held input: at all states a cell away along an axis V is above `sampled_margin`, or above 0 if
    no state is as far inside. horizon [s]: by default that of the value function; a kernel that has
    not converged claims nothing beyond it. goal: of a capture basin, to be reached.

    Raises `SimulationError` for a value function without a claim about a law, or of an empty set.
    """
    report = value.report
    longest = report.horizon_s
    if horizon is None:
        horizon = longest
    if horizon > longest and not report.converged:
        raise SimulationError(
            f"a validation over {horizon:g} s of a value function that has not converged",
            expected=f"at most its horizon, {longest:g} s",
        )
    whole("runs: ", runs, 1)
    check_trials(runs, len(system.states))
    whole("seed: ", seed, 0)
    known = decided(system, value)
    check_not_empty(value)
    if region is None and goal is None:
        raise SimulationError("no region to stay in", remedy="give the region")
    steered = safety_law(system, value, law, sample_time=sample_time, rate=rate)
    generator = np.random.default_rng(seed)
    loss = sampled_margin(system, value, sample_time) if margin is None and system.inputs else 0.0
    inside, loss = inside_states(value, generator, runs, margin, loss)
    beyond = outside_states(value, generator, runs, margin, region, known)
    outer = outer_states(value, np.random.default_rng((seed, 1)), (runs + 1) // 2, margin, loss)
    attack = _Attack(system, known, value, steered, region, goal, horizon, sample_time, seed)
    starts = np.vstack([inside, outer.between, outer.edge])
    kinds = DISTURBED if known.disturbances else (NO_DISTURBANCE,)
    steps = len(kinds) + 2

    def run(what: str, starts: Array, count: int) -> Runs:
        return attack.run(what, starts, _part(progress, count / steps, steps))

    every = [run(what, starts, count) for count, what in enumerate(kinds)]
    found = {what: r.part(slice(0, runs)) for what, r in zip(kinds, every, strict=True)}
    kept: Any = np.stack([r.kept for r in found.values()]).all(axis=0)
    trials = [r.trials(what) for what, r in found.items()]
    beaten = _beaten(inside, found)
    if known.disturbances:
        near = np.max([r.near for r in found.values()], axis=0)
        order = np.argsort(-near, kind="stable")
        again = order[kept[order]]
        again = again[: max(1, runs // NEAREST)]
        if len(again):
            tried = run(RESTARTS, np.repeat(inside[again], TRIES, axis=0), len(kinds))
            beaten += _beaten(np.repeat(inside[again], TRIES, axis=0), {RESTARTS: tried}, TRIES)
            stood: Any = tried.kept.reshape(-1, TRIES).all(axis=1)
            off = tried.off_grid.reshape(-1, TRIES).any(axis=1) & ~stood
            kept[again] &= stood
            relaxed = int(tried.relaxed.reshape(-1, TRIES).any(axis=1).sum())
            rate_again = Rate(int(stood.sum()), int(stood.size))
            trials.append(Trials(RESTARTS, rate_again, int(off.sum()), tried.excursion, relaxed))
        total = Trials(
            ALL,
            Rate(int(kept.sum()), runs),
            sum(b.outcome == Outcome.OFF_GRID.label for b in beaten),
            float(np.max([t.excursion for t in trials])),
            max(t.relaxed for t in trials),
        )
        trials = [total, *trials]
    lost = None
    if beyond is not None:
        what = OF_VALUE if known.disturbances else NO_DISTURBANCE
        lost = run(what, beyond, len(kinds) + 1).trials(what)
    return Promise(
        law=steered.name,
        margin=margin,
        unit=report.value_unit,
        horizon=horizon,
        sample_time=sample_time,
        inside=tuple(trials),
        outside=lost,
        aim="stay" if goal is None else "reach the goal",
        beaten=tuple(beaten),
        doubt=_doubt(report) or _doubt_of_samples(known),
        held_loss=loss,
        share=outer.share,
        layers=layers_of(outer, every, loss if margin is None else None),
    )


def _part(tell: Progress | None, begin: float, parts: int) -> Callable[[float], None]:
    """The progress of one of `parts` equal parts, which begins at a share of the whole."""

    def told(fraction: float) -> None:
        if tell is not None:
            tell(begin + fraction / parts)

    return told


def _doubt(report: Report) -> str:
    """The doubt that the set touches ends of the grid beyond which its value is extrapolated."""
    ends = report.ends_reached
    if not ends or report.nodes_from_outside == 0:
        return ""
    return (
        f"the set touches the open ends of the grid ({ends}) and depends on extrapolation "
        "beyond them; widen the grid until it does not touch them"
    )


def _doubt_of_samples(system: System) -> str:
    """The doubt that a sampled disturbance may be worse between its sample points."""
    found = without_closed_form(system) if system.samples else set()
    names = [q.name for q in system.disturbances if q.symbol in found]
    if not names:
        return ""
    return (
        f"the disturbance {', '.join(names)} was sampled at {system.samples} points per "
        "coordinate, and values between them may be worse"
    )


@dataclass(frozen=True)
class _Attack:
    """The closed loop of a law, and the disturbances of its validation.

    system: as defined; known: with the prescribed disturbances of the value.
    """

    system: System
    known: System
    value: ValueFunction
    law: Law | Switching
    region: Region | None
    goal: Region | None
    horizon: float
    sample_time: float
    seed: int

    def run(self, what: str, starts: Array, tell: Callable[[float], None]) -> Runs:
        """The outcomes of the starts against one kind of disturbance."""
        plant, driven = self.known, self.law
        settings: dict[str, Any] = {
            "horizon": self.horizon,
            "sample_time": self.sample_time,
            "record_every": self.sample_time if self.goal is not None else self.horizon,
            "seed": self.seed,
            "start_outside": True,
            "progress": tell,
        }
        if what in (OF_VALUE, OF_MARGIN):
            aimed = self.goal or self.region
            plant, driven = worst_disturbance(self.system, self.value, self.law, aimed)
            aim = float(what == OF_MARGIN)
            if any(r.has(ADVERSARY_AIM) for r in plant.rates.values()):
                settings["varied"] = Varied({ADVERSARY_AIM.name: (aim, aim)})
        elif what != NO_DISTURBANCE:
            kind = SWITCHING if what == RESTARTS else what
            found = schedules(self.known)
            settings["disturbance"] = found.expressions
            settings["varied"] = found.drawn(kind, self.horizon, self.sample_time)
            settings["seed"] = self.seed + (what == RESTARTS)
        result = simulate(plant, driven, starts=starts, region=self.region, **settings)
        return self._judged(result)

    def _judged(self, result: Result) -> Runs:
        data = result.arrays
        outcome = data["outcome"].values
        left = np.nan_to_num(data["exit_time"].values, nan=np.inf)
        off = np.nan_to_num(data["off_grid_time"].values, nan=np.inf)
        worst = data["worst_constraint"].values
        if self.region is not None:
            scales = [1.0 if c.scale is None else c.scale for c in self.region.inequalities]
            worst = (worst / np.array(scales)).max(axis=1)
        if self.goal is None:
            gone = np.isin(outcome, (Outcome.LEFT, Outcome.DIVERGED))
            kept, near, missed = ~gone & np.isinf(off), worst, worst
        else:
            states = data["state"].values
            flat = states.reshape(-1, states.shape[2])
            known = np.isfinite(flat).all(axis=1)  # the record of a diverged run ends there
            points = np.where(known[:, None], flat, 0.0)

            def levels_of(region: Region) -> Any:
                symbols = [q.symbol for q in self.system.states]
                level = Evaluator([region.worst], symbols, region.parameters)
                values = np.where(known, level.values(points)[:, 0], math.inf)
                return values.reshape(states.shape[:2])

            levels = levels_of(self.goal)
            there = levels <= 0
            first = np.where(there.any(axis=1), data["time"].values[there.argmax(axis=1)], np.inf)
            lost = np.isin(outcome, (Outcome.LEFT, Outcome.DIVERGED))
            kept = np.isfinite(first) & (first <= off) & ((first <= left) | ~lost)
            if self.region is not None:  # the value of the run: min_t max(goal, max_s<t constraint)
                levels = np.maximum(levels, np.maximum.accumulate(levels_of(self.region), axis=1))
            missed = levels.min(axis=1)
            near, worst = first, np.full(len(first), math.nan)
        off_first = ~kept & np.isfinite(off) & (off <= left)
        return Runs(
            kept,
            off_first,
            np.nan_to_num(near, nan=np.inf),
            np.minimum(left, off),
            np.where(off_first, int(Outcome.OFF_GRID), outcome),
            worst,
            np.where(off_first | np.isnan(missed), math.inf, missed),
            data["infeasible"].values > 0,
        )


def _beaten(starts: Array, found: dict[str, Runs], each: int = 1) -> list[Beaten]:
    """The starts that were lost, with the first disturbance that beat each; `each`: how many
    rows in turn are one start."""
    beaten: dict[int, Beaten] = {}
    for what, runs in found.items():
        for row in map(int, np.flatnonzero(~runs.kept)):
            if row // each not in beaten:
                outcome = Outcome(int(runs.outcome[row])).label
                if outcome in ("stayed", "chattered"):  # in the region but not in the goal
                    outcome = "did not arrive"
                state = tuple(float(v) for v in starts[row])
                beaten[row // each] = Beaten(state, what, outcome, float(runs.time[row]))
    return list(beaten.values())
