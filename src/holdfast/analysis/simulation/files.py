"""Reading datasets from NetCDF files and writing them atomically."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from holdfast.execution.resources import check_memory
from holdfast.host.reading import check_file
from holdfast.host.writing import atomic_file, undisturbed

__all__ = ["atomic_file", "read_netcdf", "write_netcdf"]


MARK = "holdfast_version"
"""The attribute of every file written by holdfast."""

FORMAT = 2
"""The version of the files written here, in their attribute `format_version`.

1: without the attribute; the axes of a result had the names of its variables.
"""


def write_netcdf(dataset: xr.Dataset, path: str | Path) -> Path:
    """The dataset as NetCDF-4, compressed; `OutputError` when the folder cannot be written."""
    path = Path(path)
    encoding: dict[str, dict[str, Any]] = {}
    for name, variable in dataset.variables.items():
        if variable.dtype.kind == "U":
            encoding[str(name)] = {
                "dtype": "S1",
                "fletcher32": variable.size > 0,
            }  # characters, which MATLAB reads too
        elif variable.ndim >= 1 and variable.size:  # with checksums, which detect damage
            packed = {"zlib": True, "complevel": 1, "shuffle": True} if variable.ndim >= 2 else {}
            encoding[str(name)] = {"fletcher32": True, **packed}
    with atomic_file(path) as partial:
        stamped = dataset.assign_attrs(format_version=FORMAT)

        def write() -> None:
            stamped.to_netcdf(partial, engine="netcdf4", format="NETCDF4", encoding=encoding)

        undisturbed(write)  # an exception between two locks of HDF5 would close both for ever
    return path


def read_netcdf(path: str | Path) -> xr.Dataset:
    """The dataset of the file, which is closed again; readers check for damage.

    For a file not written by holdfast only the attributes. Raises `HoldfastError` for a path that
    is not a file, and for data that do not fit into memory.
    """
    check_file(path)

    def read() -> xr.Dataset:
        with xr.open_dataset(path, engine="netcdf4") as data:
            if MARK not in data.attrs:
                return xr.Dataset(attrs=data.attrs)
            check_memory(data.nbytes, f"the numbers in {path}", "use a machine with more memory")
            return data.load()

    return undisturbed(read)
