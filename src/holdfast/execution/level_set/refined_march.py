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

A fine grid has all nodes of a coarse one, and one more between two of them. Along the last axis a
block is a stretch of a row, a unit of a sweep. What is done with the nodes of blocks
(`block_sweep.py`) is machine code, run by threads. The code has an address of each array, so that
flags of blocks have a byte each and follow one another as the blocks do, the last axis fastest:

    values, upper, lower    (nodes,)                of a grid, at all of its nodes
    chosen                  (blocks of an axis, ...)    flags, with an axis for each of the grid
    crossed                 (blocks of an axis, ...)    bits, as `block_sweep.py` has them
    units                   (units,)                flags
    coarse                  (nodes of the coarser grid,)
    before, now             (nodes of the coarser grid,)
    out                     (nodes,)
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import cache
from importlib import resources
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.codegen.scalar_llvm import PACKED, scalars_text
from holdfast.execution.codegen.scalar_reader import read
from holdfast.execution.leaf import compiled_text
from holdfast.execution.level_set.block_sweep import CROSSED, CROSSED_HIGH, CROSSED_LOW
from holdfast.execution.level_set.march import ALL_MEASURED, MEASURED, Advances, Done, March
from holdfast.execution.level_set.sweeping import (
    ANYWHERE,
    Bounds,
    Counts,
    MarchArrays,
    Within,
    Workers,
    address,
    first_not_finite,
    on_one_side,
)
from holdfast.execution.resources import Room


class Level(MarchArrays):
    """The arrays of a march, and one step of it."""

    march: March

    def __init__(
        self,
        march: March,
        values: Array,
        bounds: tuple[Array | None, Array | None],
    ) -> None:
        """values and bounds, upper and lower, have the shape (nodes,)."""
        super().__init__(march, values, *bounds, np.empty_like)
        self.within = ANYWHERE

    def start_over(self, units: Array | None = None) -> None:
        """All units, or these, are to be computed in every stage."""
        self.flags[:] = 1 if units is None else units

    def step(
        self, workers: Workers, begin: float, dt: float, *, measure: bool, units: Array | None
    ) -> tuple[int, float]:
        """A step of all units, or of these, that are not settled: how many it computed, and how
        fast the set moved [cells/s]."""
        march, computed = self.march, 0
        counts, u = np.zeros(3), march.u(begin)
        for s, (weight, _) in enumerate(march.method.steps.stages):
            if units is not None:
                here = self.marks(s)[0]
                here &= units
            measures = s == self.stages - 1 and measure and self.within.nearest > 0
            counts = self.swept(workers, s, u, march.numbers(dt, weight, self.within), measures)
            computed += int(counts[0])
            if counts[1]:
                place = first_not_finite(self.out(s))
                raise march.not_finite(place, int(counts[1]), begin + dt)
            self.ended(s)
        return computed, float(counts[2]) / dt


Flags = npt.NDArray[np.bool_]
Bits = npt.NDArray[np.uint8]

RATIO = 2
"""Of the lengths of the cells."""


