"""Values of a file, read chunk by chunk when asked for, and tables of them that laws look up."""

from __future__ import annotations

import math
import os
import threading
import weakref
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import xarray as xr
from xarray.core import indexing

from holdfast.errors import OutputError
from holdfast.execution.arrays import AnyArray
from holdfast.execution.table_in_parts import TableInParts
from holdfast.host.files import check_file, undisturbed

T = TypeVar("T")
Whole = npt.NDArray[np.int64]
Key = int | slice

CACHE = 256 * 2**20
"""Bytes of chunks that are kept in memory by default."""

_unused: deque[Any] = deque()
"""Files to be closed by whoever reads next: objects are forgotten at any time, in any thread."""


@dataclass(frozen=True)
class Stamp:
    """By which a file is known again: its bytes, and when it was written [ns]."""

    bytes: int
    written: int

    @classmethod
    def of(cls, path: Path) -> Stamp:
        """That of a file; raises `ScenarioError` where there is none."""
        check_file(path)
        return cls.of_status(path.stat())

    @classmethod
    def of_status(cls, status: os.stat_result) -> Stamp:
        return cls(status.st_size, status.st_mtime_ns)


class _File:
    """An open file, closed when nobody needs it any more."""

    def __init__(self, path: Path) -> None:
        from netCDF4 import Dataset

        self.dataset = _read(lambda: Dataset(path))
        weakref.finalize(self, _unused.append, self.dataset)
        self._descriptor = os.open(path, os.O_RDONLY)  # after it, to be of this file or a later one
        weakref.finalize(self, os.close, self._descriptor)

    def stamp(self) -> Stamp:
        """That of the open file, which may have another name by now."""
        return Stamp.of_status(os.fstat(self._descriptor))


