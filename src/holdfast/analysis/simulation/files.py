"""Results as NetCDF files: written whole or not at all, with checksums, and read.

Arrays have names, axes and attributes: what a result file holds, without a library for it. xarray
takes half a second to load, and is loaded when a dataset is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray
from holdfast.execution.resources import check_memory
from holdfast.host.files import atomic_file, check_file, undisturbed

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class NamedArray:
    """An array, the names of its axes, and what it means (units, long_name)."""

    dims: tuple[str, ...]
    values: AnyArray
    attrs: Mapping[str, Any]


@dataclass(frozen=True)
class NamedArrays:
    """Arrays by name, those in `coordinates` describing the axes of the others."""

    variables: Mapping[str, NamedArray]
    coordinates: tuple[str, ...]
    attrs: Mapping[str, Any]

    @classmethod
    def of(cls, dataset: xr.Dataset) -> NamedArrays:
        """The arrays of a dataset, without copies."""
        variables = {str(n): cast(NamedArray, v) for n, v in dataset.variables.items()}
        attributes = {str(n): v for n, v in dataset.attrs.items()}
        return cls(variables, tuple(str(n) for n in dataset.coords), attributes)

    def __getitem__(self, name: str) -> NamedArray:
        return self.variables[name]

    def __contains__(self, name: str) -> bool:
        return name in self.variables

    @property
    def sizes(self) -> dict[str, int]:
        """The length of every axis."""
        lengths: dict[str, int] = {}
        for variable in self.variables.values():
            lengths.update(zip(variable.dims, variable.values.shape, strict=True))
        return lengths

    def dataset(self) -> xr.Dataset:
        """The same as an xarray dataset, without copies."""
        import xarray as xr

        parts: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
        for name, v in self.variables.items():
            parts[name in self.coordinates][name] = (v.dims, v.values, dict(v.attrs))
        return xr.Dataset(*parts, dict(self.attrs))


__all__ = ["atomic_file", "read_netcdf", "write_arrays", "write_netcdf"]

MARK = "holdfast_version"
"""The attribute of every file written by holdfast."""

FORMAT = 2
"""The version of the files written here, in their attribute `format_version`.

