"""Grids that are finer near the boundary of the set: what is marched, and what is refused.

The nodes of the grid are marched everywhere, those of one with cells `refine` times shorter in
blocks around the boundary (`execution/level_set/refined_march.py`). The result is the value at all
nodes of the finer grid, outside the blocks linear between nodes of the coarser one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.posed_march import march_of
from holdfast.analysis.reachability.problem import Posed
from holdfast.errors import SimulationError
from holdfast.execution.level_set.march import March
from holdfast.execution.level_set.refined_march import STRETCH, RefinedMarch
from holdfast.execution.resources import available_cores
from holdfast.maths.games.hamiltonian import Hamiltonian


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
