"""Initial values of a march, and the obstacles below and above the value.

    a region to be kept      W <= l_K                   start l_K
    one to be reached        l_T <= W                   start l_T
    reached within another   l_G <= W, then W <= l_K    start the lesser

If the sign of dW/dtau is restricted, one of them holds automatically. With d the distance to the
open ends of the grid, leaving the grid counts as lost with W <= d, and as won with l_K or -d <= W.
"""

from __future__ import annotations

import numpy as np

from holdfast.analysis.reachability.problem import Posed, check_inside
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.over_grid import over_grid


class Obstacles:
    """start, lower, upper: values at every node, flat, at the beginning of the march; if they
    depend on time, `refresh` writes those of a time into lower and upper.

    cell: the largest change of the start value from node to node. highest: bound of all values.
    """

    def __init__(self, posed: Posed) -> None:
        self.posed, problem, grid = posed, posed.problem, posed.grid
        self.room: Array | None = None
        self.margins = [
            over_grid(
                region.margin,
                [a.state.symbol for a in grid.axes],
                posed.parameters,
                [a.nodes for a in grid.axes],
                band=posed.marching.band,
                precision=posed.marching.precision,
            )
            for region in problem.regions
        ]
        start, self.lower, self.upper = self._at(posed.clock[0])
        if not (start > 0).any():
            raise SimulationError(
                f"no node of the grid is in region '{problem.start.name}'",
                remedy="take a finer grid",
            )
        self.cell = largest_change(start.reshape(grid.shape))
        if posed.beyond:
            self.room = room_inside(posed, start, self.cell)
            start, self.lower, self.upper = self._at(posed.clock[0])
        self.start = start
        self.highest = float(self.start.max())

    def refresh(self, time: float) -> None:
        start, lower, upper = self._at(time)
        self.highest = max(self.highest, float(start.max()))
        for mine, new in ((self.lower, lower), (self.upper, upper)):
            if mine is not None and new is not None:
                mine[:] = new

    def _at(self, time: float) -> tuple[Array, Array | None, Array | None]:
        """The initial value and the obstacles at a time."""
        posed, room = self.posed, self.room
        own, *others = (margin(time) for margin in self.margins)
        if any(np.isnan(m.min()) for m in (own, *others)):
            raise SimulationError(
                "the constraints of a region are NaN at some nodes of the grid",
                remedy="take an interval on which its inequalities are defined",
            )
        kept = posed.problem.limit == "shrink"
        if kept:
            check_inside(posed, own)
        lower = None if kept else own
        upper: Array | None = own if kept else (others[0] if others else None)
        if posed.beyond == "lost" and room is not None:
            upper = room if upper is None else np.minimum(upper, room)
        elif posed.beyond == "won" and room is not None:
            lower = np.minimum(own, -room) if kept else np.maximum(own, -room)
        start = upper if kept or lower is None else lower
        assert start is not None
        if upper is not None and upper is not start:
            start = np.minimum(start, upper)
        lower = None if posed.limit == "grow" or posed.problem.limit == "exact" else lower
        upper = None if posed.limit == "shrink" else upper
        if start is lower or start is upper:  # the march overwrites it in place, the obstacles stay
            start = start.copy()
        return start, lower, upper


def open_ends(posed: Posed, values: Array) -> list[tuple[int, int]]:
    """The ends of the grid beyond which the value is extrapolated: the axis, and 0 or -1.

    If the set only shrinks, ends that it does not reach initially are left out.
    """
    table = values.reshape(posed.grid.shape)
    return [
        (i, end)
        for i, axis in enumerate(posed.grid.axes)
        if axis.ends in ("contained", "extrapolated")
        for end in (0, -1)
        if posed.limit != "shrink" or (np.take(table, end, axis=i) > 0).any()
    ]


def room_inside(posed: Posed, values: Array, cell: float) -> Array:
    """The distance to the nearest open end, less half a cell, as steep as the start value."""
    shape = posed.grid.shape
    most = min(posed.marching.band, float(max(shape)) * cell)
    room = np.full(shape, most, dtype=values.dtype)
    for i, end in open_ends(posed, values):
        places = np.arange(shape[i], dtype=values.dtype)
        places = places if end == 0 else places[::-1]
        line = np.maximum((places - 0.5) * cell, -posed.marching.band).astype(values.dtype)
        rows = line.reshape([-1 if k == i else 1 for k in range(len(shape))])
        np.minimum(room, rows, out=room)
    return room.ravel()


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
