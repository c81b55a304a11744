"""Closed-loop simulation of a system under a law from many starts.

Disturbances are refused beyond their bounds, and recorded where they vary.

Trajectories are arrays with names, units and meanings.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from operator import is_
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import sympy as sp

from holdfast._version import __version__
from holdfast.analysis.simulation.files import NamedArray, NamedArrays
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.starts import Starts, on_boundary, warn_of_degrees
from holdfast.arguments import checked, written_by_user
from holdfast.errors import GainWarning, ModelWarning, SimulationError, check_name, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram, closed_loop_program
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.blocks import Trajectories
from holdfast.execution.simulation.closed_loop import ClosedLoop, Command, Commander, commander_of
from holdfast.execution.simulation.settings import (
    BY_NAME,
    Outcome,
    SafeguardAnswer,
    Settings,
    SettingsOptions,
)
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.law import CellLookup, Law, SampledLookup
from holdfast.maths.definitions.quantity import DELAY, SAMPLE_TIME, TIME, expression_of, symbol
from holdfast.maths.definitions.region import Region, drawn_shapes
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System, check_disturbance_units
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.traversal import symbols_in

if TYPE_CHECKING:
    from holdfast.maths.definitions.quantity import Quantity

NO_CONSTRAINT = -1


def described(
    program: ClosedLoopProgram,
    trajectories: Trajectories,
    settings: Settings,
    attributes: Mapping[str, Any],
    limits: Mapping[str, tuple[Array, Array]] | None = None,
    felt: Array | None = None,
) -> NamedArrays:
    """The arrays of a batch of runs with their names, units and meanings.

    limits: of "input" and "actuator" the least and the largest value of every column, or of every
    column in every run. felt: the disturbance at every recorded sample, where it varies in a run.

    The limits have the shape (columns,) or (runs, columns), felt (runs, samples, disturbances).
    """
    s, names = trajectories, [c[0] for c in program.constraints]
    exits = [NO_CONSTRAINT, *range(len(names))]

    def named(text: str, names: Sequence[str], units: Sequence[str]) -> dict[str, str]:
        return {"long_name": text, "names": ", ".join(names), "units": ", ".join(units)}

    value = {"value_of_kernel": program.value_signal} if program.value_signal else {}
    variables: dict[str, Any] = {
        "state": (
            ("run", "time", "state_name"),
            s.state,
            named("state", *_columns(program.states)),
        ),
        "input": (
            ("run", "time", "input_name"),
            s.input,
            named("input after saturation", *_columns(program.inputs)),
        ),
        "actuator": (
            ("run", "time", "actuator_name"),
            s.actuator,
            {"long_name": "actuator value", "units": program.actuator_unit},
        ),
        "mode": (
            ("run", "time"),
            s.mode,
            flags(s.mode, range(len(program.modes)), program.modes, "mode of the law"),
        ),
        "signal": (
            ("run", "time", "signal_name"),
            s.signal,
            {**named("signal of the law", program.signals, program.signal_units), **value},
        ),
        "constraint": (
            ("run", "time", "constraint_name"),
            s.constraint,
            named("constraint, safe where <= 0", names, [c[1] for c in program.constraints]),
        ),
        "outcome": (
            ("run",),
            s.outcome,
            flags(s.outcome, list(Outcome), [o.label for o in Outcome], "how the run ended"),
        ),
        "exit_time": (
            ("run",),
            s.exit_time,
            {
                "units": "s",
                "long_name": "time of leaving the region or the grid, chattering or diverging",
            },
        ),
        "exit_constraint": (
            ("run",),
            s.exit_constraint,
            flags(s.exit_constraint, exits, ["none", *names], "first constraint violated"),
        ),
        "goal_time": (
            ("run",),
            s.goal_time,
            {"units": "s", "long_name": "since when the run is in the goal at its end"},
        ),
        "worst_constraint": (
            ("run", "constraint_name"),
            s.worst,
            {"long_name": "largest value over all of time"},
        ),
        "peak_input": (("run", "input_name"), s.peak_input, {"long_name": "largest magnitude"}),
        "peak_actuator": (
            ("run", "actuator_name"),
            s.peak_actuator,
            {"long_name": "largest magnitude", "units": program.actuator_unit},
        ),
        "switches": (("run",), s.switches, {"long_name": "changes of mode"}),
        "shortest_dwell": (
            ("run",),
            s.shortest_dwell,
            {"units": "s", "long_name": "shortest time between two changes of mode"},
        ),
        "infeasible": (
            ("run",),
            s.infeasible,
            {"long_name": "control samples at which the safeguard found no admissible input"},
        ),
        "largest_slack": (
            ("run",),
            s.largest_slack,
            {"long_name": "most by which the safeguard relaxed its conditions"},
        ),
        "varied": (("run", "varied_name"), s.varied, {"long_name": "varied numbers of every run"}),
        "off_grid_time": (
            ("run",),
            s.off_grid,
            {
                "units": "s",
                "long_name": "when the law was first outside its grid or cells",
            },
        ),
        "rejected_steps": (("run",), s.rejected, {"long_name": "adaptive steps refused"}),
        "state_is_angle": (
            ("state_name",),
            np.array([q.angle for q in program.states], dtype=np.int8),
        ),
    }
    if program.safeguarded:
        variables |= _safeguard(program, s)
    for axis, ends in (limits or {}).items():
        for side, word, values in zip(("low", "high"), ("least", "largest"), ends, strict=True):
            dims = ("run", f"{axis}_name")[-values.ndim :]
            variables[f"{axis}_{side}"] = (dims, values, {"long_name": f"{word} {axis} admitted"})
    coordinates: dict[str, Any] = {
        "time": ("time", s.time, {"units": "s", "long_name": "time"}),
        "run": ("run", np.arange(len(s.outcome), dtype=np.int32)),
        "state_name": ("state_name", labels([q.name for q in program.states])),
        "input_name": ("input_name", labels([q.name for q in program.inputs])),
        "actuator_name": ("actuator_name", labels(program.actuators)),
        "signal_name": ("signal_name", labels(program.signals)),
        "signal_unit": ("signal_name", labels(program.signal_units)),
        "constraint_name": ("constraint_name", labels(names)),
        "state_unit": ("state_name", labels([q.unit for q in program.states])),
        "state_description": (
            "state_name",
            labels([q.description or q.name for q in program.states]),
        ),
        "input_unit": ("input_name", labels([q.unit for q in program.inputs])),
        "input_description": (
            "input_name",
            labels([q.description or q.name for q in program.inputs]),
        ),
        "constraint_unit": ("constraint_name", labels([c[1] for c in program.constraints])),
        "varied_name": ("varied_name", labels(program.varied.labels)),
    }
    if felt is not None:
        names, units = _columns(program.disturbances)
        about = named("disturbance where the vehicle is", names, units)
        variables["disturbance"] = (("run", "time", "disturbance_name"), felt, about)
        coordinates["disturbance_name"] = ("disturbance_name", labels(names))
        coordinates["disturbance_unit"] = ("disturbance_name", labels(units))
    fixed = {
        "Conventions": "CF-1.11",
        "sample_time_s": settings.sample_time,
        "tolerance": settings.tolerance,
        "safeguarded": int(program.safeguarded),
        "seed": settings.seed if settings.seed < 2**63 else str(settings.seed),
    }
    everything = {
        name: _named(*variable) for name, variable in {**variables, **coordinates}.items()
    }
    return NamedArrays(everything, tuple(coordinates), {**fixed, **attributes})


def _named(
    dims: str | tuple[str, ...],
    values: np.ndarray[Any, Any],
    attributes: Mapping[str, Any] | None = None,
) -> NamedArray:
    return NamedArray((dims,) if isinstance(dims, str) else dims, values, attributes or {})


def flags(
    array: np.ndarray[Any, Any], values: Sequence[int], words: Sequence[str], text: str
) -> dict[str, Any]:
    """The attributes of numbers that encode words (CF conventions, section 3.5)."""
    return {
        "long_name": text,
        "flag_values": np.array(values, dtype=array.dtype),
        "flag_meanings": " ".join(w.replace(" ", "_") for w in words),
    }


def _safeguard(program: ClosedLoopProgram, s: Trajectories) -> dict[str, Any]:
    """The law's requests at every recorded sample, and the result of its safety filter."""
    names, units = (", ".join(part) for part in _columns(program.inputs))
    before = "before the safeguard and saturation"
    answers = list(SafeguardAnswer)
    variables: dict[str, Any] = {
        "nominal": (
            ("run", "time", "input_name"),
            s.nominal,
            {"long_name": f"command of the law {before}", "names": names, "units": units},
        ),
        "slack": (
            ("run", "time"),
            s.sample_slack,
            {
                "long_name": "how far the conditions of the safeguard were relaxed, 0 where an "
                "input met them all",
                "units": ", ".join(program.slack_units),
            },
        ),
        "safeguard": (
            ("run", "time"),
            s.safeguard,
            flags(s.safeguard, answers, [a.label for a in answers], "answer of the safeguard"),
        ),
        "overruled": (
            ("run",),
            s.overruled,
            {"long_name": "control samples at which the safeguard changed the command"},
        ),
    }
    if program.actuators:
        about = {"long_name": f"actuator values requested by the law, {before}"}
        variables["nominal_actuator"] = (
            ("run", "time", "actuator_name"),
            s.nominal_actuator,
            {**about, "units": program.actuator_unit},
        )
    return variables


