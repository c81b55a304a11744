"""Value functions (level-set functions) on a grid: V > 0 inside the set, 0 on its boundary.

A value is a dataset with names and units; it knows what its set claims, the share of the cells in
which it is positive, random nodes that satisfy a condition, and its inner set.

No scheme on a grid, of first or higher order, guarantees that a lost state is never called safe:
V is linear between nodes, and if it jumps at the boundary, the zero of the numerical jump may lie
on the wrong side, by more cells the finer the grid is. The error of the set is therefore estimated
in cells, from the boundaries alone, and the inner set is the set eroded by as many.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypedDict, Unpack

import numpy as np
import numpy.typing as npt
import xarray as xr

from holdfast.analysis.reachability import stored_values
from holdfast.analysis.reachability.grid import Axis, Grid, largest_change, number
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.stored_values import ARRIVALS, Layers, StoredTables
from holdfast.analysis.simulation.files import write_values
from holdfast.arguments import (
    Count,
    OfStates,
    RangesOfParameters,
    RangesOfStates,
    Seconds,
    checked,
)
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.arrays import Array as DoubleArray
from holdfast.execution.resources import check_memory
from holdfast.execution.table_in_parts import TableInParts, slopes_at, values_at
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.value import InNotebooks, Value

if TYPE_CHECKING:
    from holdfast.analysis.certificates.certificate import Certificate
    from holdfast.analysis.certificates.outer_set import OuterOptions, OuterSet
    from holdfast.maths.definitions.system import System


class CertifyOptions(TypedDict, total=False):
    """Those of `hf.certify`, but the candidate, of which they are options.

    They stand here, where they are read without loading what proves.
    """

    box: RangesOfStates | None
    cells: int | Mapping[str, int | Sequence[float]] | None
    sample_time: Seconds
    horizon: Seconds | None
    inputs: int | Mapping[str, int]
    uncertain: RangesOfParameters | None
    disturbance: Mapping[str, float] | None
    target: Region | None
    errors: OfStates | None
    delay: Seconds
    halvings: Count
    steps: int | None
    enclosure: str
    store: str | Path | None
    margin: float
    progress: Callable[[str, float], None] | None


@dataclass(frozen=True)
class Claim:
    """What the states of a set are said to be able to do: stay in `region`, or reach `goal`."""

    region: Region | None
    goal: Region | None = None


class Tried(Protocol):
    """A closed-loop validation, as `Promise`."""

    @property
    def outcome(self) -> str: ...

    @property
    def conclusion(self) -> str: ...

    @property
    def kept_share(self) -> float: ...


def recorded(promise: Tried) -> dict[str, Any]:
    """What a validation came to, as entries of the report."""
    return {
        "promise_outcome": promise.outcome,
        "promise_conclusion": promise.conclusion,
        "promise_share": promise.kept_share,
    }


Indices = npt.NDArray[np.intp]


class Places:
    """Nodes that satisfy a condition, counted slab by slab along the first axis.

    A list of all of them would take more memory than the value itself. holds(k): the condition at
    all nodes of the k-th slab.
    """

    def __init__(self, holds: Callable[[int], Any], shape: Sequence[int]) -> None:
        self._holds, self._shape = holds, tuple(shape)
        counts = [np.count_nonzero(holds(k)) for k in range(self._shape[0])]
        self._ends = np.cumsum(counts)

    def __len__(self) -> int:
        return int(self._ends[-1])

    def at(self, ranks: Indices) -> tuple[Indices, ...]:
        """The nodes of these ranks, as an index for every axis. ranks: shape (places,), as each
        index."""
        outer = np.searchsorted(self._ends, ranks, side="right")
        inner = np.empty(len(ranks), dtype=np.intp)
        for k in np.unique(outer):
            here = outer == k
            begins = self._ends[k - 1] if k else 0
            inner[here] = np.flatnonzero(self._holds(int(k)))[ranks[here] - begins]
        return (outer, *np.unravel_index(inner, self._shape[1:])) if self._shape[1:] else (outer,)


def dataset_of(
    grid: Grid,
    values: npt.NDArray[Any],
    report: Report,
    times: Sequence[float] | None,
    arrival: npt.NDArray[Any] | None,
) -> xr.Dataset:
    """The arrays with names and units; `values` of several times has time first. The shape is
    (times, nodes of the first axis, nodes of the second, and so on), arrival [s] without times."""
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
    times = data["time"].values
    k = int(np.argmin(np.abs(times - time)))
    if not abs(times[k] - time) <= 1e-9 * float(np.abs(times).max()):
        shown = ", ".join(f"{t:g}" for t in times)
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


TOGETHER = 1_000_000
"""The most nodes of a block evaluated at once, unless two axes alone have more."""


def share_inside(values: Array, periodic: Sequence[bool]) -> float:
    """The mean over all cells of the share of a cell in which the value is positive.

    A cell whose corners are all positive counts 1, one that has no positive corner 0. For the
    others let m be the mean of the corners and d_i the mean difference along axis i: the share is

        1/2 + m / sum_i |d_i|   within [0, 1]

    which is exact for a boundary normal to an axis, and correct on average over many cells for any
    other plane.

    values: shape (nodes of the first axis, nodes of the second, and so on).
    """
    outer = 0  # axes traversed cell by cell
    while outer < values.ndim - 1 and math.prod(values.shape[outer:]) * 2**outer > TOGETHER:
        outer += 1
    cells = [n if around else n - 1 for n, around in zip(values.shape, periodic, strict=True)]
    inside = 0.0
    for place in itertools.product(*(range(c) for c in cells[:outer])):
        block = values
        for axis, k in enumerate(place):
            if k + 1 < values.shape[axis]:  # a view: the block may be large
                block = block[(slice(None),) * axis + (slice(k, k + 2),)]
            else:
                block = block.take([k, 0], axis=axis)
        for axis in range(outer, values.ndim):
            if periodic[axis]:
                block = np.concatenate([block, block.take([0], axis=axis)], axis=axis)
        inside += _shares(block)
    return inside / math.prod(cells)


def _shares(corners: Array) -> float:
    mean = corners.astype(np.float64)
    some = every = corners > 0
    slopes: list[Array] = []
    for axis in range(corners.ndim):
        above, below = (_part(mean, axis, k) for k in (1, 0))
        slopes = [0.5 * (_part(s, axis, 1) + _part(s, axis, 0)) for s in slopes]
        slopes.append(above - below)
        mean = 0.5 * (above + below)
        some = _part(some, axis, 1) | _part(some, axis, 0)
        every = _part(every, axis, 1) & _part(every, axis, 0)
    cut = some & ~every
    swing = sum((np.abs(s[cut]) for s in slopes), start=np.zeros(int(cut.sum())))
    level = np.divide(mean[cut], swing, out=np.zeros_like(swing), where=swing > 0)
    return float(every.sum() + np.clip(0.5 + level, 0.0, 1.0).sum())


def _part(values: Array, axis: int, first: int) -> Array:
    """The upper (1) or lower (0) ends of all intervals along an axis."""
    count = values.shape[axis] - 1
    return values[(slice(None),) * axis + (slice(first, first + count),)]


MOST_CELLS = 20
"""A set with an error of more cells than this counts as unknown."""

MOST = 0.95
"""Part of the nodes beside the boundary; at a crease of V a single one may be off arbitrarily."""

STEEP, SHARE = 0.6, 0.05
"""V jumps where its change across the boundary, on cells of half the size, is more than this part
of what it was (half of it where V is smooth, all of it where it jumps), on this share of it."""

STEEPER = 4.0
"""V jumps where it changes over a cell by so many times the largest change of its start."""

ORDERS = {"upwind": 1, "eno2": 2, "eno3": 3, "weno5": 5}
"""Orders of the schemes where V is smooth."""

Truths = npt.NDArray[np.bool_]


def with_error_in_cells(value: ValueFunction, coarse: ValueFunction) -> ValueFunction:
    """`value`, on cells of size h, with the error of its boundary, from the set on cells of 2 h.

    The distance of the two boundaries is, in cells,

        d = max | r_h - r_2h |   over 95 % of the nodes beside either boundary

    (the nodes that have a neighbour on the other side of it), with r the distance of a node to the
    boundary, above 0 inside: the largest box around it (as many cells along every axis) that does
    not reach the boundary; V is linear between nodes. Where V is continuous at the boundary, a
    scheme that converges with order 1 or more has an error of at most d. A scheme of order p smears
    a jump over h^q, with q = p / (p + 1) (A. Harten, J. Comput. Phys. 83, 1989, for contact
    discontinuities): there the error is d / (2^q - 1), and up to one cell more, since V is linear
    across the jump.

    jumps: whether V jumps on a part of the boundary. error_reach: the error in whole cells, at
    least 1, by which `inner` erodes the set; 0 says that it is not known: `MOST_CELLS` are not
    enough, or a part of the set is disputed.
    boundary_error: the same along every axis, in its unit. error_cells is `error_reach` where V
    jumps: there the difference of two values says nothing about places.
    """
    periodic = [a.ends == "periodic" for a in value.grid.axes]
    fine, rough = value.values(), between(coarse.values(), periodic)
    jumps = _jumps(fine, coarse.values(), periodic)
    apart = _distance(fine, rough, periodic)
    if jumps:
        order = ORDERS[value.report.scheme]
        apart = apart / (2.0 ** (order / (order + 1)) - 1.0) + 1.0
    near = apart <= MOST_CELLS and not value.report.disputed_share  # both may be spread alike
    reach = max(1, math.ceil(apart)) if near else 0
    lengths = {a.name: reach * a.step for a in value.grid.axes} if reach else {}
    if jumps:
        value = value.reported(error_cells=float(reach) if reach else None)
    return value.reported(error_reach=reach, jumps=jumps, boundary_error=lengths)


def _distance(values: Array, other: Array, periodic: Sequence[bool]) -> float:
    """Of the boundaries of two sets, in cells; infinite where it is more than `MOST_CELLS`."""
    near = beside(values, periodic) | beside(other, periodic)
    apart = np.abs(_depths(values, periodic, near) - _depths(other, periodic, near))
    if not len(apart):
        return 0.0
    return float(np.quantile(np.nan_to_num(apart, nan=math.inf), MOST, method="higher"))


def _depths(values: Array, periodic: Sequence[bool], near: Truths) -> Array:
    """How many cells these nodes are inside, below 0 outside; NaN beyond `MOST_CELLS`."""
    depths = np.full(int(near.sum()), np.nan)
    low = high = values
    for cells in range(MOST_CELLS + 1):
        lower, higher = _spread(low, periodic, np.minimum), _spread(high, periodic, np.maximum)
        for side, inner, outer in ((1.0, low, lower), (-1.0, high, higher)):
            a, b = inner[near], outer[near]
            crossed = np.isnan(depths) & ((a > 0) != (b > 0))
            depths[crossed] = side * (cells + a[crossed] / (a[crossed] - b[crossed]))
        if not np.isnan(depths).any():
            break
        low, high = lower, higher
    return depths


def between(rough: Array, periodic: Sequence[bool]) -> Array:
    """Values on a grid at the nodes of one with half the cells, linear between its nodes. n nodes
    of an axis (nodes of the first, and so on) become 2 n - 1, or 2 n of a periodic one."""
    for i, around in enumerate(periodic):
        rows = np.moveaxis(rough, i, 0)
        after = np.roll(rows, -1, axis=0) if around else rows[1:]
        fine = np.empty((len(rows) + len(after), *rows.shape[1:]), dtype=rows.dtype)
        fine[::2], fine[1::2] = rows, (rows[: len(after)] + after) / 2
        rough = np.moveaxis(fine, 0, i)
    return rough


def beside(values: Array, periodic: Sequence[bool]) -> Truths:
    """The nodes that have one of the other side among themselves and their neighbours. Both have
    the shape (nodes of the first axis, nodes of the second, and so on)."""
    inside = values > 0
    other: Truths = _spread(inside, periodic, np.minimum) != _spread(inside, periodic, np.maximum)
    return other


def _jumps(fine: Array, rough: Array, periodic: Sequence[bool]) -> bool:
    """Whether V jumps on a part of the boundary.

    Looked at are the edges of the coarse grid that the boundary crosses, and the steeper of the two
    that each is made of on the fine one.
    """
    steep = crossed = 0
    thin = tuple(slice(None, None, 2) for _ in periodic)
    for i, around in enumerate(periodic):
        rows = np.moveaxis(fine[(*thin[:i], slice(None), *thin[i + 1 :])], i, 0)
        ends = np.moveaxis(rough, i, 0)
        if around:
            rows, ends = np.concatenate([rows, rows[:1]]), np.concatenate([ends, ends[:1]])
        changes = np.abs(np.diff(rows, axis=0))
        steeper = np.maximum(changes[::2], changes[1::2])
        whole = np.abs(np.diff(ends, axis=0))
        across = (ends[1:] > 0) != (ends[:-1] > 0)
        steep += int((steeper > STEEP * whole)[across].sum())
        crossed += int(across.sum())
    return steep > SHARE * crossed


def steeper_than_its_start(value: ValueFunction) -> bool:
    """Whether V jumps, as one grid shows it: it changes over a cell by far more than its start."""
    return largest_change(value.values()) > STEEPER * value.report.cell > 0


def inner(value: ValueFunction) -> ValueFunction:
    """The value function of the set of `value`, eroded by `error_reach` cells on all sides."""
    cells = value.report.error_reach
    if cells is None:
        raise SimulationError(
            "an inner set of a value function without an estimate of its error",
            remedy="compute it with estimate_error=True",
        )
    if not cells:
        raise SimulationError(
            f"the estimated error of the set exceeds {MOST_CELLS} cells"
            if not value.report.disputed_share
            else "an inner set of one that is disputed",
            remedy="take a finer grid",
        )
    data = value.dataset["value"]
    periodic = [a.ends == "periodic" for a in value.grid.axes]
    numbers = data.values
    if "time" in data.dims:
        worn = np.stack([_worn(one, periodic, cells) for one in numbers])
    else:
        worn = _worn(numbers, periodic, cells)
    last = worn[-1] if "time" in data.dims else worn
    dataset = value.dataset.assign(value=data.copy(data=worn))
    dataset = dataset.drop_vars([n for n in ("arrival", "outside") if n in dataset])
    worn_value = replace(value, dataset=dataset)
    return worn_value.reported(
        inner_cells=cells,
        empty=not float(last.max()) > 0,
        promise_outcome=None,
        promise_conclusion=None,
        promise_share=None,
    )


def _worn(numbers: Array, periodic: Sequence[bool], cells: int) -> Array:
    for _ in range(cells):
        numbers = _spread(numbers, periodic, np.minimum)
    return numbers


def _spread(numbers: Array, periodic: Sequence[bool], choose: Any) -> Array:
    """The least, or the largest, over every node and its neighbours, including diagonal ones."""
    for i, around in enumerate(periodic):
        rows = np.moveaxis(numbers, i, 0)
        above, below = np.roll(rows, -1, axis=0), np.roll(rows, 1, axis=0)
        if not around:
            above[-1], below[0] = rows[-1], rows[0]
        numbers = np.moveaxis(choose(rows, choose(above, below)), 0, i)
    return numbers


@dataclass(frozen=True, eq=False, repr=False)
class ValueFunction(Value, InNotebooks):
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

    def __repr__(self) -> str:
        nodes = " x ".join(str(a.count) for a in self.grid.axes)
        names = ", ".join(a.state.name for a in self.grid.axes)
        attributes = self.dataset.attrs
        of = f"{attributes.get('region', '')}, {attributes.get('system', '')}"
        return f"<{attributes.get('kind', 'value function')} of {of}: {nodes} nodes over {names}>"

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
    def values(self, time: float | None = None) -> DoubleArray:
        """The values at the nodes, at the end or at one of the requested times. The shape is (nodes
        of the first axis, nodes of the second, and so on)."""
        number = self._number(time)
        data = self.dataset["value"]
        data = data if number is None else data.isel(time=number)
        if self.stored is not None:
            self._check_room(data.size * data.dtype.itemsize)
        table: DoubleArray = data.values
        return table

    def highest(self, time: float | None = None) -> float:
        """The largest value at the nodes, at the end or at one of the requested times.

        Large files have it, so that nothing else of them is read.
        """
        if self.stored is None:
            return float(self.values(time).max())
        return self.stored.highest(self._number(time))

    @checked
    def at(self, states: npt.ArrayLike, time: float | None = None) -> DoubleArray:
        """V at states of shape (count, states), linear between nodes; NaN outside the grid.

        Raises `SimulationError` for a state that is not finite; so do `gradient` and `contains`.
        """
        points = self._points(states)
        return values_at(self.table(time), points, self._geometry())

    @checked
    def gradient(self, states: npt.ArrayLike, time: float | None = None) -> DoubleArray:
        """dV/dq at states of shape (count, states): central differences, interpolated."""
        points = self._points(states)
        return slopes_at(self.table(time), points, self._geometry())

    @checked
    def least_time(self, states: npt.ArrayLike) -> DoubleArray:
        """The least time [s] to the goal from states of shape (count, states), of a capture basin.

        Linear between the nodes that reach the goal. NaN where the goal is not reached within the
        horizon whatever the inputs are (V <= 0), and outside the grid, where nothing is known.
        `least_time_law` arrives in this time. Where T jumps, as beside a path that just misses the
        goal, a state within a cell of the jump may be on its other side.

        Raises `SimulationError` for a value function without times of arrival.
        """
        self.check_times()
        points, geometry = self._points(states), self._geometry()
        weighted, share = (values_at(t, points, geometry) for t in self._arrivals())
        reached = (self.at(points) > 0) & (share > 0)
        return np.where(reached, weighted / np.where(reached, share, 1.0), np.nan)

    def check_times(self) -> None:
        """Refuse a value function without times of arrival."""
        if "arrival" not in self.dataset:
            raise SimulationError(
                "this value function has no least times",
                expected="a capture basin of a problem that does not depend on time, computed with "
                "arrival_steps above 0",
            )

    @checked
    def contains(
        self, states: npt.ArrayLike, margin: float = 0.0, time: float | None = None
    ) -> npt.NDArray[np.bool_]:
        """Whether V > margin, at the end or at one of the requested times; not outside the grid.
        states: shape (count, states). The answers have the shape (count,)."""
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
        intervals = {}
        for i, axis in enumerate(self.grid.axes):
            best = table.max(axis=tuple(k for k in range(table.ndim) if k != i))
            inside = np.flatnonzero(best > 0)
            if not len(inside):
                intervals[axis.name] = (math.nan, math.nan)
                continue
            ends = []
            for at, out in ((int(inside[0]), -1), (int(inside[-1]), 1)):
                place = float(at)
                if 0 <= at + out < axis.count:
                    place += out * float(best[at] / (best[at] - best[at + out]))
                ends.append(axis.low + axis.step * place)
            intervals[axis.name] = (ends[0], ends[1])
        return intervals

    def inner(self) -> ValueFunction:
        """The set eroded by its estimated error in cells; needs `estimate_error` of the march."""
        return inner(self)

    def certified(
        self, system: System, region: Region, **options: Unpack[CertifyOptions]
    ) -> Certificate:
        """The part of the set that is proved, a certificate: `hf.certify` with this candidate."""
        from holdfast.analysis.certificates.certify import certify

        return certify(system, region, candidate=self, **options)

    def outer(
        self, system: System, region: Region | None, **options: Unpack[OuterOptions]
    ) -> OuterSet:
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
            else stored_values.largest_over(data, rest, self.stored)
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

    def _points(self, states: npt.ArrayLike) -> DoubleArray:
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
        """The values at the nodes in one row, for `execution.interpolate`, shape (nodes,)."""
        if self.stored is None:
            return np.ascontiguousarray(self.values(time)).ravel()
        return self.stored.table(self._number(time))

    def layers(self, time: float | None) -> DoubleArray | Layers:
        """The values at a time, by layer along the first axis and by places. The shape is (nodes of
        the first axis, nodes of the second, and so on)."""
        if self.stored is None:
            return self.values(time)
        return Layers(self.stored.values, self._number(time))

    def law_table(self, *, all_times: bool) -> AnyArray | TableInParts:
        """The values of all times, or of the last, in one row: a table of its own for a law. The
        shape is (times * nodes,), or (nodes,) of the last."""
        if self.stored is not None:
            return self.stored.of_law(None if all_times else self._number(None))
        table = self.dataset["value"].values if all_times else self.values()
        return np.ascontiguousarray(table).ravel()

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
    """The dataset of the arrays with names and units; `values` of several times has time first. As
    `dataset_of`: (times, nodes of the first axis, nodes of the second, and so on)."""
    return ValueFunction(dataset_of(grid, values, report, times, arrival), grid)


def value_function(dataset: xr.Dataset, stored: StoredTables | None = None) -> ValueFunction:
    """A value function from its saved dataset; stored: its values, where they are in the file."""
    return ValueFunction(dataset, grid_of(dataset), stored)
