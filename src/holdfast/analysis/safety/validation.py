"""Closed-loop (Monte Carlo) validation of a kernel: trajectories of its law from random states.

The outcomes of the runs are counted for the layers of the set. Where nobody asks for another, the
trial takes about a second of work.

Disturbances are adversaries: state feedback, or along a schedule. With state feedback the
disturbance lowers the value along its gradient, or the margin of the constraints. Both are greedy,
and the first relies on the value under test. The schedules do not: every coordinate of a bound
follows

    amplitude clip(gain (sin(pace t + phase) + bias), -1, 1)

which is a constant extreme at pace 0, switches between extremes if the gain is large, and
swings if it is 1. Numbers are drawn for every run; paces are spread evenly over their logarithm,
from one change per horizon to one every few samples, so that no unit of time is preferred.

The verdict says of each disturbance which share of the starts was kept against it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.reachability.grid import whole
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.depth import Outer, inside_states, outer_states, outside_states
from holdfast.analysis.safety.promise import Beaten, Layer, Promise, Trials
from holdfast.analysis.safety.safety_filter import (
    REACHED,
    check_not_empty,
    decided,
    safety_law,
    sampled_margin,
    worst_disturbance,
)
from holdfast.analysis.safety.sampled_value import sampled_value
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.simulate import simulate
from holdfast.arguments import Count, Seconds, checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray, Array, Truths
from holdfast.execution.leaf import Evaluator
from holdfast.execution.resources import Progress, check_trials
from holdfast.execution.simulation.settings import Outcome
from holdfast.maths.control.value_filter import ADVERSARY_AIM
from holdfast.maths.definitions.bounds import Box, Product
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, Quantity, symbol
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.functions import clip
from holdfast.maths.games.hamiltonian import without_closed_form

NO_DISTURBANCE = "no disturbance"
ALL = "every disturbance tried"


@dataclass(frozen=True)
class Runs:
    """Outcomes of runs: kept, left the grid first, nearness to the boundary (large: near), time.

    worst: the largest constraint of each run, NaN for a basin; missed: the negative value of the
    run, by how much it leaves the region, or of a basin misses the goal or leaves it before.
    """

    kept: Truths
    off_grid: Truths
    near: Array
    time: Array
    outcome: AnyArray
    worst: Array
    missed: Array
    relaxed: Truths

    @property
    def excursion(self) -> float:
        return float(np.max(self.worst))

    @property
    def refuted(self) -> Truths:
        """The runs that are lost within the grid, shape (runs,)."""
        lost: Truths = ~self.kept & ~self.off_grid
        return lost

    def part(self, which: slice) -> Runs:
        """Those of some starts."""
        return Runs(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def trials(self, what: str) -> Trials:
        rate = Rate(int(self.kept.sum()), len(self.kept))
        return Trials(what, rate, int(self.off_grid.sum()), self.excursion, int(self.relaxed.sum()))


def layers_of(outer: Outer, every: Sequence[Runs], loss: float | None) -> tuple[Layer, ...]:
    """The layers of a set around the states inside, whose runs are the last of every kind.

    loss: of a held input, where the set claims what is a cell inside.
    """
    parts = (
        (outer.between, outer.between_share, "at least a cell inside", "a cell", loss),
        (outer.edge, outer.edge_share, "within a cell of the edge", "the edge", None),
    )
    layers, ahead = [], len(every[0].kept) - sum(len(states) for states, *_ in parts)
    for states, share, where, down_to, allowed in parts:
        runs = [r.part(slice(ahead, ahead + len(states))) for r in every]
        ahead += len(states)
        if len(states):
            within = [np.where(r.kept | r.off_grid, 0.0, r.missed) for r in runs]
            missed = max(float(m.max()) for m in within)
            trials = _against_all(runs)
            layers.append(Layer(where, down_to, share, trials, max(missed, 0.0), allowed))
    return tuple(layers)


def _against_all(every: Sequence[Runs]) -> Trials:
    """The starts against all that was tried."""
    stood: Any = np.stack([r.kept for r in every]).all(axis=0)
    off: Any = ~stood & ~np.stack([r.refuted for r in every]).any(axis=0)
    relaxed: Any = np.stack([r.relaxed for r in every]).any(axis=0)
    worst = float(np.max([r.excursion for r in every]))
    what = ALL if len(every) > 1 else NO_DISTURBANCE
    rate = Rate(int(stood.sum()), len(stood))
    return Trials(what, rate, int(off.sum()), worst, int(relaxed.sum()))


Range = tuple[float, float]

STEEP = 1e6
"""The gain of a switching schedule."""

CONSTANT, INSIDE = "constant extremes", "constants within the bounds"
SWITCHING, SWINGING = "switching extremes", "random swings"


@dataclass(frozen=True)
class Schedules:
    """Disturbances along a schedule: one set of expressions for all kinds, and the draws.

    coordinates: the kind of bound of each coordinate, "box" or "ball".
    """

    expressions: dict[str, sp.Expr]
    coordinates: tuple[str, ...]

    def drawn(self, kind: str, horizon: float, sample_time: float) -> Varied:
        """The draws of every run for a kind, one of CONSTANT, INSIDE, SWITCHING, SWINGING."""
        paces = (math.log(math.pi / horizon), math.log(math.pi / (5.0 * sample_time)))
        if kind in (CONSTANT, INSIDE):
            paces = (-700.0, -700.0)  # exp(-700) t is constant
        gain = 1.0 if kind == SWINGING else STEEP
        draws: dict[str, Range] = {"schedule_gain": (gain, gain)}
        for number, bound in enumerate(self.coordinates):
            either = kind == INSIDE or (bound == "ball" and kind != SWINGING)
            least = -1.0 if either else 1.0
            draws[f"schedule_amplitude_{number}"] = (least, 1.0)
            draws[f"schedule_pace_{number}"] = (paces[0], max(paces))
            draws[f"schedule_phase_{number}"] = (-math.pi, math.pi)
            draws[f"schedule_bias_{number}"] = (-0.9, 0.9) if kind == SWITCHING else (0.0, 0.0)
        used = {s.name for e in self.expressions.values() for s in e.free_symbols}
        draws = {n: ends for n, ends in draws.items() if n in used}
        return Varied(draws, {}, {}, dict.fromkeys(draws, "1"))


def schedules(system: System) -> Schedules:
    """The disturbances of the system along schedules that stay within their bounds."""
    coordinates: list[str] = []

    def wave(bound: str) -> sp.Expr:
        number = len(coordinates)
        coordinates.append(bound)
        amplitude, pace, phase, bias = (
            symbol(f"schedule_{name}_{number}") for name in ("amplitude", "pace", "phase", "bias")
        )
        swing = sp.sin(sp.exp(pace) * TIME + phase) + bias
        return amplitude * clip(symbol("schedule_gain") * swing, sp.S(-1), sp.S(1))

    assert system.disturbance_bounds is not None
    moved = system.disturbance_bounds.moving(wave)
    expressions = dict(zip(system.disturbance_names, moved, strict=True))
    read = set().union(*(r.free_symbols for r in system.rates.values()))
    for q in system.disturbances:
        if q.symbol not in read:  # no rate depends on it
            expressions[q.name] = sp.S.Zero
    return Schedules(expressions, tuple(coordinates))


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
    runs: Count = 1000,
    margin: float | None = None,
    horizon: Seconds | None = None,
    sample_time: Seconds = 0.02,
    rate: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Promise:
    """Simulate from random states of the kernel, and as many of the rest of `region`.

    Up to half as many more are in each layer of the kernel between these states and its edge: at
    least a cell inside, and within a cell of the edge. So the whole set is tried, and the shares of
    its volume are in the answer. Starts a cell inside may be lost by no more than a held input can
    lose, without a `margin`; those within a cell of the edge are counted.

    Every start is run against each of these disturbances, and counts as kept if it is kept against
    all: one that lowers the value, one that lowers the margin of the constraints, constant
    extremes, constants within the bounds, switching extremes, and random swings. The starts that
    came nearest to being lost are run again, against ten more switching disturbances.

    region: the constraints, None if a goal may be reached through any state. runs: from the kernel.
    rate [1/s]: of the filter, see `safety_law`. law: the law under the safety filter; None: the
    optimal inputs, under it where `safety_law` has the sampled game. margin [unit of V]: the depth
    of the starts inside the set; by default one cell and the loss of a held input: at all states a
    cell away along an axis V is above `sampled_margin`, or above 0 if no state is as far inside.
    horizon [s]: by default that of the value function; a kernel that has not converged claims
    nothing beyond it. goal: of a capture basin, to be reached.

    Raises `SimulationError` for a value function without a claim about a law, or of an empty set.

    >>> hf.check_promise(cart, kernel, track, runs=20).kept_share
    1.0
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
    check_not_empty(value)
    if region is None and goal is None:
        raise SimulationError("no region to stay in", remedy="give the region")
    model, loss = decided(system, value), 0.0
    if system.inputs:
        steered = safety_law(system, value, law, sample_time=sample_time, rate=rate)
        loss = sampled_margin(system, value, sample_time) if margin is None else 0.0
    elif law is not None:
        raise SimulationError(f"system '{system.name}' has no inputs", expected="no law")
    else:
        steered = Law("no inputs", system.states, {IDLE.name: sp.S.Zero})
    generator = np.random.default_rng(seed)
    inside, loss = inside_states(value, generator, runs, margin, loss)
    beyond = outside_states(value, generator, runs, margin, region, model)
    outer = outer_states(value, np.random.default_rng((seed, 1)), (runs + 1) // 2, margin, loss)
    attack = _Attack(system, model, value, steered, region, goal, horizon, sample_time, seed)
    starts = np.vstack([inside, outer.between, outer.edge])
    kinds = DISTURBED if model.disturbances else (NO_DISTURBANCE,)
    steps = len(kinds) + 2

    def run(what: str, starts: Array, count: int) -> Runs:
        return attack.run(what, starts, _part(progress, count / steps, steps))

    every = [run(what, starts, count) for count, what in enumerate(kinds)]
    by_kind = {what: r.part(slice(0, runs)) for what, r in zip(kinds, every, strict=True)}
    unbeaten: Any = np.stack([r.kept for r in by_kind.values()]).all(axis=0)
    refuted: Any = np.stack([r.refuted for r in by_kind.values()]).any(axis=0)
    trials = [r.trials(what) for what, r in by_kind.items()]
    beaten = _beaten(inside, by_kind)
    if model.disturbances:
        near = np.max([r.near for r in by_kind.values()], axis=0)
        order = np.argsort(-near, kind="stable")
        again = order[unbeaten[order]]
        again = again[: max(1, runs // NEAREST)]
        if len(again):
            tried = run(RESTARTS, np.repeat(inside[again], TRIES, axis=0), len(kinds))
            beaten += _beaten(np.repeat(inside[again], TRIES, axis=0), {RESTARTS: tried}, TRIES)
            stood: Any = tried.kept.reshape(-1, TRIES).all(axis=1)
            beat: Any = tried.refuted.reshape(-1, TRIES).any(axis=1)
            off = ~stood & ~beat
            unbeaten[again] &= stood
            refuted[again] |= beat
            relaxed = int(tried.relaxed.reshape(-1, TRIES).any(axis=1).sum())
            rate_again = Rate(int(stood.sum()), int(stood.size))
            trials.append(Trials(RESTARTS, rate_again, int(off.sum()), tried.excursion, relaxed))
        total = Trials(
            ALL,
            Rate(int(unbeaten.sum()), runs),
            int((~unbeaten & ~refuted).sum()),
            float(np.max([t.excursion for t in trials])),
            max(t.relaxed for t in trials),
        )
        trials = [total, *trials]
    lost = None
    if beyond is not None:
        what = OF_VALUE if model.disturbances else NO_DISTURBANCE
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
        doubt=_doubt(report) or _doubt_of_samples(model),
        held_loss=loss,
        share=outer.share,
        layers=layers_of(outer, every, loss if margin is None else None),
    )


IDLE = Quantity("no_input", "1")


def _with_idle(system: System) -> System:
    """A system with one input more, which moves nothing: a closed loop has something to command."""
    free = (sp.oo,) * len(system.inputs)
    others = system.input_bounds or Box(tuple(-e for e in free), free)
    bounds = Product((Box((0,), (0,)), others)) if free else Box((0,), (0,))
    return replace(system, inputs=(IDLE, *system.inputs), input_bounds=bounds)


def _part(tell: Progress | None, begin: float, parts: int) -> Callable[[float], None]:
    """The progress of one of `parts` equal parts, which begins at a share of the whole."""

    def tell_part(fraction: float) -> None:
        if tell is not None:
            tell(begin + fraction / parts)

    return tell_part


def _doubt(report: Report) -> str:
    """The doubt that a part of the set is disputed, or that the set touches ends of the grid beyond
    which its value is extrapolated."""
    if report.disputed_share:
        return (
            f"{100 * report.disputed_share:.2g} % of the set are disputed: only a scheme of first "
            "order reaches them; let differences be states where two players move something apart, "
            "or take a finer grid"
        )
    ends = report.ends_reached
    if not ends or report.nodes_from_outside == 0:
        return ""
    return (
        f"the set touches the open ends of the grid ({ends}) and depends on extrapolation "
        "beyond them; widen the grid until it does not touch them"
    )


def _doubt_of_samples(system: System) -> str:
    """The doubt that a sampled disturbance may be worse between its sample points."""
    sampled = without_closed_form(system) if system.samples else set()
    names = [q.name for q in system.disturbances if q.symbol in sampled]
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
            schedule = schedules(self.known)
            settings["disturbance"] = schedule.expressions
            settings["varied"] = schedule.drawn(kind, self.horizon, self.sample_time)
            settings["seed"] = self.seed + (what == RESTARTS)
        if not self.system.inputs:
            plant = _with_idle(plant)
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
            stood, near, missed = ~gone & np.isinf(off), worst, worst
        else:
            states = data["state"].values
            flat = states.reshape(-1, states.shape[2])
            finite: Truths = np.all(np.isfinite(flat), axis=1)  # where a run diverged
            points = np.where(finite[:, None], flat, 0.0)

            def levels_of(region: Region) -> Any:
                symbols = [q.symbol for q in self.system.states]
                level = Evaluator([region.worst], symbols, region.parameters)
                values = np.where(finite, level.values(points)[:, 0], math.inf)
                return values.reshape(states.shape[:2])

            levels = levels_of(self.goal)
            there = levels <= 0
            first = np.where(there.any(axis=1), data["time"].values[there.argmax(axis=1)], np.inf)
            lost = np.isin(outcome, (Outcome.LEFT, Outcome.DIVERGED))
            stood = np.isfinite(first) & (first <= off) & ((first <= left) | ~lost)
            if self.region is not None:  # the value of the run: min_t max(goal, max_s<t constraint)
                levels = np.maximum(levels, np.maximum.accumulate(levels_of(self.region), axis=1))
            missed = levels.min(axis=1)
            near, worst = first, np.full(len(first), math.nan)
        off_first = ~stood & np.isfinite(off) & (off <= left)
        return Runs(
            stood,
            off_first,
            np.nan_to_num(near, nan=np.inf),
            np.minimum(left, off),
            np.where(off_first, int(Outcome.OFF_GRID), outcome),
            worst,
            np.where(off_first | np.isnan(missed), math.inf, missed),
            data["infeasible"].values > 0,
        )


def _beaten(starts: Array, by_kind: dict[str, Runs], each: int = 1) -> list[Beaten]:
    """The starts that were lost, with the first disturbance that beat each; `each`: how many
    rows in turn are one start."""
    beaten: dict[int, Beaten] = {}
    for what, runs in by_kind.items():
        for row in map(int, np.flatnonzero(~runs.kept)):
            if row // each not in beaten:
                outcome = Outcome(int(runs.outcome[row])).label
                if outcome in ("stayed", "chattered"):  # in the region but not in the goal
                    outcome = "did not arrive"
                state = tuple(float(v) for v in starts[row])
                beaten[row // each] = Beaten(state, what, outcome, float(runs.time[row]))
    return list(beaten.values())


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
