"""Files that appear whole under their name, or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.errors import OutputError

if TYPE_CHECKING:
    import xarray as xr


LITTLE = 1 << 20
"""Bytes: less than this on a disk is no room."""


class atomic_file:
    """Context manager: a temporary path beside `path`, renamed to it on success only.

    What a link leads to is replaced, not the link; a device, a pipe or a folder is refused.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()  # of a link, what it leads to

    def __enter__(self) -> Path:
        if self.path.exists() and not self.path.is_file():
            raise _refusal(self.path, OSError("it is there, and no file"))
        try:
            handle, name = tempfile.mkstemp(
                dir=self.path.parent, prefix=f".{self.path.name}.", suffix=".partial"
            )
        except OSError as error:
            raise _refusal(self.path, error) from None
        os.close(handle)
        self.partial = Path(name)
        return self.partial

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        if problem is not None:
            self.partial.unlink(missing_ok=True)
            if isinstance(problem, OSError) or str(problem).startswith("NetCDF: "):
                raise _refusal(self.path, problem) from None
            return
        try:
            self.partial.chmod(0o666 & ~_umask())
            os.replace(self.partial, self.path)
        except OSError as error:
            self.partial.unlink(missing_ok=True)
            raise _refusal(self.path, error) from None


def _refusal(path: Path, problem: BaseException) -> OutputError:
    """HDF5 does not say why it failed; a disk without room is the reason to think of."""
    reason = getattr(problem, "strerror", None) or str(problem)
    free = shutil.disk_usage(path.parent).free if path.parent.exists() else LITTLE
    if free < LITTLE:
        reason += f"; the disk has {free / 1024:.0f} KiB left"
    return OutputError(
        f"{path} cannot be written ({reason})",
        remedy="make room, or choose another folder with --out",
    )


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
        dataset.to_netcdf(partial, engine="netcdf4", format="NETCDF4", encoding=encoding)
    return path


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
