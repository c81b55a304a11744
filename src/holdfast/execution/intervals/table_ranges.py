"""Between what a table of values at nodes lies over boxes, and between what its slopes.

The value is linear along every axis between two nodes, and so are its central differences over one
step; within one step of the end of a grid a difference is one-sided, and lies between those at the
two nodes around it. So over a box both lie between what they are at the nodes around it. A place
beyond the grid counts as the nearest place of it.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.table_in_parts import in_memory

Ends = tuple[Array, Array]
MOST = 64
"""Steps of the grid along an axis that a box may reach over; of a wider one nothing is known."""

FARTHEST = 1e9
"""Steps from the first node of a periodic axis; nothing is known beyond."""


class TableRanges:
    """A table of `interpolate.py`: its values, lowest nodes, steps, shape, and periodic axes.

    nodes: of the value, then of the slope along each axis, the ends at the nodes, both of the
    shape of the grid: they are apart by rounding.
    """

    def __init__(self, table: Any) -> None:
        values, low, steps, shape, periodic = table
        self.shape = tuple(int(n) for n in shape)
        self.values = np.asarray(in_memory(values), dtype=np.float64).reshape(self.shape)
        self.low, self.steps = np.asarray(low, float), np.asarray(steps, float)
        self.periodic = tuple(bool(p) for p in periodic)
        slopes = map(self._node_slopes, range(len(self.shape)))
        self.nodes: list[Ends] = [(self.values, self.values), *slopes]

    def over(self, low: Array, high: Array) -> tuple[Array, Array]:
        """The ends of the value and the slopes over boxes of places, shapes (boxes, 1 + axes)."""
        blocks = [self._block(axis, low[:, axis], high[:, axis]) for axis in range(low.shape[1])]
        shape = (len(low), len(self.nodes))
        least, most = np.full(shape, np.inf), np.full(shape, -np.inf)
        for offsets in itertools.product(*(range(int(n.max(initial=0)) + 1) for _, n in blocks)):
            there = np.ones(len(low), dtype=bool)
            for k, (_, more) in zip(offsets, blocks, strict=True):
                there &= k <= more
            some = np.flatnonzero(there)
            at = tuple(
                (first[some] + k) % n
                for k, (first, _), n in zip(offsets, blocks, self.shape, strict=True)
            )
            for k, (a, b) in enumerate(self.nodes):
                least[some, k] = np.minimum(least[some, k], a[at])
                most[some, k] = np.maximum(most[some, k], b[at])
        known = ~np.isinf(least)
        return np.where(known, least, np.nan), np.where(known, most, np.nan)

    def _node_slopes(self, axis: int) -> Ends:
        """The differences at the nodes along an axis, one-sided at its ends."""
        v, h = np.moveaxis(self.values, axis, 0), self.steps[axis]
        around = [v[-1:], v, v[:1]] if self.periodic[axis] else [v[:1], v, v[-1:]]
        wide = np.concatenate(around)
        apart = np.full(len(v), 2.0)
        if not self.periodic[axis]:
            apart[[0, -1]] = 1.0
        found = (wide[2:] - wide[:-2]) / (apart * h).reshape(-1, *(1,) * (v.ndim - 1))
        room = 2.0**-50 * np.abs(found)  # three roundings
        ends = (np.nextafter(found + side * room, side * np.inf) for side in (-1, 1))
        low, high = (np.moveaxis(e, 0, axis) for e in ends)
        return low, high

    def _block(self, axis: int, low: Array, high: Array) -> tuple[Any, Any]:
        """The first node around boxes, and how many more there are; -1 where not known."""
        with np.errstate(invalid="ignore", over="ignore"):
            a, b = ((end - self.low[axis]) / self.steps[axis] for end in (low, high))
            room = 2.0**-50 * (np.abs(a) + np.abs(b) + np.abs(self.low[axis] / self.steps[axis]))
            a, b = np.floor(a - room), np.ceil(b + room)
        last = self.shape[axis] - 1
        if self.periodic[axis]:
            known = (np.abs(a) < FARTHEST) & (b - a < MOST)
        else:
            a, b = np.clip(a, 0, last), np.clip(b, 0, last)
            known = b - a < MOST  # false for what is not a number
        more = np.where(known, b - a, -1.0)
        return np.where(known, a, 0.0).astype(np.int64), more.astype(np.int64)
