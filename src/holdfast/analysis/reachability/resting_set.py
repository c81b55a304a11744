"""Sets of schemes of high order, held to those of a scheme that converges.

A scheme of high order may stand still at a ridge at which the solution moves. The same scheme held
close to a monotone step (`execution/level_set/stage_steps.py`) converges to the solution, at the
price of first order at every ridge. So both are asked: with V of the march of high order and F of
the filtered one the answer is

    V,  or F where no F within a cell along the axes is above 0, of a set that is to be kept
    V,  or F where all F within a cell are above 0,              of one that is to be reached
    V,  or F in either case,            of a set of an instant, or what is to be reached in time

It has the accuracy of high order where the two sets are that close. On fine grids it is a few cells
(`RIM`), a share of the grid that tends to 0, so that it converges with the filtered value. Where V
of a set that is to be kept has come to rest, the filtered march goes on from it, until it rests as
well. Elsewhere it goes the same way as the other from the start on.

A set that is to be reached without an opponent has no ridge at which H is wrong: H is convex. It is
marched once, but for a basin that depends on time: what it is kept within makes it a kernel.

A scheme of first order with the largest speeds of an axis, or of a node, enlarges a set where its
value is convex. Beside it goes the same scheme with the speeds that two slopes allow, and the
answer is the lesser of both values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.hamilton_jacobi import marched
from holdfast.analysis.reachability.march_part import hamiltonian_of
from holdfast.analysis.reachability.one_march import Progress, Until
from holdfast.analysis.reachability.options import Marching
from holdfast.analysis.reachability.problem import Posed
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import Method

RIM = 0.078
"""Cells by which the set of high order may be larger than that of the filtered scheme, or smaller,
in roots of the mean number of nodes along an axis, rounded up: one on 164 nodes, two on 657. At its
tips, and all around where the value jumps, a monotone step wears off more cells of finer grids."""

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
    if not any(posed.held):
        return marched(posed, progress, begin, until)
    h = hamiltonian_of(posed)
    sharp = marched(posed, _half(progress, 0), begin, until, h)
    report, is_kernel = sharp.report, posed.problem.limit == "shrink"
    if report.ended_early or (is_kernel and report.empty and not posed.several):
        return sharp
    beside = replace(posed.renamed("rest"), filtered=not posed.first_order)
    tolerance = max(beside.marching.tolerance, float(_rim(posed, posed.grid)))
    dissipation = "local-local" if posed.first_order else beside.marching.dissipation
    marching = replace(beside.marching, tolerance=tolerance, dissipation=dissipation)
    at_rest = report.converged and is_kernel and not posed.several
    if at_rest:
        begin = np.asarray(sharp.values())
    elif not (report.converged and is_kernel) and report.steps > 1:  # one may have no length
        beside = replace(beside, steps=_steps_beside(marching))
    beside = replace(beside, marching=marching)
    worn = marched(beside, _half(progress, 1), begin, h=h)
    left = worn.report.residual_cells
    if at_rest and not worn.report.converged and left is not None and left <= tolerance:
        worn = marched(beside.renamed("at rest"), _half(progress, 1), np.array(worn.values()), h=h)
    return _held(sharp, worn, posed)


def _steps_beside(marching: Marching) -> Method:
    """Of the filtered march beside one that does not come to rest."""
    method = marching.method
    order, cfl = min(method.order, ORDER), max(method.cfl, min(LONGER * method.cfl, LONGEST))
    return replace(method, order=order, cfl=cfl, long=method.order > ORDER and marching.refine == 1)


def _half(progress: Progress | None, which: int) -> Progress | None:
    """What the first or the second of two marches calls with its share."""
    return None if progress is None else lambda share: progress(0.5 * (which + share))


def _held(sharp: ValueFunction, worn: ValueFunction, posed: Posed) -> ValueFunction:
    """The value of the first where its set is within the rim of that of the second, at every time.

    It is changed in place, plane by plane, so that it may be larger than the memory.
    """
    report, grid, sides = sharp.report, worn.grid, posed.held
    rim, is_kernel = _rim(posed, grid), posed.problem.limit == "shrink"
    tables = [v.dataset["value"].values for v in (sharp, worn)]
    several = "time" in sharp.dataset["value"].dims
    before = after = moved = 0
    for values, filtered in zip(*tables, strict=True) if several else [tables]:
        before = after = moved = 0  # the last are those of the horizon
        for planes in _some_planes(values):
            was, v = values[planes] > 0, values[planes]
            if sides.above:
                highest = _around(filtered, planes, grid, rim, maximum_filter)
                v = np.where((highest > 0) & (rim > 0), v, np.minimum(v, highest))
            if sides.below:
                lowest = _around(filtered, planes, grid, rim, minimum_filter)
                v = np.where(lowest > 0, np.maximum(v, lowest), v)
            values[planes], now = v, v > 0
            before, after = before + int(was.sum()), after + int(now.sum())
            moved += int((was != now).sum())
    if "arrival" in sharp.dataset:
        times, filtered = (v.dataset["arrival"].values for v in (sharp, worn))
        if sides.below:
            _no_later(times, filtered, grid, rim)
        if sides.above:
            np.maximum(times, filtered, out=times)  # NaN where either is never there
    lost = after == 0 and is_kernel
    reached = report.reached_s if is_kernel else max(report.reached_s, worn.report.reached_s)
    return sharp.reported(
        converged=(report.converged or lost) and worn.report.converged,
        empty=after == 0,
        filtered_share=moved / max(before, after, 1),
        reached_s=reached,
        wall_time_s=report.wall_time_s + worn.report.wall_time_s,
    )


def _no_later(times: Array, filtered: Array, grid: Grid, rim: int) -> None:
    """Times of arrival, NaN for none, no later than the latest filtered one within the rim."""

    def latest_of(arrivals: Array, **options: Any) -> Array:
        latest: Array = maximum_filter(np.where(np.isnan(arrivals), math.inf, arrivals), **options)
        return latest

    for planes in _some_planes(times):
        latest = _around(filtered, planes, grid, rim, latest_of)
        sharp = times[planes]
        times[planes] = np.where(latest < math.inf, np.fmin(sharp, latest), sharp)


def _rim(posed: Posed, grid: Grid) -> int:
    """That of the schemes of high order; of two of first order the lesser value is taken."""
    return 0 if posed.first_order else rim_of(grid)


def rim_of(grid: Grid) -> int:
    """Cells by which the set of high order may be beside the filtered one, which is also how far
    that may still move where it is said to rest."""
    return math.ceil(RIM * math.sqrt(float(np.mean([axis.count for axis in grid.axes]))))


def _some_planes(values: Array) -> Iterator[slice]:
    """Planes of the first axis that are looked at together."""
    count = len(values)
    step = max(1, TOGETHER // (values.size // count))
    return (slice(k, min(k + step, count)) for k in range(0, count, step))


def _around(
    values: Array, planes: slice, grid: Grid, rim: int, extreme: Callable[..., Array]
) -> Array:
    """Of these planes the largest or the least value within the rim."""
    count = len(values)
    modes = ["wrap" if axis.ends == "periodic" else "nearest" for axis in grid.axes]
    near = np.arange(planes.start - rim, planes.stop + rim)
    near = near % count if modes[0] == "wrap" else np.clip(near, 0, count - 1)
    extremes = extreme(values[near], size=2 * rim + 1, mode=["nearest", *modes[1:]])
    return extremes[rim : rim + planes.stop - planes.start]
