"""A kernel at which a march comes to rest, and whether the equation rests there too.

A scheme of high order may stand still at a ridge at which the solution falls. The same scheme held
close to a monotone step (`execution/level_set/stage_steps.py`) converges to the solution, at the
price of first order at every ridge. So both are asked: the march of high order goes first, and from
its rest that of the filtered scheme goes on, until it rests as well. With V of the first and F of
the second the answer is

    V,  or F where no F within a few cells along the axes is above 0

It has the accuracy of high order where the two sets are that close. The few cells (`RIM`) are a
share of the grid that tends to 0, so that it converges with the filtered value.

Of a set that grows a march that stands still too early gives an inner set, and those of an instant,
or that depend on time, come to no rest: they are marched by the scheme of high order alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter

from holdfast.analysis.reachability.hamilton_jacobi import marched
from holdfast.analysis.reachability.one_march import Progress, Until
from holdfast.analysis.reachability.problem import Posed
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.schemes import schemes

RIM = 0.125
"""Cells by which the set of high order may be larger than that of the filtered scheme, in roots of
the mean number of nodes along an axis, rounded up: at the tips of a set a monotone step wears off
more cells of finer grids."""

TOGETHER = 1 << 22
"""Nodes that are looked at together."""

SETTLED = 0.1
"""The least tolerance [cells] of the rest of the filtered scheme: whole cells are asked of it."""


def marched_to_rest(
    posed: Posed,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
) -> ValueFunction:
    """As `marched`, of a scheme whose rest is one of the equation."""
    marching = posed.marching
    sharp = marched(posed, progress, begin, until)
    shrinks = posed.limit == "shrink" and not schemes()[marching.scheme].one_slope
    if not (shrinks and sharp.report.converged) or sharp.report.empty:
        return sharp
    aside = posed.aside("rest")
    coarse = replace(aside.marching, tolerance=max(marching.tolerance, SETTLED))
    worn = marched(replace(aside, marching=coarse, filtered=True), begin=np.asarray(sharp.values()))
    return _no_larger(sharp, worn)


def _no_larger(sharp: ValueFunction, worn: ValueFunction) -> ValueFunction:
    """The value of the first, where it is within the rim of the second, from its rest on.

    It is changed in place, plane by plane, so that it may be larger than the memory.
    """
    report, table = sharp.report, sharp.dataset["value"].values
    rested = [table]
    if "time" in sharp.dataset["value"].dims:
        times = sharp.dataset["time"].values
        rested = [table[k] for k in np.flatnonzero(times >= report.reached_s * (1.0 - 1e-9))]
    before = after = 0
    for planes, bound in _largest_around(worn):
        before += int((rested[-1][planes] > 0).sum())
        for values in rested:
            values[planes] = np.where(bound > 0, values[planes], np.minimum(values[planes], bound))
        after += int((rested[-1][planes] > 0).sum())
    return sharp.reported(
        converged=worn.report.converged,
        empty=after == 0,
        filtered_share=(before - after) / max(before, 1),
        wall_time_s=report.wall_time_s + worn.report.wall_time_s,
    )


def _largest_around(value: ValueFunction) -> Iterator[tuple[slice, Array]]:
    """Of some planes of the first axis at a time the largest value within the rim."""
    axes, values = value.grid.axes, value.values()
    rim = math.ceil(RIM * math.sqrt(float(np.mean([axis.count for axis in axes]))))
    modes = ["wrap" if axis.ends == "periodic" else "nearest" for axis in axes]
    count = axes[0].count
    step = max(1, TOGETHER // (values.size // count))
    for first in range(0, count, step):
        last = min(first + step, count)
        around = np.arange(first - rim, last + rim)
        around = around % count if modes[0] == "wrap" else np.clip(around, 0, count - 1)
        bound = maximum_filter(values[around], size=2 * rim + 1, mode=["nearest", *modes[1:]])
        yield slice(first, last), bound[rim : rim + last - first]
