"""A safety filter around any controller: the least change of its command that stays inside.

What a region's filter misses between samples is how far hostile commands drive a constraint out.

A condition is met at a sample, with an input that is held until the next, T later, and gains that T
bears (`maths/control/safety_filter.py`). What remains is how the derivative of the condition
changes meanwhile. With d2c/dt2 <= M, or d3c/dt3 <= J, along the holds beside the limit

    c(i+1) <= (1 - k1 T) c(i) + M T^2 / 2                 c <= M T / (2 k1)               order one
    d2c/dt2 <= -(k1 + k2) dc/dt - k1 k2 c + J t           c <= about J T / (2 k1 k2)      order two

Where M is the same at all states it bounds what is crossed (`crossings_of`). Else M and J over all
states and inputs are many times what they are where a condition binds, so that the number is
measured: closed loops from states at which the filter's promise begins, under commands
that push as far as the bounds of the inputs go, along the normal of the nearest condition or at
random corners.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.online.controller import Given, Measurements, Remade, time_of
from holdfast.analysis.online.decision import Decision, Decisions, Near, Obstructs, Status
from holdfast.analysis.online.filter_law import (
    Made,
    Reasons,
    fallback_of,
    filter_of,
    warn_of_reduction,
)
from holdfast.analysis.online.obstacle_slots import (
    Among,
    Clearing,
    Surroundings,
    check_pose,
)
from holdfast.analysis.simulation.simulate import simulate
from holdfast.arguments import checked, renamed
from holdfast.errors import (
    DefinitionError,
    SimulationError,
    suggestion,
)
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.closed_loop import Command
from holdfast.execution.simulation.control_sample import ControlSamples
from holdfast.execution.simulation.settings import RK4
from holdfast.maths.control.observer import observe, observe_set
from holdfast.maths.control.safety_filter import Asked, limit_rates
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, Quantity, symbol
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact

if TYPE_CHECKING:
    from holdfast.analysis.online.filter_law import Keep

DRAWN = 20
"""States that are drawn for each run, of which those serve at which the promise begins."""
PACES = 3.0  # horizon of a run, in times of the slower gain
SAMPLES = 40  # at least
PUSHES = 5  # commands at random corners in a run


@dataclass(frozen=True)
class Overshoot:
    """How far constraints were crossed although an input met all conditions at every sample.

    crossed: inequality -> the most [its unit], 0 where none was. runs: how many count; relaxed: how
    many do not, since at some sample no input met all conditions. sample_time [s].
    """

    crossed: Mapping[str, float]
    runs: int
    relaxed: int
    sample_time: float

    def __str__(self) -> str:
        most = ", ".join(f"'{name}' by up to {value:.3g}" for name, value in self.crossed.items())
        return (
            f"in {self.runs} runs under hostile commands, held for {self.sample_time:g} s, "
            f"constraints are crossed: {most}; in {self.relaxed} more no input met all conditions"
        )


def crossings_of(
    made: Made, sample_time: float, margins: Mapping[str, float], uncertain: Sequence[str]
) -> dict[str, float]:
    """Inequality -> the most by which held inputs can cross it, in its unit: `math.inf` if unknown.

    An inequality is left out where the derivative that its condition bounds does not change during
    a hold, since nothing remains then. Where it is the first derivative, and its own does not
    depend on the states, M is its most over the bounds of inputs and disturbances, by intervals.
    """
    system, region = made.system, made.region
    if region is None or made.gains is None:
        return {}
    numbers = {p.symbol: float(p.value) for p in made.law.parameters if p.name not in uncertain}
    held: dict[str, float] = {}
    for piece in made.asked():
        c = piece.condition
        derivatives = [region.inequality(c.name).expression]
        for _ in range(max(piece.orders) + 1):
            derivatives.append(_along(system, derivatives[-1]))
        if sp.expand(derivatives[-1].xreplace(numbers)) == 0:
            continue
        most = math.inf
        if piece.orders == (1,):
            most = _most(system, derivatives[2].xreplace(numbers), numbers)
        crossed = max(0.0, most) * sample_time / (2 * made.gains[0]) - margins.get(c.name, 0.0)
        if crossed > 0:
            held[c.name] = max(held.get(c.name, 0.0), crossed)
    return held


def crossings_text(crossings: Mapping[str, float], sample_time: float) -> str:
    """What remains between samples, as a sentence; empty where nothing does."""
    if not crossings:
        return ""
    bounded = [f"'{n}' by at most {v:.3g}" for n, v in crossings.items() if math.isfinite(v)]
    others = ", ".join(f"'{n}'" for n, v in crossings.items() if not math.isfinite(v))
    if others:
        bounded.append(f"{others} by what SafetyFilter.overshoot(box) measures")
    return (
        f"between samples, {sample_time:g} s apart, constraints may be crossed: "
        f"{'; '.join(bounded)}; a margin of that size covers it"
    )


def _along(system: System, e: sp.Expr) -> sp.Expr:
    """The rate of an expression of t, the states and what is held."""
    rates = (e.diff(q.symbol) * system.rates[q.name] for q in system.states)
    return sp.Add(e.diff(TIME), *rates)


def _most(system: System, e: sp.Expr, numbers: Mapping[sp.Symbol, float]) -> float:
    """The most over the bounds of inputs and disturbances; infinite for what depends on others."""
    ends: dict[sp.Symbol, tuple[float, float]] = {}
    for members, bounds in (
        (system.inputs, system.input_bounds),
        (system.disturbances, system.disturbance_bounds),
    ):
        if bounds is None:
            continue
        for q, pair in zip(members, bounds.ranges(), strict=True):
            low, high = (sp.sympify(end).xreplace(numbers) for end in pair)
            if low.is_number and high.is_number:
                ends[q.symbol] = float(low), float(high)
    if e.free_symbols - set(ends) or not np.isfinite(list(ends.values())).all():
        return math.inf
    corners = np.array([list(ends.values())])
    try:
        _, (most,) = Enclosure([exact(e)], list(ends)).over(corners[:, :, 0], corners[:, :, 1])
    except DefinitionError:
        return math.inf
    return math.inf if np.isnan(most[0]) else float(most[0])


def overshoot_of(
    made: Made, box: Mapping[str, tuple[float, float]], sample_time: float, runs: int, seed: int
) -> Overshoot:
    """How far constraints are crossed because inputs are held: measured, in their units.

    It is the most of so many runs, from states of `box` with c <= 0 and dc/dt + k1 c <= 0, under
    commands that push as far as the bounds go; all states are measured, and there is no
    disturbance. A margin of that size covers it. box: the ends of every state in its unit; an angle
    that is left out is any.

    Raises `DefinitionError` for a filter that keeps a kernel, a state without ends, and a box
    in which no such state was found.
    """
    system, law, region = made.system, made.law, made.region
    if region is None or made.kernel is not None:
        raise DefinitionError("the filter keeps a kernel", expected="regions alone")
    numbers = {p.name: float(p.value) for p in law.parameters}
    starts = _starts(system, law, made.asked(), box, runs, seed)
    commands = _Hostile(system, law, len(starts), seed)
    samples = max(SAMPLES, math.ceil(PACES / (numbers["kappa1"] * sample_time)))
    commands.lasting = max(1, samples // PUSHES)
    commands.sample_time = sample_time
    result = simulate(
        system, law, starts=starts, region=region, horizon=samples * sample_time,
        sample_time=sample_time, record_every=samples * sample_time, substeps=10,
        command=commands,
    )  # fmt: skip
    data = result.arrays
    met = np.asarray(data["infeasible"].values == 0)
    worst = data["worst_constraint"].values[met]
    crossed = np.maximum(worst.max(axis=0, initial=0.0), 0.0)
    names = region.inequality_names
    return Overshoot(
        dict(zip(names, crossed.tolist(), strict=True)),
        int(met.sum()), int((~met).sum()), sample_time,
    )  # fmt: skip


def _starts(
    system: System,
    law: Law,
    pieces: Sequence[Asked],
    box: Mapping[str, tuple[float, float]],
    runs: int,
    seed: int,
) -> Array:
    """States of the box at which c + m <= 0 and what the first condition keeps below 0 is."""
    for name in box:
        if name not in system.state_names:
            raise DefinitionError(
                f"box: '{name}' is no state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    ends = np.array([_ends_of(q, box) for q in system.states])
    generator = np.random.default_rng(seed)
    drawn = ends[:, 0] + (ends[:, 1] - ends[:, 0]) * generator.random((DRAWN * runs, len(ends)))
    still = {q.symbol: sp.S.Zero for q in system.disturbances}
    levels = [e.xreplace(still) for piece in pieces for e in piece.kept]
    states = [q.symbol for q in system.states]
    values = Evaluator(levels, states, law.parameters).values(drawn)
    inside = drawn[(values <= 0).all(axis=1)]
    if not len(inside):
        raise DefinitionError(
            f"none of {len(drawn)} states of the box is one at which the filter's promise begins",
            expected="c <= 0 and dc/dt + k1 c <= 0 for every constraint",
        )
    return inside[:runs]


class _Hostile:
    """Commands that push as far as the bounds go; half the runs along the nearest condition."""

    lasting = 1
    sample_time = 1.0

    def __init__(self, system: System, law: Law, runs: int, seed: int) -> None:
        guard = law.safeguard
        assert guard is not None
        self.inputs, self.soft = len(system.inputs), len(guard.offsets) - guard.hard
        still = {q.symbol: sp.S.Zero for q in system.disturbances}
        rows = [
            e
            for j in range(guard.hard, len(guard.offsets))
            for e in (*(guard.normals[n][j] for n in system.input_names), guard.offsets[j])
        ]
        states = [q.symbol for q in system.states]
        self.rows = Evaluator([e.xreplace(still) for e in rows], states, law.parameters)
        values = {p.symbol: float(p.value) for p in law.parameters}
        scales = [float(guard.scales[n].xreplace(values)) for n in system.input_names]
        ranges = [(-sp.oo, sp.oo)] * self.inputs
        if system.input_bounds is not None:
            ranges = system.input_bounds.ranges()
        pairs = [[float(sp.sympify(e).xreplace(values)) for e in pair] for pair in ranges]
        ends = np.array(pairs)
        wide = np.array(scales)[:, np.newaxis] * np.array([-1.0, 1.0])
        self.ends = np.where(np.isfinite(ends), ends, 10.0 * wide)
        self.greedy = np.arange(runs) % 2 == 0
        self.generator = np.random.default_rng(seed + 1)
        self.pushes = self._corners(runs)

    def __call__(self, t: float, states: Array) -> Array:
        sample = round(t / self.sample_time)
        if sample % self.lasting == 0:
            self.pushes = self._corners(len(states))
        rows = self.rows.values(states).reshape(len(states), self.soft, self.inputs + 1)
        normals, offsets = rows[:, :, :-1], rows[:, :, -1]
        size = np.linalg.norm(normals * (self.ends[:, 1] - self.ends[:, 0]), axis=2)
        room = offsets / np.where(size > 0, size, math.inf)
        nearest = normals[np.arange(len(states)), room.argmin(axis=1)]
        along = np.where(nearest > 0, self.ends[:, 1], self.ends[:, 0])
        return np.where(self.greedy[:, np.newaxis], along, self.pushes)

    def _corners(self, runs: int) -> Array:
        upper = self.generator.random((runs, self.inputs)) < 0.5
        return np.where(upper, self.ends[:, 1], self.ends[:, 0])


def _ends_of(state: Quantity, box: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    if state.name not in box:
        if state.angle:
            return -math.pi, math.pi
        raise DefinitionError(
            f"box: '{state.name}' has no ends", expected="those of every state but angles"
        )
    low, high = (float(e) for e in box[state.name])
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise DefinitionError(
            f"box: the ends of '{state.name}' are {low:g} and {high:g}",
            expected="two finite numbers, the lower first",
        )
    return low, high


class SafetyFilter(Remade):
    """The least change of a command that keeps the state in a set, sample by sample.

        minimise  sum_i ((u_i - w_i) / scale_i)^2  over the inputs u within their bounds

    w is the command of your own controller. With a `Region` the conditions are those of
    `holdfast.safeguard` (a control barrier function, of order two where necessary) for each of its
    inequalities; with a `ValueFunction`, a kernel, those of `holdfast.safety_law`.

    system: its inputs are what the command gives. obstacles: of how many it keeps clear that `step`
    is told of, or `hf.Obstacles`. keep: a kernel of this system, which may be put
    together from one part (`PartsValue`, see `parts_law`), or a region; or several of them, at most
    one a kernel, in order of priority: where not all can be kept, the last gives way first
    (`in_order`), and `Decision.gave_way` names what did. sample_time [s]: of your loop. delay [s]:
    how old a measurement is: a kernel's filter predicts the state from the inputs that were sent
    since, which it remembers; at the first sample, where none was, the measurement counts as the
    state. Where it cannot predict, as behind an observer, the margin allows for the delay. rate
    [1/s]: of a kernel's filter, as of `safety_law`; by default 2, or as much less as the sample
    time bears. margin [unit of V]: of a kernel's filter, what V is kept above. ahead [s]: of a
    kernel's filter, how long the game of held inputs may take, by default about 5. gains [1/s]: of
    a region's filter, as of `safeguard`; by default (1, 4), or as much less as the sample time
    bears; refused where it does not. margins, constraints, worst, uncertain: of a region's filter,
    as of `safeguard`. disturbance_measured: whether `step` is given the disturbances. states: names
    of those that are measured, if not all: an observer estimates the others and the disturbances
    (`observe`). bandwidth [1/s]: of the observer. error_bounds [unit of each state]: state -> how
    wrong its measurement may be; then it is a guaranteed set of them (`observe_set`). rate_bounds
    [unit of each per second]: disturbance -> how fast it may change. scales: input -> the change of
    it that counts as 1. rates: the largest rates of inputs and of states (accelerations), see
    `limit_rates`; with those of inputs the filter remembers its last input. fallback: the input
    where a measurement or the command is not finite, by default 0 within the bounds. around: the
    vehicle in the loop, where `system` is a reduced model of it: a `ModelWarning` names the states
    that the filter does not know.

    An untried kernel is tried in closed loop (`PromiseFellShortWarning`, `PromiseNotTriedWarning`).
    A kernel that has not converged is one for its horizon: after that the status is OUTSIDE_GRID
    until `reset`. A filter is for one thread at a time.

    Raises `DefinitionError` and `SimulationError` as `safeguard`, `safety_law` and `observe` do.

    >>> guard = hf.SafetyFilter(cart, track)
    >>> guard.step(state=[0.5, 0.3], command=[1.0])
    <Decision at 0 s: changed, input [0.5]>
    """

    @renamed(measured="disturbance_measured")
    @checked
    def __init__(
        self,
        system: System,
        keep: Keep | Sequence[Keep] = (),
        *,
        obstacles: int | Clearing | None = None,
        sample_time: float = 0.02,
        delay: float = 0.0,
        ahead: bool | float = True,
        rate: float | None = None,
        margin: float | None = None,
        gains: tuple[float, float] | None = None,
        margins: Mapping[str, float] | None = None,
        constraints: Region | None = None,
        disturbance_measured: bool = False,
        worst: Sequence[str] = (),
        uncertain: Mapping[str, tuple[float, float]] | None = None,
        states: Sequence[str] | None = None,
        bandwidth: float = 2.0,
        error_bounds: Mapping[str, float] | None = None,
        rate_bounds: Mapping[str, float] | None = None,
        scales: Mapping[str, float] | None = None,
        rates: Mapping[str, float] | None = None,
        fallback: Sequence[float] | None = None,
        around: System | None = None,
    ) -> None:
        if not (math.isfinite(sample_time) and sample_time > 0):
            raise SimulationError(f"sample_time is {sample_time}", expected="seconds, above 0")
        self.system, self.keep, self.sample_time = system, keep, float(sample_time)
        clearing = None
        if obstacles is not None:
            clearing = (Clearing(obstacles) if isinstance(obstacles, int) else obstacles).of(system)
            check_pose(clearing, system.state_names if states is None else states)
        self.clearing = clearing
        made = filter_of(
            system, keep, delay=delay, ahead=ahead, sample_time=self.sample_time, rate=rate,
            margin=margin, gains=gains, margins=margins, constraints=constraints,
            disturbance_measured=disturbance_measured, worst=worst, uncertain=uncertain,
            scales=scales, predicts=states is None, clearing=clearing,
        )  # fmt: skip
        if made.kernel is not None:
            made.kernel.check_around(system, states, rates)
        self.delay = float(delay)
        law = made.whole_law
        if rates is not None:
            law = limit_rates(system, law, rates)
        lookup = law.lookup
        self._timed = bool(lookup and lookup.timed)
        self._lasts = made.lasts + 1e-9 * (made.lasts < math.inf)
        if states is not None:
            if error_bounds is None:
                law = observe(system, law, measured=states, bandwidth=bandwidth)
            else:
                law = observe_set(
                    system, law, measured=states, bandwidth=bandwidth, error_bounds=error_bounds,
                    rate_bounds=rate_bounds,
                )  # fmt: skip
        if error_bounds is None and rate_bounds is not None:
            raise DefinitionError("rate bounds are given, but no error bounds")
        if states is None and error_bounds is not None:
            raise DefinitionError(
                "error bounds are given, but no observer", remedy="name the measured states"
            )
        self.law = law
        self._program = closed_loop_program(
            system, law, region=None, goal=None, disturbance={}, stepper=RK4
        )
        self._samples = ControlSamples(self._program, self.sample_time)
        self._many: ControlSamples | None = None
        felt = tuple(q.name for q in system.disturbances if q.name in {r.name for r in law.reads})
        measured = tuple(system.state_names if states is None else states)
        self._told = Measurements(
            self._program, measured, felt, system.input_names, self._pairs_handed
        )  # fmt: skip
        if clearing is not None:
            apart = rates is not None or states is not None or disturbance_measured
            if clearing.pair is not None and apart:
                raise DefinitionError(
                    "the kernel of two vehicles is kept beside an observer, limits of rates or "
                    "measured disturbances",
                    expected="none of these",
                )
            self._slots = clearing.slots(system, made.law, self._program, self.sample_time)
        self._count = self._of_many = 0
        self._fallback = fallback_of(system, fallback)
        self._made = made
        self._margins, self._uncertain = dict(margins or {}), tuple(uncertain or ())
        warn_of_reduction(system, around)
        if made.kernel is not None:
            made.kernel.warn_of_promise(system, self.sample_time, stacklevel=4)

    @property
    def measured_states(self) -> tuple[str, ...]:
        """The states that `step` is given."""
        return self._told.states

    @property
    def measured_disturbances(self) -> tuple[str, ...]:
        """The disturbances that `step` is given."""
        return self._told.disturbances

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """The names of `Decision.actuators`."""
        return self.system.actuators or self.system.input_names

    @property
    def fallback(self) -> Array:
        """The input where a measurement or the command is not finite, shape (inputs,)."""
        return self._fallback[0].copy()

    # -- at a sample -------------------------------------------------------------------------

    def step(
        self,
        state: Given,
        command: Given,
        t: float | None = None,
        disturbance: Given | None = None,
        obstacles: Sequence[Obstructs] | Array | None = None,
    ) -> Decision:
        """The decision on a command [units of the inputs] at a measured state.

        state, command, disturbance: numbers in the order of their names, or by name; the measured
        states only. t [s]: by default the number of samples since `reset` times the sample time.
        obstacles: of `hf.Obstacle`, all that are known, for a filter that has room for them; or
        discs, shape (count, 3 to 9), the columns of `obstacle_slots.DISC`. A loop calls it once a
        sample. Raises `SimulationError` for wrong names or shapes; numbers that are not
        finite are a status.
        """
        readings = self._told
        finite = readings.fill(state, disturbance, command)
        t = time_of(t, self._count, self.sample_time)
        self._count += 1
        near = None
        self._check_obstacles(obstacles)
        if obstacles is not None and finite:
            near = self._near(readings.row, obstacles)
            finite = near.found >= 0
        seen = readings.row.copy()
        if not (finite and math.isfinite(t)):
            return self._refused(t, seen, near)
        samples = self._samples
        row = samples.answer(t, seen)
        rows, values = samples.rows, row.tolist()
        applied, wanted = values[rows.command], values[rows.nominal]
        if not math.isfinite(sum(applied)) or math.isnan(values[rows.slack]):
            samples.forget()
            return self._refused(t, seen, near)
        changed = applied != wanted
        if self._past(t) or not math.isnan(values[rows.outside]) or self._beyond(seen):
            status = Status.OUTSIDE_GRID
        elif values[rows.slack] > 0.0 or (near is not None and near.unkept):
            status = Status.INFEASIBLE
        else:
            status = Status.CHANGED if changed else Status.PASSED
        return Decision(row, rows, status, values[rows.overruled] != 0.0, t, seen, self, near)

    def _check_obstacles(self, obstacles: object) -> None:
        if obstacles is None and self.clearing is not None:
            raise SimulationError(
                "the obstacles are None", expected="obstacles=[...], of hf.Obstacle; none is []"
            )
        if obstacles is not None and self.clearing is None:
            raise SimulationError(
                "obstacles are given to a filter without room for any",
                remedy="make it with obstacles=20, as many as it is to count with",
            )

    def _near(self, row: Array, obstacles: Sequence[Obstructs] | Array) -> Near:
        """Hand the nearest pairs of obstacles over, in a row of what is seen; what was near."""
        slots = self._slots
        count = slots.fill(row[: len(self.system.states)], obstacles, row[self._told.commanded])
        row[len(row) - len(slots.pairs) :] = slots.pairs
        around = obstacles.copy() if isinstance(obstacles, np.ndarray) else tuple(obstacles)
        assert self.clearing is not None
        return Near(slots.near.copy(), count, around, self.clearing.evaded, slots.unkept)

    @property
    def _pairs_handed(self) -> int:
        things, numbers, _ = self._program.things
        return things * numbers

    def step_many(
        self,
        states: npt.ArrayLike,
        commands: npt.ArrayLike,
        t: float | None = None,
        disturbances: npt.ArrayLike | None = None,
        obstacles: Sequence[Sequence[Obstructs]] | Array | None = None,
    ) -> Decisions:
        """The decisions on many commands at many states, shapes (count, states), (count, inputs).

        Each row is a vehicle: what a filter with an observer, rates of inputs or a delay remembers
        is of the same row before, until `reset` or until there are more or fewer rows.
        disturbances: those that are measured, (count, disturbances). obstacles: those of each
        vehicle, or discs (count, discs, columns), as of `step`.
        """
        seen = self._told.rows(states, disturbances, commands)
        finite = np.asarray(np.isfinite(seen).all(axis=1))
        self._check_obstacles(obstacles)
        unkept = np.zeros(len(seen), dtype=bool)
        if obstacles is not None:
            if len(obstacles) != len(seen):
                raise SimulationError(
                    f"obstacles of {len(obstacles)} vehicles", expected=f"of {len(seen)}"
                )
            for k in np.flatnonzero(finite).tolist():
                near = self._near(seen[k], obstacles[k])
                finite[k], unkept[k] = near.found >= 0, bool(near.unkept)
        if not len(seen):
            rows, self._many = self._many, ControlSamples(self._program, self.sample_time, 1)
            one, there = np.zeros((1, seen.shape[1])), np.ones(1, dtype=bool)
            nothing = Decisions._make(part[:0] for part in self._answers(0.0, one, there, ~there))
            self._many = rows
            return nothing
        if self._many is None or self._many.count != len(seen):
            self._many = ControlSamples(self._program, self.sample_time, len(seen))
            self._of_many = 0
        t = time_of(t, self._of_many, self.sample_time)
        self._of_many += bool(self._program.remembered)
        finite &= math.isfinite(t)
        return self._answers(t, seen, finite, unkept)

    def _answers(self, t: float, seen: Array, finite: Truths, unkept: Truths) -> Decisions:
        assert self._many is not None
        before = self._many.memory
        answers = self._many.answers(t, np.where(finite[:, np.newaxis], seen, 0.0))
        rows = self._many.rows
        finite = finite & np.isfinite(answers[:, rows.command]).all(axis=1)
        finite &= ~np.isnan(answers[:, rows.slack])
        inputs, nominal = answers[:, rows.command], answers[:, rows.nominal]
        actuators, slack = answers[:, rows.actuators], answers[:, rows.slack].copy()
        overruled = answers[:, rows.overruled] != 0.0
        changed = (inputs != nominal).any(axis=1)
        states = np.where(finite[:, np.newaxis], seen, 0.0)[:, : len(self.system.states)]
        outside = ~np.isnan(answers[:, rows.outside]) | self._past(t)
        if self._made.parts is not None:
            outside |= self._made.parts.excess(states) > 0
        if not finite.all():
            sent = self._sent_instead(before)
            self._many.remember_all(np.where(finite[:, np.newaxis], self._many.memory, sent))
        for k in np.flatnonzero(~finite):
            refused = self._nothing_from(t, seen[k])
            inputs[k], actuators[k], nominal[k] = refused.input, refused.actuators, refused.nominal
            slack[k], overruled[k] = 0.0, True
        codes = np.select(
            [~finite, outside, (slack > 0.0) | unkept, changed], [4, 3, 2, 1], default=0
        )
        status = tuple(_STATUSES[k] for k in codes.tolist())
        value = np.where(finite, self._made.values(t, states, answers[:, rows.value]), math.nan)
        return Decisions(inputs, actuators, nominal, overruled, slack, value, status)

    def _past(self, t: float) -> bool:
        """Whether a time is outside the horizon of the kernel."""
        return self._lasts < math.inf and not 0.0 <= t <= self._lasts

    def _beyond(self, seen: Array) -> bool:
        """Whether the parts of a kernel promise nothing at a state."""
        parts, n = self._made.parts, len(self.system.states)
        return parts is not None and bool(parts.excess(seen[np.newaxis, :n])[0] > 0)

    def among(self, command: Command, obstacles: Surroundings) -> Among:
        """Your controller among obstacles, as the `command` of `simulate` with the law `law`.

        command: a function of t [s] and of the states, shape (runs, states), to commands, shape
        (runs, inputs). obstacles: a function of the same to a list of `Obstacle` for each run.
        After the runs `least` has the smallest gap of each [m], as the filter was told, `unkept` at
        how many samples the kernel of two vehicles was not kept.

        Raises `SimulationError` for a filter without obstacles.

        >>> guard = hf.SafetyFilter(robot, obstacles=hf.Obstacles(1, lead=0.3), gains=(1, 4))
        >>> buoy = [hf.Obstacle.disc((2, 0), 0.5)]
        >>> drive = guard.among(lambda t, q: [[1.0, 0.0]] * len(q), lambda t, q: [buoy] * len(q))
        >>> _ = hf.simulate(robot, guard.law, command=drive, starts=[[0, 0.1, 0]], horizon=5)
        >>> round(drive.least[0], 2)
        0.0
        """
        if self.clearing is None:
            raise SimulationError("the filter has no obstacles", remedy="obstacles=20, say")
        return Among(self._slots, command, obstacles)

    def reset(self) -> None:
        """Begin anew: the time is 0, and what an observer estimated is forgotten."""
        self._samples.reset()
        self._count, self._many = 0, None

    def _now(self) -> Any:
        many = None if self._many is None else (self._many.count, self._many.now())
        return self._count, self._samples.now(), self._of_many, many

    def _resume(self, earlier: Any) -> None:
        self._count, samples, self._of_many, many = earlier
        self._samples.resume(samples)
        self._many = None
        if many is not None:
            count, of_many = many
            self._many = ControlSamples(self._program, self.sample_time, count)
            self._many.resume(of_many)

    def prepare(self) -> None:
        """Compile what the sentences of decisions look ahead with, which the first one would."""
        self._reasons.prepare()

    def export_c(self, name: str = "safety_filter", *, table: str = "text") -> str:
        """The filter as C99: `NAME_step` takes the command as its argument `handed`.

        See `holdfast.export_c`; `export_c_header` gives the header.
        """
        from holdfast.execution.codegen.c_source import export_c

        return export_c(self.system, self.law, name, table=table)

    def export_c_header(self, name: str = "safety_filter", *, table: str = "text") -> str:
        """The header of `export_c`."""
        from holdfast.execution.codegen.c_source import export_c_header

        return export_c_header(self.system, self.law, name, table=table)

    # -- what its sample time leaves ---------------------------------------------------------

    @property
    def gains(self) -> tuple[float, float] | None:
        """k1 and k2 [1/s] of its conditions; None for a kernel alone."""
        return self._made.gains

    @property
    def unused(self) -> Mapping[str, tuple[str, ...]]:
        """Inequality -> inputs that act on it after two derivatives, which it leaves alone."""
        return self._reasons.unused

    @cached_property
    def crossings(self) -> Mapping[str, float]:
        """Inequality -> the most by which it may be crossed between samples [its unit].

        `math.inf` where no bound is at hand, and `overshoot` measures it. Empty for a kernel, and
        for conditions that do not change while an input is held.
        """
        return crossings_of(self._made, self.sample_time, self._margins, self._uncertain)

    def __str__(self) -> str:
        sets: list[Any] = [*self.keep] if isinstance(self.keep, list | tuple) else [self.keep]
        names = [f"'{k.name}'" if isinstance(k, Region) else f"a kernel of {k.names}" for k in sets]
        keeps = [f"keeps {' and '.join(names)}"] if names else []
        if self.clearing is not None:
            keeps.append(f"keeps clear of up to {self.clearing.most} obstacles at a time")
        late = f", of states that are seen {self.delay:g} s late" if self.delay else ""
        lines = [
            f"safety filter of '{self.system.name}': {' and '.join(keeps)}, "
            f"with inputs held for {self.sample_time:g} s{late}",
            crossings_text(self.crossings, self.sample_time),
        ]
        return "\n".join(line for line in lines if line)

    def overshoot(
        self, box: Mapping[str, tuple[float, float]], *, runs: int = 1000, seed: int = 0
    ) -> Overshoot:
        """How far constraints are crossed because inputs are held: see `overshoot_of`."""
        return overshoot_of(self._made, box, self.sample_time, runs, seed)

    # -- what is said of a decision ----------------------------------------------------------

    def value_at(self, decision: Decision) -> float:
        """`Decision.value`."""
        if decision.status is Status.NOT_A_NUMBER:
            return math.nan
        if self._told.states != self.system.state_names and isinstance(self._made.first, Region):
            return math.nan
        states = decision.seen[np.newaxis, : len(self.system.states)]
        return float(self._made.values(decision.t, states, np.array([decision.looked_up]))[0])

    def reason(self, decision: Decision) -> str:
        """`Decision.why`."""
        return self._reasons.sentence(decision)

    def gave_way(self, decision: Decision) -> tuple[str, ...]:
        """`Decision.gave_way`."""
        return self._reasons.gave_way(decision)

    @cached_property
    def _reasons(self) -> Reasons:
        return Reasons(
            self.system,
            self._made,
            self.law,
            self._told,
            self._program,
            timed=self._timed,
        )

    # -- what is not as it should be ---------------------------------------------------------

    @property
    def observes(self) -> bool:
        """Whether it remembers more than what was sent."""
        of_sent = {f"last_{name}" for name in self.system.input_names}
        if self._made.ahead is not None:
            of_sent |= self._made.ahead.memory.following.keys()
        return not of_sent.issuperset(self._program.remembered)

    def _refused(self, t: float, seen: Array, near: Near | None = None) -> Decision:
        if self._program.remembered:
            if not self.observes:
                self._samples.begin(t)  # what is sent is remembered from here on
            self._samples.remember_all(self._sent_instead(self._samples.memory))
        return self._nothing_from(t, seen, near)

    def _sent_instead(self, memory: Array) -> Array:
        """What is remembered, of each vehicle, where the fallback was sent."""
        places = {name: i for i, name in enumerate(self._program.remembered)}
        after = memory.copy()
        for name, value in zip(self.system.input_names, self._fallback[0], strict=True):
            if (last := f"last_{name}") in places:
                after[:, places[last]] = value
        if self._made.ahead is not None:
            following = self._made.ahead.memory.following
            rows = np.hstack([memory, np.tile(self._fallback[0], (len(memory), 1))])
            for name, column in zip(following, self._following.values(rows).T, strict=True):
                after[:, places[name]] = column
        return after

    @cached_property
    def _following(self) -> Evaluator:
        """What a prediction remembers next, from everything that is remembered and the input."""
        assert self._made.ahead is not None
        symbols = [symbol(n) for n in self._program.remembered]
        symbols += [q.symbol for q in self.system.inputs]
        return Evaluator(list(self._made.ahead.memory.following.values()), symbols, ())

    def _nothing_from(self, t: float, seen: Array, near: Near | None = None) -> Decision:
        rows, readings = self._samples.rows, self._told
        row = self._samples.nothing()
        row[rows.command] = row[rows.input] = self._fallback[0]
        row[rows.actuators] = self._fallback[1]
        row[rows.nominal] = seen[readings.commanded]
        row[rows.slack], row[rows.overruled] = 0.0, 1.0
        return Decision(row, rows, Status.NOT_A_NUMBER, True, t, seen, self, near)


_STATUSES = tuple(Status)
