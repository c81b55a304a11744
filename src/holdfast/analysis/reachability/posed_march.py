"""The march of a posed problem on this machine: values, their obstacles and records, stages.

Initial values, and the obstacles below and above the value:

    a region to be kept      W <= l_K                   start l_K
    one to be reached        l_T <= W                   start l_T
    reached within another   l_G <= W, then W <= l_K    start the lesser

If the sign of dW/dtau is restricted, one of them holds automatically. With d the distance to the
open ends of the grid, leaving the grid counts as lost with W <= d, and as won with l_K or -d <= W.

Near the boundary of the set a grid may be finer: its nodes are marched everywhere, those of one
with cells `refine` times shorter in blocks around the boundary
(`execution/level_set/refined_march.py`). The result is the value at all nodes of the finer grid,
outside the blocks linear between nodes of the coarser one.

The values may be those of some planes of the grid: a part of a march that is divided
(`divided_march.py`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.checkpoint import Written, read_parts, readable, write_part
from holdfast.analysis.reachability.grid import Axis, Grid, largest_change
from holdfast.analysis.reachability.problem import ON_END, Ends, Posed, check_inside, touched
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.device.program import device_named
from holdfast.execution.level_set.device_sweeping import DeviceSweeping
from holdfast.execution.level_set.march import ALL, Advances, Done, March, OverGrid, over_grid
from holdfast.execution.level_set.refined_march import STRETCH, RefinedMarch, RefinedSweeping
from holdfast.execution.level_set.sweeping import (
    Planes,
    Sweeping,
    Within,
    layout,
    on_one_side,
)
from holdfast.execution.resources import Disk, Memory, Room, available_cores
from holdfast.maths.games.hamiltonian import Hamiltonian, hamiltonian


@dataclass(frozen=True)
class Facts:
    """What is known of the start value. nan: whether it is somewhere; inside: whether a node is in
    the set; ends: the ends of the grid that the set touches; cell: the largest change from node to
    node; highest: the largest value; deepest: the largest magnitude."""

    nan: bool
    inside: bool
    ends: Ends
    cell: float
    highest: float
    deepest: float


NOTHING = Facts(False, True, frozenset(), 0.0, -math.inf, 0.0)
"""Facts of a start value at no node; that a node is in the set has been found before."""

WIDER = 1.0 / 15.0
"""Share of an axis for which the margin is taken to fall beyond its ends. With a few cells in its
place finer grids would keep too much where constraints meet; without end all would too little."""

NODES_RENEWED_AT_ONCE = 1 << 20
"""Nodes at which moving bounds are renewed together."""


def merged(parts: Sequence[Facts]) -> Facts:
    """Of the whole grid, from those of its parts."""
    return Facts(
        any(f.nan for f in parts),
        any(f.inside for f in parts),
        frozenset().union(*(f.ends for f in parts)),
        max(f.cell for f in parts),
        max(f.highest for f in parts),
        max(f.deepest for f in parts),
    )


def check_start(posed: Posed, facts: Facts) -> None:
    """Refuse a start value that no march can begin with."""
    if facts.nan:
        raise SimulationError(
            "the constraints of a region are NaN at some nodes of the grid",
            remedy="take an interval on which its inequalities are defined",
        )
    check_inside(posed, facts.ends)
    if not facts.inside:
        raise SimulationError(
            f"no node of the grid is in region '{posed.problem.start.name}'",
            remedy="take a finer grid",
        )


class Obstacles:
    """start, lower, upper: values at every node of some planes of the grid, shape (nodes,), at the
    beginning of the march; if they depend on time, `refresh` writes those of a time into lower and
    upper.

    highest: bound of all values at them, without the halo. room: of a count an array (count,).
    """

    def __init__(self, posed: Posed, planes: Planes, room: Callable[[int], Array]) -> None:
        grid = posed.grid
        self.posed, self.planes, self._empty = posed, planes, room
        self.room: Array | None = None
        axes = [grid.axes[0].nodes[planes.nodes], *(a.nodes for a in grid.axes[1:])]
        self.shape = tuple(len(a) for a in axes)
        self.margins = [
            over_grid(
                region.margin,
                [a.state.symbol for a in grid.axes],
                posed.parameters,
                axes,
                band=posed.marching.band,
                precision=posed.marching.precision,
                room=room,
            )
            for region in posed.problem.regions
        ]
        self._begin_at(posed.clock[0])

    def facts(self) -> Facts:
        start = self.start.reshape(self.shape)
        inner = self.planes.own
        mine = start[inner]
        before = inner.start - (not self.planes.ends[0])  # the change from the part before it, too
        return Facts(
            bool(np.isnan(mine.min())),
            any((plane > 0).any() for plane in mine),
            touched(mine, self.planes.ends),
            largest_change(start[before : inner.stop]),
            float(mine.max()),
            float(max(mine.max(), -mine.min())),
        )

    def begin(self, facts: Facts) -> Facts:
        """Where leaving the grid counts, as for the whole grid: what is known of the new start."""
        posed = self.posed
        if posed.beyond:
            self.room = self._room_inside(open_ends(posed, facts.ends), facts.cell)
            self._begin_at(posed.clock[0])
            facts = replace(self.facts(), cell=facts.cell)
        self.highest = facts.highest
        return facts

    def falls(self, highest: float) -> Array:
        """How steeply the margin falls beyond the lower and the upper end of every axis, at most
        [its unit per unit of the state], over nodes that are lost, and down to what: a row of each
        axis, shape (axes, 4).

        So the value falls beyond an end (`stencils.py`) as on a grid that is wider by `WIDER`.
        highest: the highest start value, as far below zero as which it falls at most.
        """
        posed, values = self.posed, self.start.reshape(self.shape)
        ends = np.tile((0.0, 0.0, -math.inf, -math.inf), (len(self.shape), 1))
        if posed.problem.limit != "shrink":
            return ends
        first, *others = posed.grid.axes
        symbols = [a.state.symbol for a in posed.grid.axes]
        axes = [first.nodes[self.planes.nodes], *(a.nodes for a in others)]
        for (i, axis), side in itertools.product(enumerate(posed.grid.axes), (0, 1)):
            if axis.ends != "contained" or (i == 0 and not self.planes.ends[side]):
                continue
            place = (self.planes.own.start, self.planes.own.stop - 1)[side] if i == 0 else -side
            edge = np.take(values, place, axis=i)
            further = (axis.low - axis.step, axis.high + axis.step)[side]
            beyond = over_grid(
                posed.problem.regions[0].margin, symbols, posed.parameters,
                [np.array([further]) if k == i else nodes for k, nodes in enumerate(axes)],
                band=posed.marching.band,
            )(posed.clock[0]).reshape(edge.shape)  # fmt: skip
            fall = edge - np.maximum(beyond, -highest)  # of NaN no node is lost
            lost = edge <= ON_END * fall
            steepest = np.max(fall, initial=0.0, where=lost) / axis.step
            depth = WIDER * (axis.high - axis.low) * steepest
            lowest = np.max(edge, initial=-math.inf, where=lost) - depth
            ends[i, [side, 2 + side]] = steepest, lowest
        return ends

    def refresh(self, time: float) -> None:
        planes = self.shape[0]
        block = max(1, NODES_RENEWED_AT_ONCE * planes // len(self.start))
        self.check([self.renew(time, k, min(k + block, planes)) for k in range(0, planes, block)])

    def renew(self, time: float, first: int, last: int) -> Facts:
        """Bounds of a time at some places of the first axis; what is known of the start there."""
        plane = len(self.start) // self.shape[0]
        nodes = slice(first * plane, last * plane)
        start, lower, upper = self._at(time, nodes)
        for bound, new in ((self.lower, lower), (self.upper, upper)):
            if bound is not None and new is not None:
                bound[nodes] = new
        inner = self.planes.own
        low, high = max(inner.start, first), min(inner.stop, last)
        if low >= high:
            return NOTHING
        mine = start.reshape(last - first, *self.shape[1:])[low - first : high - first]
        at_first, at_last = self.planes.ends
        ends = touched(mine, (at_first and low == inner.start, at_last and high == inner.stop))
        return replace(
            NOTHING, nan=bool(np.isnan(mine.min())), ends=ends, highest=float(mine.max())
        )

    def check(self, parts: Sequence[Facts]) -> None:
        """Refuse bounds, renewed at all places, of a start that no march can go on with."""
        facts = merged(parts)
        check_start(self.posed, facts)
        self.highest = max(self.highest, facts.highest)

    def _begin_at(self, time: float) -> None:
        start, self.lower, self.upper = self._at(time)
        self.start = start
        if start is self.lower or start is self.upper:  # the march overwrites it in place
            self.start = self._empty(len(start))
            self.start[:] = start

    def _at(self, time: float, of: slice = ALL) -> tuple[Array, Array | None, Array | None]:
        """The initial value and the obstacles at a time, at all nodes or at some."""
        posed, room = self.posed, None if self.room is None else self.room[of]
        first, *others = (margin(time, of) for margin in self.margins)
        shrinks = posed.problem.limit == "shrink"
        lower = None if shrinks else first
        upper: Array | None = first if shrinks else (others[0] if others else None)
        if posed.beyond == "lost" and room is not None:
            upper = room if upper is None else np.minimum(upper, room, out=self._empty(len(room)))
        elif posed.beyond == "won" and room is not None:
            lower = np.negative(room, out=self._empty(len(room)))
            (np.minimum if shrinks else np.maximum)(first, lower, out=lower)
        start = upper if shrinks or lower is None else lower
        assert start is not None
        if upper is not None and upper is not start:
            start = np.minimum(start, upper, out=self._empty(len(start)) if of is ALL else None)
        lower = None if posed.limit == "grow" or posed.problem.limit == "exact" else lower
        upper = None if posed.limit == "shrink" else upper
        return start, lower, upper

    def _room_inside(self, ends: Sequence[tuple[int, int]], cell: float) -> Array:
        """The distance to the nearest open end, less half a cell, as steep as the start value."""
        shape, band = self.posed.grid.shape, self.posed.marching.band
        kind = self.start.dtype
        room = self._empty(len(self.start)).reshape(self.shape)
        room[:] = min(band, float(max(shape)) * cell)
        for i, end in ends:
            places = np.arange(shape[i], dtype=kind)
            places = places if end == 0 else places[::-1]
            places = places[self.planes.nodes] if i == 0 else places
            line = np.maximum((places - 0.5) * cell, -band).astype(kind)
            rows = line.reshape([-1 if k == i else 1 for k in range(len(shape))])
            np.minimum(room, rows, out=room)
        return room.ravel()


def open_ends(posed: Posed, reached: Ends) -> list[tuple[int, int]]:
    """The ends of the grid beyond which the value is extrapolated: the axis, and 0 or -1.

    If the set only shrinks, ends that it does not reach initially are left out.
    """
    return [
        (i, end)
        for i, axis in enumerate(posed.grid.axes)
        if axis.ends in ("contained", "extrapolated")
        for end in (0, -1)
        if posed.limit != "shrink" or (i, end) in reached
    ]


NODES_LOOKED_AT_AT_ONCE = 1 << 20
"""Nodes that are looked at together, to save memory."""


class Record:
    """Filled at every one of `stops` [s]; `arrays` and `restore` carry it over an interruption.

    first: the start value at the nodes of the record, shape (nodes,). at_times, arrival: arrays of
    this shape.
    """

    def __init__(self, posed: Posed, first: Array, room: Room) -> None:
        self.posed, self._room = posed, room
        self.at_times: dict[float, Array] = {}
        self.arrival: Array | None = None
        self.then = 0.0
        if posed.arrival_steps:
            self.arrival = room.empty(len(first), np.float64)
            for part in _pieces(len(first)):
                self.arrival[part] = np.where(first[part] > 0, 0.0, math.nan)
            self.before = room.copy(first)
        self.keep(0.0, first)

    def keep(self, time: float, values: Array) -> None:
        """Take down the values of a time [s], shape (nodes,)."""
        if self.posed.several and time in self.posed.asked:
            self.at_times[time] = self._room.copy(values)
        if self.arrival is not None and time > self.then:
            for part in _pieces(len(values)):
                now, was, arrival = values[part], self.before[part], self.arrival[part]
                new = (now > 0) & np.isnan(arrival)
                share = -was[new] / (now[new] - was[new])
                arrival[new] = self.then + share * (time - self.then)
            self.before[:] = values
            self.then = time

    def arrays(self) -> dict[str, Array]:
        """All that is kept so far, each of shape (nodes,)."""
        records: dict[str, Array] = {named(t): v for t, v in self.at_times.items()}
        if self.arrival is not None:
            records |= {"arrival": self.arrival, "before": self.before}
        return records

    def restore(self, saved: Callable[[str], Any | None], nodes: slice, then: float) -> None:
        """saved: what was kept, over the grid, by name; nodes: those of this record."""
        for time in self.posed.asked:
            if (values := saved(named(time))) is not None:
                count, kind = nodes.stop - nodes.start, self.posed.marching.precision
                self.at_times[time] = self._room.empty(count, kind)
                _fill(self.at_times[time], values, nodes)
        if self.arrival is not None:
            for name, array in (("arrival", self.arrival), ("before", self.before)):
                values = saved(name)
                assert values is not None
                _fill(array, values, nodes)
            self.then = then


def stops(posed: Posed) -> list[float]:
    """The times [s] at which a march is recorded."""
    if not posed.arrival_steps:
        return sorted(posed.asked)
    steps = np.linspace(0, posed.horizon, posed.arrival_steps + 1)[1:]
    close = 1e-9 * posed.horizon  # the same time but for rounding
    new = [float(t) for t in steps if min(abs(t - s) for s in posed.asked) > close]
    return sorted([*posed.asked, *new])


def named(time: float) -> str:
    """What the values of a time are called among the arrays of a record."""
    return f"at_{time!r}"


def _fill(array: Array, values: Any, nodes: slice) -> None:
    """With these of the values, some at a time."""
    for part in _pieces(len(array)):
        stop = min(nodes.start + part.stop, nodes.stop)
        array[part] = values[nodes.start + part.start : stop]


def _pieces(count: int) -> list[slice]:
    return [slice(k, k + NODES_LOOKED_AT_AT_ONCE) for k in range(0, count, NODES_LOOKED_AT_AT_ONCE)]


LEEWAY = 0.08, 5.0, 6.0
"""Of a filtered march (`stage_leaf.py`): the largest share of the largest rate of the start value
by which rates may be apart, the same times the cells of an axis, and how much a kink within a cell
counts beside a curvature that changes the slope as much."""

RATE_TIMES = 9
"""Times at which the rates of a problem that depends on time are looked at."""


@dataclass(frozen=True)
class StartFacts:
    """Of a start value, for `March`. rate: how fast it changes at most [its unit per second], where
    the march is filtered; falls: how it falls beyond the ends of every axis, shape (axes, 4)."""

    rate: float = math.inf
    falls: Array | None = None


def march_of(
    posed: Posed,
    h: Hamiltonian,
    grid: Grid,
    *,
    planes: Planes | None = None,
    threads: int = 1,
    cut: tuple[int, int, int, int] | None = None,
    start: StartFacts = StartFacts(),
    fastest: Callable[[Sequence[float]], tuple[Array, float]] | None = None,
) -> March:
    """The march of a problem over a grid, or over some planes of it; cut, fastest: of `March`, of
    which `fastest` gives speeds of the shape (axes,)."""
    marching = posed.marching
    axes, kinds = [a.nodes for a in grid.axes], [a.ends for a in grid.axes]
    if planes is not None and not planes.whole:
        axes[0] = axes[0][planes.nodes]
        kinds[0] = "extrapolated" if kinds[0] == "periodic" else kinds[0]
        cut = _cut(grid.shape, len(planes.nodes))
    return March(
        h,
        posed.parameters,
        axes,
        [a.step for a in grid.axes],
        kinds,
        method=posed.method,
        filtered=posed.filtered,
        leeway=leeway_on(grid),
        limit=posed.limit,
        clock=posed.clock,
        reflected=None if planes is None else reflected(posed, planes),
        precision=marching.precision,
        threads=threads,
        device=None if marching.device == "cpu" else device_named(marching.device),
        cut=cut,
        fastest=fastest,
        start_rate=start.rate,
        falls=start.falls,
    )


def leeway_on(grid: Grid) -> tuple[float, float]:
    """The share and the weight of a kink, of `March`."""
    cells = 1.0 / float(np.mean([1.0 / (a.count - 1) for a in grid.axes]))
    most, times_cells, kink = LEEWAY
    return min(most, times_cells / cells), kink


def _cut(shape: Sequence[int], nodes: int) -> tuple[int, int, int, int]:
    """The units of a part of so many nodes along the first axis: those of the grid."""
    many, groups, stretches, longest = layout(shape)
    if len(shape) == 1:
        return many, groups, -(-nodes // longest), longest
    if len(shape) == 2:
        return many, -(-nodes // many), stretches, longest
    return many, groups, stretches, longest


def reflected(posed: Posed, planes: Planes) -> list[npt.NDArray[np.int64]] | None:
    """The place of every node's reflection along each axis, where there is a symmetry: of each the
    shape (nodes of the axis,)."""
    signs = posed.marching.symmetry
    if signs is None:
        return None
    places = [
        a.reflected if signs.get(a.name) == -1 else np.arange(a.count, dtype=np.int64)
        for a in posed.grid.axes
    ]
    if not planes.whole:
        places[0] = np.arange(len(planes.nodes))
    return places


def start_rate(posed: Posed, h: Hamiltonian, planes: Planes, start: npt.NDArray[Any]) -> float:
    """The largest rate of change of the start value [its unit per second] in these planes.

        max over nodes of   sum_i c_i |dV/dx_i|

    with the largest speeds c_i at the node and the flatter of the slopes at both sides of it, at
    the nodes in the set or next to it. No value that begins with this one changes faster, where
    nothing depends on time. Of what does, the rates of `RATE_TIMES` times count. start: shape
    (nodes,) of all planes that are held, the halo included.
    """
    grid = posed.grid
    axes = [grid.axes[0].nodes[planes.nodes], *(a.nodes for a in grid.axes[1:])]
    symbols = [a.state.symbol for a in grid.axes]
    speeds = OverGrid(h.speeds, symbols, posed.parameters, axes)
    first, pace = posed.clock
    many = RATE_TIMES if posed.varies else 1
    times = [first + pace * posed.horizon * k / max(many - 1, 1) for k in range(many)]
    values = start.reshape([len(a) for a in axes])
    plane, largest = values[0].size, 0.0
    for k in range(planes.own.start, planes.own.stop):
        near = values[max(k - 1, 0) : k + 2]
        slopes, inside = _slopes_of_plane(near, k - max(k - 1, 0), [a.step for a in grid.axes])
        for time in times:
            for nodes, fastest in speeds.parts(time, slice(k * plane, (k + 1) * plane)):
                here = slice(nodes.start - k * plane, nodes.stop - k * plane)
                rate = (fastest * slopes[:, here]).sum(axis=0)[inside[here]]
                largest = max(largest, float(rate.max(initial=0.0)))
    return largest


def _slopes_of_plane(
    values: npt.NDArray[Any], k: int, steps: Sequence[float]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Of the nodes of a plane among its neighbours: the flatter of the slopes at both sides along
    every axis, flat, and whether a node is in the set or next to it."""
    plane = values[k]
    around = [values[j] if 0 <= j < len(values) else None for j in (k - 1, k + 1)]
    inside, slopes = plane > 0, np.zeros((len(steps), *plane.shape))
    for other in (v for v in around if v is not None):
        inside = inside | (other > 0)
    slopes[0] = _flatter([None if v is None else np.abs(plane - v) / steps[0] for v in around])
    positive = plane > 0
    for i in range(1, len(steps)):
        rows, to = np.moveaxis(plane, i - 1, 0), np.moveaxis(slopes[i], i - 1, 0)
        change = np.abs(np.diff(rows, axis=0)) / steps[i]
        to[1:-1] = np.minimum(change[1:], change[:-1])
        to[0], to[-1] = change[0], change[-1]
        near, of = np.moveaxis(inside, i - 1, 0), np.moveaxis(positive, i - 1, 0)
        near[1:] |= of[:-1]
        near[:-1] |= of[1:]
    return slopes.reshape(len(steps), -1), inside.ravel()


