"""Value functions (level-set functions) on a grid: V > 0 inside the set, 0 on its boundary."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from holdfast.analysis.reachability.cells import share_inside
from holdfast.analysis.reachability.given import number
from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.inner_set import inner
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.simulation.files import write_netcdf
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.look_up import slopes_at, values_at
from holdfast.maths.definitions.quantity import Quantity


@dataclass(frozen=True)
class ValueFunction:
    """V over the states, at one time or several; the set is { V > 0 }.

    dataset: `value` with one dimension for every state and, if several times were requested,
    `time` [s] first; of a capture basin also `arrival` [s], the least time to the goal. Its
    attributes hold the problem, the method, and the error estimates: see `report`.
    """

    dataset: xr.Dataset
    grid: Grid

    @property
    def report(self) -> Report:
        """The problem, the march and its error estimates, as one record."""
        return Report.read(self.dataset.attrs)

    def reported(self, **changes: Any) -> ValueFunction:
        """The same values with some entries of the report replaced; None removes an entry."""
        attributes = dataclasses.replace(self.report, **changes).attributes()
        others = {n: v for n, v in self.dataset.attrs.items() if n not in Report.names()}
        dataset = self.dataset.copy(deep=False)
        dataset.attrs = {**others, **attributes}
        return ValueFunction(dataset, self.grid)

    @property
    def names(self) -> tuple[str, ...]:
        """The states, in the order of the axes."""
        return tuple(a.name for a in self.grid.axes)

    @checked
    def values(self, time: float | None = None) -> Array:
        """The values at the nodes, at the end or at one of the requested times."""
        data = self.dataset["value"]
        if "time" in data.dims:
            data = data.isel(time=-1) if time is None else _at(data, time)
        elif time is not None:
            raise SimulationError(
                "this value function is stored at its last time only",
                remedy="compute it with times=[...]",
            )
        found: Array = data.values
        return found

    @checked
    def at(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """V at states of shape (count, states), linear between nodes; NaN outside the grid.

        Raises `SimulationError` for a state that is not finite; so do `gradient` and `contains`.
        """
        points = self._points(states)
        return values_at(self._flat(time), points, self._geometry())

    @checked
    def gradient(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """dV/dq at states of shape (count, states): central differences, interpolated."""
        points = self._points(states)
        return slopes_at(self._flat(time), points, self._geometry())

    @checked
    def least_time(self, states: npt.ArrayLike) -> Array:
        """The least time [s] to the goal from states of shape (count, states), of a capture basin.

        Linear between the nodes that reach the goal; NaN where V <= 0, and outside the grid.

        Raises `SimulationError` for a value function without times of arrival.
        """
        if "arrival" not in self.dataset:
            raise SimulationError(
                "this value function has no least times",
                expected="a capture basin of a problem that does not depend on time",
                remedy="or compute them: arrival_steps=100",
            )
        points, geometry = self._points(states), self._geometry()
        arrival = np.ascontiguousarray(self.dataset["arrival"].values, dtype=np.float64)
        reached = np.isfinite(arrival)
        found = values_at(np.where(reached, arrival, 0.0).ravel(), points, geometry)
        share = values_at(reached.astype(np.float64).ravel(), points, geometry)
        known = (self.at(points) > 0) & (share > 0)
        return np.where(known, found / np.where(known, share, 1.0), np.nan)

    @checked
    def contains(
        self, states: npt.ArrayLike, margin: float = 0.0, time: float | None = None
    ) -> npt.NDArray[np.bool_]:
        """Whether V > margin, at the end or at one of the requested times.

        A state outside the grid is not contained.
        """
        inside: npt.NDArray[np.bool_] = self.at(states, time) > margin
        return inside

    @checked
    def fraction(self, time: float | None = None) -> float:
        """The share of the grid's box in the set.

        Cell by cell, of the linear function with the mean value and the mean slopes of the cell's
        corners, so that its error falls with the square of the step.
        """
        return share_inside(self.values(time), [a.ends == "periodic" for a in self.grid.axes])

    @checked
    def volume(self, time: float | None = None) -> float:
        """The volume of the set, in the product of the units of the states."""
        return self.fraction(time) * math.prod(a.high - a.low for a in self.grid.axes)

    @checked
    def extent(self, time: float | None = None) -> dict[str, tuple[float, float]]:
        """State -> its least and largest value in the set, between nodes by linear interpolation.

        NaN if the set is empty.
        """
        table = self.values(time)
        found = {}
        for i, axis in enumerate(self.grid.axes):
            best = table.max(axis=tuple(k for k in range(table.ndim) if k != i))
            inside = np.flatnonzero(best > 0)
            if not len(inside):
                found[axis.name] = (math.nan, math.nan)
                continue
            ends = []
            for at, out in ((int(inside[0]), -1), (int(inside[-1]), 1)):
                place = float(at)
                if 0 <= at + out < axis.count:
                    place += out * float(best[at] / (best[at] - best[at + out]))
                ends.append(axis.low + axis.step * place)
            found[axis.name] = (ends[0], ends[1])
        return found

    def inner(self) -> ValueFunction:
        """The set eroded by its estimated error in cells, from a coarser grid.

        Needs `estimate_error` of the march; see `reachability.inner_set`. An estimate is not a
        proof.
        """
        return inner(self)

    def last(self) -> ValueFunction:
        """The value function at its last time only."""
        if "time" not in self.dataset["value"].dims:
            return self
        return ValueFunction(self.dataset.isel(time=-1, drop=True), self.grid)

    @checked
    def slice(self, **at: float) -> ValueFunction:
        """A slice of the value function at fixed values of some states, by linear interpolation."""
        data, axes = self.dataset["value"], self.grid.axes
        for name, value in at.items():
            axis = self._axis(name)
            number(f"{name} = ", value, "a finite number", np.isfinite)
            data = _held(data, axis, float(value))
            axes = tuple(a for a in axes if a.name != name)
        return ValueFunction(data.to_dataset().assign_attrs(self.dataset.attrs), Grid(axes))

    @checked
    def projection(self, *names: str) -> ValueFunction:
        """The largest value over all other states: the projection of the set on the named ones."""
        for name in names:
            self._axis(name)
        rest = [a.name for a in self.grid.axes if a.name not in names]
        data = self.dataset["value"].max(rest)
        axes = tuple(a for a in self.grid.axes if a.name in names)
        return ValueFunction(data.to_dataset().assign_attrs(self.dataset.attrs), Grid(axes))

    @checked
    def save(self, path: str | Path) -> Path:
        """Write NetCDF-4, compressed, atomically; `OutputError` if the folder cannot be written."""
        return write_netcdf(self.dataset, path)

    def summary(self) -> dict[str, Any]:
        """The problem, the method and the error estimates, for summary.json."""
        return {k: v for k, v in self.dataset.attrs.items() if k != "scenario_text"} | {
            "fraction_of_box": self.fraction(),
            "volume": self.volume(),
            "extent": {n: list(ends) for n, ends in self.extent().items()},
        }

    def _axis(self, name: str) -> Axis:
        for axis in self.grid.axes:
            if axis.name == name:
                return axis
        raise SimulationError(
            f"'{name}' is not an axis", expected="one of " + ", ".join(self.names)
        )

    def _points(self, states: npt.ArrayLike) -> Array:
        points = np.ascontiguousarray(np.atleast_2d(np.asarray(states, dtype=np.float64)))
        if points.ndim != 2 or points.shape[1] != len(self.grid.axes):
            raise SimulationError(
                f"states have the shape {points.shape}", expected=f"(count, {len(self.grid.axes)})"
            )
        if not np.isfinite(points).all():
            row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
            shown = ", ".join(f"{v:g}" for v in points[row])
            raise SimulationError(f"state {row} is not finite: ({shown})")
        return points

    def _flat(self, time: float | None) -> npt.NDArray[Any]:
        return np.ascontiguousarray(self.values(time)).ravel()

    def _geometry(self) -> tuple[npt.NDArray[Any], ...]:
        axes = self.grid.axes
        return (
            np.array([a.low for a in axes]),
            np.array([a.step for a in axes]),
            np.array([a.count for a in axes], dtype=np.int64),
            np.array([a.ends == "periodic" for a in axes]),
        )


def to_value_function(
    grid: Grid,
    values: npt.NDArray[Any],
    report: Report,
    *,
    times: Sequence[float] | None = None,
    arrival: npt.NDArray[Any] | None = None,
) -> ValueFunction:
    """The dataset of the arrays with names and units; `values` of several times has time first."""
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
    return ValueFunction(xr.Dataset(variables, coordinates, report.attributes()), grid)


def value_function(dataset: xr.Dataset) -> ValueFunction:
    """A value function from its saved dataset."""
    dims = [str(d) for d in dataset["value"].dims if d != "time"]
    axes = []
    for name in dims:
        said = dataset[name].attrs
        text = "" if said["long_name"] == name else said["long_name"]
        q = Quantity(name, said["units"], text, angle=bool(said["is_angle"]))
        axes.append(
            Axis(q, float(said["low"]), float(said["high"]), dataset.sizes[name], said["ends"])
        )
    return ValueFunction(dataset, Grid(tuple(axes)))


def _at(data: xr.DataArray, time: float) -> xr.DataArray:
    known = data["time"].values
    k = int(np.argmin(np.abs(known - time)))
    if not abs(known[k] - time) <= 1e-9 * float(np.abs(known).max()):
        shown = ", ".join(f"{t:g}" for t in known)
        raise SimulationError(f"no value at {time:g} s", expected=f"one of {shown}")
    return data.isel(time=k)


def _held(data: xr.DataArray, axis: Axis, value: float) -> xr.DataArray:
    place = (value - axis.low) / axis.step
    if axis.ends == "periodic":
        place %= axis.count
    elif not -1e-9 <= place <= axis.count - 1 + 1e-9:
        raise SimulationError(
            f"'{axis.name}' at {value:g} is outside the grid",
            expected=f"{axis.low:g} to {axis.high:g}",
        )
    k = int(np.clip(np.floor(place), 0, axis.count - (1 if axis.ends == "periodic" else 2)))
    f = place - k
    near, far = (data.isel({axis.name: j % axis.count}, drop=True) for j in (k, k + 1))
    return near if abs(f) < 1e-12 else (1 - f) * near + f * far