class Blocks:
    """The blocks of a grid of the `shape`, with as many nodes along each axis as `sizes` says.

    The last block along an axis may have fewer: its last node then stands for the missing ones.
    """

    def __init__(
        self, shape: Sequence[int], periodic: Sequence[bool], sizes: Sequence[int]
    ) -> None:
        self.shape, self.periodic, self.sizes = tuple(shape), tuple(periodic), tuple(sizes)
        self.counts = tuple(-(-n // s) for n, s in zip(shape, sizes, strict=True))
        self.coarse = tuple(
            n // RATIO if around else (n - 1) // RATIO + 1
            for n, around in zip(shape, periodic, strict=True)
        )
        self._blocks_of = [np.arange(n) // s for n, s in zip(shape, sizes, strict=True)]
        last = zip(shape, sizes, self.counts, strict=True)
        self._thin = [around and n - (c - 1) * s < s and c > 2
                      for (n, s, c), around in zip(last, periodic, strict=True)]  # fmt: skip
        """Axes around which the last block has fewer nodes: the one after it is near, too."""

    def wider(self, chosen: Flags, axes: int | None = None) -> Flags:
        """The chosen blocks and their neighbours along the first axes, diagonal ones too, in the
        same shape."""
        wide = chosen
        for i in range(len(self.shape) if axes is None else axes):
            wide = wide | self._shifted(wide, i, 1) | self._shifted(wide, i, -1)
        return wide

    def beside(self, chosen: Flags) -> Flags:
        """The blocks next to the chosen ones along an axis that are not chosen, in the same
        shape."""
        near = np.zeros_like(chosen)
        for i in range(len(self.shape)):
            near |= self._shifted(chosen, i, 1) | self._shifted(chosen, i, -1)
        return near & ~chosen

    def _shifted(self, flags: Flags, axis: int, by: int) -> Flags:
        """The flag of the block before each one along an axis, or of that after it (-1)."""
        shifted = np.zeros_like(flags)
        before, rows = np.moveaxis(flags, axis, 0), np.moveaxis(shifted, axis, 0)
        if by > 0:
            rows[1:] = before[:-1]
        else:
            rows[:-1] = before[1:]
        if self.periodic[axis]:
            here, there = (0, -1) if by > 0 else (-1, 0)
            rows[here] = before[there]
            if self._thin[axis]:
                here, there = (0, -2) if by > 0 else (-2, 0)
                rows[here] |= before[there]
        return shifted

    def near(self, chosen: Flags, crossed: Bits) -> Flags:
        """The blocks near a change of the sign of a value, in the same shape.

        crossed: where it changes in every block (`BlockTasks.crossed`): anywhere, in the first or
        the last nodes along the last axis. In other directions all blocks beside it are near.
        """
        close, last = (crossed & CROSSED) > 0, len(self.shape) - 1
        low = np.where(chosen, (crossed & CROSSED_LOW) > 0, close)
        high = np.where(chosen, (crossed & CROSSED_HIGH) > 0, close)
        close |= self._shifted(high, last, 1) | self._shifted(low, last, -1)
        return self._to_the_ends(self.wider(close, last))

    def _to_the_ends(self, chosen: Flags) -> Flags:
        """With the blocks at the ends of the grid beside them: what is beyond is continued from the
        nodes of one grid only."""
        extended = chosen.copy()
        for i, around in enumerate(self.periodic):
            if not around and self.counts[i] > 1:
                rows = np.moveaxis(extended, i, 0)
                rows[0] |= rows[1]
                rows[-1] |= rows[-2]
        return extended

    def units(self, chosen: Flags) -> npt.NDArray[np.uint8]:
        """1 for the units of a sweep that are in chosen blocks, shape (units,); a unit is a stretch
        of a row."""
        of = [*self._blocks_of[:-1], np.arange(self.counts[-1])]
        return chosen[np.ix_(*of)].astype(np.uint8).ravel()

    def thinned(self, values: Array) -> Array:
        """The values of the fine grid at the nodes of the coarse one, in the shape of the latter:
        (nodes of an axis, ...)."""
        return values.reshape(self.shape)[(slice(None, None, RATIO),) * len(self.shape)]

    def count(self, chosen: Flags) -> int:
        """The number of nodes in the chosen blocks."""
        held = chosen.astype(np.int64)
        for of in self._blocks_of:
            many = np.bincount(of)
            held = np.tensordot(many, held, axes=(0, 0))
        return int(held)


Numbers = npt.NDArray[Any]

ENTRIES = ("fill", "look_over", "hand_down", "take_over", "losses")
"""Of which the last alone counts something."""

ALONE = 32768
"""Nodes for which other threads are not worth waking."""


class BlockCode:
    """The addresses of its functions, for `Workers`, and the memory that a thread needs."""

    def __init__(self, precision: str) -> None:
        folder, files = resources.files(__package__), ("stencils", "block_sweep")
        parsed = read("\n".join((folder / f"{name}.py").read_text("utf-8") for name in files))
        single = precision == "float32"
        text = scalars_text(parsed, ENTRIES, single=single, fused=True, packed=True)
        self._machine = compiled_text(text, optimised=True)
        self.places = {name: self._machine.address(PACKED + name) for name in ENTRIES}
        self._kind = np.dtype(precision)

    def memory(self, sizes: Sequence[int]) -> tuple[Numbers, Numbers]:
        """For blocks of so many nodes along each axis: `room`, which is 0, and `rows`."""
        values = (2 ** (len(sizes) - 1) + 2) * (sizes[-1] + 2)
        room = np.zeros(8 * len(sizes) + 3, dtype=np.int64)
        return room, np.empty(values, dtype=self._kind)


@cache
def block_code(precision: str) -> BlockCode:
    """The code for "float32" or "float64"."""
    return BlockCode(precision)


class BlockTasks:
    """The blocks of a grid, the threads that work on them, and what they do."""

    def __init__(self, blocks: Blocks, workers: Workers, precision: str) -> None:
        self._blocks, self._code = blocks, block_code(precision)
        self._workers, self._alone = workers, Workers(1, 1)
        # Five numbers of every axis, one kind after the other: `of` in `block_sweep.py`.
        self._of = np.array([*blocks.shape, *blocks.coarse, *blocks.sizes, *blocks.counts,
                             *blocks.periodic], dtype=np.int64)  # fmt: skip

    def _run(self, name: str, count: int, *arguments: Any) -> Counts:
        """Shared by the threads where there is much to do; count: of the blocks."""
        several = count * math.prod(self._blocks.sizes) > ALONE
        workers = self._workers if several else self._alone
        workers.share(0, count)
        memory = [self._code.memory(self._blocks.sizes) for _ in range(workers.threads)]
        rows = np.array([[*map(address, of_thread), *arguments] for of_thread in memory])
        return workers.run(self._code.places[name], rows)

    def _of_chosen(self, name: str, chosen: Flags, *arguments: Any) -> None:
        blocks = np.flatnonzero(chosen)
        if len(blocks):
            self._run(name, len(blocks), address(blocks), *self._shape, *arguments)

    @property
    def _shape(self) -> tuple[int, int]:
        return address(self._of), len(self._blocks.shape)

    def fill(
        self,
        chosen: Flags,
        targets: Sequence[Numbers],
        coarse: tuple[Numbers, Numbers],
        bounds: tuple[Numbers | None, Numbers | None],
    ) -> None:
        """The chosen blocks from the lesser of two values on the coarser grid, within bounds.

        It is linear along every axis, and at the nodes of the coarser grid that of this grid.
        targets, bounds (upper and lower): each (nodes,).
        coarse: each (nodes of the coarser grid,).
        """
        to = np.array([address(t) for t in targets], dtype=np.int64)
        limits = (0 if a is None else address(a) for a in bounds)
        self._of_chosen("fill", chosen, *map(address, coarse), address(to), len(to), *limits)

    def crossed(self, chosen: Flags, values: Numbers, coarse: Numbers, reach: int) -> Bits:
        """Where the sign of a value changes in every block, as `Blocks.near` reads it, in the shape
        of the chosen ones.

        In the chosen blocks the value is that of their grid, in others that of the coarser one.
        """
        bits = np.zeros(chosen.shape, dtype=np.uint8)
        arguments = (address(chosen), address(values), address(coarse), reach, address(bits))
        self._run("look_over", chosen.size, *self._shape, *arguments)
        return bits

    def hand_down(self, chosen: Flags, values: Numbers, coarse: Numbers) -> None:
        """The values of the chosen blocks to the nodes of the coarser grid in them."""
        self._of_chosen("hand_down", chosen, address(values), address(coarse))

    def take_over(self, chosen: Flags, values: Numbers, out: Numbers) -> None:
        """The values of the chosen blocks to another array."""
        self._of_chosen("take_over", chosen, address(values), address(out))

    def loss(
        self, chosen: Flags, before: Numbers, now: Numbers, side: float, nearest: float
    ) -> float:
        """The largest share of its value that a node of the coarser grid changed by, of those on a
        side of zero (1 or -1) that are in no chosen block."""
        numbers = np.array([side, nearest])
        arguments = (address(chosen), address(before), address(now), address(numbers))
        return float(self._run("losses", chosen.size, *self._shape, *arguments)[2])


SIDE = {1: 16, 2: 8}
"""Nodes of a block along an axis but the last, by the number of axes."""

LEAST_SIDE = 4
"""The same with more axes, where the blocks around a boundary are a larger share of all."""

STRETCH = 16
"""Nodes of a block along the last axis."""


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
        self.longest_step, self.crossing, self.name = fine.longest_step, fine.crossing, fine.name

    def sweeping(
        self,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        room: Room | None = None,
        bounds: Bounds | None = None,
    ) -> tuple[RefinedSweeping, Advances]:
        """As `March.sweeping`, in memory, of bounds that do not move; values and bounds have the
        shape (nodes,) of the finest grid."""
        sweeping = RefinedSweeping(self, values, upper, lower)
        return sweeping, sweeping.advances

    def intervals(self, times: Sequence[float]) -> Iterator[tuple[float, float, int, float | None]]:
        """Begin and step [s], the number of steps, and which of `times` an interval ends at."""
        group: list[tuple[float, float, float | None]] = []
        for one in self.fine.steps_to(times):
            group.append(one)
            if len(group) == self.every or one[2] is not None:
                yield group[0][0], group[0][1], len(group), one[2]
                group = []


class RefinedSweeping:
    """Every grid with its values and threads, in a `with` statement as `Sweeping`; outside the
    blocks the values of the finest are those of the present time only when they are asked for."""

    def __init__(
        self, march: RefinedMarch, values: Array, upper: Array | None, lower: Array | None
    ) -> None:
        self._march, self._threads = march, ExitStack()
        of_grid = [values, upper, lower]
        grids = [of_grid]
        for blocks in reversed(march.blocks):
            of_grid = [None if a is None else blocks.thinned(a).ravel() for a in of_grid]
            grids.insert(0, of_grid)
        coarsest, *finer = zip(march.marches, grids, strict=True)
        self._grids: list[_Base | _Pair] = [_Base(*self._level(*coarsest))]
        for blocks, of_one in zip(march.blocks, finer, strict=True):
            coarser = self._grids[-1]
            self._finest = _Pair(*self._level(*of_one), coarser, blocks, march.every, march.side)
            self._grids.append(self._finest)

    def _level(self, march: March, arrays: Sequence[Array | None]) -> tuple[Level, Workers]:
        values, upper, lower = arrays
        assert values is not None
        workers = Workers(march.threads, march.places)
        return Level(march, values, (upper, lower)), workers

    def __enter__(self) -> RefinedSweeping:
        for grid in self._grids:
            self._threads.enter_context(grid.workers)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        if kind is None:
            self._finest.whole()
        self._threads.__exit__(kind, error, at)

    def advances(
        self, times: Sequence[float], within: Within, done: Done
    ) -> Iterator[float | None]:
        """As `Advances` from the beginning, an interval at a time."""
        for grid in self._grids:
            grid.level.within = within
        for start, dt, steps, end in self._march.intervals(times):
            self._finest.march(start, dt, steps, done)
            done.time = start + steps * dt if end is None else end
            done.marched = sum(grid.marched for grid in self._grids)
            yield end

    def values(self) -> Array:
        """The values at all nodes of the finest grid, shape (nodes,), between two intervals."""
        return self._finest.whole()

    def largest(self) -> float:
        return float(self.values().max())

    def on_one_side(self, limit: str) -> bool:
        return on_one_side(self.values(), limit)


class _Base:
    """The coarsest grid, all of which is marched; marched: nodes, in all steps together."""

    def __init__(self, level: Level, workers: Workers) -> None:
        self.level, self.workers = level, workers
        self.marched = 0.0

    @property
    def values(self) -> Array:
        """At all nodes of this grid, shape (nodes,)."""
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
        self.marched = 0.0

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
        self.marched += steps * blocks.count(wanted)
        self._steps(start, dt, steps, before, done)
        if self.level.arrays[0] is not values:
            tasks.take_over(wanted, self.level.arrays[0], values)
            self.level.exchange()
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
                least = max(level.within.nearest, 1e-300)
                lost = self.tasks.loss(self.chosen, before, self.coarser.values, self.side, least)
                speed = max(speed, lost / (steps * dt))
            if done.measured:
                done.moved(speed)
        done.fixed = speed == 0.0 and not (level.flags[0] & units).any()

    def whole(self) -> Array:
        """The values at all nodes of this grid, shape (nodes,)."""
        coarse = self.coarser.values
        self.tasks.fill(~self.chosen, [self.values], (coarse, coarse), self.level.kept)
        return self.values
