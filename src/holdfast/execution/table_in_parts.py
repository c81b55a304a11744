"""A table of which only what is looked up is in memory, and values between the nodes of any table.

Compiled code reads a table through the address of its first number. Here that address is the begin
of a stretch of reserved memory, as long as the table, of which the operating system gives a page
only when it is written. Before compiled code looks something up, the numbers that it will read are
fetched from where they are stored; so the code, and every bit that it computes, are the same as for
a table in memory.
"""

from __future__ import annotations

import mmap
import sys
import threading
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray, Array, Wholes
from holdfast.execution.codegen.scalar_llvm import called
from holdfast.execution.interpolate import numbers_of_places
from holdfast.execution.resources import check_memory, is_room_for

PAGE = 4096
"""Bytes that are given at a time."""

MOST_NODES = 1 << 19
"""Nodes that are fetched at a time."""

BYTES_A_SECOND, SECONDS_OF_A_FETCH = 2.5e8, 1e-3
"""About how fast a file is read and unpacked, and how long it takes to fetch for a few states."""

NO_RESERVE = getattr(mmap, "MAP_NORESERVE", 0x4000 if sys.platform == "linux" else 0)


class Source(Protocol):
    """Numbers in the order of a table that are somewhere else."""

    @property
    def size(self) -> int: ...
    @property
    def dtype(self) -> np.dtype[Any]: ...
    @property
    def room(self) -> int: ...
    def take(self, nodes: Wholes) -> AnyArray:
        """The numbers at places of the table, both of the shape (nodes,)."""

    def all(self) -> AnyArray:
        """All numbers, shape (numbers,)."""

    def in_turn(self) -> Iterator[AnyArray]:
        """All numbers in turn, each array of the shape (some numbers,)."""


