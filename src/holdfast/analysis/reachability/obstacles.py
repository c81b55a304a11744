"""Initial values of a march, and the obstacles below and above the value.

    a region to be kept      W <= l_K                   start l_K
    one to be reached        l_T <= W                   start l_T
    reached within another   l_G <= W, then W <= l_K    start the lesser

If the sign of dW/dtau is restricted, one of them holds automatically. With d the distance to the
open ends of the grid, leaving the grid counts as lost with W <= d, and as won with l_K or -d <= W.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from holdfast.analysis.reachability.problem import ON_END, Ends, Posed, check_inside, touched
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.layers import Part
from holdfast.execution.level_set.over_grid import ALL, over_grid


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

TOGETHER = 1 << 20
"""Nodes at which moving bounds are renewed together."""


def merged(found: Sequence[Facts]) -> Facts:
    """Of the whole grid, from those of its parts."""
    return Facts(
        any(f.nan for f in found),
        any(f.inside for f in found),
        frozenset().union(*(f.ends for f in found)),
        max(f.cell for f in found),
        max(f.highest for f in found),
        max(f.deepest for f in found),
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
    """start, lower, upper: values at every node of a part of the grid, flat, at the beginning of
    the march; if they depend on time, `refresh` writes those of a time into lower and upper.

    highest: bound of all values of the part, without its halo. room: an array of so many values.
    """

    def __init__(self, posed: Posed, part: Part, room: Callable[[int], Array]) -> None:
        grid = posed.grid
        self.posed, self.part, self._empty = posed, part, room
        self.room: Array | None = None
        axes = [grid.axes[0].nodes[part.nodes], *(a.nodes for a in grid.axes[1:])]
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
        own = self.part.own
        mine = start[own]
        before = own.start - (self.part.first > 0)  # the change from the part before it, too
        return Facts(
            bool(np.isnan(mine.min())),
            any((plane > 0).any() for plane in mine),
            touched(mine, self.part.ends),
            largest_change(start[before : own.stop]),
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
        [its unit per unit of the state], over nodes that are lost, and down to what.

        So the value falls beyond an end (`stencils.py`) as on a grid that is wider by `WIDER`.
        highest: of `MarchPart.falls`.
        """
        posed, values = self.posed, self.start.reshape(self.shape)
        ends = np.tile((0.0, 0.0, -math.inf, -math.inf), (len(self.shape), 1))
        if posed.problem.limit != "shrink":
            return ends
        symbols = [a.state.symbol for a in posed.grid.axes]
        axes = [posed.grid.axes[0].nodes[self.part.nodes], *(a.nodes for a in posed.grid.axes[1:])]
        for (i, axis), side in itertools.product(enumerate(posed.grid.axes), (0, 1)):
            if axis.ends != "contained" or (i == 0 and not self.part.ends[side]):
                continue
            place = (self.part.own.start, self.part.own.stop - 1)[side] if i == 0 else -side
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
        block = max(1, TOGETHER * planes // len(self.start))
        self.check([self.renew(time, k, min(k + block, planes)) for k in range(0, planes, block)])

    def renew(self, time: float, first: int, last: int) -> Facts:
        """Bounds of a time at some places of the first axis; what is known of the start there."""
        plane = len(self.start) // self.shape[0]
        nodes = slice(first * plane, last * plane)
        start, lower, upper = self._at(time, nodes)
        for known, new in ((self.lower, lower), (self.upper, upper)):
            if known is not None and new is not None:
                known[nodes] = new
        own = self.part.own
        low, high = max(own.start, first), min(own.stop, last)
        if low >= high:
            return NOTHING
        mine = start.reshape(last - first, *self.shape[1:])[low - first : high - first]
        at_first, at_last = self.part.ends
        ends = touched(mine, (at_first and low == own.start, at_last and high == own.stop))
        return replace(
            NOTHING, nan=bool(np.isnan(mine.min())), ends=ends, highest=float(mine.max())
        )

    def check(self, found: Sequence[Facts]) -> None:
        """Refuse bounds, renewed at all places, of a start that no march can go on with."""
        facts = merged(found)
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
        own, *others = (margin(time, of) for margin in self.margins)
        kept = posed.problem.limit == "shrink"
        lower = None if kept else own
        upper: Array | None = own if kept else (others[0] if others else None)
        if posed.beyond == "lost" and room is not None:
            upper = room if upper is None else np.minimum(upper, room, out=self._empty(len(room)))
        elif posed.beyond == "won" and room is not None:
            lower = np.negative(room, out=self._empty(len(room)))
            (np.minimum if kept else np.maximum)(own, lower, out=lower)
        start = upper if kept or lower is None else lower
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
            places = places[self.part.nodes] if i == 0 else places
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


def largest_change(values: Array) -> float:
    """The largest difference between neighbours, at the nodes in the set or next to it."""

    def largest(ahead: Array, behind: Array) -> float:
        near = (ahead > 0) | (behind > 0)
        return float(np.abs(ahead - behind)[near].max(initial=0.0))

    found = 0.0
    for k, slab in enumerate(values):  # slab by slab, to save memory
        if k:
            found = max(found, largest(slab, values[k - 1]))
        for i in range(slab.ndim):
            rows = np.moveaxis(slab, i, 0)
            found = max(found, largest(rows[1:], rows[:-1]))
    return found