def _columns(quantities: Sequence[Quantity]) -> tuple[list[str], list[str]]:
    return [q.name for q in quantities], [q.unit for q in quantities]


def labels(names: Any) -> np.ndarray[Any, Any]:
    return np.array(list(names), dtype=str) if len(names) else np.array([], dtype="<U1")


MOST = 1 << 16
"""Samples at which a disturbance is evaluated at a time."""


def check_disturbance(
    system: System,
    loop: ClosedLoop,
    settings: Settings,
    plant: Mapping[str, float],
    disturbance: Mapping[str, sp.Expr],
    drawn: Array,
    first: int,
) -> None:
    """Refuse a disturbance that is not finite, or leaves its bounds, in any run.

    A field is judged along the runs (`check_field`): here its states are not known.

    drawn: the draws of each run, shape (runs, draws).
    """
    if not system.disturbances or loop.program.bounded:
        return
    used = set().union(*(e.free_symbols for e in disturbance.values()))
    steps = 4 * settings.samples + 1 if TIME in used else 1
    times = np.arange(steps, dtype=np.float64) * (settings.sample_time / 4)
    bounds = system.disturbance_bounds
    names = [*loop.program.varied.names, *loop.program.varied.plant]
    varied = {symbol(n) for n in names}
    bound_varies = bounds is not None and bool(bounds.free_symbols & varied)
    rows = drawn if used & varied or bound_varies else drawn[:1]
    values = {p.symbol: p.value for p in loop.program.parameters}
    worst: list[tuple[int, float, Array]] = []

    def check(run: int, time: float, sample: Array, bound: Bounds) -> None:
        if not bound.contains([float(v) for v in sample]):
            shown = ", ".join(
                f"{n} = {v:.4g}" for n, v in zip(system.disturbance_names, sample, strict=True)
            )
            at = f"t = {time:.4g} s" + (f" of run {run}" if len(rows) > 1 else "")
            raise SimulationError(
                f"the disturbance leaves its bounds at {at}: {shown}",
                remedy=f"reduce it, or raise the bound of system '{system.name}'",
                key="disturbance",
            )

    for run, row in enumerate(rows, first):
        real = {**plant, **dict(zip(names, row, strict=True))}
        samples = loop.disturbances(times, p=loop.parameter_array(real))
        if not np.isfinite(samples).all():
            raise SimulationError(
                f"a disturbance is not finite at some time of run {run}", key="disturbance"
            )
        extremes = [(run, times[i], samples[i]) for i in _extremes(samples)]
        if bounds is not None and (bound_varies or run == first):
            bound = bounds.at(values | {symbol(n): v for n, v in real.items()})
        if bound_varies:
            for where in extremes:
                check(*where, bound)
        worst += extremes
    if bounds is not None and not bound_varies:
        for index in _extremes(np.array([w[2] for w in worst])):
            check(*worst[index], bound)


