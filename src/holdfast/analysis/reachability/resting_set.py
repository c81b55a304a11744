"""Sets of two marches, of which one keeps the other from a set that is too large or too small.

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

    A march that `until` ended has no other beside it. progress: half of it is that of the first
    march, which may be the only one.
    """
    if not posed.marched_twice:
        return marched(posed, progress, begin, until)
    h = hamiltonian_of(posed)
    first = marched(posed, _half(progress, 0), begin, until, h)
    report, is_kernel = first.report, posed.problem.limit == "shrink"
    if report.ended_early or (is_kernel and report.empty and not posed.several):
        return first
    beside = replace(posed.renamed("rest"), filtered=not posed.marching.first_order)
    marching = beside.marching
    if marching.first_order:
        marching = replace(marching, dissipation="local-local")
    else:
        rim = float(rim_of(posed.grid))
        marching = replace(marching, tolerance=max(marching.tolerance, rim))
    at_rest = report.converged and is_kernel and not posed.several
    if at_rest:
        begin = np.asarray(first.values())
    elif not (report.converged and is_kernel) and report.steps > 1:  # one may have no length
        beside = replace(beside, steps=_steps_beside(marching))
    beside = replace(beside, marching=marching)
    second = marched(beside, _half(progress, 1), begin, h=h)
    left, rests = second.report.residual_cells, second.report.converged
    if at_rest and not rests and left is not None and left <= marching.tolerance:
        begin = np.array(second.values())
        second = marched(beside.renamed("at rest"), _half(progress, 1), begin, h=h)
    return _of_both(first, second, posed)


def _steps_beside(marching: Marching) -> Method:
    """Of the march beside one that does not come to rest."""
    method = marching.method
    order, cfl = min(method.order, ORDER), max(method.cfl, min(LONGER * method.cfl, LONGEST))
    return replace(method, order=order, cfl=cfl, long=method.order > ORDER and marching.refine == 1)


def _half(progress: Progress | None, which: int) -> Progress | None:
    """What the first or the second of two marches calls with its share."""
    return None if progress is None else lambda share: progress(0.5 * (which + share))


def _of_both(first: ValueFunction, second: ValueFunction, posed: Posed) -> ValueFunction:
    """The answer of two marches: the values of the first are changed in place, plane by plane, so
    that they may be larger than the memory."""
    report, grid = first.report, second.grid
    tables = [v.dataset["value"].values for v in (first, second)]
    several, lesser = "time" in first.dataset["value"].dims, posed.marching.first_order
    before = after = moved = 0
    for values, other in zip(*tables, strict=True) if several else [tables]:
        before = after = moved = 0  # the last are those of the horizon
        answers = _lesser(values, other) if lesser else _held(values, other, grid, posed)
        for planes, answer in answers:
            was, now = values[planes] > 0, answer > 0
            values[planes] = answer
            before, after = before + int(was.sum()), after + int(now.sum())
            moved += int((was != now).sum())
    if "arrival" in first.dataset:
        times, others = (v.dataset["arrival"].values for v in (first, second))
        if lesser:
            np.maximum(times, others, out=times)  # NaN where one of them is never there
        else:
            _no_later(times, others, grid)
    is_kernel, rests = posed.problem.limit == "shrink", (report.converged, second.report.converged)
    reached = report.reached_s if is_kernel else max(report.reached_s, second.report.reached_s)
    return first.reported(
        converged=any(rests) if is_kernel and after == 0 else all(rests),
        empty=after == 0,
        filtered_share=moved / max(before, after, 1),
        reached_s=reached,
        wall_time_s=report.wall_time_s + second.report.wall_time_s,
    )


def _lesser(values: Array, other: Array) -> Iterator[tuple[slice, Array]]:
    for planes in _some_planes(values):
        yield planes, np.minimum(values[planes], other[planes])


def _held(
    values: Array, filtered: Array, grid: Grid, posed: Posed
) -> Iterator[tuple[slice, Array]]:
    """The value of the first where its set is within the rim of the filtered one."""
    sides = posed.held
    for planes in _some_planes(values):
        v = values[planes]
        if sides.above:
            highest = _around(filtered, planes, grid, maximum_filter)
            v = np.where(highest > 0, v, np.minimum(v, highest))
        if sides.below:
            lowest = _around(filtered, planes, grid, minimum_filter)
            v = np.where(lowest > 0, np.maximum(v, lowest), v)
        yield planes, v


def _no_later(times: Array, filtered: Array, grid: Grid) -> None:
    """Times of arrival, NaN for none, no later than the latest filtered one within the rim."""

    def latest_of(arrivals: Array, **options: Any) -> Array:
        latest: Array = maximum_filter(np.where(np.isnan(arrivals), math.inf, arrivals), **options)
        return latest

    for planes in _some_planes(times):
        latest = _around(filtered, planes, grid, latest_of)
        sharp = times[planes]
        times[planes] = np.where(latest < math.inf, np.fmin(sharp, latest), sharp)


def rim_of(grid: Grid) -> int:
    """Cells by which the set of high order may be beside the filtered one, which is also how far
    that may still move where it is said to rest."""
    return math.ceil(RIM * math.sqrt(float(np.mean([axis.count for axis in grid.axes]))))


def _some_planes(values: Array) -> Iterator[slice]:
    """Planes of the first axis that are looked at together."""
    count = len(values)
    step = max(1, TOGETHER // (values.size // count))
    return (slice(k, min(k + step, count)) for k in range(0, count, step))


def _around(values: Array, planes: slice, grid: Grid, extreme: Callable[..., Array]) -> Array:
    """Of these planes the largest or the least value within the rim."""
    rim, count = rim_of(grid), len(values)
    modes = ["wrap" if axis.ends == "periodic" else "nearest" for axis in grid.axes]
    near = np.arange(planes.start - rim, planes.stop + rim)
    near = near % count if modes[0] == "wrap" else np.clip(near, 0, count - 1)
    extremes = extreme(values[near], size=2 * rim + 1, mode=["nearest", *modes[1:]])
    return extremes[rim : rim + planes.stop - planes.start]
