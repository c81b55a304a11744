"""The panels of a run's histories: curves of one unit, limits and thresholds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from holdfast.analysis.simulation.named_arrays import NamedArrays
from holdfast.analysis.simulation.result import Result
from holdfast.execution.arrays import Array
from holdfast.presentation.figures import style


@dataclass(frozen=True)
class Panel:
    """Curves against time, values (time, name).

    nominal: the same curves as requested by the law, before its safety filter. limits: (low, high)
    of every curve, infinite without a limit. levels: horizontal lines by label. fed: whether the
    curves are the inputs applied to the vehicle.
    """

    title: str
    unit: str
    names: list[str]
    values: Array
    nominal: Array | None = None
    limits: Array | None = None
    levels: Mapping[str, float] = field(default_factory=dict)
    fed: bool = False


def panels(result: Result, run: int) -> list[Panel]:
    """States by unit, actuators (or inputs), constraints by unit, signals, the kernel's value."""
    data = result.arrays
    states = _near_zero(data["state"].values[run], data["state_is_angle"].values)
    names = [style.label(str(n)) for n in data["state_name"].values]
    found = _by_unit("state", _units(data, "state"), names, states)
    found += _fed(data, run)
    if data.sizes["constraint_name"]:
        labels = [str(n).replace("_", " ") for n in data["constraint_name"].values]
        values, title = data["constraint"].values[run], "constraints (safe below 0)"
        limited = _by_unit(title, _units(data, "constraint"), labels, values)
        found += [replace(panel, levels={"": 0.0}) for panel in limited]
    return found + _signals(result, run)


def _fed(data: NamedArrays, run: int) -> list[Panel]:
    """The actuators, or the inputs if these are the same, with nominal values and limits."""
    axis = "actuator" if data.sizes["actuator_name"] else "input"
    names = [str(n) for n in data[f"{axis}_name"].values]
    units = _units(data, "input")
    if axis == "actuator":
        units = [str(data["actuator"].attrs["units"])] * len(names)
    else:
        names = [style.label(n) for n in names]
    asked = "nominal" if axis == "input" else "nominal_actuator"
    nominal = data[asked].values[run] if asked in data else None
    limits = None
    if f"{axis}_low" in data:  # missing in files of format 1
        ends = [data[f"{axis}_{side}"] for side in ("low", "high")]
        limits = np.array([e.values[run] if "run" in e.dims else e.values for e in ends]).T
    title = {"actuator": "actuators", "input": "input"}[axis]
    return [
        replace(
            panel,
            nominal=None if nominal is None else nominal[:, columns],
            limits=None if limits is None else limits[columns],
            fed=True,
        )
        for panel, columns in zip(
            _by_unit(title, units, names, data[axis].values[run]), _columns(units), strict=True
        )
    ]


def _signals(result: Result, run: int) -> list[Panel]:
    """The switching signals, the value of a kernel with its thresholds, and the other signals."""
    data = result.arrays
    names = [str(n) for n in data["signal_name"].values]
    values = data["signal"].values[run]
    known = "signal_unit" in data
    units = _units(data, "signal") if known else ["1"] * len(names)
    value = str(data["signal"].attrs.get("value_of_kernel", ""))
    found = []
    for title, chosen in (
        ("switching signals", [i for i, n in enumerate(names) if n.startswith("sigma")]),
        ("value of the kernel (kept above 0)", [i for i, n in enumerate(names) if n == value]),
    ):
        if not chosen:
            continue
        levels = {"boundary": 0.0} if title.startswith("value") else {}
        margin = float((result.parameters or {}).get("safety_margin", 0.0))
        if levels and margin:
            levels["margin"] = margin
        labels = ["$V$"] if levels else [_signal_label(names[i]) for i in chosen]
        found.append(Panel(title, units[chosen[0]], labels, values[:, chosen], levels=levels))
    rest = [i for i, n in enumerate(names) if not n.startswith("sigma") and n != value]
    labels = [names[i].replace("_", " ") for i in rest]
    return found + _by_unit("signals", [units[i] for i in rest], labels, values[:, rest])


def _near_zero(states: Array, angles: npt.NDArray[np.int8]) -> Array:
    """The states; every angle is shifted by the full turns counted at its end."""
    late = states[len(states) // 2 :]
    late = late[np.isfinite(late).all(axis=1)]
    turns = np.round(np.median(late, axis=0) / (2 * np.pi)) if len(late) else 0.0
    shifted: Array = states - 2 * np.pi * np.where(angles == 1, turns, 0.0)
    return shifted


def _signal_label(name: str) -> str:
    _, _, tail = name.partition("_")
    return f"$\\sigma$ {tail.replace('_', ' ')}"


def _units(data: NamedArrays, axis: str) -> list[str]:
    return [str(u) for u in data[f"{axis}_unit"].values]


def _columns(units: Sequence[str]) -> list[list[int]]:
    """The columns of every unit."""
    return [[i for i, u in enumerate(units) if u == unit] for unit in dict.fromkeys(units)]


def _by_unit(title: str, units: Sequence[str], names: Sequence[str], values: Array) -> list[Panel]:
    kinds = {"m": "position", "rad": "angle", "m/s": "velocity", "rad/s": "turn rate"}
    return [
        Panel(
            kinds.get(units[columns[0]], "state") if title == "state" else title,
            units[columns[0]],
            [names[i] for i in columns],
            values[:, columns],
        )
        for columns in _columns(units)
    ]
