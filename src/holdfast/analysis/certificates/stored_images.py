"""Images of cells in a file, so that a run that is interrupted goes on where it stopped.

A folder has one file for each set of cells whose images are found in turn: which blocks are done,
then the images. What is noted as done is on the disk before that, and a file is of one problem: a
digest in its name is that of all that decides its numbers.
"""

from __future__ import annotations

import hashlib
import math
import os
import time
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast._version import __version__
from holdfast.analysis.certificates.cells import Cells, Floats, Truths, Wholes
from holdfast.errors import CacheWarning, OutputError
from holdfast.execution.intervals.held_flow import HeldFlow

NAME = "certificate.images"
EVERY = 1.0
"""Seconds after which what is done is written."""

PAGE = 4096


class Store:
    """The folder of a run that may be interrupted: its images, in the order they are asked for.

    Raises `OutputError` for a folder that there is not.
    """

    def __init__(self, folder: str | Path) -> None:
        if not str(folder) or not Path(folder).is_dir():
            raise OutputError(f"store: '{folder}' is no folder", remedy="make it first")
        self.folder, self._asked = Path(folder), 0

    def blocks(
        self, flow: HeldFlow, cells: Cells, candidates: Floats, of: Wholes, tasks: Sequence[object]
    ) -> Blocks:
        """The blocks of these images: those of an earlier run, or none that is done.

        Warns with `CacheWarning` where an earlier run was of another problem or version.
        """
        digest = hashlib.sha256(f"{__version__} {flow.digest} {cells.periodic} {tasks}".encode())
        for part in (*cells.edges, candidates, of):
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        self._asked += 1
        path = self.folder / f"{NAME}.{self._asked}.{digest.hexdigest()[:24]}"
        others = [f for f in self.folder.glob(f"{NAME}.{self._asked}.*") if f != path]
        if others:
            warnings.warn(
                f"what an earlier run left in {self.folder} is of another problem or version: "
                "this one begins anew",
                CacheWarning,
                stacklevel=2,
            )
            _remove(others)
        return Blocks(path, (len(of), len(candidates), len(cells.counts)), len(tasks))


def forget(folder: Path) -> None:
    """Remove what runs of this folder have left, once their certificate is written."""
    _remove(folder.glob(f"{NAME}.*"))


def _remove(files: Iterable[Path]) -> None:
    for file in list(files):
        file.unlink(missing_ok=True)


class Blocks:
    """The arrays of images, in a file or, without a path, in memory; `done` are the tasks that are.

    first, last: shape (cells, inputs, axes); usable: shape (cells, inputs).
    """

    def __init__(self, path: Path | None, shape: tuple[int, int, int], tasks: int) -> None:
        sizes = [tasks, 4 * math.prod(shape), 4 * math.prod(shape), math.prod(shape[:2])]
        begins = np.cumsum([0, *(-(-size // PAGE) * PAGE for size in sizes)]).tolist()
        self._raw: npt.NDArray[np.uint8] | np.memmap[tuple[int], np.dtype[np.uint8]]
        self._raw = np.zeros(begins[-1], dtype=np.uint8) if path is None else _mapped(path, begins)
        parts = [self._raw[a : a + size] for a, size in zip(begins, sizes, strict=False)]
        self.done: Truths = parts[0].view(np.bool_)
        self.first: npt.NDArray[np.int32] = parts[1].view(np.int32).reshape(shape)
        self.last: npt.NDArray[np.int32] = parts[2].view(np.int32).reshape(shape)
        self.usable: Truths = parts[3].view(np.bool_).reshape(shape[:2])
        self._waiting: list[int] = []
        self._written = time.monotonic()

    def note(self, task: int) -> None:
        """A task is done."""
        self._waiting.append(task)
        if time.monotonic() - self._written >= EVERY:
            self.write()

    def write(self) -> None:
        """What was noted, behind its images."""
        if isinstance(self._raw, np.memmap):
            self._raw.flush()
        self.done[self._waiting] = True
        if isinstance(self._raw, np.memmap):
            self._raw.flush()
        self._waiting, self._written = [], time.monotonic()


def _mapped(path: Path, begins: list[int]) -> np.memmap[tuple[int], np.dtype[np.uint8]]:
    size = max(begins[-1], 1)
    try:
        with path.open("ab") as file:
            if file.tell() != size:  # room for all of it, so that no write to it finds none
                file.truncate(0)
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                else:
                    file.write(bytes(size))
        return np.memmap(path, dtype=np.uint8, mode="r+", shape=(size,))
    except OSError as error:
        path.unlink(missing_ok=True)
        raise OutputError(
            f"{path} of {size / 2**20:,.0f} MiB cannot be written ({error.strerror})",
            remedy="choose a folder with room for it",
        ) from None