def _extremes(samples: Array) -> list[int]:
    """The decisive rows for a box and for a ball: extreme components, extreme size."""
    sizes = np.linalg.norm(samples, axis=1)
    return sorted({int(sizes.argmax()), *samples.argmin(axis=0), *samples.argmax(axis=0)})


def check_field(system: System, trajectories: Trajectories, first: int) -> None:
    """Refuse a field that was beyond its bounds, or not finite, where a run was at a sample."""
    if not trajectories.beyond.size:
        return
    since = trajectories.beyond[:, 0]
    runs = np.flatnonzero(~np.isnan(since))
    if not runs.size:
        return
    run = runs[0]
    time, *values = trajectories.beyond[run]
    shown = ", ".join(
        f"{n} = {v:.4g}" for n, v in zip(system.disturbance_names, values, strict=True)
    )
    count = f", as in {len(runs)} of {len(since)} runs" if len(since) > 1 else ""
    raise SimulationError(
        f"the disturbance leaves its bounds where run {first + run} is at t = {time:.4g} s: "
        f"{shown}{count}",
        remedy="limit the field, for example by clip or tanh, or raise the bound of system "
        f"'{system.name}'",
        key="disturbance",
    )


def felt_along(
    loop: ClosedLoop, trajectories: Trajectories, settings: Settings, plant: Mapping[str, float]
) -> Array | None:
    """The disturbance at every recorded sample, (run, time, disturbance); None where constant."""
    program = loop.program
    if not program.in_run:
        return None
    runs, times = trajectories.state.shape[:2]
    columns = loop.columns((*program.varied.names, *program.varied.plant))
    numbers = loop.parameter_array(plant, settings.sample_time)
    felt = np.empty((runs, times, len(program.disturbances)))
    several = max(1, MOST // times)
    for begin in range(0, runs, several):
        part = slice(begin, begin + several)
        states = trajectories.state[part]
        p = np.tile(numbers, (len(states), 1))
        p[:, columns] = trajectories.varied[part]
        p = np.repeat(p, times, axis=0)
        if program.wandering:  # the last numbers before the sample time
            p[:, -1 - program.wandering : -1] = np.nan_to_num(
                trajectories.wander[part].reshape(len(p), -1)
            )
        values = loop.disturbances(
            np.tile(trajectories.time, len(states)), states.reshape(len(states) * times, -1), p
        )
        values[np.isnan(states).any(axis=2).reshape(-1)] = np.nan  # after the end of a run
        felt[part] = values.reshape(len(states), times, -1)
    return felt


@checked
def simulate(
    system: System,
    law: Law | Switching,
    *,
    starts: Starts | Sequence[Sequence[float]] | Array,
    part: range | None = None,
    region: Region | None = None,
    goal: Region | None = None,
    horizon: float,
    stepper: str = "rk4",
    disturbance: Mapping[str, float | sp.Expr] | None = None,
    plant: Mapping[str, float] | None = None,
    varied: Varied | None = None,
    reference: Mapping[str, float] | None = None,
    start_outside: bool = False,
    attributes: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    command: Command | Commander | None = None,
    **settings: Unpack[SettingsOptions],
) -> Result:
    """Simulate `system` under `law` from every start and return a `Result`.

    starts: a `Starts`, or an array of shape (runs, states). part: the subset of runs to simulate;
    every run is the same in any part. region: the inequalities to watch; a run that violates one is
    marked as having left, and when. goal: where a run must be at the end to have reached it.
    horizon [s]: how long. stepper: "rk4", "bogacki-shampine" or "dormand-prince". disturbance: name
    -> number or expression of t, parameters and states of the plant: a field, which the vehicle
    feels where it is. plant: parameters of the simulated vehicle that its law does not know.
    varied: the variation between runs; with `vertices`, every start is simulated at each of them.
    reference: the desired final state, for error statistics. start_outside: allow starts outside
    the region. command: your own controller, where the law is handed its command (`commanded`,
    `SafetyFilter.law`): called at every sample with t and the measured states, shape (runs,
    states), it returns shape (runs, inputs); or an object with the methods of `Commander`.
    attributes: kept with the result. settings: those of `Settings`, such as sample_time.

    Warns with `GainWarning` when the gains violate a condition of the law, and with `AngleWarning`
    where an angle [rad] starts at more than a turn. Raises `DefinitionError` for a law that does
    not fit the system, and `SimulationError` for invalid starts, disturbances or settings, and for
    a disturbance beyond its bounds: of a field at a sample of any run.

    >>> run = hf.simulate(cart, brake, starts=[[0.5, 0.0]], region=track, horizon=8.0)
    >>> run.dataset["state"].sel(run=0)[-1].values.round(3)
    array([ 0.002, -0.001])
    """
    check_name(stepper, BY_NAME, SimulationError, f"unknown stepper '{stepper}'")
    for name in settings:
        check_name(
            name, Settings.__dataclass_fields__, SimulationError, f"unknown setting '{name}'"
        )
    chosen = Settings(horizon=horizon, **settings)
    if chosen.until_goal and goal is None:
        raise SimulationError("until_goal without a goal", key="until_goal")
    for name in reference or {}:
        if name not in system.state_names:
            raise SimulationError(f"reference of '{name}', which is not a state", key="reference")
    expressions = {k: expression_of(v) for k, v in (disturbance or {}).items()}
    for name in expressions:
        if name not in system.disturbance_names:
            raise SimulationError(
                f"system '{system.name}' has no disturbance '{name}'",
                remedy=suggestion(name, system.disturbance_names),
                key="disturbance",
            )
    for name in plant or {}:
        if name not in (names := [p.name for p in system.parameters]):
            raise SimulationError(
                f"plant: system '{system.name}' has no parameter '{name}'",
                remedy=suggestion(name, names),
                key="plant",
            )
        if varied is not None and name in (*varied.names, *varied.plant):
            raise SimulationError(
                f"'{name}' of the plant is both varied and given a number",
                remedy="vary it under [varied.plant], or leave one of them out",
                key="plant",
            )
    definitions = _Identity((system, law, region, goal, BY_NAME[stepper], varied))
    compiled = _compiled.__wrapped__ if law.lookup is not None else _compiled  # a table is large
    loop = compiled(definitions, tuple(expressions.items()), chosen.continuous)
    program = loop.program
    if isinstance(law.lookup, CellLookup):
        _check_held(law.lookup, program, chosen)
    if isinstance(law.lookup, SampledLookup):
        _check_hold(law.lookup, "a sampled game", program, chosen)
    values = {p.symbol: p.value for p in program.parameters}
    real = values | {symbol(name): float(value) for name, value in (plant or {}).items()}
    for parameters in (values, real):
        if system.input_bounds is not None:
            system.input_bounds.at(parameters)
    turns = varied.turns if varied is not None else 1
    if written_by_user():
        if isinstance(starts, Starts):
            warn_of_degrees(system, starts)
        check_disturbance_units(system, expressions)
    if isinstance(starts, Starts):
        starts = starts.in_units_of(system)
        loop.check_room(starts.count * turns if part is None else len(part), chosen)
    try:
        initial = _from_every_start(
            lambda of: _initial_states(system, region, loop, starts, chosen, start_outside, of),
            turns,
            part,
        )
    except SimulationError as error:
        error.key = "starts"
        raise
    if written_by_user() and not isinstance(starts, Starts):
        warn_of_degrees(system, initial)
    first = part.start if part is not None else 0
    drawn = loop.varied(len(initial), chosen.seed, first)
    _check_varied(program, drawn, first)
    check_disturbance(system, loop, chosen, dict(plant or {}), expressions, drawn, first)
    seconds = {
        SAMPLE_TIME: 0.0 if chosen.continuous else chosen.sample_time,
        DELAY: chosen.delay,
    }
    _warn_of_gains(program, values | seconds, drawn)
    trajectories = loop.simulate(
        initial, chosen, plant=plant, varied=drawn, first=first, progress=progress,
        commander=commander_of(command, program),
    )  # fmt: skip
    check_field(system, trajectories, first)
    return Result(
        described(
            program,
            trajectories,
            chosen,
            {
                "holdfast_version": __version__,
                "system": system.name,
                "law": law.name,
                "region": region.name if region else "",
                "goal": goal.name if goal else "",
                "stepper": stepper,
                "wall_time_s": trajectories.wall_time,
                "parameters": json.dumps({p.name: p.value for p in program.parameters}),
                "plant": json.dumps(dict(plant or {})),
                "reference": json.dumps(dict(reference or {})),
                "vertices": json.dumps([*varied.vertices] if varied is not None else []),
                **(attributes or {}),
            },
            _limits(system, real, (*program.varied.names, *program.varied.plant), drawn),
            felt_along(loop, trajectories, chosen, dict(plant or {})),
        ),
        scene=drawn_shapes(region, goal),
        system=system,
        parameters={p.name: p.value for p in program.parameters},
        reference=reference,
    )


def _initial_states(
    system: System,
    region: Region | None,
    loop: ClosedLoop,
    starts: Starts | Sequence[Sequence[float]] | Array,
    settings: Settings,
    start_outside: bool,
    part: range | None = None,
) -> Array:
    """The states of the starts, or of a part of them; `SimulationError` for an invalid state. The
    states have the shape (runs, states)."""
    names = system.state_names
    first = part.start if part is not None else 0
    if isinstance(starts, Starts):
        fixed = np.array([[s.get(n, 0.0) for n in names] for s in starts.states], dtype=float)
        fixed = fixed.reshape(-1, len(names))
        if starts.random < 0:
            raise SimulationError(f"{starts.random} random starts", expected="0 or more")
        drawn = range(starts.random)
        if part is not None:
            drawn = range(max(0, first - len(fixed)), max(0, part.stop - len(fixed)))
            fixed = fixed[part.start : part.stop]
            if part.step != 1 or drawn.stop > starts.random:
                raise SimulationError(f"part {part} of {len(starts.states) + starts.random} runs")
        parts = [fixed]
        if drawn:
            if not starts.box:
                raise SimulationError(f"{starts.random} random starts need a box to be drawn from")
            low, high = (
                np.array([starts.box.get(n, (0.0, 0.0))[i] for n in names], dtype=float)
                for i in (0, 1)
            )
            for name, a, b in zip(names, low, high, strict=True):
                if not a <= b:
                    raise SimulationError(
                        f"the box of '{name}' is [{a:g}, {b:g}]", expected="lowest first"
                    )
            if starts.active:
                parts.append(on_boundary(system, region, starts, drawn, low, high, settings.seed))
            else:
                parts.append(loop.sample(low, high, len(drawn), settings.seed, drawn.start))
        initial = np.vstack(parts)
    else:
        initial = np.array(starts, dtype=float)
        if initial.ndim != 2 or initial.shape[1] != len(names):
            raise SimulationError(
                f"starts have the shape {initial.shape}",
                expected=f"(runs, {len(names)}) for the states {', '.join(names)}",
            )
        if part is not None:
            initial = initial[part.start : part.stop]
    if len(initial) == 0:
        raise SimulationError("the simulation has no runs", expected="at least one start")
    if not np.isfinite(initial).all():
        raise SimulationError("a start is not finite")
    if not start_outside:
        values = loop.constraints(initial)
        bad = np.argwhere(~(values <= settings.tolerance))
        if bad.size:
            run, j = bad[0]
            name, unit = loop.program.constraints[j]
            state = ", ".join(f"{n}={v:g}" for n, v in zip(names, initial[run], strict=True))
            raise SimulationError(
                f"start {first + run} ({state}) lies outside the region: {name} = "
                f"{values[run, j]:.4g} {unit}",
                expected=f"at most {settings.tolerance:g}",
                remedy="move the start, or allow starts outside the region",
            )
    return initial


class _Identity:
    """Objects as a key: the same ones, not equal ones."""

    def __init__(self, objects: tuple[Any, ...]) -> None:
        self.objects = objects

    def __hash__(self) -> int:
        return hash(tuple(map(id, self.objects)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and all(map(is_, self.objects, other.objects))


@lru_cache(maxsize=8)
def _compiled(
    of: _Identity, disturbance: tuple[tuple[str, sp.Expr], ...], continuous: bool
) -> ClosedLoop:
    """The compiled program of definitions; these do not change, so the last few programs stay."""
    system, law, region, goal, stepper, varied = of.objects
    program = closed_loop_program(
        system, law, region=region, goal=goal, disturbance=dict(disturbance), stepper=stepper,
        continuous=continuous, varied=varied,
    )  # fmt: skip
    return ClosedLoop(program)


def _check_held(lookup: CellLookup, program: ClosedLoopProgram, chosen: Settings) -> None:
    """Refuse other samples than those of a certificate, and say what is beyond what it counts."""
    _check_hold(lookup, "a certificate", program, chosen)
    for more in _beyond(lookup, chosen):
        warnings.warn(f"{more}: its promise does not hold", ModelWarning, stacklevel=4)


def _check_hold(
    lookup: CellLookup | SampledLookup, whose: str, program: ClosedLoopProgram, chosen: Settings
) -> None:
    """Refuse other samples than those of a law's table."""
    if chosen.continuous:
        raise SimulationError(
            f"the inputs of {whose} are held for {lookup.hold:g} s",
            expected="sampled control",
            key="continuous",
        )
    program.check_sample_time(chosen.sample_time)
    late = lookup.predicted if isinstance(lookup, SampledLookup) else 0.0
    if late and abs(chosen.delay - late) > 1e-9 * late:
        raise SimulationError(
            f"{whose} predicts the state over a delay of {late:g} s, and is shown it "
            f"{chosen.delay:g} s late",
            expected=f"a delay of {late:g} s",
            remedy="make the law for the delay of the run",
            key="delay",
        )


def _beyond(lookup: CellLookup, chosen: Settings) -> Iterator[str]:
    """What a run has more of than the certificate of its law counts with.

    A delay is of whole samples; a certificate counts with inputs that are less than one late.
    """
    if chosen.delay > lookup.delay:
        yield (
            f"the law sees everything {chosen.delay:g} s late, and its certificate counts with "
            f"inputs that are late by up to {lookup.delay:g} s"
        )
    for name, size in chosen.noise_uniform.items():
        if size > (error := lookup.error_of(name)):
            yield (
                f"the noise of '{name}' is up to {size:g}, and the certificate of the law counts "
                f"with up to {error:g}"
            )
    for name, size in chosen.noise_normal.items():
        if size > 0:
            yield f"the noise of '{name}' has no bound, and the certificate of the law needs one"


def _limits(
    system: System, values: Mapping[sp.Symbol, float], varied: Sequence[str], drawn: Array
) -> dict[str, tuple[Array, Array]]:
    """The least and the largest value of every input and actuator of the simulated vehicle.

    One row per run if they depend on varied parameters.
    """
    bounds = system.input_bounds
    if bounds is None:
        return {}
    sets: dict[str, Bounds] = {"input": bounds}
    if system.actuators and system.actuator_bounds is not None:
        sets["actuator"] = system.actuator_bounds
    symbols = [symbol(n) for n in varied]
    each = bool(bounds.free_symbols & set(symbols))
    rows = (
        [{**values, **dict(zip(symbols, row, strict=True))} for row in drawn] if each else [values]
    )
    limits = {}
    for axis, limited in sets.items():
        ends = [e for pair in limited.ranges() for e in pair]
        table = np.array([[_number(e, row) for e in ends] for row in rows])
        low, high = table[:, ::2], table[:, 1::2]
        limits[axis] = (low, high) if each else (low[0], high[0])
    return limits


def _number(e: sp.Expr, values: Mapping[sp.Symbol, float]) -> float:
    return float(e.xreplace({s: sp.Float(float(values[s])) for s in e.free_symbols}))


def _from_every_start(
    initial: Callable[[range | None], Array], turns: int, part: range | None
) -> Array:
    """Every start repeated in a row, or the requested part of these runs."""
    if turns == 1:
        return initial(part)
    if part is None:
        return np.repeat(initial(None), turns, axis=0)
    of = range(part.start // turns, -(-part.stop // turns))
    repeated = np.repeat(initial(of), turns, axis=0)
    return repeated[part.start - of.start * turns : part.stop - of.start * turns]


def _check_varied(program: ClosedLoopProgram, drawn: Array, first: int) -> None:
    """Refuse a run's value that is invalid for its parameter."""
    limits = {p.name: p.above for p in program.parameters}
    names = [*program.varied.names, *program.varied.plant]
    for j, name in enumerate(names):
        bad = np.flatnonzero(~(np.isfinite(drawn[:, j]) & (drawn[:, j] > limits[name])))
        if bad.size:
            raise SimulationError(
                f"'{program.varied.labels[j]}' is {drawn[bad[0], j]:g} in run {first + bad[0]}",
                expected=f"above {limits[name]:g}"
                if np.isfinite(limits[name])
                else "a finite number",
                key="varied",
            )


def _warn_of_gains(
    program: ClosedLoopProgram, values: Mapping[sp.Symbol, float], drawn: Array
) -> None:
    """One warning for each gain condition that at least one run violates, or a refusal."""
    names = [symbol(n) for n in program.varied.names]
    for condition in program.conditions:
        involved = {*symbols_in(condition.value), *symbols_in(condition.limit)}
        columns = [j for j, name in enumerate(names) if name in involved]
        rows = drawn[:, columns] if columns else drawn[:1, :0]
        judged: dict[bytes, str | None] = {}  # equal numbers are judged once
        for row in rows:
            if row.tobytes() not in judged:
                numbers = {names[j]: v for j, v in zip(columns, row, strict=True)}
                judged[row.tobytes()] = condition.violation({**values, **numbers})
        violated = [message for row in rows if (message := judged[row.tobytes()])]
        if violated:
            if condition.refused:
                raise SimulationError(violated[0])
            count = f" (in {len(violated)} of {len(rows)} runs)" if len(rows) > 1 else ""
            warnings.warn(violated[0] + count, GainWarning, stacklevel=3)
