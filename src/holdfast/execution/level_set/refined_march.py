"""A march over a coarse grid, and over finer ones in blocks around the boundary of the set.

Every grid has cells half as long as those of the one before. Two of them go on in turns, an
interval of a few steps of the finer one at a time:

    1. the coarser grid is marched to the end of the interval, with those that are coarser yet;
    2. the blocks near the boundary are chosen: those that it crosses, and all around them;
    3. blocks that were not among them take the value of the coarser grid, linear between its nodes;
       so does a rim around all of them, the lesser of the values at both ends of the interval;
    4. the chosen blocks are marched by the same sweep as any grid;
    5. the nodes of the coarser grid in them take the value of the finer one.

The boundary crosses at most a cell in an Euler step, so that it stays within the chosen blocks.
Where the value of the coarser grid comes to zero elsewhere, its blocks are chosen too. Where all
blocks are chosen, the values are those of the march over the whole finest grid, to the bit. What is
beyond an end of the grid is continued from the nodes of one grid.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.block_code import BlockTasks
from holdfast.execution.level_set.blocks import Blocks
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

Arrays = tuple[Array, Array | None, Array | None]
"""Values, and what bounds them above and below."""

Numbers = tuple[float, float, float]
"""Floor, ceiling, and distances from zero below which there is rounding only."""


class RefinedMarch:
    """A march over several grids; the values are those of the finest, at all of its nodes."""

    def __init__(self, marches: Sequence[March], periodic: Sequence[bool], *, side: float) -> None:
        """marches: each over a grid with cells half as long as those before. side: of zero, on
        which it is looked how fast the set moves, 1 or -1."""
        self.marches, self.fine, self.side = marches, marches[-1], side
        n = len(self.fine.shape)
        sizes = [*[SIDE.get(n, LEAST_SIDE)] * (n - 1), STRETCH]
        self.blocks = [Blocks(m.shape.tolist(), periodic, sizes) for m in marches[1:]]
        fine = self.fine
        self.every = max(min(sizes) // (2 * fine.method.steps.lengths), 1)  # steps of an interval
        self.longest_step, self.crossing, self.code = fine.longest_step, fine.crossing, fine.code
        self.refine = 2 ** len(self.blocks)
        self.complete: Callable[[], object] = lambda: None
        """Has the values at all nodes be those of the present time."""
        self.marched_share = 0.0
        """Nodes marched on all grids, in a mean step of the finest and as a share of its nodes."""

    def run(
        self,
        values: Array,
        times: Sequence[float],
        *,
        upper: Array | None = None,
        lower: Array | None = None,
        floor: float = -math.inf,
        ceiling: float = math.inf,
        nearest: float = 0.0,
        keep: Callable[[float], None] | None = None,
        tell: Callable[[Done], bool] | None = None,
    ) -> Done:
        """As `March.run` from the beginning; `tell` is called after every interval.

        Outside the blocks `values` are those of the time only after `complete`, and at the end.
        """
        done, began = Done(), time.perf_counter()
        with ExitStack() as stack:
            arrays, numbers = (values, upper, lower), (floor, ceiling, nearest)
            pair = self._pairs(arrays, numbers, stack)
            self.complete = pair.whole
            for start, dt, steps, end in self._intervals(times):
                pair.march(start, dt, steps, done)
                done.time = start + steps * dt if end is None else end
                done.seconds = time.perf_counter() - began
                if keep is not None and end is not None:
                    keep(end)
                done.stopped = tell is not None and tell(done)
                if done.stopped:
                    break
            pair.whole()
        self.complete = lambda: None  # it is; the threads have ended
        self.marched_share = pair.marched / max(done.steps * self.fine.nodes, 1)
        return done

    def _pairs(self, arrays: Arrays, numbers: Numbers, stack: ExitStack) -> _Pair:
        """Every grid with the coarser ones; the finest has these arrays."""
        thinner: list[Arrays] = [arrays]
        for blocks in reversed(self.blocks):
            own = [None if a is None else blocks.thinned(a).ravel() for a in thinner[0]]
            assert own[0] is not None
            thinner.insert(0, (own[0], own[1], own[2]))
        found: _Base | _Pair | None = None
        for k, (march, own_arrays) in enumerate(zip(self.marches, thinner, strict=True)):
            level = Level(march, own_arrays[0], own_arrays[1:], numbers)
            workers = stack.enter_context(Workers(march.code, march.threads, march.places))
            if found is None:
                found = _Base(level, workers)
            else:
                found = _Pair(level, workers, found, self.blocks[k - 1], self.every, self.side)
        assert isinstance(found, _Pair)
        return found

    def _intervals(
        self, times: Sequence[float]
    ) -> Iterator[tuple[float, float, int, float | None]]:
        """Begin and step [s], the number of steps, and which of `times` an interval ends at."""
        group: list[tuple[float, float, float | None]] = []
        for one in self.fine.steps_to(times):
            group.append(one)
            if len(group) == self.every or one[2] is not None:
                yield group[0][0], group[0][1], len(group), one[2]
                group = []


class _Base:
    """The coarsest grid, all of which is marched; marched: nodes, in all steps together."""

    def __init__(self, level: Level, workers: Workers) -> None:
        self.level, self.workers = level, workers
        self.marched = 0.0

    @property
    def values(self) -> Array:
        return self.level.arrays[0]

    def advance(self, start: float, length: float) -> None:
        march = self.level.march
        count = max(1, math.ceil(length / march.longest_step - 1e-9))
        self.level.start_over()
        for k in range(count):
            at = start + k * length / count
            self.level.step(self.workers, at, length / count, measure=False, units=None)
        self.marched += count * march.nodes


class _Pair:
    """A grid of which blocks are marched, with the coarser ones."""

    def __init__(
        self,
        level: Level,
        workers: Workers,
        coarser: _Base | _Pair,
        blocks: Blocks,
        every: int,
        side: float,
    ) -> None:
        self.level, self.workers, self.coarser = level, workers, coarser
        self.blocks, self.every, self.side = blocks, every, side
        self.values = level.arrays[0]
        self.tasks = BlockTasks(blocks, workers, level.march.code.kind.name)
        self.chosen = np.ones(blocks.counts, dtype=bool)  # all have the value to begin with
        self.cells = level.march.method.steps.lengths  # that the boundary crosses in a step
        self.own = 0.0

    @property
    def marched(self) -> float:
        return self.own + self.coarser.marched

    def advance(self, start: float, length: float) -> None:
        """So much further, all nodes of the grid."""
        count = max(1, math.ceil(length / self.level.march.longest_step - 1e-9))
        dt = length / count
        for k in range(0, count, self.every):
            self.march(start + k * dt, dt, min(self.every, count - k), Done())
        self.whole()

    def march(self, start: float, dt: float, steps: int, done: Done) -> None:
        """The coarser grids, then the chosen blocks over an interval; `done` takes down steps."""
        blocks, coarser = self.blocks, self.coarser
        values, tasks = self.values, self.tasks
        tasks.hand_down(self.chosen, values, coarser.values)  # a finer grid may have changed them
        before = coarser.values.copy()
        coarser.advance(start, steps * dt)
        crossed = tasks.crossed(self.chosen, values, before, self.every * self.cells + 2)
        wanted = blocks.near(self.chosen, crossed)
        bounds, rim = self.level.kept, blocks.beside(wanted)
        tasks.fill(wanted & ~self.chosen, [values], (before, before), bounds)
        tasks.fill(rim, self.level.arrays, (before, coarser.values), bounds)
        self.chosen = wanted
        self.own += steps * blocks.count(wanted)
        self._steps(start, dt, steps, before, done)
        if self.level.arrays[0] is not values:
            tasks.take_over(wanted, self.level.arrays[0], values)
            self.level.arrays.reverse()
        tasks.hand_down(wanted, values, coarser.values)

    def _steps(self, start: float, dt: float, steps: int, before: Array, done: Done) -> None:
        level, units, speed = self.level, self.blocks.units(self.chosen), 0.0
        level.start_over(units)
        self.workers.share(0, level.march.places)
        for k in range(steps):
            last = k == steps - 1
            done.measured = last or done.steps < ALL_MEASURED or done.steps % MEASURED == 0
            computed, speed = level.step(
                self.workers, start + k * dt, dt, measure=done.measured, units=units
            )
            done.computed += computed
            done.of += level.march.units * level.march.method.stages
            done.steps += 1
            if last:
                least = max(level.numbers[2], 1e-300)
                lost = self.tasks.loss(self.chosen, before, self.coarser.values, self.side, least)
                speed = max(speed, lost / (steps * dt))
            if done.measured:
                done.moved(speed)
        done.fixed = speed == 0.0 and not (level.flags[0] & units).any()

    def whole(self) -> Array:
        """The values at all nodes of this grid."""
        coarse = self.coarser.values
        self.tasks.fill(~self.chosen, [self.values], (coarse, coarse), self.level.kept)
        return self.values
