"""Sets of schemes of high order, held to those of a scheme that converges.

A scheme of high order may stand still at a ridge at which the solution falls. The same scheme held
close to a monotone step (`execution/level_set/stage_steps.py`) converges to the solution, at the
price of first order at every ridge. So of a set that is to be kept both are asked: with V of the
march of high order and F of the filtered one the answer is

    V,  or F where no F within a few cells along the axes is above 0

It has the accuracy of high order where the two sets are that close. The few cells (`RIM`) are a
share of the grid that tends to 0, so that it converges with the filtered value. Where V has come
to rest the filtered march goes on from it, until it rests as well. Where it has not, or where
values at earlier times are asked for, it goes the same way as the other from the start on.

A set that is to be reached against a disturbance is the same the other way about: a march may stop
before all is won. It is filtered throughout (`filtered_throughout`).
Without an opponent a set that grows has no ridge at which H is wrong on both sides: H is convex.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter

from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.hamilton_jacobi import marched
from holdfast.analysis.reachability.march_part import hamiltonian_of
from holdfast.analysis.reachability.one_march import Progress, Until
from holdfast.analysis.reachability.options import Marching
from holdfast.analysis.reachability.problem import Posed
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import Method
from holdfast.execution.level_set.schemes import schemes

RIM = 0.125
"""Cells by which the set of high order may be larger than that of the filtered scheme, in roots of
the mean number of nodes along an axis, rounded up: at the tips of a set a monotone step wears off
more cells of finer grids."""

TOGETHER = 1 << 22
"""Nodes that are looked at together."""

ORDER = 2
"""The order of the steps of the filtered march beside one that does not come to rest. Steps of
first order would wear off what goes round, and a third gains nothing: whole cells are asked of it.
Where a march comes to rest depends on roundings, so that one from a rest on has the order of the
other. Single precision would be faster, but which stencil is taken is left to rounding then: in
other units the sets of one in 300 problems differed by a node."""

LONGER, LONGEST = 1.25, 0.95
"""How many times as long its steps are, but no longer than this share of a stable one: a filtered
step is as good as monotone up to the whole."""


def filtered_throughout(posed: Posed) -> bool:
    """Whether a march of this problem is filtered from its start on, and has no other beside it."""
    problem = posed.problem
    opposed = problem.disturbances == "min" and bool(posed.system.disturbances)
    high = not schemes()[posed.marching.scheme].one_slope
    return high and problem.limit != "shrink" and opposed


def marched_to_rest(
    posed: Posed,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
) -> ValueFunction:
    """As `marched`, of a scheme that stands still only where the equation does.

    A march that `until` ended is not held to the filtered one. progress: half of it is that of the
    first march, which may be the only one.
    """
    if not posed.marched_twice:
        return marched(posed, progress, begin, until)
    h = hamiltonian_of(posed)
    sharp = marched(posed, _half(progress, 0), begin, until, h)
    report = sharp.report
    if report.ended_early or (report.empty and not posed.several):
        return sharp
    beside = replace(posed.renamed("rest"), filtered=True, arrival_steps=0)
    tolerance = max(beside.marching.tolerance, float(rim_of(posed.grid)))
    marching = replace(beside.marching, tolerance=tolerance)
    at_rest = report.converged and not posed.several
    if at_rest:
        begin = np.asarray(sharp.values())
    elif not report.converged and report.steps > 1:  # a single step may be of no length
        beside = replace(beside, steps=_steps_beside(marching))
    beside = replace(beside, marching=marching)
    worn = marched(beside, _half(progress, 1), begin, h=h)
    left = worn.report.residual_cells
    if at_rest and not worn.report.converged and left is not None and left <= tolerance:
        worn = marched(beside.renamed("at rest"), _half(progress, 1), np.array(worn.values()), h=h)
    return _no_larger(sharp, worn)


def _steps_beside(marching: Marching) -> Method:
    """Of the filtered march beside one that does not come to rest."""
    method = marching.method
    order, cfl = min(method.order, ORDER), max(method.cfl, min(LONGER * method.cfl, LONGEST))
    return replace(method, order=order, cfl=cfl, long=method.order > ORDER and marching.refine == 1)


def _half(progress: Progress | None, which: int) -> Progress | None:
    """What the first or the second of two marches calls with its share."""
    return None if progress is None else lambda share: progress(0.5 * (which + share))


def _no_larger(sharp: ValueFunction, worn: ValueFunction) -> ValueFunction:
    """The value of the first, where it is within the rim of the second, at every time.

    It is changed in place, plane by plane, so that it may be larger than the memory.
    """
    report = sharp.report
    tables = [v.dataset["value"].values for v in (sharp, worn)]
    several = "time" in sharp.dataset["value"].dims
    before = after = 0
    for values, held in zip(*tables, strict=True) if several else [tables]:
        before = after = 0  # the last are those of the horizon
        for planes, bound in _largest_around(held, worn.grid):
            before += int((values[planes] > 0).sum())
            values[planes] = np.where(bound > 0, values[planes], np.minimum(values[planes], bound))
            after += int((values[planes] > 0).sum())
    return sharp.reported(
        converged=(report.converged or after == 0) and worn.report.converged,
        empty=after == 0,
        filtered_share=(before - after) / max(before, 1),
        wall_time_s=report.wall_time_s + worn.report.wall_time_s,
    )


def rim_of(grid: Grid) -> int:
    """Cells by which the set of high order may be larger, which is also how far the filtered one
    may still move where it is said to rest."""
    return math.ceil(RIM * math.sqrt(float(np.mean([axis.count for axis in grid.axes]))))


def _largest_around(values: Array, grid: Grid) -> Iterator[tuple[slice, Array]]:
    """Of some planes of the first axis at a time the largest value within the rim."""
    axes = grid.axes
    rim = rim_of(grid)
    modes = ["wrap" if axis.ends == "periodic" else "nearest" for axis in axes]
    count = axes[0].count
    step = max(1, TOGETHER // (values.size // count))
    for first in range(0, count, step):
        last = min(first + step, count)
        around = np.arange(first - rim, last + rim)
        around = around % count if modes[0] == "wrap" else np.clip(around, 0, count - 1)
        bound = maximum_filter(values[around], size=2 * rim + 1, mode=["nearest", *modes[1:]])
        yield slice(first, last), bound[rim : rim + last - first]
