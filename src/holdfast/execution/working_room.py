"""Where large arrays are: in memory, or in files that the system reads and writes as needed."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from holdfast.errors import OutputError

Values = npt.NDArray[Any]


class Room(Protocol):
    """Gives arrays of values."""

    @property
    def on_disk(self) -> bool:
        """Whether they are in files."""

    def empty(self, count: int, kind: npt.DTypeLike) -> Values:
        """So many values of a kind."""

    def copy(self, values: Values) -> Values:
        """The same values in another array."""


class Memory:
    """The memory of this process."""

    on_disk = False

    def empty(self, count: int, kind: npt.DTypeLike) -> Values:
        return np.empty(count, dtype=kind)

    def copy(self, values: Values) -> Values:
        return values.copy()


class Disk:
    """Nameless files in a folder: they are gone with the arrays, and with the process."""

    on_disk = True

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def empty(self, count: int, kind: npt.DTypeLike) -> Values:
        """The file takes its room at once: a disk that is full is met here, and not in the midst of
        a march, where it would end the process."""
        size = count * np.dtype(kind).itemsize
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder) as file:
                os.posix_fallocate(file.fileno(), 0, max(size, 1))
                return np.memmap(file, dtype=kind, mode="r+", shape=(count,))
        except OSError as error:
            raise self._refusal(error, size) from None

    def copy(self, values: Values) -> Values:
        found = self.empty(len(values), values.dtype)
        found[:] = values
        return found

    def _refusal(self, error: OSError, size: int) -> OutputError:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            free = shutil.disk_usage(self.folder).free
            return OutputError(
                f"no room for {size / 2**30:.3g} GiB in {self.folder}, which has "
                f"{free / 2**30:.3g} GiB left",
                remedy="choose a folder of a larger disk for on_disk, or take fewer nodes",
            )
        return OutputError(
            f"{self.folder} cannot be written ({error.strerror})",
            remedy="choose another folder for on_disk",
        )
