"""Trajectories as an xarray dataset with names, units and meanings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from holdfast.execution.closed_loop import Outcome, Trajectories
from holdfast.execution.settings import Settings
from holdfast.execution.translate import ClosedLoopProgram

if TYPE_CHECKING:
    from holdfast.maths.quantity import Quantity

NO_CONSTRAINT = -1
NAMED_AXES = ("state", "input", "actuator", "signal", "constraint", "varied")


def to_dataset(
    program: ClosedLoopProgram,
    trajectories: Trajectories,
    settings: Settings,
    attributes: Mapping[str, Any],
) -> xr.Dataset:
    """Names, units and meanings around the arrays of a batch of runs."""
    s, names = trajectories, [c[0] for c in program.constraints]
    exits = [NO_CONSTRAINT, *range(len(names))]

    def meanings(
        array: np.ndarray[Any, Any], values: Sequence[int], words: Sequence[str], text: str
    ) -> dict[str, Any]:
        return {
            "long_name": text,
            "flag_values": np.array(values, dtype=array.dtype),
            "flag_meanings": " ".join(w.replace(" ", "_") for w in words),
        }

    def named(text: str, names: Sequence[str], units: Sequence[str]) -> dict[str, str]:
        return {"long_name": text, "names": ", ".join(names), "units": ", ".join(units)}

    variables: dict[str, Any] = {
        "state": (("run", "time", "state"), s.state, named("state", *_columns(program.states))),
        "input": (
            ("run", "time", "input"),
            s.input,
            named("input after saturation", *_columns(program.inputs)),
        ),
        "actuator": (
            ("run", "time", "actuator"),
            s.actuator,
            {"long_name": "actuator value", "units": program.actuator_unit},
        ),
        "mode": (
            ("run", "time"),
            s.mode,
            meanings(s.mode, range(len(program.modes)), program.modes, "mode of the law"),
        ),
        "signal": (
            ("run", "time", "signal"),
            s.signal,
            {"long_name": "signal of the law", "names": ", ".join(program.signals)},
        ),
        "constraint": (
            ("run", "time", "constraint"),
            s.constraint,
            named("constraint, safe where <= 0", names, [c[1] for c in program.constraints]),
        ),
        "outcome": (
            ("run",),
            s.outcome,
            meanings(s.outcome, list(Outcome), [o.label for o in Outcome], "how the run ended"),
        ),
        "exit_time": (
            ("run",),
            s.exit_time,
            {"units": "s", "long_name": "time of leaving the region, chattering or diverging"},
        ),
        "exit_constraint": (
            ("run",),
            s.exit_constraint,
            meanings(s.exit_constraint, exits, ["none", *names], "first constraint violated"),
        ),
        "goal_time": (
            ("run",),
            s.goal_time,
            {"units": "s", "long_name": "since when the run is in the goal at its end"},
        ),
        "worst_constraint": (
            ("run", "constraint"),
            s.worst,
            {"long_name": "largest value over all of time"},
        ),
        "peak_input": (("run", "input"), s.peak_input, {"long_name": "largest magnitude"}),
        "peak_actuator": (
            ("run", "actuator"),
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
        "slack": (("run",), s.slack, {"long_name": "most by which it relaxed its conditions"}),
        "varied": (("run", "varied"), s.varied, {"long_name": "what differs from run to run"}),
        "rejected_steps": (("run",), s.rejected, {"long_name": "adaptive steps refused"}),
        "state_is_angle": (("state",), np.array([q.angle for q in program.states], dtype=np.int8)),
    }
    coordinates = {
        "time": ("time", s.time, {"units": "s", "long_name": "time"}),
        "run": np.arange(len(s.outcome), dtype=np.int32),
        "state_name": ("state", _labels([q.name for q in program.states])),
        "input_name": ("input", _labels([q.name for q in program.inputs])),
        "actuator_name": ("actuator", _labels(program.actuators)),
        "signal_name": ("signal", _labels(program.signals)),
        "constraint_name": ("constraint", _labels(names)),
        "state_unit": ("state", _labels([q.unit for q in program.states])),
        "state_description": ("state", _labels([q.description or q.name for q in program.states])),
        "input_unit": ("input", _labels([q.unit for q in program.inputs])),
        "input_description": ("input", _labels([q.description or q.name for q in program.inputs])),
        "constraint_unit": ("constraint", _labels([c[1] for c in program.constraints])),
        "varied_name": ("varied", _labels(program.varied.labels)),
    }
    fixed = {
        "Conventions": "CF-1.11",
        "sample_time_s": settings.sample_time,
        "tolerance": settings.tolerance,
        "safeguarded": int(program.safeguarded),
        "seed": settings.seed if settings.seed < 2**63 else str(settings.seed),
    }
    return indexed(xr.Dataset(variables, coordinates, {**fixed, **attributes}))


def _columns(quantities: Sequence[Quantity]) -> tuple[list[str], list[str]]:
    return [q.name for q in quantities], [q.unit for q in quantities]


def indexed(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with `.sel(state_name="x")` and the like."""
    for axis in NAMED_AXES:
        if f"{axis}_name" not in dataset:  # a result of an older version
            continue
        dataset = dataset.set_xindex(f"{axis}_name")
    return dataset


def _labels(names: Any) -> np.ndarray[Any, Any]:
    return np.array(list(names), dtype=str) if len(names) else np.array([], dtype="<U1")
