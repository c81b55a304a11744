"""The value that a march begins with, and the obstacles below and above it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.posed import Posed, check_inside
from holdfast.errors import SimulationError
from holdfast.execution.over_grid import values_on_grid
from holdfast.maths.region import Region

Array = npt.NDArray[Any]


def start_and_obstacles(posed: Posed) -> tuple[Array, Array | None, Array | None, float]:
    """The start value, what it never falls below, what it never exceeds, and the change of the
    start value over a cell: the largest between neighbours."""
    problem, marching = posed.problem, posed.marching

    def margin(region: Region) -> Array:
        return values_on_grid(
            region.margin,
            [a.state.symbol for a in posed.grid.axes],
            posed.parameters,
            [a.nodes for a in posed.grid.axes],
            band=marching.band,
            precision=marching.precision,
        )

    values = margin(problem.start)
    check_inside(posed, values)
    lower = values.copy() if problem.kept else None
    upper = margin(problem.above) if problem.above else None
    if upper is not None:
        np.minimum(values, upper, out=values)
    if np.isnan(values).any():
        raise SimulationError(
            "the margin of a region is no number at some nodes of the grid",
            remedy="take an interval on which its inequalities are defined",
        )
    if not (values > 0).any():
        raise SimulationError(
            f"no node of the grid is in region '{problem.start.name}'", remedy="take a finer grid"
        )
    cell = largest_change(values.reshape(posed.grid.shape))
    if posed.beyond:
        inside = room_inside(posed, values, cell)
        np.clip(inside, -marching.band, marching.band, out=inside)
        if posed.beyond == "lost":
            np.minimum(values, inside, out=values)
            if problem.limit != "shrink":
                upper = inside if upper is None else np.minimum(upper, inside)
        elif problem.limit == "shrink":
            lower = np.minimum(values, -inside)
        else:
            np.maximum(values, -inside, out=values)
            lower = values.copy() if lower is not None else None
            if upper is not None:
                np.minimum(values, upper, out=values)
    return values, lower, upper, cell


def open_ends(posed: Posed, values: Array) -> list[tuple[int, int]]:
    """The ends of the grid beyond which the value is continued: the axis, and 0 or -1.

    Left out are those that a set which only shrinks, and does not reach them, never comes to.
    """
    table = values.reshape(posed.grid.shape)
    return [
        (i, end)
        for i, axis in enumerate(posed.grid.axes)
        if axis.ends in ("contained", "extrapolated")
        for end in (0, -1)
        if posed.problem.limit != "shrink" or (np.take(table, end, axis=i) > 0).any()
    ]


def room_inside(posed: Posed, values: Array, cell: float) -> Array:
    """The distance to the nearest open end, less half a cell, as steep as the start value."""
    shape = posed.grid.shape
    room = np.full(shape, float(max(shape)) * cell, dtype=values.dtype)
    for i, end in open_ends(posed, values):
        places = np.arange(shape[i], dtype=values.dtype)
        places = places if end == 0 else places[::-1]
        line = ((places - 0.5) * cell).astype(values.dtype)
        rows = line.reshape([-1 if k == i else 1 for k in range(len(shape))])
        np.minimum(room, rows, out=room)
    return room.ravel()


def largest_change(values: Array) -> float:
    """The largest difference between neighbours, at the nodes in the set or next to it."""

    def largest(ahead: Array, behind: Array) -> float:
        near = (ahead > 0) | (behind > 0)
        return float(np.abs(ahead - behind)[near].max(initial=0.0))

    found = 0.0
    for k, slab in enumerate(values):  # slab by slab, so that it takes little memory
        if k:
            found = max(found, largest(slab, values[k - 1]))
        for i in range(slab.ndim):
            rows = np.moveaxis(slab, i, 0)
            found = max(found, largest(rows[1:], rows[:-1]))
    return found
