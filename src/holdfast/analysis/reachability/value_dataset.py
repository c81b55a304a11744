"""Value functions as datasets with names and units, and places in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.march_report import Report
from holdfast.errors import SimulationError
from holdfast.maths.definitions.quantity import Quantity


def dataset_of(
    grid: Grid,
    values: npt.NDArray[Any],
    report: Report,
    times: Sequence[float] | None,
    arrival: npt.NDArray[Any] | None,
) -> xr.Dataset:
    """The arrays with names and units; `values` of several times has time first."""
    names = [a.name for a in grid.axes]
    unit = report.value_unit
    coordinates: dict[str, Any] = {
        a.name: (
            a.name,
            a.nodes,
            {
                "units": a.state.unit,
                "long_name": a.state.description or a.name,
                "ends": a.ends,
                "low": a.low,
                "high": a.high,
                "is_angle": int(a.state.angle),
            },
        )
        for a in grid.axes
    }
    dims = names
    if times is not None:
        coordinates["time"] = ("time", np.array(times), {"units": "s"})
        dims = ["time", *names]
    text = "value, positive inside the set"
    variables: dict[str, Any] = {"value": (dims, values, {"units": unit, "long_name": text})}
    if arrival is not None:
        said = {"units": "s", "long_name": "least time to the target; NaN where it is not reached"}
        variables["arrival"] = (names, arrival, said)
    return xr.Dataset(variables, coordinates, report.attributes())


def grid_of(dataset: xr.Dataset) -> Grid:
    """The grid of such a dataset."""
    dims = [str(d) for d in dataset["value"].dims if d != "time"]
    axes = []
    for name in dims:
        said = dataset[name].attrs
        text = "" if said["long_name"] == name else said["long_name"]
        q = Quantity(name, said["units"], text, angle=bool(said["is_angle"]))
        axes.append(
            Axis(q, float(said["low"]), float(said["high"]), dataset.sizes[name], said["ends"])
        )
    return Grid(tuple(axes))


def number_of_time(data: xr.DataArray, time: float) -> int:
    known = data["time"].values
    k = int(np.argmin(np.abs(known - time)))
    if not abs(known[k] - time) <= 1e-9 * float(np.abs(known).max()):
        shown = ", ".join(f"{t:g}" for t in known)
        raise SimulationError(f"no value at {time:g} s", expected=f"one of {shown}")
    return k


def between_nodes(axis: Axis, value: float) -> tuple[tuple[int, ...], float]:
    """The nodes of an axis below and above a value, and how far it is between."""
    place = (value - axis.low) / axis.step
    if axis.ends == "periodic":
        place %= axis.count
    elif not -1e-9 <= place <= axis.count - 1 + 1e-9:
        raise SimulationError(
            f"'{axis.name}' at {value:g} is outside the grid",
            expected=f"{axis.low:g} to {axis.high:g}",
        )
    k = int(np.clip(np.floor(place), 0, axis.count - (1 if axis.ends == "periodic" else 2)))
    return (k, (k + 1) % axis.count), place - k
