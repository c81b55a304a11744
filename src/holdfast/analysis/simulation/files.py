"""Data sets as NetCDF files, written whole or not at all, and read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from holdfast.execution.resources import check_memory
from holdfast.host.reading import check_file
from holdfast.host.writing import atomic_file, undisturbed

__all__ = ["atomic_file", "read_netcdf", "write_netcdf"]


MARK = "holdfast_version"
"""The attribute that every file of ours has."""

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
        elif variable.ndim >= 1 and variable.size:  # with checksums: damage does not go unnoticed
            packed = {"zlib": True, "complevel": 1, "shuffle": True} if variable.ndim >= 2 else {}
            encoding[str(name)] = {"fletcher32": True, **packed}
    with atomic_file(path) as partial:
        stamped = dataset.assign_attrs(format_version=FORMAT)

        def write() -> None:
            stamped.to_netcdf(partial, engine="netcdf4", format="NETCDF4", encoding=encoding)

        undisturbed(write)  # an exception between two locks of HDF5 would close both for ever
    return path


def read_netcdf(path: str | Path) -> xr.Dataset:
    """All of the file, which is closed again; what is wrong with a damaged one, readers say.

    Of a file that is not ours the attributes alone. Raises `HoldfastError` for what is not a file, and
    for what does not fit into memory.
    """
    check_file(path)

    def read() -> xr.Dataset:
        with xr.open_dataset(path, engine="netcdf4") as data:
            if MARK not in data.attrs:
                return xr.Dataset(attrs=data.attrs)
            check_memory(data.nbytes, f"the numbers in {path}", "use a machine with more memory")
            return data.load()

    return undisturbed(read)
