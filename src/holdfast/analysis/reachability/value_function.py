"""Value functions (level-set functions) on a grid: V > 0 inside the set, 0 on its boundary."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from holdfast.analysis.reachability import stored_tables
from holdfast.analysis.reachability.cells import share_inside
from holdfast.analysis.reachability.claim import Claim, Tried, recorded
from holdfast.analysis.reachability.given import number
from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.inner_set import inner
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.stored_tables import ARRIVALS, Layers, StoredTables
from holdfast.analysis.reachability.value_dataset import (
    between_nodes,
    dataset_of,
    grid_of,
    number_of_time,
)
from holdfast.analysis.simulation.files import write_values
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray, Array
from holdfast.execution.look_up import slopes_at, values_at
from holdfast.execution.resources import check_memory
from holdfast.execution.table_in_parts import TableInParts


@dataclass(frozen=True)
class ValueFunction:
    """V over the states, at one time or several; the set is { V > 0 }.

    dataset: `value` with one dimension for every state and, if several times were requested,
    `time` [s] first; of a capture basin also `arrival` [s], the least time to the goal. Its
    attributes hold the problem, the method, and the error estimates: see `report`. stored: where
    the values are still in a file (`load`), of which `at`, `gradient`, `contains`, `least_time`,
    `slice` and laws read the chunks that they need; else None. claim: None of a file. games: what
    `sampled_value` has computed of the same values.
    """

    dataset: xr.Dataset
    grid: Grid
    stored: StoredTables | None = field(default=None, repr=False, compare=False)
    claim: Claim | None = field(default=None, repr=False, compare=False)
    games: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)

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
        return dataclasses.replace(self, dataset=dataset)

    def tried(self, promise: Tried) -> ValueFunction:
        """The same values with what a closed-loop validation came to in the report."""
        return self.reported(**recorded(promise))

    def in_memory(self) -> ValueFunction:
        """The same with all its numbers in memory; `SimulationError` where they do not fit."""
        if self.stored is None:
            return self
        self._check_room(self.dataset.nbytes)
        return dataclasses.replace(self, dataset=self.dataset.load(), stored=None)

    @property
    def names(self) -> tuple[str, ...]:
        """The states, in the order of the axes."""
        return tuple(a.name for a in self.grid.axes)

    @checked
    def values(self, time: float | None = None) -> Array:
        """The values at the nodes, at the end or at one of the requested times."""
        number = self._number(time)
        data = self.dataset["value"]
        data = data if number is None else data.isel(time=number)
        if self.stored is not None:
            self._check_room(data.size * data.dtype.itemsize)
        found: Array = data.values
        return found

    def highest(self, time: float | None = None) -> float:
        """The largest value at the nodes, at the end or at one of the requested times.

        Large files have it, so that nothing else of them is read.
        """
        if self.stored is None:
            return float(self.values(time).max())
        return self.stored.highest(self._number(time))

    @checked
    def at(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """V at states of shape (count, states), linear between nodes; NaN outside the grid.

        Raises `SimulationError` for a state that is not finite; so do `gradient` and `contains`.
        """
        points = self._points(states)
        return values_at(self.table(time), points, self._geometry())

    @checked
    def gradient(self, states: npt.ArrayLike, time: float | None = None) -> Array:
        """dV/dq at states of shape (count, states): central differences, interpolated."""
        points = self._points(states)
        return slopes_at(self.table(time), points, self._geometry())

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
        found, share = (values_at(t, points, geometry) for t in self._arrivals())
        known = (self.at(points) > 0) & (share > 0)
        return np.where(known, found / np.where(known, share, 1.0), np.nan)

    @checked
    def contains(
        self, states: npt.ArrayLike, margin: float = 0.0, time: float | None = None
    ) -> npt.NDArray[np.bool_]:
        """Whether V > margin, at the end or at one of the requested times; not outside the grid."""
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
        """The set eroded by its estimated error in cells; needs `estimate_error` of the march."""
        return inner(self)

    def certified(self, system: Any, region: Any, **options: Any) -> Any:
        """The part of the set that is proved, a certificate: `hf.certify` with this candidate."""
        from holdfast.analysis.certificates.certify import certify

        return certify(system, region, candidate=self, **options)

    def outer(self, system: Any, region: Any, **options: Any) -> Any:
        """Cells outside which a state is lost, or not reached, for sure: `hf.outer_set`."""
        from holdfast.analysis.certificates.outer_set import outer_set

        return outer_set(self, system, region, **options)

    def last(self) -> ValueFunction:
        """The value function at its last time only."""
        if "time" not in self.dataset["value"].dims:
            return self
        dataset = self.dataset.isel(time=-1, drop=True)
        if self.stored is None:
            return dataclasses.replace(self, dataset=dataset)
        self._check_room(self.dataset["value"].nbytes // self.dataset.sizes["time"])
        return dataclasses.replace(self, dataset=dataset.load(), stored=None)

    @checked
    def slice(self, **at: float) -> ValueFunction:
        """A slice of the value function at fixed values of some states, by linear interpolation."""
        axes, places = self.grid.axes, {}
        for name, value in at.items():
            axis = self._axis(name)
            number(f"{name} = ", value, "a finite number", np.isfinite)
            places[name] = between_nodes(axis, float(value))
            axes = tuple(a for a in axes if a.name != name)
        data = self.dataset["value"].isel({n: list(between) for n, (between, _) in places.items()})
        for name, (_, f) in places.items():
            near, far = (data.isel({name: j}, drop=True) for j in (0, -1))
            data = near if abs(f) < 1e-12 else (1 - f) * near + f * far
        return ValueFunction(data.to_dataset().assign_attrs(self.dataset.attrs), Grid(axes))

    @checked
    def projection(self, *names: str) -> ValueFunction:
        """The largest value over all other states: the projection of the set on the named ones."""
        for name in names:
            self._axis(name)
        rest = [a.name for a in self.grid.axes if a.name not in names]
        data = self.dataset["value"]
        data = (
            data.max(rest)
            if self.stored is None
            else stored_tables.largest_over(data, rest, self.stored)
        )
        axes = tuple(a for a in self.grid.axes if a.name in names)
        return ValueFunction(data.to_dataset().assign_attrs(self.dataset.attrs), Grid(axes))

    @checked
    def save(self, path: str | Path) -> Path:
        """Write NetCDF-4, compressed, atomically; `OutputError` if the folder cannot be written.
        Values of more than 65,536 numbers are in chunks of at most so many, and nothing of them is
        copied.
        """
        return write_values(self.dataset, path)

    def summary(self) -> dict[str, Any]:
        """The problem, the method and the error estimates, for summary.json."""
        return {k: v for k, v in self.dataset.attrs.items() if k != "scenario_text"} | {
            **self.report.told(),
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

    def table(self, time: float | None = None) -> AnyArray | TableInParts:
        """The values at the nodes in one row, for `execution.look_up`."""
        if self.stored is None:
            return np.ascontiguousarray(self.values(time)).ravel()
        return self.stored.table(self._number(time))

    def layers(self, time: float | None) -> Array | Layers:
        """The values at a time, by layer along the first axis and by places."""
        if self.stored is None:
            return self.values(time)
        return Layers(self.stored.values, self._number(time))

    def law_table(self, *, all_times: bool) -> AnyArray | TableInParts:
        """The values of all times, or of the last, in one row: a table of its own for a law."""
        if self.stored is not None:
            return self.stored.of_law(None if all_times else self._number(None))
        found = self.dataset["value"].values if all_times else self.values()
        return np.ascontiguousarray(found).ravel()

    def _arrivals(self) -> list[AnyArray | TableInParts]:
        """The times of arrival, 0 where there is none, and 1 where there is one."""
        if self.stored is not None and "arrival" in self.stored.arrays:
            return [self.stored.table(name="arrival", of=f) for f in ARRIVALS]
        arrival = self.dataset["arrival"].values
        return [f(arrival).ravel() for f in ARRIVALS]

    def _number(self, time: float | None) -> int | None:
        """Which of several times it is; None of a value function at one time."""
        data = self.dataset["value"]
        if "time" in data.dims:
            return data.sizes["time"] - 1 if time is None else number_of_time(data, time)
        if time is not None:
            raise SimulationError(
                "this value function is stored at its last time only",
                remedy="compute it with times=[...]",
            )
        return None

    def _check_room(self, size: int) -> None:
        check_memory(
            size,
            "the values of the kernel, which are needed as a whole here,",
            "take slices or states of it, or use a machine with more memory",
        )

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
    return ValueFunction(dataset_of(grid, values, report, times, arrival), grid)


def value_function(dataset: xr.Dataset, stored: StoredTables | None = None) -> ValueFunction:
    """A value function from its saved dataset; stored: its values, where they are in the file."""
    return ValueFunction(dataset, grid_of(dataset), stored)
