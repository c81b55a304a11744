"""Files that appear whole under their name, or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.errors import OutputError

if TYPE_CHECKING:
    import xarray as xr


class atomic_file:
    """Context manager: a temporary path beside `path`, renamed to it on success only."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> Path:
        try:
            handle, name = tempfile.mkstemp(
                dir=self.path.parent, prefix=f".{self.path.name}.", suffix=".partial"
            )
        except OSError as error:
            raise OutputError(
                f"{self.path} cannot be written ({error.strerror})",
                remedy="choose another folder with --out",
            ) from None
        os.close(handle)
        self.partial = Path(name)
        return self.partial

    def __exit__(self, kind: object, problem: object, trace: object) -> None:
        if kind is not None:
            self.partial.unlink(missing_ok=True)
            return
        self.partial.chmod(0o666 & ~_umask())
        try:
            os.replace(self.partial, self.path)
        except OSError as error:
            self.partial.unlink(missing_ok=True)
            raise OutputError(
                f"{self.path} cannot be written ({error.strerror})",
                remedy="choose another folder with --out",
            ) from None


def write_netcdf(dataset: xr.Dataset, path: str | Path) -> Path:
    """The dataset as NetCDF-4, compressed; `OutputError` when the folder cannot be written."""
    path = Path(path)
    encoding: dict[str, dict[str, Any]] = {}
    for name, variable in dataset.variables.items():
        if variable.dtype.kind == "U":
            encoding[str(name)] = {"dtype": "S1"}  # characters, which MATLAB reads too
        elif variable.ndim >= 2:
            encoding[str(name)] = {"zlib": True, "complevel": 1, "shuffle": True}
    with atomic_file(path) as partial:
        dataset.to_netcdf(partial, engine="netcdf4", format="NETCDF4", encoding=encoding)
    return path


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
