"""Trajectories as arrays with names, units and meanings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.analysis.simulation.named_arrays import NamedArray, NamedArrays
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.simulation.outcomes import Outcome, SafeguardAnswer
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.simulation.trajectories import Trajectories

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
            _flags(s.mode, range(len(program.modes)), program.modes, "mode of the law"),
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
            _flags(s.outcome, list(Outcome), [o.label for o in Outcome], "how the run ended"),
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
            _flags(s.exit_constraint, exits, ["none", *names], "first constraint violated"),
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
        "state_name": ("state_name", _labels([q.name for q in program.states])),
        "input_name": ("input_name", _labels([q.name for q in program.inputs])),
        "actuator_name": ("actuator_name", _labels(program.actuators)),
        "signal_name": ("signal_name", _labels(program.signals)),
        "signal_unit": ("signal_name", _labels(program.signal_units)),
        "constraint_name": ("constraint_name", _labels(names)),
        "state_unit": ("state_name", _labels([q.unit for q in program.states])),
        "state_description": (
            "state_name",
            _labels([q.description or q.name for q in program.states]),
        ),
        "input_unit": ("input_name", _labels([q.unit for q in program.inputs])),
        "input_description": (
            "input_name",
            _labels([q.description or q.name for q in program.inputs]),
        ),
        "constraint_unit": ("constraint_name", _labels([c[1] for c in program.constraints])),
        "varied_name": ("varied_name", _labels(program.varied.labels)),
    }
    if felt is not None:
        names, units = _columns(program.disturbances)
        about = named("disturbance where the vehicle is", names, units)
        variables["disturbance"] = (("run", "time", "disturbance_name"), felt, about)
        coordinates["disturbance_name"] = ("disturbance_name", _labels(names))
        coordinates["disturbance_unit"] = ("disturbance_name", _labels(units))
    fixed = {
        "Conventions": "CF-1.11",
        "sample_time_s": settings.sample_time,
        "tolerance": settings.tolerance,
        "safeguarded": int(program.safeguarded),
        "seed": settings.seed if settings.seed < 2**63 else str(settings.seed),
    }
    everything = {name: _named(*given) for name, given in {**variables, **coordinates}.items()}
    return NamedArrays(everything, tuple(coordinates), {**fixed, **attributes})


def _named(
    dims: str | tuple[str, ...],
    values: np.ndarray[Any, Any],
    attributes: Mapping[str, Any] | None = None,
) -> NamedArray:
    return NamedArray((dims,) if isinstance(dims, str) else dims, values, attributes or {})


def _flags(
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
    found: dict[str, Any] = {
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
            _flags(s.safeguard, answers, [a.label for a in answers], "answer of the safeguard"),
        ),
        "overruled": (
            ("run",),
            s.overruled,
            {"long_name": "control samples at which the safeguard changed the command"},
        ),
    }
    if program.actuators:
        about = {"long_name": f"actuator values requested by the law, {before}"}
        found["nominal_actuator"] = (
            ("run", "time", "actuator_name"),
            s.nominal_actuator,
            {**about, "units": program.actuator_unit},
        )
    return found


def _columns(quantities: Sequence[Quantity]) -> tuple[list[str], list[str]]:
    return [q.name for q in quantities], [q.unit for q in quantities]


def _labels(names: Any) -> np.ndarray[Any, Any]:
    return np.array(list(names), dtype=str) if len(names) else np.array([], dtype="<U1")
