"""Blocks of the nodes of a grid: which lie near a boundary, and their values from a coarser grid.

A fine grid has all nodes of a coarse one, and one more between two of them. Along the last axis a
block is a stretch of a row, a unit of a sweep (`units.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray as Array

Flags = npt.NDArray[np.bool_]
Places = npt.NDArray[np.int64]

RATIO = 2
"""Of the lengths of the cells."""

TOGETHER = 1 << 20
"""Nodes of blocks that are looked at together, at most."""


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
        self._strides = [math.prod(shape[i + 1 :]) for i in range(len(shape))]

    def _places(self, axis: int, ahead: int) -> Places:
        """The places along an axis of the nodes of every block, and of so many after them."""
        size, n = self.sizes[axis], self.shape[axis]
        found = np.arange(self.counts[axis])[:, np.newaxis] * size + np.arange(size + ahead)
        if ahead and self.periodic[axis]:
            last = found[:, :size].max(axis=1, initial=0)
            found = np.where(last[:, np.newaxis] < n, found % n, found)
        return np.minimum(found, n - 1)

    def nodes(self, chosen: Flags, ahead: int = 0) -> Iterator[tuple[Places, Places]]:
        """The nodes of the chosen blocks, some blocks at a time, flat, and which blocks these are.

        Shapes (blocks, nodes along each axis) and (blocks, axes). ahead: so many nodes more.
        """
        rows = np.argwhere(chosen)
        together = max(1, TOGETHER // math.prod(s + ahead for s in self.sizes))
        tables = [self._places(i, ahead) * s for i, s in enumerate(self._strides)]
        for first in range(0, len(rows), together):
            some = rows[first : first + together]
            flat = np.zeros(1, dtype=np.int64)
            for i, table in enumerate(tables):
                flat = flat + table[some[:, i]].reshape(len(some), *self._along(i, table.shape[1]))
            yield flat, some

    def wider(self, chosen: Flags, axes: int | None = None) -> Flags:
        """The chosen blocks and their neighbours along the first axes, diagonal ones too."""
        found = chosen
        for i in range(len(self.shape) if axes is None else axes):
            found = found | self._shifted(found, i, 1) | self._shifted(found, i, -1)
        return found

    def beside(self, chosen: Flags) -> Flags:
        """The blocks next to the chosen ones along an axis that are not chosen."""
        found = np.zeros_like(chosen)
        for i in range(len(self.shape)):
            found |= self._shifted(chosen, i, 1) | self._shifted(chosen, i, -1)
        return found & ~chosen

    def _shifted(self, flags: Flags, axis: int, by: int) -> Flags:
        """The flag of the block before each one along an axis, or of that after it (-1)."""
        found = np.roll(flags, by, axis)
        if not self.periodic[axis]:
            np.moveaxis(found, axis, 0)[0 if by > 0 else -1] = False
        return found

    def near(self, chosen: Flags, values: Array, coarse: Array, reach: int) -> Flags:
        """The blocks with nodes that are near a change of the sign of a value.

        Within so many nodes along the last axis, and as many as a block has along the others. In
        the chosen blocks the value is that of the fine grid, in others that of the coarse one.
        """
        found = self._crossed_on_coarse(coarse) & ~chosen
        low, high = found.copy(), found.copy()
        parts = ((found, slice(None)), (low, slice(reach + 1)), (high, slice(-reach - 1, None)))
        signs: list[list[Flags]] = [[], [], []]
        for flat, _ in self.nodes(chosen, ahead=1):
            inside = values[flat] > 0
            for kept, (_, part) in zip(signs, parts, strict=True):
                rows = inside[..., part].reshape(len(flat), -1)
                kept.append(np.logical_and(rows.any(axis=1), ~rows.all(axis=1)))
        for kept, (flags, _) in zip(signs, parts, strict=True):
            if kept:
                flags[chosen] = np.concatenate(kept)
        last = len(self.shape) - 1
        found |= self._shifted(high, last, 1) | self._shifted(low, last, -1)
        return self._to_the_ends(self.wider(found, last))

    def _to_the_ends(self, chosen: Flags) -> Flags:
        """With the blocks at the ends of the grid beside them: what is beyond is continued from the
        nodes of one grid only."""
        found = chosen.copy()
        for i, around in enumerate(self.periodic):
            if not around and self.counts[i] > 1:
                rows = np.moveaxis(found, i, 0)
                rows[0] |= rows[1]
                rows[-1] |= rows[-2]
        return found

    def _crossed_on_coarse(self, coarse: Array) -> Flags:
        inside = coarse.reshape(self.coarse) > 0
        some = every = inside
        for i, around in enumerate(self.periodic):
            some, every = self._any(some, i, around), ~self._any(~every, i, around)
        return some & ~every

    def _any(self, flags: Flags, axis: int, around: bool) -> Flags:
        """Along an axis for every block: whether a coarse node in it, or on either side, is set."""
        rows = np.moveaxis(flags, axis, 0)
        beyond = rows[:1] if around else rows[-1:]
        rows = np.concatenate([rows, beyond, np.zeros_like(beyond)])
        begins = np.arange(self.counts[axis]) * self.sizes[axis]
        ends = np.minimum(begins + self.sizes[axis], self.shape[axis])
        parts = np.stack([begins // RATIO, -(-ends // RATIO) + 1], axis=1).ravel()
        return np.moveaxis(np.logical_or.reduceat(rows, parts)[::2], 0, axis)

    def interpolated(self, chosen: Flags, coarse: Array) -> Iterator[tuple[Places, Array]]:
        """The nodes of chosen blocks, flat, and the value on the coarse grid there.

        It is linear along every axis, and at the nodes of the coarse grid that of this grid.
        """
        table = coarse.reshape(self.coarse)
        for flat, rows in self.nodes(chosen):
            window: list[Places] = []
            for i, (size, n) in enumerate(zip(self.sizes, self.coarse, strict=True)):
                ahead = np.arange(-(-size // RATIO) + 1)
                at = rows[:, i, np.newaxis] * (size // RATIO) + ahead
                at = at % n if self.periodic[i] else np.minimum(at, n - 1)
                window.append(at.reshape(len(rows), *self._along(i, len(ahead))))
            found = table[tuple(window)]
            for i in range(len(self.shape)):
                found = _halved(found, i + 1)
            yield flat, self._ended(found, rows)

    def _along(self, axis: int, count: int) -> list[int]:
        return [count if i == axis else 1 for i in range(len(self.shape))]

    def _ended(self, values: Array, rows: Places) -> Array:
        """With the value of the last node for those that a last block has not."""
        for i, (count, size, n) in enumerate(zip(self.counts, self.sizes, self.shape, strict=True)):
            there = n - (count - 1) * size
            if there < size and self.periodic[i]:
                last = rows[:, i] == count - 1
                along = np.moveaxis(values, i + 1, 1)
                along[last, there:] = along[last, there - 1 : there]
        return values

    def units(self, chosen: Flags) -> npt.NDArray[np.uint8]:
        """1 for the units of a sweep that are in chosen blocks; a unit is a stretch of a row."""
        of = [*self._blocks_of[:-1], np.arange(self.counts[-1])]
        return chosen[np.ix_(*of)].astype(np.uint8).ravel()

    def coarse_nodes(self, chosen: Flags) -> Flags:
        """Which nodes of the coarse grid are in chosen blocks."""
        return chosen[np.ix_(*(b[::RATIO] for b in self._blocks_of))]

    def thinned(self, values: Array) -> Array:
        """The values of the fine grid at the nodes of the coarse one."""
        return values.reshape(self.shape)[(slice(None, None, RATIO),) * len(self.shape)]

    def count(self, chosen: Flags) -> int:
        """The number of nodes in the chosen blocks."""
        held = chosen.astype(np.int64)
        for of in self._blocks_of:
            many = np.bincount(of)
            held = np.tensordot(many, held, axes=(0, 0))
        return int(held)


def _halved(values: Array, axis: int) -> Array:
    """With the mean of two neighbours along an axis between them; without the last."""
    shape = list(values.shape)
    shape[axis] = RATIO * (shape[axis] - 1)
    found = np.empty(shape, dtype=values.dtype)
    rows, out = np.moveaxis(values, axis, 0), np.moveaxis(found, axis, 0)
    out[::RATIO] = rows[:-1]
    np.add(rows[:-1], rows[1:], out=out[1::RATIO])
    out[1::RATIO] *= 0.5
    return found