class StoredValues:
    """The array `name` of a NetCDF file, of which chunks are read and the last ones are kept.

    name: with its group before it, as in "part_1/value", where it is not in the root.
    room: bytes of chunks that are kept. chunks_read, bytes_read: how often the file was read, and
    the bytes of numbers that came from it, before compression. The file stays open, so that one
    that replaces it under its name does not mix with it. stamp: of the file when it was opened
    first, here or in another process.

    Raises `OutputError` for a file that has another.
    """

    def __init__(
        self,
        path: Path,
        name: str = "value",
        room: int = CACHE,
        file: _File | None = None,
        stamp: Stamp | None = None,
    ) -> None:
        self.path, self.name, self.room = path.absolute(), name, room
        self.stamp = stamp or Stamp.of(self.path)
        self.chunks_read = self.bytes_read = 0
        self._kept: OrderedDict[tuple[int, ...], AnyArray] = OrderedDict()
        self._lock = threading.Lock()
        self._file = self._opened() if file is None else file
        _read(self._look)

    def _look(self) -> None:
        """Find the array in its file."""
        self._variable = self._file.dataset[self.name]
        self._variable.set_auto_maskandscale(False)
        self._variable.set_var_chunk_cache(0, 1, 0.0)  # chunks are kept here, and once
        self.shape: tuple[int, ...] = tuple(int(n) for n in self._variable.shape)
        self.dtype: np.dtype[Any] = np.dtype(self._variable.dtype).newbyteorder("=")
        chunks = self._variable.chunking()
        self.chunks = (
            _slabs(self.shape, self.dtype) if chunks == "contiguous" else tuple(map(int, chunks))
        )

    def _opened(self) -> _File:
        file = _File(self.path)
        self._check_same(file)
        return file

    def _check_same(self, file: _File) -> None:
        if file.stamp() != self.stamp:
            raise OutputError(
                f"{self.path} is not the file that it was when its values were loaded",
                remedy="load it again",
            )

    def __getstate__(self) -> tuple[Path, str, int, None, Stamp]:
        return self.path, self.name, self.room, None, self.stamp

    def __setstate__(self, state: tuple[Path, str, int, None, Stamp]) -> None:
        self.__init__(*state)  # type: ignore[misc]

    def __eq__(self, other: object) -> bool:
        """Whether it is the same array of the same file, unchanged since."""
        return isinstance(other, StoredValues) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Path, str, Stamp]:
        return self.path, self.name, self.stamp

    @property
    def size(self) -> int:
        """The number of entries."""
        return math.prod(self.shape)

    def beside(self, name: str) -> StoredValues:
        """Another array of the same file."""
        return StoredValues(self.path, name, self.room, self._file, self.stamp)

    def read(self, key: tuple[Any, ...]) -> Any:
        """The entries at a number, a slice or several numbers along every axis."""
        along = [np.arange(n)[k].reshape(-1) % n for k, n in zip(key, self.shape, strict=True)]
        out = np.empty([len(a) for a in along], self.dtype)
        touched = [np.unique(a // c) for a, c in zip(along, self.chunks, strict=True)]
        for place in product(*touched):
            positions = [
                np.flatnonzero(a // c == k)
                for a, c, k in zip(along, self.chunks, place, strict=True)
            ]
            inside = [a[o] % c for a, o, c in zip(along, positions, self.chunks, strict=True)]
            chunk = self._chunk(tuple(int(k) for k in place))
            out[np.ix_(*positions)] = chunk[np.ix_(*inside)]
        whole = (isinstance(k, int | np.integer) for k in key)
        return out[tuple(0 if w else slice(None) for w in whole)]

    def take(self, nodes: Whole) -> AnyArray:
        """The entries of these numbers in the order of the array. Both have the shape (nodes,)."""
        places = np.stack(np.unravel_index(nodes, self.shape), axis=1)
        chunks = np.array(self.chunks)
        counts = [-(-n // c) for n, c in zip(self.shape, self.chunks, strict=True)]
        numbers = np.ravel_multi_index(tuple((places // chunks).T), counts)
        out = np.empty(len(nodes), self.dtype)
        order = np.argsort(numbers, kind="stable")
        touched, first = np.unique(numbers[order], return_index=True)
        for number, rows in zip(touched, np.split(order, first[1:]), strict=True):
            place = np.unravel_index(int(number), counts)
            chunk = self._chunk(tuple(int(k) for k in place))
            out[rows] = chunk[tuple((places[rows] % chunks).T)]
        return out

    def entries(self, first: tuple[Key, ...]) -> AnyArray:
        """All entries below these along the first axes, past the chunks that are kept, shape (rest
        of the axes, ...)."""
        rest = self.shape[len(first) :]
        return self._from_file((*first, *(slice(0, n) for n in rest)))

    def _chunk(self, place: tuple[int, ...]) -> AnyArray:
        cached = self._known(place)
        return _read(lambda: self._kept_from(place)) if cached is None else cached

    def _known(self, place: tuple[int, ...]) -> AnyArray | None:
        with self._lock:
            if place in self._kept:
                self._kept.move_to_end(place)
            return self._kept.get(place)

    def _kept_from(self, place: tuple[int, ...]) -> AnyArray:
        """A chunk that no other thread reads now, and one may have read just before."""
        if (cached := self._known(place)) is not None:
            return cached
        key = tuple(
            slice(k * c, min((k + 1) * c, n))
            for k, c, n in zip(place, self.chunks, self.shape, strict=True)
        )
        chunk = self._from_file(key)
        most = max(1, self.room // (math.prod(self.chunks) * self.dtype.itemsize))
        with self._lock:
            self._kept[place] = chunk
            while len(self._kept) > most:
                self._kept.popitem(last=False)
        return chunk

    def _from_file(self, key: tuple[Key, ...]) -> AnyArray:
        try:
            entries: AnyArray = _read(lambda: np.asarray(self._variable[key], self.dtype))
        except (RuntimeError, OSError, MemoryError) as error:
            self._check_same(self._file)
            raise OutputError(
                f"{self.path} is damaged: a part of '{self.name}' cannot be read ({error})",
                remedy="compute it again, or fetch it again",
            ) from None
        self._check_same(self._file)
        self.chunks_read += 1
        self.bytes_read += entries.nbytes
        return entries


class _InXarray(xr.backends.BackendArray):
    """Stored values as what xarray reads when it is asked for numbers."""

    def __init__(self, stored: StoredValues) -> None:
        self.stored, self.shape, self.dtype = stored, stored.shape, stored.dtype

    def __deepcopy__(self, memo: object) -> _InXarray:
        return self

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER, self.stored.read
        )


def as_read(dataset: xr.Dataset, stored: StoredValues) -> xr.Dataset:
    """The dataset with the stored values in place of its array of their name."""
    name = stored.name.rpartition("/")[2]
    old = dataset.variables[name]
    new = xr.Variable(old.dims, indexing.LazilyIndexedArray(_InXarray(stored)), old.attrs)
    return dataset.assign({name: new})


def _read(work: Callable[[], T]) -> T:
    """The result of `work` with files; those that nobody uses are closed before."""

    def after_closing() -> T:
        while _unused:
            _unused.popleft().close()
        return work()

    return undisturbed(after_closing)


def _slabs(shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, ...]:
    """How an array that has no chunks is read: in parts of a few hundred KiB, as they lie."""
    chunks = [1] * len(shape)
    room = max(1, 2**18 // dtype.itemsize)
    for axis in reversed(range(len(shape))):
        chunks[axis] = min(shape[axis], room)
        room //= max(1, chunks[axis])
        if not room or chunks[axis] < shape[axis]:
            break
    return tuple(chunks)


Change = Callable[[AnyArray], AnyArray]


MOST_OF_LAYERS = 4
"""Times the room of kept chunks that a layer of chunks may take, so that each is read once."""


class Part:
    """Stored values at one of several times (or all), as the source of a table.

    of: what becomes of every number.
    """

    def __init__(
        self, stored: StoredValues, time: int | None = None, of: Change = np.asarray
    ) -> None:
        self.stored, self.of = stored, of
        self._first = () if time is None else (time % stored.shape[0],)
        self._shape = stored.shape[len(self._first) :]
        self.size, self.room = math.prod(self._shape), stored.room
        self.dtype = of(np.zeros(1, stored.dtype)).dtype

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Part) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[StoredValues, tuple[int, ...], Change]:
        return self.stored, self._first, self.of

    def take(self, nodes: npt.NDArray[np.int64]) -> AnyArray:
        """The entries of these numbers; both have the shape (nodes,)."""
        return self.of(self.stored.take(nodes + sum(self._first) * self.size))

    def all(self) -> AnyArray:
        """All entries in one row, past the chunks that are kept, shape (entries,)."""
        return self.of(self.stored.entries(self._first).reshape(-1))

    def in_turn(self) -> Iterator[AnyArray]:
        """All entries in rows, one slab after the other, each of the shape (some entries,)."""
        return (slab.reshape(-1) for slab in self.slabs())

    def slabs(self) -> Iterator[AnyArray]:
        """The entries in parts along the first axis: one layer of chunks at a time: (some of the
        first axis, nodes of the others, ...)."""
        axis = len(self._first)
        n, some = self.stored.shape[axis], self.stored.chunks[axis]
        for k in range(0, n, some):
            yield self.of(self.stored.entries((*self._first, slice(k, min(k + some, n)))))


class StoredTables:
    """The stored arrays of a value function by name.

    highest: the largest value at every time, where the file says it.
    """

    def __init__(self, arrays: Mapping[str, StoredValues], highest: Any = None) -> None:
        self.arrays, self._highest = arrays, highest
        self._made: dict[tuple[str, int | None, Change], TableInParts] = {}
        self._making = threading.Lock()

    def __getstate__(self) -> tuple[Mapping[str, StoredValues], Any]:
        return self.arrays, self._highest

    def __setstate__(self, state: tuple[Mapping[str, StoredValues], Any]) -> None:
        self.__init__(*state)  # type: ignore[misc]

    @property
    def values(self) -> StoredValues:
        """The values themselves."""
        return self.arrays["value"]

    @property
    def bytes_read(self) -> int:
        """The bytes of numbers that were read so far, before compression."""
        return sum(a.bytes_read for a in self.arrays.values())

    @property
    def chunks_read(self) -> int:
        """How many chunks, or parts of several, were read so far."""
        return sum(a.chunks_read for a in self.arrays.values())

    def table(
        self, time: int | None = None, name: str = "value", of: Change = np.asarray
    ) -> TableInParts:
        """The table of an array; that of the time that was asked for last is kept."""
        key = name, time, of
        with self._making:
            if key not in self._made:
                for other in [k for k in self._made if k[0] == name and k[1] != time]:
                    del self._made[other]
                self._made[key] = TableInParts(Part(self.arrays[name], time, of))
            return self._made[key]

    def of_law(self, time: int | None = None) -> TableInParts:
        """A table of the values for a law alone."""
        return TableInParts(Part(self.values, time))

    def highest(self, time: int | None) -> float:
        """The largest value at one of several times."""
        said = np.atleast_1d(self._highest)
        if said.dtype.kind == "f" and len(said) == (1 if time is None else self.values.shape[0]):
            return float(said[time or 0])
        return float(np.max([slab.max() for slab in Part(self.values, time).slabs()]))


class Layers:
    """Values at one time, as an array that is read layer by layer along its first axis."""

    def __init__(self, stored: StoredValues, time: int | None) -> None:
        self._first = () if time is None else (time,)
        self._stored = stored
        self.shape = stored.shape[len(self._first) :]
        some = stored.chunks[len(self._first)]
        size = math.prod(self.shape[1:]) * stored.dtype.itemsize
        self._some = some if some * size <= MOST_OF_LAYERS * max(stored.room, 1) else 1
        self._kept: tuple[int, AnyArray] = (-1, np.empty(0))

    def __getitem__(self, at: Any) -> AnyArray:
        """A layer, or the entries at an array of places for every axis."""
        if isinstance(at, tuple):
            nodes = np.asarray(np.ravel_multi_index(at, self.shape), dtype=np.int64)
            return self._stored.take(nodes + sum(self._first) * math.prod(self.shape))
        number = at // self._some
        if self._kept[0] != number:
            along = slice(number * self._some, (number + 1) * self._some)
            self._kept = number, self._stored.entries((*self._first, along))
        return self._kept[1][at - number * self._some]


def largest_over(data: xr.DataArray, rest: list[str], stored: StoredTables) -> xr.DataArray:
    """`data.max(rest)` of stored values, of which one layer of chunks is in memory at a time."""
    if not rest:
        return data.load()
    along = str(next(d for d in data.dims if d != "time"))
    some = stored.values.chunks[data.dims.index(along)]
    starts = range(0, data.sizes[along], some)
    parts = [data.isel({along: slice(k, k + some)}).max(rest) for k in starts]
    if along not in rest:
        return xr.concat(parts, along)
    return xr.concat(parts, "part").max("part")


def _times(arrival: AnyArray) -> AnyArray:
    return np.where(np.isfinite(arrival), arrival, 0.0).astype(np.float64)


def _reached(arrival: AnyArray) -> AnyArray:
    return np.isfinite(arrival).astype(np.float64)


ARRIVALS: tuple[Change, Change] = (_times, _reached)
"""Of the times of arrival: 0 where there is none; 1 where there is one."""
