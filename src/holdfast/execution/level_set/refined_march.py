"""A march over a coarse grid, and over a fine one in blocks around the boundary of the set.

The two go on in turns, an interval of a few steps of the fine grid at a time:

    1. the coarse grid is marched to the end of the interval;
    2. the blocks near the boundary are chosen: those that it crosses, and all around them;
    3. blocks that were not among them take the value of the coarse grid, linear between its nodes;
       so does a rim around all of them, the lesser of the values at both ends of the interval;
    4. the chosen blocks are marched by the same sweep as any grid;
    5. the nodes of the coarse grid in them take the value of the fine one.

The boundary crosses at most one cell in a step, so that it stays within the chosen blocks. Where
the value of the coarse grid comes to zero elsewhere, as where a set falls apart, its blocks are
chosen too. Where all blocks are chosen, the values are those of the march over the whole fine grid,
to the bit. What is beyond an end of the grid is continued from the nodes of one of the two.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.blocks import Blocks, Flags
from holdfast.execution.level_set.level import Level
from holdfast.execution.level_set.march import ALL_MEASURED, MEASURED, March
from holdfast.execution.level_set.settling import Done
from holdfast.execution.level_set.workers import Workers

SIDE = {1: 16, 2: 8}
"""Nodes of a block along an axis but the last, by the number of axes."""

LEAST_SIDE = 4
"""The same with more axes, where the blocks around a boundary are a larger share of all."""

STRETCH = 16
"""Nodes of a block along the last axis."""

Interval = tuple[float, float, int, float | None]
"""Begin and step [s], the number of steps, and the time asked for that it ends at."""


class RefinedMarch:
    """A march over two grids; the values are those of the fine one, at all of its nodes."""

    def __init__(
        self, coarse: March, fine: March, periodic: Sequence[bool], ratio: int, *, side: float
    ) -> None:
        """ratio: of the lengths of their cells. side: of zero, on which it is looked how fast the
        set moves, 1 or -1."""
        self.coarse, self.fine, self.side = coarse, fine, side
        n = len(fine.shape)
        side = max(SIDE.get(n, LEAST_SIDE), ratio)
        sizes = [*[side] * (n - 1), int(fine.cut[3])]
        self.blocks = Blocks(fine.shape.tolist(), periodic, sizes, ratio)
        self.every = min(sizes) // 2  # steps of an interval
        self.reach = self.every + 2
        self.longest_step, self.crossing, self.code = fine.longest_step, fine.crossing, fine.code
        self.marched_share = 0.0  # the mean share of the fine grid's nodes in chosen blocks

    def run(
        self,
        values: Array,
        times: Sequence[float],
        *,
        upper: Array | None = None,
        lower: Array | None = None,
        refresh: Callable[[float], None] | None = None,
        floor: float = -math.inf,
        ceiling: float = math.inf,
        nearest: float = 0.0,
        keep: Callable[[float, Array], None] | None = None,
        tell: Callable[[Done, Callable[[], Array]], bool] | None = None,
        done: Done | None = None,
    ) -> Done:
        """As `March.run` from the beginning; `tell` is called after every interval.

        Bounds that move (`refresh`) are not for it.
        """
        assert refresh is None
        done, began, nodes = done or Done(), time.perf_counter(), 0.0
        pair = _Pair(self, values, (upper, lower), (floor, ceiling, nearest))
        with (
            Workers(self.fine.code, self.fine.threads, self.fine.places) as many,
            Workers(self.coarse.code, self.coarse.threads, self.coarse.places) as few,
        ):
            for interval in self._intervals(times):
                start, dt, steps, end = interval
                pair.march_coarse(few, interval)
                nodes += steps * self.blocks.count(pair.chosen)
                pair.march_fine(many, interval, done)
                done.time = start + steps * dt if end is None else end
                done.seconds = time.perf_counter() - began
                if keep is not None and end is not None:
                    keep(end, pair.whole())
                done.stopped = tell is not None and tell(done, pair.whole)
                if done.stopped:
                    break
            pair.whole()
        self.marched_share = nodes / max(done.steps * self.fine.nodes, 1)
        return done

    def _intervals(self, times: Sequence[float]) -> Iterator[Interval]:
        group: list[tuple[float, float, float | None]] = []
        for one in self.fine.steps_to(times):
            group.append(one)
            if len(group) == self.every or one[2] is not None:
                yield group[0][0], group[0][1], len(group), one[2]
                group = []


class _Pair:
    """The values on both grids, and the blocks that are chosen."""

    def __init__(
        self,
        march: RefinedMarch,
        values: Array,
        bounds: tuple[Array | None, Array | None],
        numbers: tuple[float, float, float],
    ) -> None:
        self.blocks, self.values, self.bounds = march.blocks, values, bounds
        self.reach, self.nearest, self.side = march.reach, numbers[2], march.side
        self.longest = march.coarse.longest_step
        thin = [None if a is None else self.blocks.thinned(a).ravel() for a in (values, *bounds)]
        assert thin[0] is not None
        self.fine = Level(march.fine, values, bounds, numbers)
        self.coarse = Level(march.coarse, thin[0], (thin[1], thin[2]), numbers)
        self.chosen = np.ones(self.blocks.counts, dtype=bool)  # all have the value to begin with
        self.before = thin[0]

    def march_coarse(self, workers: Workers, interval: Interval) -> None:
        """To the end of an interval, for which the blocks are chosen."""
        start, dt, steps, _ = interval
        blocks, coarse = self.blocks, self.coarse
        self.before = coarse.arrays[0].copy()
        count = max(1, math.ceil(steps * dt / self.longest - 1e-9))
        length = steps * dt / count
        coarse.start_over()
        for k in range(count):
            coarse.step(workers, start + k * length, length, measure=False, units=None)
        wanted = blocks.near(self.chosen, self.values, self.before, self.reach)
        self._fill(wanted & ~self.chosen, [self.values], self.before)
        lesser = np.minimum(self.before, coarse.arrays[0])
        self._fill(blocks.beside(wanted), self.fine.arrays, lesser)
        self.chosen = wanted

    def march_fine(self, workers: Workers, interval: Interval, done: Done) -> None:
        """The chosen blocks over the interval; `done` takes down the steps."""
        start, dt, steps, _ = interval
        fine, units = self.fine, self.blocks.units(self.chosen)
        fine.start_over(units)
        speed = 0.0
        for k in range(steps):
            last = k == steps - 1
            done.measured = last or done.steps < ALL_MEASURED or done.steps % MEASURED == 0
            computed, speed = fine.step(
                workers, start + k * dt, dt, measure=done.measured, units=units
            )
            done.computed += computed
            done.of += fine.march.units * fine.march.method.order
            done.steps += 1
            if last:
                speed = max(speed, self._loss() / (steps * dt))
            if done.measured:
                done.moved(speed)
        done.fixed = speed == 0.0 and not (fine.flags[0] & units).any()
        self._bring_together()

    def _bring_together(self) -> None:
        """The steps in the caller's array, and the fine values at nodes of the coarse grid."""
        blocks, fine = self.blocks, self.fine
        if fine.arrays[0] is not self.values:
            for flat, _ in blocks.nodes(self.chosen):
                self.values[flat] = fine.arrays[0][flat]
            fine.arrays.reverse()
        there = blocks.coarse_nodes(self.chosen)
        table = self.coarse.arrays[0].reshape(blocks.coarse)
        table[there] = blocks.thinned(self.values)[there]

    def whole(self) -> Array:
        """The values at all nodes of the fine grid."""
        self._fill(~self.chosen, [self.values], self.coarse.arrays[0])
        return self.values

    def _fill(self, chosen: Flags, arrays: Sequence[Array], coarse: Array) -> None:
        """The value of the coarse grid in blocks of the fine one, within its bounds."""
        upper, lower = self.bounds
        for flat, value in self.blocks.interpolated(chosen, coarse):
            found = value if lower is None else np.maximum(value, lower[flat])
            found = found if upper is None else np.minimum(found, upper[flat])
            for array in arrays:
                array[flat] = found

    def _loss(self) -> float:
        """The largest share of its value that a node of the coarse grid changed by in the interval,
        of those on that side of zero that are in no chosen block."""
        apart = ~self.blocks.coarse_nodes(self.chosen).ravel() & (self.side * self.before > 0)
        was, now = self.before[apart], self.coarse.arrays[0][apart]
        share = np.abs(now - was) / np.maximum(np.abs(was), max(self.nearest, 1e-300))
        return float(share.max(initial=0.0))
