"""The march of a posed problem: over its grid, over a part of it, over another one, or refined.

Near the boundary of the set a grid may be finer: its nodes are marched everywhere, those of one
with cells `refine` times shorter in blocks around the boundary
(`execution/level_set/refined_march.py`). The result is the value at all nodes of the finer grid,
outside the blocks linear between nodes of the coarser one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.problem import Posed
from holdfast.errors import SimulationError
from holdfast.execution.device.program import device_named
from holdfast.execution.level_set.march import March, OverGrid
from holdfast.execution.level_set.refined_march import STRETCH, RefinedMarch
from holdfast.execution.level_set.slab import Part
from holdfast.execution.level_set.sweeping import layout
from holdfast.execution.resources import available_cores
from holdfast.maths.games.hamiltonian import Hamiltonian

LEEWAY = 0.08, 5.0, 6.0
"""Of a filtered march (`stage_leaf.py`): the largest share of the largest rate of the start value
by which rates may be apart, the same times the cells of an axis, and how much a kink within a cell
counts beside a curvature that changes the slope as much."""

RATE_TIMES = 9
"""Times at which the rates of a problem that depends on time are looked at."""


def march_of(
    posed: Posed, h: Hamiltonian, grid: Grid, *, part: Part | None = None, **options: Any
) -> March:
    """The march of a problem over a grid, or a part of it; options: others of `March`."""
    marching = posed.marching
    axes, kinds = [a.nodes for a in grid.axes], [a.ends for a in grid.axes]
    if part is not None and not part.whole:
        axes[0] = axes[0][part.nodes]
        kinds[0] = "extrapolated" if kinds[0] == "periodic" else kinds[0]
        options["cut"] = _cut(grid.shape, len(part.nodes))
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
        precision=marching.precision,
        device=device_named(marching.device),
        **options,
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


def reflected(posed: Posed, part: Part) -> list[npt.NDArray[np.int64]] | None:
    """The place of every node's reflection along each axis, where there is a symmetry."""
    signs = posed.marching.symmetry
    if signs is None:
        return None
    places = [
        a.reflected if signs.get(a.name) == -1 else np.arange(a.count, dtype=np.int64)
        for a in posed.grid.axes
    ]
    if not part.whole:
        places[0] = np.arange(len(part.nodes))
    return places


def start_rate(posed: Posed, h: Hamiltonian, part: Part, start: npt.NDArray[Any]) -> float:
    """The largest rate of change of the start value [its unit per second] in a part of the grid.

        max over nodes of   sum_i c_i |dV/dx_i|

    with the largest speeds c_i at the node and the flatter of the slopes at both sides of it, at
    the nodes in the set or next to it. No value that begins with this one changes faster, where
    nothing depends on time. Of what does, the rates of `RATE_TIMES` times count.
    """
    grid = posed.grid
    axes = [grid.axes[0].nodes[part.nodes], *(a.nodes for a in grid.axes[1:])]
    symbols = [a.state.symbol for a in grid.axes]
    speeds = OverGrid(h.speeds, symbols, posed.parameters, axes)
    first, pace = posed.clock
    many = RATE_TIMES if posed.varies else 1
    times = [first + pace * posed.horizon * k / max(many - 1, 1) for k in range(many)]
    values = start.reshape([len(a) for a in axes])
    plane, largest = values[0].size, 0.0
    for k in range(part.own.start, part.own.stop):
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
    posed: Posed, base: Grid, hamiltonian: Hamiltonian, **options: Any
) -> RefinedMarch:
    """The march of a problem; base: the grid that it is refined from; options: of `March`."""
    threads = posed.marching.threads or available_cores()

    def of(grid: Grid, stretch: int | None) -> March:
        rows = grid.shape[-2] if len(grid.axes) > 1 else 1
        cut = None if stretch is None else (1, rows, -(-grid.shape[-1] // stretch), stretch)
        return march_of(posed, hamiltonian, grid, threads=threads, cut=cut, **options)

    between = [2**k for k in range(1, posed.marching.refine.bit_length())]
    marches = [of(base, None), *(of(finer(base, k), STRETCH) for k in between)]
    periodic = [a.ends == "periodic" for a in base.axes]
    return RefinedMarch(marches, periodic, side=1.0 if posed.limit == "shrink" else -1.0)


def refinement_of(march: RefinedMarch) -> dict[str, Any]:
    """The entries of the report about a march that was refined."""
    return {"refine": march.refine, "marched_share": march.marched_share}
