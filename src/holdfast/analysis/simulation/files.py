"""Results as NetCDF files: written whole or not at all, with checksums, and read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.simulation.named_arrays import NamedArrays
from holdfast.execution.resources import check_memory
from holdfast.host.reading import check_file
from holdfast.host.writing import atomic_file, undisturbed

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["atomic_file", "read_netcdf", "write_arrays", "write_netcdf"]

MARK = "holdfast_version"
"""The attribute of every file written by holdfast."""

FORMAT = 2
"""The version of the files written here, in their attribute `format_version`.

1: without the attribute; the axes of a result had the names of its variables.
"""


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

        undisturbed(write)  # an exception between two locks of HDF5 would close both for ever
    return path


def write_arrays(arrays: NamedArrays, path: str | Path) -> Path:
    """The file that `write_netcdf` writes of the same dataset, without xarray."""
    path = Path(path)
    with atomic_file(path) as partial:
        undisturbed(lambda: _write(arrays, partial))
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


def _write(arrays: NamedArrays, path: Path) -> None:
    from netCDF4 import Dataset

    beside, alone = _related(arrays)
    with Dataset(path, "w", format="NETCDF4") as file:
        file.setncatts({**arrays.attrs, "format_version": FORMAT, **alone})
        for name, variable in arrays.variables.items():
            values, dims = variable.values, variable.dims
            said = {**variable.attrs, **beside[name]}
            stored = _storage(values.dtype.kind, values.ndim, values.size)
            if values.dtype.kind == "U":
                values = _characters(values)
                dims = (*dims, f"string{values.shape[-1]}")
                said["_Encoding"] = "utf-8"
            for dim, length in zip(dims, values.shape, strict=True):
                if dim not in file.dimensions:
                    file.createDimension(dim, length)
            missing = np.nan if values.dtype.kind == "f" else None
            made = file.createVariable(name, values.dtype, dims, fill_value=missing, **stored)
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
    found: dict[str, dict[str, str]] = {}
    used: set[str] = set()
    for name, variable in arrays.variables.items():
        mine = [
            c
            for c in names
            if name not in (*names, *variable.dims) and {*arrays[c].dims} <= {*variable.dims}
        ]
        used.update(mine)
        found[name] = {"coordinates": " ".join(mine)} if mine else {}
    rest = [c for c in names if c not in used]
    return found, {"coordinates": " ".join(rest)} if rest else {}


def read_netcdf(path: str | Path) -> xr.Dataset:
    """The dataset of the file, which is closed again; readers check for damage.

    For a file not written by holdfast only the attributes. Raises `HoldfastError` for a path that
    is not a file, and for data that do not fit into memory.
    """
    import xarray as xr

    check_file(path)

    def read() -> xr.Dataset:
        with xr.open_dataset(path, engine="netcdf4") as data:
            if MARK not in data.attrs:
                return xr.Dataset(attrs=data.attrs)
            check_memory(data.nbytes, f"the numbers in {path}", "use a machine with more memory")
            return data.load()

    return undisturbed(read)
