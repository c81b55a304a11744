"""Blocks of the nodes of a grid: which lie near a boundary, and their values from a coarser grid.

A fine grid has all nodes of a coarse one, and one more between two of them. Along the last axis a
block is a stretch of a row, a unit of a sweep (`units.py`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.block_sweep import CROSSED, CROSSED_HIGH, CROSSED_LOW

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
        found = np.zeros_like(flags)
        before, rows = np.moveaxis(flags, axis, 0), np.moveaxis(found, axis, 0)
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
        return found

    def near(self, chosen: Flags, crossed: Bits) -> Flags:
        """The blocks near a change of the sign of a value.

        crossed: where it changes in every block (`BlockTasks.crossed`): anywhere, in the first or
        the last nodes along the last axis. In other directions all blocks beside it are near.
        """
        found, last = (crossed & CROSSED) > 0, len(self.shape) - 1
        low = np.where(chosen, (crossed & CROSSED_LOW) > 0, found)
        high = np.where(chosen, (crossed & CROSSED_HIGH) > 0, found)
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

    def units(self, chosen: Flags) -> npt.NDArray[np.uint8]:
        """1 for the units of a sweep that are in chosen blocks; a unit is a stretch of a row."""
        of = [*self._blocks_of[:-1], np.arange(self.counts[-1])]
        return chosen[np.ix_(*of)].astype(np.uint8).ravel()

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
