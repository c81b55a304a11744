"""Threads that share the places of an axis among themselves, stage after stage.

A stage of a march over a small grid takes a fraction of a millisecond, of which a thread that
sleeps would take a tenth to wake. So they look out for a moment before they sleep.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.execution.level_set.sweep_code import SweepCode

Counts = npt.NDArray[np.float64]

SPINS = 100_000
"""Number of looks before a worker sleeps: some 100 microseconds."""


class Workers:
    """Threads of which the caller is one; to be used in a `with` statement.

    Each takes the next slice of the places when it has done one. Slices become shorter, so that
    all end at about the same time.
    """

    def __init__(self, code: SweepCode, threads: int, places: int) -> None:
        self.watch, self.turns = code.watch, code.turns
        self._threads = threads
        self.share(0, places)
        self._others = [_Other(self, k) for k in range(1, threads)]
        self._waits = np.zeros(1, dtype=np.int64)
        self.stage = 0
        self.turn = np.zeros(1, dtype=np.int64)
        self.job: Callable[[], Counts] | None = None

    def share(self, first: int, last: int) -> None:
        """The places that are shared in the stages to come."""
        slices = [first]
        while slices[-1] < last:
            slices.append(slices[-1] + max(1, (last - slices[-1]) // (2 * self._threads)))
        self._slices = np.array(slices)

    def __enter__(self) -> Workers:
        for other in self._others:
            other.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._begin(None)  # what was begun before is ended; an interrupt may come at any time
        for other in self._others:
            other.join()

    def _begin(self, job: Callable[[], Counts] | None) -> None:
        self.job = job
        self.stage += 1
        self.turn[0] = self.stage * self.turns
        for other in self._others:
            if other.go.locked():
                other.go.release()

    def run(self, function: Callable[..., None], *arguments: Any) -> Counts:
        """The sums of the first two that they count, the largest of the third."""

        def job() -> Counts:
            counts = np.zeros(3)
            function(self.turn, self._slices, *arguments, counts)
            return counts

        self._begin(job)
        try:
            sums = job()
        finally:  # none works on the caller's arrays when this ends, be it by an interrupt
            others = [self._ended(other) for other in self._others]
        for counts in others:
            if isinstance(counts, BaseException):
                raise counts
            sums[:2] += counts[:2]
            sums[2] = max(sums[2], counts[2])
        return sums

    def _ended(self, other: _Other) -> Counts | BaseException:
        self.watch(self._waits, other.waits, self.stage + 1, SPINS)
        return other.result()


class _Other(threading.Thread):
    """Two locks are what it and the caller wait for, after having looked for a while.

    They look for what the other does in compiled code only: the first turn taken, and the wait for
    the next stage begun. Whoever sees it finds the interpreter free, and need not sleep for it.
    """

    def __init__(self, of: Workers, place: int) -> None:
        super().__init__(name=f"holdfast-march-{place}", daemon=True)
        self.of = of
        self.go, self.done = threading.Lock(), threading.Lock()
        self.go.acquire()
        self.done.acquire()
        self.waits = np.zeros(1, dtype=np.int64)
        self.counts: Counts | BaseException = np.zeros(3)

    def run(self) -> None:
        first = 1
        while True:
            first += self.of.turns
            self.of.watch(self.waits, self.of.turn, first, SPINS)
            self.go.acquire()
            if self.of.job is None:
                return
            try:
                self.counts = self.of.job()
            except BaseException as error:  # the caller raises it
                self.counts = error
            self.done.release()

    def result(self) -> Counts | BaseException:
        """Its counts in the stage that the caller has begun, or its error.

        An interrupt that comes meanwhile is raised when the stage is done."""
        try:
            self.done.acquire()
        except KeyboardInterrupt:
            self.done.acquire()
            raise
        return self.counts