1: without the attribute; the axes of a result had the names of its variables.
"""


HIGHEST = "highest"
"""The attribute of large values that tells the highest of them, at every time."""

CHUNK = 2**16
"""Numbers of a chunk at most; arrays over a grid with no more than that have none."""


def write_netcdf(dataset: xr.Dataset, path: str | Path) -> Path:
    """The dataset as NetCDF-4; `OutputError` when the folder cannot be written."""
    path = Path(path)
    encoding: dict[str, dict[str, Any]] = {}
    for name, variable in dataset.variables.items():
        kind = variable.dtype.kind
        if stored := _storage(kind, variable.ndim, variable.size):
            encoding[str(name)] = {"dtype": "S1", **stored} if kind == "U" else stored
    with atomic_file(path) as partial:
        stamped = dataset.assign_attrs(format_version=FORMAT)

        def write() -> None:
            stamped.to_netcdf(partial, engine="netcdf4", format="NETCDF4", encoding=encoding)

        undisturbed(write)
    return path


def write_values(dataset: xr.Dataset, path: str | Path) -> Path:
    """`write_netcdf` of values over a grid: large arrays in chunks, compressed, part by part.

    Nothing large is copied, and what is still in a file is read as it is written.
    """
    if not any(_is_large(v) for v in dataset.variables.values()):
        return write_netcdf(dataset, path)
    return write_arrays(NamedArrays.of(dataset), path, chunked=True)


def chunks_of(shape: Sequence[int], dims: Sequence[str]) -> tuple[int, ...]:
    """The chunks of an array over a grid: about as long along every axis, each of one time.

    At most `CHUNK` numbers: larger ones cost more for one cell, smaller ones more for a slice.
    """
    grid = [k for k, d in enumerate(dims) if d != "time"]
    chunks = [1] * len(shape)
    room, left = CHUNK, len(grid)
    for k in sorted(grid, key=lambda k: shape[k]):
        most = max(1, int(room ** (1 / left) + 1e-9))
        parts = -(-shape[k] // most)
        chunks[k] = -(-shape[k] // parts)
        room, left = room // chunks[k], left - 1
    return tuple(chunks)


def _is_large(variable: Any) -> bool:
    return bool(variable.dtype.kind in "fiu" and variable.ndim and variable.size > CHUNK)


def write_arrays(arrays: NamedArrays, path: str | Path, *, chunked: bool = False) -> Path:
    """The file that `write_netcdf` writes of the same dataset, without xarray.

    chunked: large arrays are those of `write_values`.
    """
    path = Path(path)
    with atomic_file(path) as partial:
        undisturbed(lambda: _write(arrays, partial, chunked))
    return path


def _storage(kind: str, ndim: int, size: int) -> dict[str, Any]:
    """How an array is stored: with a checksum, which detects damage; whole numbers packed.

    Floating-point numbers would shrink by a quarter, and packing takes longer than simulating.
    """
    if kind == "U":
        return {"fletcher32": size > 0}  # characters, which MATLAB reads too
    if not (ndim and size):
        return {}
    packed = {"zlib": True, "complevel": 1, "shuffle": True} if ndim >= 2 and kind != "f" else {}
    return {"fletcher32": True, **packed}


def _write_large(file: Any, name: str, variable: Any, said: dict[str, Any]) -> None:
    """An array in chunks, layer by layer, and the highest number of every time.

    Compressed, since values are cut off far outside, and smooth elsewhere.
    """
    dims, shape, kind = tuple(map(str, variable.dims)), variable.shape, variable.dtype.kind
    for dim, length in zip(dims, shape, strict=True):
        if dim not in file.dimensions:
            file.createDimension(dim, length)
    chunks = chunks_of(shape, dims)
    made = file.createVariable(
        name, variable.dtype, dims, fill_value=np.nan if kind == "f" else None, zlib=True,
        complevel=1, shuffle=True, fletcher32=True, chunksizes=chunks,
    )  # fmt: skip
    made.set_auto_maskandscale(False)
    made.set_var_chunk_cache(0, 1, 0.0)  # whole layers of chunks are written
    timed = dims[0] == "time"
    first = [(k,) for k in range(shape[0])] if timed else [()]
    axis = int(timed)
    highest = []
    for time in first:
        most = -np.inf
        for k in range(0, shape[axis], chunks[axis]):
            part = (*time, slice(k, min(k + chunks[axis], shape[axis])))
            numbers = np.asarray(variable[part].values)
            made[part] = numbers
            most = float(np.maximum(most, numbers.max()))  # NaN where one is
        highest.append(most)
    made.setncatts({**said, HIGHEST: highest} if name == "value" else said)


def write_groups(whole: NamedArrays, groups: Mapping[str, NamedArrays], path: str | Path) -> Path:
    """A file with `whole` in its root, and with groups, each written as by `write_values`."""
    path = Path(path)
    with atomic_file(path) as partial:
        undisturbed(lambda: _write(whole, partial, False, groups))
    return path


def _write(
    arrays: NamedArrays,
    path: Path,
    chunked: bool,
    groups: Mapping[str, NamedArrays] | None = None,
) -> None:
    from netCDF4 import Dataset

    with Dataset(path, "w", format="NETCDF4") as file:
        _fill(file, arrays, chunked)
        for name, inside in (groups or {}).items():
            _fill(file.createGroup(name), inside, True)


def _fill(group: Any, arrays: NamedArrays, chunked: bool) -> None:
    """Write arrays to a file, or to a group of it."""
    beside, alone = _related(arrays)
    group.setncatts({**arrays.attrs, "format_version": FORMAT, **alone})
    for name, variable in arrays.variables.items():
        dims = tuple(map(str, variable.dims))
        if chunked and _is_large(variable):
            _write_large(group, name, variable, {**variable.attrs, **beside[name]})
            continue
        values = variable.values
        said = {**variable.attrs, **beside[name]}
        stored = _storage(values.dtype.kind, values.ndim, values.size)
        if values.dtype.kind == "U":
            values = _characters(values)
            dims = (*dims, f"string{values.shape[-1]}")
            said["_Encoding"] = "utf-8"
        for dim, length in zip(dims, values.shape, strict=True):
            if dim not in group.dimensions:
                group.createDimension(dim, length)
        missing = np.nan if values.dtype.kind == "f" else None
        made = group.createVariable(name, values.dtype, dims, fill_value=missing, **stored)
        made.set_auto_maskandscale(False)
        made.set_auto_chartostring(False)
        made.setncatts(said)
        if values.size:
            made[...] = values


def _characters(texts: npt.NDArray[np.str_]) -> npt.NDArray[np.bytes_]:
    """The texts as rows of characters in UTF-8."""
    rows = np.char.encode(texts, "utf-8") if texts.size else texts.astype("S1")
    return np.ascontiguousarray(rows)[..., None].view("S1")


def _related(arrays: NamedArrays) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """The attributes that name the coordinates of each array, and those of none (CF, chapter 5)."""
    names = sorted(n for n in arrays.coordinates if arrays[n].dims != (n,))
    attributes: dict[str, dict[str, str]] = {}
    used: set[str] = set()
    for name, variable in arrays.variables.items():
        mine = [
            c
            for c in names
            if name not in (*names, *variable.dims) and {*arrays[c].dims} <= {*variable.dims}
        ]
        used.update(mine)
        attributes[name] = {"coordinates": " ".join(mine)} if mine else {}
    rest = [c for c in names if c not in used]
    return attributes, {"coordinates": " ".join(rest)} if rest else {}


def read_netcdf(
    path: str | Path,
    left: Callable[[xr.Dataset], Sequence[str]] = lambda data: (),
    group: str | None = None,
) -> xr.Dataset:
    """The dataset of the file, or of a group of it; it is closed again; readers check for damage.

    left: the names of the arrays of a dataset that are not read; instead of them the dataset has
    arrays of the same shape that take no memory. For a file not written by holdfast only the
    attributes. Raises `HoldfastError` for a path that is not a file, and for data that do not fit
    into memory.
    """
    import xarray as xr

    check_file(path)

    def read() -> xr.Dataset:
        with xr.open_dataset(path, engine="netcdf4", group=group) as data:
            if MARK not in data.attrs:
                return xr.Dataset(attrs=data.attrs)
            unread = {
                n: data.variables[n].copy(
                    data=np.broadcast_to(np.zeros((), data[n].dtype), data[n].shape)
                )
                for n in left(data)
            }
            data = data.assign(unread)
            needed = sum(v.nbytes for n, v in data.variables.items() if n not in unread)
            check_memory(needed, f"the numbers in {path}", "use a machine with more memory")
            return data.load()

    return undisturbed(read)
