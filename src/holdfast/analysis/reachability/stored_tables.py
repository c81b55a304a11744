"""The arrays of a value function that are still in its file, as tables that laws look up."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from holdfast.analysis.reachability.stored_values import StoredValues
from holdfast.execution.arrays import AnyArray
from holdfast.execution.table_in_parts import TableInParts

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

    def take(self, nodes: npt.NDArray[np.int64]) -> AnyArray:
        """The entries of these numbers."""
        return self.of(self.stored.take(nodes + sum(self._first) * self.size))

    def all(self) -> AnyArray:
        """All entries in one row, past the chunks that are kept."""
        return self.of(self.stored.entries(self._first).reshape(-1))

    def in_turn(self) -> Iterator[AnyArray]:
        """All entries in rows, one slab after the other."""
        return (slab.reshape(-1) for slab in self.slabs())

    def slabs(self) -> Iterator[AnyArray]:
        """The entries in parts along the first axis: one layer of chunks at a time."""
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