class TableInParts:
    """The numbers of `source`, of which at most about `source.room` bytes are in memory.

    array: what compiled code reads. reads: how many numbers were fetched. using: the lock of
    whoever reads `array`, from `fetch` on, since another thread may have the pages given back.
    """

    def __init__(self, source: Source) -> None:
        self.source, self.dtype, self.reads = source, source.dtype, 0
        self._memory = _reserved(source.size * self.dtype.itemsize)
        self._marks = _reserved(source.size)
        self.array: AnyArray = np.frombuffer(self._memory, self.dtype, source.size)
        self._known = np.frombuffer(self._marks, np.uint8, source.size)
        self._fetched: list[Wholes] = []
        self._pages = 0
        self._whole: AnyArray | None = None
        self._loading, self.using = threading.Lock(), threading.RLock()

    def __reduce__(self) -> tuple[type, tuple[Source]]:
        return TableInParts, (self.source,)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TableInParts) and self.source == other.source

    def __hash__(self) -> int:
        return hash(self.source)

    @property
    def nbytes(self) -> int:
        """The bytes of the whole table."""
        return self.source.size * self.dtype.itemsize

    def whole(self) -> AnyArray:
        """All numbers in memory; `SimulationError` where they do not fit. Their shape is
        (numbers,)."""
        with self._loading:
            if self._whole is None:
                check_memory(
                    self.nbytes,
                    "the values of the kernel, which are needed as a whole here,",
                    "use hf.SafetyFilter, which reads the cells that it visits",
                )
                self._whole = self.source.all()
            return self._whole

    def values_at(self, points: Array, grid: tuple[AnyArray, ...]) -> Array:
        """`look_up.values_at`, of which it fetches what it needs. points: shape (count, axes). The
        values have the shape (count,)."""
        return self._found("interpolate_many", points, grid, sloped=False)

    def slopes_at(self, points: Array, grid: tuple[AnyArray, ...]) -> Array:
        """`look_up.slopes_at`, of which it fetches what it needs. points: shape (count, axes), as
        the slopes."""
        return self._found("slopes_many", points, grid, sloped=True)

    def fetch(self, points: Array, grid: tuple[AnyArray, ...], *, sloped: bool) -> None:
        """Fetch what is read at points (count, axes) and missing."""
        nodes = _nodes(points, grid, sloped)
        with self.using:
            if self._known[nodes].all():
                return
            missing = np.unique(nodes[(nodes >= 0) & (self._known[nodes] == 0)])
            if len(missing):
                if self._pages * PAGE > self.source.room:
                    self._forget()
                    missing = np.unique(nodes[nodes >= 0])
                self._take(missing)

    def _take(self, missing: Wholes) -> None:
        """Read these numbers from the source."""
        self.array[missing] = self.source.take(missing)
        self._fetched.append(missing)
        self._known[missing] = 1
        self.reads += len(missing)
        for size in (self.dtype.itemsize, 1):
            self._pages += int(np.count_nonzero(np.diff(missing * size // PAGE))) + 1

    def fetch_looked_up(self, points: Array, grid: tuple[AnyArray, ...]) -> None:
        """`fetch` of what a law looks up: the value and the slopes at the nearest places. points:
        shape (count, axes). grid: four arrays of the shape (axes,)."""
        low, steps, shape, periodic = grid
        ends = low + steps * (np.asarray(shape) - 1)
        nearest = np.minimum(np.maximum(points, low), ends)
        self.fetch(np.where(np.asarray(periodic, bool), points, nearest), grid, sloped=True)

    def _forget(self) -> None:
        """Give all pages back."""
        for nodes in self._fetched:
            self._known[nodes] = 0
        self._fetched, self._pages = [], 0
        if hasattr(mmap, "MADV_DONTNEED"):
            self._memory.madvise(mmap.MADV_DONTNEED)
            if sys.platform == "linux":
                self._marks.madvise(mmap.MADV_DONTNEED)

    def _found(
        self, name: str, points: Array, grid: tuple[AnyArray, ...], *, sloped: bool
    ) -> Array:
        axes = points.shape[1]
        each = (1 << axes) * (1 + 2 * axes * sloped)
        some = max(1, MOST_NODES // each)
        out = np.empty(points.shape if sloped else len(points))
        low, steps, shape, periodic = grid
        wholes = tuple(np.ascontiguousarray(a, dtype=np.int64) for a in (shape, periodic))
        room, whole = numbers_of_places(axes)
        for k in range(0, len(points), some):
            part = points[k : k + some]
            with self.using:
                self.fetch(part, grid, sloped=sloped)
                called(
                    "interpolate", name, len(part), self.array, part, low, steps, *wholes, axes,
                    out[k : k + some], np.empty(room), np.empty(whole, dtype=np.int64),
                )  # fmt: skip
        return out


def in_memory(values: AnyArray | TableInParts) -> AnyArray:
    """The numbers of a table, all of them in memory, shape (numbers,)."""
    return values.whole() if isinstance(values, TableInParts) else values


def in_turn(values: AnyArray | TableInParts) -> Iterator[AnyArray]:
    """The numbers of a table in rows, one after the other, each of the shape (some numbers,)."""
    if isinstance(values, TableInParts):
        yield from values.source.in_turn()
    else:
        yield values


def read_at(values: AnyArray | TableInParts) -> int:
    """The address at which compiled code reads a table of the shape (numbers,)."""
    array = values.array if isinstance(values, TableInParts) else values
    return array.ctypes.data


def for_look_ups(values: AnyArray | TableInParts, count: int) -> AnyArray | TableInParts:
    """All numbers of a table, where they fit and reading them takes less time than fetching.

    count: of the times that something is fetched.

    The shape is (numbers,).
    """
    if not isinstance(values, TableInParts):
        return values
    short = values.nbytes / BYTES_A_SECOND < count * SECONDS_OF_A_FETCH
    return values.whole() if short and is_room_for(values.nbytes) else values


def can_reserve() -> bool:
    """Whether this system gives memory page by page."""
    return hasattr(mmap, "MAP_PRIVATE") and hasattr(mmap, "MAP_ANONYMOUS")


def _reserved(size: int) -> mmap.mmap:
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | NO_RESERVE
    try:
        return mmap.mmap(-1, max(size, 1), flags=flags)
    except (OSError, OverflowError, ValueError) as error:
        raise SimulationError(
            f"{size / 2**30:.3g} GiB of addresses cannot be reserved ({error})",
            remedy="raise the limit of addresses (ulimit -v), or load it with lazy=False",
        ) from None


def _nodes(points: Array, grid: tuple[AnyArray, ...], sloped: bool) -> Wholes:
    """The nodes that are read at points, -1 among them where a point is outside."""
    low, steps, shape, periodic = grid
    axes = len(shape)
    wholes = (np.ascontiguousarray(a, dtype=np.int64) for a in (shape, periodic))
    room, whole = numbers_of_places(axes)
    out = np.empty(len(points) * (1 << axes) * (1 + 2 * axes * sloped), dtype=np.int64)
    called(
        "interpolate", "corners_many", len(points), np.ascontiguousarray(points), low, steps,
        *wholes, axes, int(sloped), out, np.empty(room), np.empty(whole, dtype=np.int64),
    )  # fmt: skip
    return out


Grid = tuple[AnyArray, ...]
"""The lowest nodes, the steps, the shape, and whether an axis is periodic."""


def values_at(values: AnyArray | TableInParts, points: Array, grid: Grid) -> Array:
    """The values at points (count, axes), linear along each axis; NaN outside the grid."""
    if isinstance(values, TableInParts):
        return values.values_at(points, grid)
    return _found("interpolate_many", values, points, grid, np.empty(len(points)))


def slopes_at(values: AnyArray | TableInParts, points: Array, grid: Grid) -> Array:
    """The central differences at points, interpolated, of shape (count, axes)."""
    if isinstance(values, TableInParts):
        return values.slopes_at(points, grid)
    return _found("slopes_many", values, points, grid, np.empty(points.shape))


def _found(name: str, values: AnyArray, points: Array, grid: Grid, out: Array) -> Array:
    low, steps, shape, periodic = grid
    room, whole = numbers_of_places(len(shape))
    whole_numbers = (np.ascontiguousarray(a, dtype=np.int64) for a in (shape, periodic))
    inputs: tuple[Any, ...] = (len(points), values, points, low, steps, *whole_numbers, len(shape))
    called("interpolate", name, *inputs, out, np.empty(room), np.empty(whole, dtype=np.int64))
    return out