def _flatter(sides: Sequence[npt.NDArray[Any] | None]) -> npt.NDArray[Any] | float:
    there = [s for s in sides if s is not None]
    return np.minimum(*there) if len(there) == 2 else there[0] if there else 0.0


def finer(grid: Grid, refine: int) -> Grid:
    """The grid with cells so many times shorter along every axis."""

    def divided(axis: Axis) -> Axis:
        last = axis.ends != "periodic"
        return replace(axis, count=refine * (axis.count - last) + last)

    return Grid(tuple(divided(a) for a in grid.axes))


def on_finer_grid(posed: Posed) -> Posed:
    """The same problem on the grid of its answer."""
    return replace(posed, grid=finer(posed.grid, posed.marching.refine))


def check_refined(posed: Posed) -> None:
    """Refuse a refined march of a problem that depends on time."""
    if posed.marching.refine > 1 and posed.varies:
        raise SimulationError(
            "refine where a rate or a region depends on time: the boundary may then be anywhere",
            expected="a problem that does not depend on time",
            remedy="leave out refine, and take more nodes",
        )


def refined_march(
    posed: Posed, base: Grid, h: Hamiltonian, threads: int, start: StartFacts
) -> RefinedMarch:
    """The march of a problem; base: the grid that it is refined from."""

    def of(grid: Grid, stretch: int | None) -> March:
        rows = grid.shape[-2] if len(grid.axes) > 1 else 1
        cut = None if stretch is None else (1, rows, -(-grid.shape[-1] // stretch), stretch)
        return march_of(posed, h, grid, threads=threads, cut=cut, start=start)

    between = [2**k for k in range(1, posed.marching.refine.bit_length())]
    marches = [of(base, None), *(of(finer(base, k), STRETCH) for k in between)]
    periodic = [a.ends == "periodic" for a in base.axes]
    return RefinedMarch(marches, periodic, side=1.0 if posed.limit == "shrink" else -1.0)


def hamiltonian_of(posed: Posed) -> Hamiltonian:
    return hamiltonian(
        posed.system,
        inputs=posed.problem.inputs,
        disturbances=posed.problem.disturbances,
        samples=posed.marching.samples,
    )


def room_of(posed: Posed) -> Room:
    """Where the arrays of a march are."""
    folder = posed.marching.on_disk
    return Memory() if folder is None else Disk(Path(folder))


class PosedMarch:
    """The values at some planes of the grid, and the march that changes them, on this machine.

    To be used in a `with` statement, in which the stages are carried out.
    """

    divided = False
    march: March | RefinedMarch
    start: Facts
    """What is known of the start value."""

    def __init__(self, posed: Posed, h: Hamiltonian, planes: Planes, room: Room) -> None:
        self.posed, self.planes, self._h, self._room = posed, planes, h, room
        kind = posed.marching.precision  # no method: the arrays would stay until a collection
        self._obstacles = Obstacles(posed, planes, lambda count: room.empty(count, kind))
        self._sweeping: Sweeping | DeviceSweeping | RefinedSweeping | None = None

    def facts(self) -> Facts:
        """What is known of the start value at its own planes."""
        return self._obstacles.facts()

    def start_rate(self) -> float:
        """The largest rate of change of the start value [its unit per second] there."""
        return start_rate(self.posed, self._h, self.planes, self._obstacles.start)

    def falls(self, highest: float) -> Array:
        """How the start value falls beyond the ends of the grid, of `March`, shape (axes, 4).

        highest: the highest start value, as far below zero as which it falls at most.
        """
        return self._obstacles.falls(highest)

    def start_with(
        self, facts: Facts, march: March | RefinedMarch, least: Array | None = None
    ) -> Facts:
        """The start value, from what is known of it over the grid; what is known of it here.

        least: values that it begins with where they are less, at all nodes of the grid, shape
        (nodes,), or that of the grid.
        """
        obstacles, posed = self._obstacles, self.posed
        self.start = obstacles.begin(facts)
        if least is not None:
            planes = least.reshape(posed.grid.axes[0].count, -1)[self.planes.nodes]
            np.minimum(obstacles.start, planes.ravel(), out=obstacles.start)
            self.start = replace(self.start, deepest=obstacles.facts().deepest)
        self.march, self._values = march, obstacles.start
        self.record = Record(posed, self._mine(self._values), self._room)
        return self.start

    def code(self) -> str:
        return self.march.name

    def __enter__(self) -> PosedMarch:
        sweeping, self._advances = self._swept()
        self._sweeping = sweeping.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        """After an error the values may be those of no time."""
        sweeping, self._sweeping = self._sweeping, None
        if sweeping is not None:
            sweeping.__exit__(kind, error, at)

    def _swept(self) -> tuple[Sweeping | DeviceSweeping | RefinedSweeping, Advances]:
        """What carries out the stages."""
        upper, lower = self._obstacles.upper, self._obstacles.lower
        return self.march.sweeping(self._values, upper, lower, self._room, self._moving)

    @property
    def _moving(self) -> Obstacles | None:
        moves = any(r.moves for r in self.posed.problem.regions)
        return self._obstacles if moves else None

    def advances(
        self, times: Sequence[float], within: Within, done: Done
    ) -> Iterator[float | None]:
        """As `Advances`."""
        return self._advances(times, within, done)

    @property
    def _plane(self) -> int:
        """Nodes at a place of the first axis."""
        return len(self._obstacles.start) // len(self.planes.nodes)

    def _all(self) -> Array:
        """The values, between two steps; they change with the next."""
        return self._values if self._sweeping is None else self._sweeping.values()

    def _mine(self, values: Array) -> Array:
        inner = self.planes.own
        return values[inner.start * self._plane : inner.stop * self._plane]

    def now(self) -> Array:
        """Those at its own nodes, shape (own nodes,)."""
        return self._mine(self._all())

    def keep(self, time: float) -> None:
        """Take down the values of a time [s] marched."""
        self.record.keep(time, self.now())

    def largest(self) -> float:
        if self._sweeping is not None:
            return self._sweeping.largest()
        return float(self.now().max())

    def highest(self) -> float:
        """Bound of all values so far."""
        return self._obstacles.highest

    def on_one_side(self, limit: str) -> bool:
        """Whether nothing is left of a set that shrinks, or nothing is left for one that grows."""
        if self._sweeping is not None:
            return self._sweeping.on_one_side(limit)
        return on_one_side(self.now(), limit)

    def ends(self) -> Ends:
        """The ends of the grid that the set touches."""
        return touched(
            self._all().reshape(self._obstacles.shape)[self.planes.own], self.planes.ends
        )

    def held(self) -> dict[str, Array]:
        """All that the march depends on and has recorded, each of shape (own nodes,)."""
        return {"values": self.now(), **self.record.arrays()}

    def arrays(self, room: Room) -> dict[str, Array]:
        """The same, each of shape (own nodes,): a march that goes on overwrites them."""
        return self.held()

    def recorded(self) -> float:
        return self.record.then

    def write(self, generation: Path) -> list[Written]:
        return [write_part(generation, self.planes.own_nodes.start, self.held())]

    def restore(self, path: Path, then: float) -> None:
        plane, inner = self._plane, self.planes.own_nodes
        with readable(path, "" if self.planes.whole else "a checkpoint that all machines share"):
            saved = read_parts(path, plane)
            values = saved("values")
            if values is None:
                raise KeyError("values")
            for j, k in enumerate(self.planes.nodes.tolist()):
                self._values[j * plane : (j + 1) * plane] = values[k * plane : (k + 1) * plane]
            self.record.restore(saved, slice(inner.start * plane, inner.stop * plane), then)
        if self.posed.varies:  # what it has come to by now, when it may have been larger than now
            largest = float(self._mine(self._values).max())
            self._obstacles.highest = max(self._obstacles.highest, largest)


def march_here(posed: Posed, base: Grid, h: Hamiltonian, begin: Array | None = None) -> PosedMarch:
    """The march of a problem over its whole grid, which is refined from another one, or is it.

    begin: values that it begins with where they are less than those of the problem, shape (nodes,),
    or that of the grid.
    """
    planes = Planes.all_of(posed.grid.axes[0].count)
    values = PosedMarch(posed, h, planes, room_of(posed))
    facts = values.facts()
    check_start(posed, facts)
    start = StartFacts(falls=values.falls(facts.highest))
    if posed.filtered:
        start = replace(start, rate=values.start_rate())
    threads = posed.marching.threads or available_cores()
    march: March | RefinedMarch = (
        refined_march(posed, base, h, threads, start)
        if posed.marching.refine > 1
        else march_of(posed, h, posed.grid, planes=planes, threads=threads, start=start)
    )
    values.start_with(facts, march, begin)
    return values
