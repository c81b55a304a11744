"""Memory, cores and threads of this machine."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError

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
    counters: list[npt.NDArray[np.int64]],
    threads: int,
    stop: npt.NDArray[np.int64],
    total: int,
    progress: Progress | None,
) -> None:
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
