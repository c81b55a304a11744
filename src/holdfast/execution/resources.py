"""Memory, cores and threads of this machine, and where large arrays are.

They are in memory, or in files that the system reads and writes as needed.
"""

from __future__ import annotations

import errno
import math
import os
import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from holdfast.errors import OutputError, SimulationError
from holdfast.execution.arrays import AnyArray, Wholes


class Room(Protocol):
    """Gives arrays of values."""

    @property
    def on_disk(self) -> bool:
        """Whether they are in files."""

    def empty(self, count: int, kind: npt.DTypeLike) -> AnyArray:
        """So many values of a kind, shape (count,)."""

    def copy(self, values: AnyArray) -> AnyArray:
        """The same values in another array, shape (count,)."""


class Memory:
    """The memory of this process."""

    on_disk = False

    def empty(self, count: int, kind: npt.DTypeLike) -> AnyArray:
        """So many values of a kind, shape (count,)."""
        return np.empty(count, dtype=kind)

    def copy(self, values: AnyArray) -> AnyArray:
        """The same values in another array of the same shape."""
        return values.copy()


class Disk:
    """Nameless files in a folder: they are gone with the arrays, and with the process."""

    on_disk = True

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def empty(self, count: int, kind: npt.DTypeLike) -> AnyArray:
        """The file takes its room at once: a disk that is full is met here, and not in the midst of
        a march, where it would end the process.

        The shape is (count,).
        """
        size = count * np.dtype(kind).itemsize
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder) as file:
                os.posix_fallocate(file.fileno(), 0, max(size, 1))
                return np.memmap(file, dtype=kind, mode="r+", shape=(count,))
        except OSError as error:
            raise self._refusal(error, size) from None

    def copy(self, values: AnyArray) -> AnyArray:
        """The same values in a file of their own, shape (count,)."""
        copied = self.empty(len(values), values.dtype)
        copied[:] = values
        return copied

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


Progress = Callable[[float], None]
"""Called from time to time with the finished fraction."""


def check_memory(
    needed: int, what: str, remedy: str = "raise record_every, or simulate fewer runs at a time"
) -> None:
    """Refuse arrays beyond the memory, before anything is allocated."""
    total = total_memory()
    if not is_room_for(needed):
        raise SimulationError(
            f"{what} take {needed / 2**30:.3g} GiB, this machine has {total / 2**30:.3g}",
            expected="at most 70 % of it",
            remedy=remedy,
        )


def check_trials(runs: int, states: int) -> None:
    """Refuse a validation with more runs, and as many near the edge, than the memory allows."""
    check_memory(8 * 8 * runs * (2 * states + 4), f"the starts of {runs:,} runs", "try fewer")


def is_room_for(needed: int) -> bool:
    """Whether so many bytes are at most 70 % of the memory."""
    return needed <= 0.7 * total_memory()


def total_memory() -> float:
    """Bytes of memory of this machine; infinite where that is unknown."""
    if not hasattr(os, "sysconf"):
        return math.inf
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def available_cores() -> int:
    """The cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_threads(
    work: Callable[..., Any],
    bounds: list[tuple[int, int]],
    counters: list[Wholes],
    threads: int,
    stop: Wholes,
    total: int,
    progress: Progress | None,
) -> None:
    """The work of every part of `bounds` by threads, until `stop` is set; counters and stop: shape
    (1,)."""
    with ThreadPoolExecutor(threads) as pool:
        jobs = {pool.submit(work, a, b, c) for (a, b), c in zip(bounds, counters, strict=True)}
        try:
            waiting = jobs
            while waiting:
                done, waiting = wait(waiting, timeout=0.05, return_when=FIRST_EXCEPTION)
                for job in done:
                    job.result()
                if progress is not None:
                    progress(min(1.0, sum(int(c[0]) for c in counters) / max(total, 1)))
        except BaseException:
            stop[0] = 1
            raise
