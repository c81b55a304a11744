"""The law of a safety filter: the command of another controller, kept in regions and a kernel.

Why the filter decided as it did is one sentence, with names, distances and times.

Times are those at which a vehicle whose input is held would leave its constraints.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from holdfast.analysis.online.controller import Measurements
from holdfast.analysis.online.decision import Decision, Status
from holdfast.errors import (
    DefinitionError,
    ModelWarning,
    SimulationError,
    suggestion,
)
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram, closed_loop_program
from holdfast.execution.codegen.scalar_llvm import called
from holdfast.execution.foreseen import numbers_of_look
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import RK4, Outcome, Settings
from holdfast.maths.control.barrier_conditions import unused_inputs
from holdfast.maths.control.parameter_box import parameter_box
from holdfast.maths.control.prediction import Prediction
from holdfast.maths.control.safety_filter import Asked, asked_of, in_order, safeguard
from holdfast.maths.control.velocity_tracking import commanded
from holdfast.maths.definitions.extension import both
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, Parameter
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching, as_switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import symbols_of

if TYPE_CHECKING:
    from holdfast.analysis.decomposition.parts_value import PartsValue
    from holdfast.analysis.online.kernel_filter import KeptKernel
    from holdfast.analysis.online.obstacle_slots import Clearing
    from holdfast.analysis.reachability.value_function import ValueFunction

    Keep = ValueFunction | PartsValue | Region


@dataclass(frozen=True)
class Made:
    """The law of a filter; first: the most important of what it keeps but obstacles that move.

    region: of all regions.

    asked: what it asks of the region, by `asked_of`. ahead: of a kernel whose state is seen late,
    with the memory that the law reads.
    """

    system: System
    law: Law
    first: Keep | None
    kernel: KeptKernel | None
    region: Region | None
    asked: Callable[[], list[Asked]]
    ahead: Prediction | None = None

    @property
    def whole_law(self) -> Law | Switching:
        """The law, with what it remembers."""
        return self.ahead.remembered(self.law) if self.ahead else self.law

    @property
    def gains(self) -> tuple[float, float] | None:
        """k1 and k2 of the conditions of regions [1/s]; None without a region."""
        numbers = {p.name: float(p.value) for p in self.law.parameters}
        return (numbers["kappa1"], numbers["kappa2"]) if "kappa1" in numbers else None

    @property
    def parts(self) -> PartsValue | None:
        """The kernel, if it is put together from parts."""
        return self.kernel.parts if self.kernel else None

    @property
    def predicted(self) -> bool:
        """Whether its actuators are predicted, and kept in a share of their range."""
        return self.kernel is not None and self.kernel.predicted

    @property
    def table(self) -> ValueFunction | None:
        """The value function of the kernel, or of its part, that the law looks up."""
        return self.kernel.table if self.kernel else None

    @property
    def lasts(self) -> float:
        """How long the promise of the kernel lasts [s]."""
        return self.kernel.lasts if self.kernel else math.inf

    def values(self, t: float, states: Array, looked_up: Array) -> Array:
        """The value at states (count, states): V, or -max_j c_j of a region at t [s].

        looked_up: what the law looks up there, at the remaining time.
        """
        if self.first is None:
            return np.full(len(states), math.nan)
        if isinstance(self.first, Region):
            return -self._levels.values(at_time(t, states)).max(axis=1)
        assert self.kernel is not None  # what is kept first is a kernel, the only one or the first
        timed = self.law.lookup is not None and self.law.lookup.timed
        return self.kernel.values(states, looked_up, timed)

    @cached_property
    def _levels(self) -> Evaluator:
        assert isinstance(self.first, Region)
        return levels_of(self.system, self.first)


def levels_of(system: System, region: Region) -> Evaluator:
    """The c_j of a region, of the states and of t."""
    return Evaluator(
        [c.expression for c in region.inequalities],
        [*(q.symbol for q in system.states), TIME],
        region.parameters,
    )


def at_time(t: float, states: Array) -> Array:
    """The states, and the time behind each: states (count, states), and (count, states + 1)."""
    return np.hstack([states, np.full((len(states), 1), t)])


def filter_of(
    system: System,
    keep: Keep | Sequence[Keep],
    *,
    sample_time: float,
    delay: float,
    ahead: bool | float,
    rate: float | None,
    margin: float | None,
    gains: tuple[float, float] | None,
    margins: Mapping[str, float] | None,
    constraints: Region | None,
    disturbance_measured: bool,
    worst: Sequence[str],
    uncertain: Mapping[str, tuple[float, float]] | None,
    scales: Mapping[str, float] | None,
    predicts: bool,
    clearing: Clearing | None,
) -> Made:
    """The law that hands on a command within what is kept; the options are of `SafetyFilter`.

    predicts: whether it may predict the state over a delay. clearing: of obstacles at run time.
    """
    parts: list[Any] = list(keep) if isinstance(keep, list | tuple) else [keep]
    kernels = [_kernel(system, part, len(parts)) for part in parts if not isinstance(part, Region)]
    _check_options(
        bool(kernels), len(kernels) < len(parts), clearing is not None, rate=rate,
        margin=margin, delay=delay,
        ahead=ahead, gains=gains, margins=margins, constraints=constraints,
        disturbance_measured=disturbance_measured, worst=worst, uncertain=uncertain,
    )  # fmt: skip
    if constraints is not None:
        place, first = next((k, x) for k, x in enumerate(parts) if isinstance(x, Region))
        parts[place] = both(first, constraints)
    regions = [part for part in parts if isinstance(part, Region)]
    names = [name for region in regions for name in region.inequality_names]
    for name in margins or {}:
        if name not in names:
            raise DefinitionError(
                f"margin of '{name}', which is not an inequality of what is kept",
                remedy=suggestion(str(name), names),
            )
    command = commanded(system)

    memories: list[Prediction] = []

    waiting = iter(kernels)

    def kept_in(part: Keep) -> Law:
        if not isinstance(part, Region):
            law, predicted = next(waiting).law(
                system, command, predicts=predicts, rate=rate, margin=margin,
                sample_time=sample_time, delay=delay, scales=scales, ahead=ahead,
            )  # fmt: skip
            memories.extend([predicted] if predicted else [])
            return law
        inside = {n: v for n, v in (margins or {}).items() if n in part.inequality_names}
        return safeguard(
            system,
            command,
            part,
            gains=gains,
            margins=inside,
            scales=scales,
            disturbance_measured=disturbance_measured,
            worst=worst,
            uncertain=uncertain,
            sample_time=sample_time,
        )

    filters = [kept_in(part) for part in parts]
    if clearing is not None:
        apart = clearing.law(
            system, command, gains=gains, disturbance_measured=disturbance_measured, worst=worst,
            box=parameter_box(_of_system(system, uncertain), system, None), scales=scales or {},
            sample_time=sample_time,
        )  # fmt: skip
        filters.insert(0, apart)
    law = in_order(filters) if len(filters) > 1 else filters[0]
    region = reduce(both, regions) if regions else None
    return Made(
        system,
        law,
        parts[0] if parts else None,
        kernels[0] if kernels else None,
        region,
        partial(
            asked_of,
            system,
            region,
            tuple(margins or ()),
            tuple(worst),
            disturbance_measured,
            parameter_box(uncertain, system, region),
        )
        if region is not None
        else list,
        memories[0] if memories else None,
    )


def _of_system(
    system: System, uncertain: Mapping[str, tuple[float, float]] | None
) -> Mapping[str, tuple[float, float]]:
    names = {p.name for p in system.parameters}
    return {name: ends for name, ends in (uncertain or {}).items() if name in names}


def _kernel(system: System, part: Any, count: int) -> KeptKernel:
    """What is kept and is no region; what has to do with kernels is loaded for it alone."""
    from holdfast.analysis.online.kernel_filter import kept_kernel

    return kept_kernel(system, part, count)


def fallback_of(system: System, fallback: Sequence[float] | None) -> tuple[Array, Array]:
    """The input, within its bounds, that is applied where nothing is known; its actuators. The
    shapes are (inputs,) and (actuators,)."""
    names = system.input_names
    wanted = np.zeros(len(names)) if fallback is None else np.asarray(fallback, dtype=np.float64)
    if wanted.shape != (len(names),) or not np.isfinite(wanted).all():
        raise SimulationError(
            f"fallback is {fallback!r}", expected=f"{len(names)} numbers: {', '.join(names)}"
        )
    values = {p.symbol: p.value for p in system.parameters}
    asked = system.allocated([sp.Float(v) for v in wanted])
    limited = [sp.sympify(e).xreplace(values) for e in system.limited(asked)]
    made = [sp.sympify(e).xreplace(values) for e in system.produced(limited)]
    return np.array(made, dtype=np.float64), np.array(limited, dtype=np.float64)


def _check_options(kernel: bool, region: bool, moving: bool, **options: Any) -> None:
    """Refuse options that nothing of what is kept has."""
    if not kernel and not region and not moving:
        raise DefinitionError(
            "there is nothing to keep", expected="a region, a kernel, or obstacles=..."
        )
    if moving and options["delay"]:
        raise DefinitionError(
            f"a delay of {options['delay']:g} s beside obstacles that move",
            remedy="give obstacles their age, and a clearance for the way of the vehicle meanwhile",
        )
    if region and not kernel and options["delay"]:
        raise DefinitionError(
            f"a delay of {options['delay']:g} s, for which a region's filter has no margin",
            remedy="give margins for what may happen meanwhile, or a kernel",
        )
    of_kernels = {"rate": None, "margin": None, "delay": 0.0, "ahead": True}
    of_regions = {
        "gains": None,
        "margins": None,
        "constraints": None,
        "disturbance_measured": False,
        "worst": (),
        "uncertain": None,
    }
    of_both = {"gains", "disturbance_measured", "worst", "uncertain"}
    for usual, has, whose in ((of_kernels, kernel, "region"), (of_regions, region, "kernel")):
        for name, value in usual.items():
            if moving and name in of_both:
                continue
            if not has and options[name] != value:
                raise DefinitionError(f"{name} is given, which a {whose}'s filter has not")


def warn_of_reduction(system: System, around: System | None) -> None:
    """A filter of a reduced model cannot keep its promise around the whole vehicle."""
    if around is None:
        missing, whole = system.promoted, "the vehicle itself"
        remedy = f"around=system says that you command {_and(system.input_names)} at once"
    else:
        if unknown := [n for n in system.state_names if n not in around.state_names]:
            raise DefinitionError(
                f"system '{system.name}' has the state '{unknown[0]}', and '{around.name}' has "
                "none of that name"
            )
        moving = symbols_of([around.rates[n] for n in system.state_names])
        others = [q for q in around.states if q.name not in system.state_names]
        act = any(q.symbol in moving for q in others)  # or it is a subsystem, and exact
        missing = tuple(q.name for q in others if act)
        whole, remedy = f"'{around.name}'", "compute a kernel of it, or keep a region"
    if missing:
        warnings.warn(
            f"the filter is computed for '{system.name}', which leaves out how {_and(missing)} "
            f"{'change' if len(missing) > 1 else 'changes'}; around {whole} its promise does not "
            f"hold; {remedy}",
            ModelWarning,
            stacklevel=5,
        )


def _and(names: Sequence[str]) -> str:
    return " and ".join(names)


HORIZON = 10.0
"""How far ahead it looks [s]."""

RECORDS = 500


BEGAN = Parameter("forecast_began", "s", "when a motion begins", value=0.0)


def _begun_later(region: Region) -> Region:
    """A region that moves, at times from `BEGAN` on."""
    return replace(
        region,
        inequalities=tuple(
            replace(c, expression=c.expression.xreplace({TIME: TIME + BEGAN.symbol}))
            for c in region.inequalities
        ),
        parameters=(*region.parameters, BEGAN),
    )


class Forecast:
    """Motions of a system whose input is held from a state on, with disturbances held or 0."""

    def __init__(self, system: System, region: Region | None) -> None:
        self.system = system
        held = tuple(
            Parameter(f"held_{q.name}", q.unit, value=0.0)
            for q in (*system.inputs, *system.disturbances)
        )
        if region is not None and region.moves:
            region = _begun_later(region)
        self.names = [p.name for p in held]
        count = len(system.inputs)
        law = Law(
            "held", system.states,
            {q.name: p.symbol for q, p in zip(system.inputs, held, strict=False)},
            parameters=held,
        )  # fmt: skip
        program = closed_loop_program(
            system, law, region=region, goal=None, stepper=RK4,
            disturbance={
                q.name: p.symbol for q, p in zip(system.disturbances, held[count:], strict=True)
            },
        )  # fmt: skip
        self._program = program
        self._loop = ClosedLoop(program)
        step = HORIZON / RECORDS
        self._settings = Settings(
            horizon=HORIZON, sample_time=step, record_every=step, threads=1, tolerance=1e-9
        )

    def motion(
        self, t: float, state: Array, held: Sequence[float]
    ) -> tuple[Array, Array, float, int]:
        """Times from t [s] on, states, the time at which the region is left (NaN: not), and by
        which c_j. state: shape (states,). The times have the shape (samples,), the states (samples,
        states)."""
        values = dict(zip(self.names, map(float, held), strict=True)) | {BEGAN.name: t}
        parameters = tuple(
            replace(p, value=values.get(p.name, p.value)) for p in self._program.parameters
        )
        self._loop.program = replace(self._program, parameters=parameters)
        run = self._loop.simulate(np.asarray(state, dtype=np.float64)[np.newaxis], self._settings)
        left = run.outcome[0] == Outcome.LEFT
        return (
            run.time, run.state[0], float(run.exit_time[0]) if left else math.nan,
            int(run.exit_constraint[0]),
        )  # fmt: skip


AT_ONCE = 1e-3
"""A shorter time [s] is not worth a number."""


class Reasons:
    """The sentences of one filter."""

    def __init__(
        self,
        system: System,
        made: Made,
        law: Law | Switching,
        readings: Measurements,
        program: ClosedLoopProgram,
        timed: bool,
    ) -> None:
        self.system, self.made, self.constraints = system, made, made.region
        self.told, self.program = readings, program
        ((self.count, self.hard),) = program.conditions_of_modes
        (self._ahead,) = program.foresight_of_modes
        estimated = any(q.name.endswith("_hat") for q in law.reads)
        self.whole = readings.states == system.state_names and not estimated
        self.law, self.timed = law, timed

    def prepare(self) -> None:
        """Compile what a sentence needs."""
        if self.constraints is not None:
            self._evaluator.values(np.zeros((1, len(self.system.states) + 1)))
        if self.whole and not self.timed:
            held = len(self.system.inputs) + len(self.system.disturbances)
            self._forecast.motion(0.0, np.zeros(len(self.system.states)), [0.0] * held)

    def sentence(self, decision: Decision) -> str:
        """One sentence about a decision."""
        status = decision.status
        if status is Status.NOT_A_NUMBER:
            faulty = self.told.faulty(decision.seen)
            if not faulty and decision.near is not None and decision.near.found < 0:
                name = decision.near.names[-1 - decision.near.found]
                faulty = f"a number of '{name}' is not finite"
                if decision.near.impossible:
                    faulty = (
                        f"a number of '{name}' cannot be: a share is above 0 and up to 1, a "
                        "radius, an acceleration, an age and an error are 0 or more"
                    )
            if not faulty and not math.isfinite(decision.t):
                faulty = f"the time is {decision.t}"
            faulty = faulty or "the conditions are not finite at this state"
            return f"{faulty}, so that the input is the fallback"
        if status is Status.OUTSIDE_GRID:
            return self._outside(decision)
        if status is Status.PASSED:
            return f"the command meets every condition{self._nearest(decision)}"
        change = self._change(decision)
        if status is Status.INFEASIBLE:
            unit = self.program.slack_units[0] if len(set(self.program.slack_units)) == 1 else ""
            gave = ", ".join(f"'{name}'" for name in self.gave_way(decision))
            if (near := decision.near) is not None:
                between = [n for n in near.clearances if n in self.gave_way(decision)]
                if between:
                    change = f"pinched by {_and([repr(n) for n in between])}: {change}"
            return (
                f"{change}: no input within its bounds meets all conditions, the least violation "
                f"is {decision.slack:.3g} {unit}".rstrip()
                + (f"; {gave} gave way" if gave else "")
                + self._left_alone(decision)
                + self._nearest(decision)
            )
        if not decision.overruled:
            slow = any(name.startswith("last_") for name in self.program.remembered)
            more = " or changes faster than they may" if slow else ""
            if self.made.predicted:
                more = ", or an actuator would leave its share with it"
            return f"{change}: the command is beyond the bounds of the inputs{more}"
        return f"{change}: {self._cause(decision)}"

    @cached_property
    def unused(self) -> dict[str, tuple[str, ...]]:
        """`SafetyFilter.unused`."""
        return {} if self.constraints is None else unused_inputs(self.system, self.constraints)

    # -- the parts of a sentence -------------------------------------------------------------

    def _change(self, decision: Decision) -> str:
        """What became of the command."""
        largest = max(np.abs(decision.nominal).max(), np.abs(decision.input).max())
        small = 1e-9 * largest  # a rounding error is shown as 0
        shown = [
            f"{q.name} from {before:.3g} to {after if abs(after) > small else 0:.3g} {q.unit}"
            for q, before, after in zip(
                self.system.inputs, decision.nominal, decision.input, strict=True
            )
            if abs(before - after) > small
        ]
        return "changed " + " and ".join(shown) if shown else "kept the command"

    def _cause(self, decision: Decision) -> str:
        """The inequality whose condition changed the command, and what would have followed."""
        left, by = self._exit(decision)
        worst = self._worst(decision)
        table = self.made.table
        if table is not None and worst == "value":
            room = decision.looked_up - self._margin
            side = "above" if room >= 0 else "below"
            near = f"the value of the {table.report.kind} is {abs(room):.3g} {self._unit}"
            near = f"{near.rstrip()} {side} its margin of {self._margin:.3g}"
            return near + self._would_be(left, "the set would have been left")
        names = self.constraints.inequality_names if self.constraints is not None else ()
        if decision.near is not None and worst in decision.near.clearances:
            gap = decision.near.clearances[worst]
            where = f"is {gap:.3g} m away" if gap >= 0 else f"is {-gap:.3g} m too near"
            return f"'{worst}' {where}{self._left_out(decision)}"
        if worst not in names:  # of the rate of a state
            return f"the {worst} would be beyond its limit"
        if not self.whole:
            return f"'{worst}' is near, by what the observer estimates"
        first = names[by] if by >= 0 else worst
        name = first if first in self._missed(decision, decision.nominal) else worst
        which = "it" if first == name else f"'{first}'"
        near = self._distance(decision, name)
        return near + self._would_be(left, f"{which} would have been violated")

    @property
    def _margin(self) -> float:
        return next(float(p.value) for p in self.law.parameters if p.name == "safety_margin")

    @property
    def _unit(self) -> str:
        assert self.made.table is not None
        unit = self.made.table.report.value_unit
        return "" if unit == "1" else unit

    def _worst(self, decision: Decision) -> str:
        """The inequality whose condition the command violates most, by its own size."""
        if self._ahead and self._lacks(decision, decision.nominal, 0) > 0:
            return "value"
        return self._named(decision)[int(np.argmax(self._short(decision, decision.nominal)))]

    def _named(self, decision: Decision) -> tuple[str, ...]:
        """The inequality of each condition after the hard ones; of a pair, its obstacle."""
        near, (_, _, each) = decision.near, self.program.things
        if near is None:
            return self._names
        pairs = len(near.gaps) // 2
        obstacles = [near.of(k) if near.gaps[2 * k + 1] >= 0 else "" for k in range(pairs)]
        return (*(name for name in obstacles for _ in range(each)), *self._names[pairs * each :])

    @staticmethod
    def _left_out(decision: Decision) -> str:
        """What the filter did not count with, as the rest of a sentence."""
        count = len(decision.left_out)
        return f"; {count} more are farther away and were not counted with" if count else ""

    def gave_way(self, decision: Decision) -> tuple[str, ...]:
        """The inequalities whose conditions the input does not meet; "value" is the kernel's."""
        gave = self._missed(decision, decision.input)
        if decision.near is not None:
            gave += [decision.near.names[k] for k in decision.near.unkept]
        if self._ahead and self._lacks(decision, decision.input, 1) > 0:
            gave.insert(0 if self._ahead[4] else len(gave), "value")
        return tuple(dict.fromkeys(gave))

    def _missed(self, decision: Decision, inputs: Array) -> list[str]:
        """The inequalities whose conditions an input does not meet."""
        short = self._short(decision, inputs) > 1e-7
        return [n for n, s in zip(self._named(decision), short, strict=True) if s]

    def _lacks(self, decision: Decision, inputs: Array, level: int) -> float:
        """What the value a sample after an input lacks of its level (0), or of its floor (1)."""
        _, moves, curved, motion, _ = self._ahead
        m = len(self.system.inputs)
        numbers = decision.conditions[self.count * (m + 1) + m :].copy()
        values, low, steps, shape, periodic = self.program.table
        axes = len(shape)
        whole = (np.ascontiguousarray(a, dtype=np.int64) for a in (shape, periodic))
        least: float = called(
            "foreseen", "least_after", values, numbers[3 : 3 + motion].copy(),
            np.ascontiguousarray(inputs), -math.inf, low, steps, *whole, axes, m, moves, curved,
            numbers[2], np.empty(numbers_of_look(axes, moves)), np.zeros(3 * axes, dtype=np.int64),
        )  # fmt: skip
        return float(numbers[level] - least - 1e-9 * numbers[2])

    def _left_alone(self, decision: Decision) -> str:
        """The inputs that could act on what gave way, and that no condition has."""
        late = [(n, name) for name in self.gave_way(decision) for n in self.unused.get(name, ())]
        said = [
            f"'{n}' acts on '{name}' by a third derivative or later, unused" for n, name in late
        ]
        return "".join(f"; {text}" for text in said)

    def _short(self, decision: Decision, inputs: Array) -> Array:
        """By how much an input misses each condition, in units of its normal and its terms."""
        m = len(self.system.inputs)
        rows = decision.conditions[: self.count * (m + 1)].reshape(-1, m + 1)[self.hard :]
        size = np.linalg.norm(rows[:, :m], axis=1)
        misses: Array = (rows[:, :m] @ inputs - rows[:, m]) / np.where(size > 0, size, 1.0)
        return misses

    @cached_property
    def _names(self) -> tuple[str, ...]:
        """The inequality of each condition after the hard ones."""
        (law,) = as_switching(self.law).modes.values()
        assert law.safeguard is not None
        return law.safeguard.names

    def _distance(self, decision: Decision, name: str) -> str:
        assert self.constraints is not None
        names = self.constraints.inequality_names
        level = float(self._levels(decision)[names.index(name)])
        unit = self.constraints.inequality(name).unit
        unit = "" if unit == "1" else f" {unit}"
        if level > 0:
            return f"'{name}' is violated by {level:.3g}{unit} already"
        return f"'{name}' is {abs(level):.3g}{unit} away"

    def _nearest(self, decision: Decision) -> str:
        """The inequality that is nearest, where the states are known."""
        if self.constraints is None and self.made.kernel is None:
            near = decision.clearances
            if not near:
                return "; no obstacle is there"
            name = min(near, key=lambda n: near[n])
            return f"; the nearest: '{name}' is {near[name]:.3g} m away{self._left_out(decision)}"
        if self.constraints is None:
            return f"; the value is {decision.value:.3g} {self._unit}".rstrip()
        if not self.whole:
            return ""
        levels = self._levels(decision)
        names = self.constraints.inequality_names
        return f"; the nearest: {self._distance(decision, names[int(np.argmax(levels))])}"

    def _levels(self, decision: Decision) -> Array:
        states = decision.seen[np.newaxis, : len(self.system.states)]
        levels: Array = self._evaluator.values(at_time(decision.t, states))[0]
        return levels

    @cached_property
    def _evaluator(self) -> Evaluator:
        assert self.constraints is not None
        return levels_of(self.system, self.constraints)

    def _exit(self, decision: Decision) -> tuple[float, int]:
        """When the command, held, would leave the set, and by which inequality; NaN: not soon.

        Negative where that is not known.
        """
        if self.timed or not (self.whole and decision.value > 0):
            return -1.0, -1
        held = [*decision.nominal, *self._disturbance(decision)]
        times, states, left, by = self._forecast.motion(
            decision.t, decision.seen[: len(self.system.states)], held
        )
        if self.made.kernel is not None and self.constraints is None:
            fine = np.isfinite(states).all(axis=1)
            values = np.full(len(times), math.nan)
            values[fine] = self.made.kernel.value.at(states[fine])
            outside = np.flatnonzero(~(values > 0))
            return (float(times[outside[0]]) if len(outside) else math.nan), -1
        return left, by

    def _would_be(self, left: float, what: str) -> str:
        if left < 0:
            return ""
        if math.isnan(left):
            return f"; with the command held it would have stayed inside for {HORIZON:g} s"
        when = "at once" if left < AT_ONCE else f"in {left:.2g} s"
        return f"; with the command held {what} {when}"

    @cached_property
    def _forecast(self) -> Forecast:
        return Forecast(self.system, self.constraints)

    def _disturbance(self, decision: Decision) -> Array:
        """The disturbances of a forecast: those that were measured, else 0."""
        n = len(self.system.states)
        felt = dict(zip(self.told.disturbances, decision.seen[n:], strict=False))
        return np.array([felt.get(name, 0.0) for name in self.system.disturbance_names])

    def _outside(self, decision: Decision) -> str:
        made, kernel = self.made, self.made.kernel
        assert kernel is not None
        table = kernel.table
        if not self.whole:
            return "the estimated state is outside the grid: nothing is promised"
        states = decision.seen[np.newaxis, : len(self.system.states)]
        if made.parts is not None and made.parts.excess(states)[0] > 0:
            where = made.parts.decomposition.where
            return f"the parts promise something where {where}, and nothing here"
        beyond = [
            f"{name} = {value:.4g} is outside {a.low:.4g} to {a.high:.4g}"
            for a, (name, (value,)) in zip(
                table.grid.axes,
                kernel.places(made.system.state_names, states).items(),
                strict=True,
            )
            if a.ends != "periodic" and not a.low <= value <= a.high
        ]
        where = ", ".join(beyond) or (
            f"at {decision.t:.4g} s the horizon of the {table.report.kind} has passed"
        )
        return f"{where}: the filter used the nearest place of its grid and promises nothing"
