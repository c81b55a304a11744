"""A kernel that a march came to rest at, and whether the equation rests there too.

A scheme of high order may stand still at a ridge at which the solution falls. The same scheme held
close to a monotone step (`execution/level_set/stage_steps.py`) converges to the solution, at the
price of first order at every ridge. So both are asked: the march of high order goes first, and from
its rest that of the filtered scheme goes on, until it rests as well. Where the set loses no more
than `most_cells`, a share of the grid that tends to 0 with the cells, the first is the answer: it
is as far from the filtered one at most, and so converges with it. Where it loses more, it rested at
no solution, and the filtered march from the beginning is the answer.

Other problems, which grow, are held at an instant, or depend on time, are marched by the filtered
scheme from the beginning.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter

from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.hamilton_jacobi import marched
from holdfast.analysis.reachability.one_march import Progress, Until
from holdfast.analysis.reachability.problem import Posed
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.schemes import schemes

WORN = 0.4
"""Cells by which the set may lose its rim to the filtered scheme, times the root of the cells along
an axis: at its tips a monotone step wears off some, more on finer grids."""

SETTLED = 0.1
"""The least tolerance [cells] of the rest of the filtered scheme: whole cells are asked of it."""


def marched_to_rest(
    posed: Posed,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
) -> ValueFunction:
    """As `marched`, whose rest the filtered scheme confirms."""
    marching = posed.marching
    rests = posed.limit == "shrink" and marching.cluster is None
    if schemes()[marching.scheme].one_slope or not rests:
        return marched(posed, progress, begin, until)
    sharp = marched(posed, progress, begin, until, filtered=False)
    if not sharp.report.converged or sharp.report.empty:
        return sharp
    aside = posed.aside("rest")
    coarse = replace(aside.marching, tolerance=max(marching.tolerance, SETTLED))
    worn = marched(replace(aside, marching=coarse), begin=np.asarray(sharp.values()))
    lost = cells_lost(sharp, worn) if worn.report.converged else None
    if lost is not None:
        return sharp.reported(filtered_cells=lost)
    return marched(posed.renamed("filtered"), progress)


def most_cells(grid: Grid) -> int:
    """The most cells that a set may lose to the filtered scheme, and be the answer."""
    return math.ceil(WORN * math.sqrt(np.mean([axis.count for axis in grid.axes])))


def cells_lost(before: ValueFunction, after: ValueFunction) -> int | None:
    """The most cells from a node of a set to the nearest one that is left of it, along the axes;
    None where they are more than `most_cells`."""
    was, left = before.values() > 0, after.values() > 0
    turns = [axis.ends == "periodic" for axis in before.grid.axes]
    for cells in range(most_cells(before.grid) + 1):
        if not (was & ~_within(left, cells, turns)).any():
            return cells
    return None


def _within(nodes: npt.NDArray[np.bool_], cells: int, turns: list[bool]) -> npt.NDArray[np.bool_]:
    modes = ["wrap" if turn else "nearest" for turn in turns]
    wide = maximum_filter(nodes.astype(np.uint8), size=2 * cells + 1, mode=modes)
    return np.asarray(wide > 0)
