"""Cells: a box of the states, divided, and sets of cells that are certified.

Some axes may be angles that come back to themselves. A certified cell has the number of its input.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array, Truths, Wholes


@dataclass(frozen=True)
class Cells:
    """counts[i] cells along axis i, between edges[i][0] and edges[i][-1].

    The edges are floats, and a cell is what lies between two of them, both included: neighbours
    share their edge, and nothing between them is lost. periodic: axes whose last edge is the first.
    """

    edges: tuple[Array, ...]
    periodic: tuple[bool, ...]

    @staticmethod
    def even(
        box: tuple[tuple[float, float], ...], counts: tuple[int, ...], periodic: tuple[bool, ...]
    ) -> Cells:
        edges = tuple(np.linspace(a, b, n + 1) for (a, b), n in zip(box, counts, strict=True))
        return Cells(edges, periodic)

    @cached_property
    def counts(self) -> tuple[int, ...]:
        return tuple(len(e) - 1 for e in self.edges)

    @cached_property
    def total(self) -> int:
        return math.prod(self.counts)

    def halved(self) -> Cells:
        """Every cell in two along each axis. Raises `SimulationError` where floats end."""
        return Cells(tuple(_with_middles(e) for e in self.edges), self.periodic)

    def corners(self, flat: Wholes) -> tuple[Array, Array]:
        """The low and the high corners of cells by their flat numbers, shapes (cells, axes)."""
        places = np.unravel_index(flat, self.counts)
        low = np.stack([e[p] for e, p in zip(self.edges, places, strict=True)], axis=1)
        high = np.stack([e[p + 1] for e, p in zip(self.edges, places, strict=True)], axis=1)
        return low, high

    def touched(self, low: Array, high: Array) -> tuple[Wholes, Wholes, Truths]:
        """The first and last cells along each axis that boxes touch, and whether they stay inside.

        Along a periodic axis numbers go on beyond the last cell, up to one turn.

        low, high: boxes, shape (boxes, states). The cells have that shape too, whether they stay
        inside (boxes,).
        """
        firsts, lasts, inside = [], [], np.ones(len(low), dtype=bool)
        for k, (edges, periodic) in enumerate(zip(self.edges, self.periodic, strict=True)):
            a, b = low[:, k], high[:, k]
            count = len(edges) - 1
            if periodic:
                turn = edges[-1] - edges[0]
                turns = np.floor((a - edges[0]) / turn)
                # both sides of an edge that rounding may have crossed
                room = 1e-12 * turn * (1 + np.abs(turns))
                a, b = a - turns * turn - room, b - turns * turn + room
                first = np.searchsorted(edges, a, side="left") - 1
                more = np.where(b > edges[-1], 1, 0)
                last = np.searchsorted(edges, b - more * turn, side="right") - 1 + more * count
                last = np.where(b > edges[-1], last, np.minimum(last, count - 1))
                behind = first < 0
                first, last = (
                    np.where(behind, first + count, first),
                    np.where(behind, last + count, last),
                )
                inside &= (b - a < turn) & (last - first < count)
            else:
                first = np.searchsorted(edges, a, side="left") - 1
                first = np.where(a == edges[0], 0, first)
                last = np.searchsorted(edges, b, side="right") - 1
                last = np.where(b == edges[-1], count - 1, last)
                inside &= (a >= edges[0]) & (b <= edges[-1])
            firsts.append(first)
            lasts.append(last)
        inside &= np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
        return np.stack(firsts, axis=1), np.stack(lasts, axis=1), inside


def _with_middles(edges: Array) -> Array:
    finer = np.empty(2 * len(edges) - 1)
    finer[::2], finer[1::2] = edges, 0.5 * edges[:-1] + 0.5 * edges[1:]
    if not (np.diff(finer) > 0).all():
        raise SimulationError("a cell is too narrow to be halved", remedy="halve less often")
    return finer


@dataclass(frozen=True)
class Halvings:
    """Cells of several sizes: those of depth g are the largest, halved g times along each axis.

    finest: the cells of the greatest depth, which is `depth`. The number of a cell is that of the
    first of the finest cells in it, and `finest.total` more for each time that it is twice as wide.
    """

    finest: Cells
    depth: int

    def grid(self, depth: int) -> Cells:
        """All cells of one depth."""
        step = 1 << (self.depth - depth)
        return Cells(tuple(e[::step] for e in self.finest.edges), self.finest.periodic)

    def numbers(self, flat: Wholes, depth: int) -> Wholes:
        """Of the cells that have these numbers in the grid of their depth, shape (cells,)."""
        doubled = self.depth - depth
        places = np.unravel_index(flat, self.grid(depth).counts)
        first = np.ravel_multi_index([p << doubled for p in places], self.finest.counts)
        ids: Wholes = first + doubled * self.finest.total
        return ids

    def has(self, numbers: Wholes) -> bool:
        """Whether all are numbers of cells: numbers (cells,)."""
        doubled, first = np.divmod(numbers, self.finest.total)
        if not ((doubled >= 0) & (doubled <= self.depth)).all():
            return False
        return all(not (p % (1 << doubled)).any()
                   for p in np.unravel_index(first, self.finest.counts))  # fmt: skip

    def spread(self, numbers: Wholes) -> tuple[Wholes, Wholes]:
        """The finest cells in cells, and for each of them the row of `numbers` that it is of:
        numbers (cells,), both results (finest cells,)."""
        rows, finest = [], []
        doubled, first = np.divmod(numbers, self.finest.total)
        axes = len(self.finest.counts)
        for k in range(self.depth + 1):
            some = np.flatnonzero(doubled == k)
            block = np.indices(axes * (1 << k,)).reshape(axes, -1)
            inside: Wholes = np.asarray(np.ravel_multi_index(list(block), self.finest.counts))
            rows.append(np.repeat(some, len(inside)))
            finest.append((first[some, None] + inside).reshape(-1))
        return np.concatenate(finest), np.concatenate(rows)


class Counted:
    """How many of a set of cells lie in a block, by sums over all smaller places."""

    def __init__(self, cells: Cells, members: Truths) -> None:
        """members: whether each cell is one, shape (cells,)."""
        grid = members.reshape(cells.counts)
        for axis, periodic in enumerate(cells.periodic):
            if periodic:  # blocks may go on beyond the last cell
                grid = np.concatenate([grid, grid], axis=axis)
        sums = grid.astype(np.int32)
        for axis in range(grid.ndim):
            sums = np.cumsum(sums, axis=axis, dtype=np.int32)
        self._sums = np.pad(sums, [(1, 0)] * grid.ndim)
        self._strides = np.array(self._sums.strides) // self._sums.itemsize
        self._flat = self._sums.reshape(-1)

    def all_of(self, first: Wholes, last: Wholes) -> Truths:
        """Whether every cell of each block is a member: first and last (blocks, states), the
        answers (blocks,)."""
        axes = first.shape[1]
        total = np.zeros(len(first), dtype=np.int64)
        for corner in range(2**axes):
            place = np.zeros(len(first), dtype=np.int64)
            sign = 1
            for axis in range(axes):
                if corner >> axis & 1:
                    place += self._strides[axis] * (last[:, axis] + 1)
                else:
                    place += self._strides[axis] * first[:, axis]
                    sign = -sign
            total += sign * self._flat[place]
        full: Truths = total == (last - first + 1).prod(axis=1)
        return full


@dataclass(frozen=True)
class Kept:
    """members: numbers of the cells that are kept; inputs: for each the one that keeps it.

    region: the cells that lie in the region. holds: sampling periods, None for ever. depth: how
    often cells were halved; `cells`, and all these numbers, are of the smallest. entries: rows
    (number in `Halvings`, input, level): the input leads from that cell to cells of a level one
    lower, as many periods as are left at most; the level is 0 for ever.
    """

    cells: Cells
    members: Wholes
    inputs: Wholes
    holds: int | None
    sweeps: int
    entries: Wholes
    region: Wholes
    depth: int = 0

    @staticmethod
    def of(
        halvings: Halvings, entries: Wholes, holds: int | None, sweeps: int, region: Wholes,
        *, target: bool = False,
    ) -> Kept:  # fmt: skip
        """Members are the cells of the entries that last longest; with a target, of all entries.
        entries: rows of cell, input and level, shape (entries, 3). region: cells, shape
        (cells,)."""
        final = entries if target else entries[entries[:, 2] == (holds or 0)]
        members, rows = halvings.spread(final[:, 0])
        order = np.argsort(members, kind="stable")
        members, inputs = members[order], final[rows[order], 1]
        region = np.union1d(region, members)  # a cell may lead to the target, and lie partly in it
        return Kept(
            halvings.finest, members, inputs, holds, sweeps, entries, region, halvings.depth
        )

    @property
    def inside(self) -> int:
        """How many cells lie in the region."""
        return len(self.region)

    @property
    def share(self) -> float:
        """Of the cells that lie in the region."""
        return len(self.members) / self.inside if self.inside else 0.0

    def spread(self) -> Wholes:
        """The entries, for each of the smallest cells that theirs are made of, shape (cells, 3)."""
        cell, rows = Halvings(self.cells, self.depth).spread(self.entries[:, 0])
        return np.concatenate([cell[:, None], self.entries[rows, 1:]], axis=1)
