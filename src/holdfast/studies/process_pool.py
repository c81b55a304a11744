"""Worker processes, one for every core, which end when interrupted."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, TypeVar

from holdfast.errors import OutputError
from holdfast.host.interruption import end_with_parent

Key = TypeVar("Key", bound=Hashable)
Answer = TypeVar("Answer")

TICK = 0.5


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Context manager: worker processes that end with the block, also after an exception.

    Raises `OutputError` if one of them was killed.
    """
    pool = ProcessPoolExecutor(count, mp_context=_Unheeding(), initializer=_alone)
    try:
        yield pool
    except BrokenProcessPool:
        raise OutputError(
            "a process was killed, perhaps for lack of memory, or could not start",
            remedy="run it again, with fewer workers: finished parts are kept; a script that calls "
            'this needs its `if __name__ == "__main__":`',
        ) from None
    finally:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def answers(
    executor: Executor,
    function: Callable[[Any], Answer],
    asked: Iterable[tuple[Key, Any]],
    window: int,
    meanwhile: Callable[[], None],
) -> Iterator[tuple[Key, Answer]]:
    """function(argument) of every pair (key, argument), as they end; at most `window` at a time.

    `meanwhile` is called while no result arrives, and may raise.
    """
    waiting = iter(asked)
    jobs: dict[Future[Answer], Key] = {}
    try:
        while True:
            for key, argument in islice(waiting, window - len(jobs)):
                jobs[executor.submit(function, argument)] = key
            if not jobs:
                return
            done, _ = wait(jobs, timeout=TICK, return_when=FIRST_COMPLETED)
            for job in done:
                yield jobs.pop(job), job.result()
            meanwhile()
    finally:
        for job in jobs:
            job.cancel()


class _Begun(SpawnProcess):
    """Block interruptions during the start of a worker too: it inherits the blocked signals."""

    def start(self) -> None:
        if not hasattr(signal, "pthread_sigmask"):
            super().start()
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Unheeding(SpawnContext):
    Process = _Begun


def _alone() -> None:
    """Initializer of a worker: the waiting parent handles interruptions and reports errors."""
    end_with_parent()
    sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
