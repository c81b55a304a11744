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

Counts = npt.NDArray[np.int64]

PATIENCE = 100_000
"""How often to look before going to sleep: for some 100 microseconds."""


class Workers:
    """Threads of which the caller is one; to be used in a `with` statement.

    Each takes the next slice of the places when it has done one. Slices become shorter, so that
    all end at about the same time. watch(counters, k, value, times): looks whether counters[k] has
    come to the value.
    """

    def __init__(self, watch: Callable[..., bool], threads: int, places: int) -> None:
        self.watch = watch
        slices = [0]
        while slices[-1] < places:
            slices.append(slices[-1] + max(1, (places - slices[-1]) // (2 * threads)))
        self._slices = np.array(slices)
        self._others = [_Other(self, k) for k in range(1, threads)]
        self.stages = np.zeros(threads, dtype=np.int64)  # begun, and ended by every other
        self.job: Callable[[], Counts] | None = None

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
        self.stages[0] += 1
        for other in self._others:
            if other.go.locked():
                other.go.release()

    def run(self, function: Callable[..., None], *arguments: Any) -> Counts:
        """The sum of what they count."""
        turn = np.zeros(1, dtype=np.int64)

        def job() -> Counts:
            counts = np.zeros(3, dtype=np.int64)
            function(turn, self._slices, *arguments, counts)
            return counts

        self._begin(job)
        return sum((other.result() for other in self._others), start=job())


class _Other(threading.Thread):
    """Two locks are what it and the caller wait for, after having looked for a while."""

    def __init__(self, of: Workers, place: int) -> None:
        super().__init__(name=f"holdfast-march-{place}", daemon=True)
        self.of, self.place = of, place
        self.go, self.done = threading.Lock(), threading.Lock()
        self.go.acquire()
        self.done.acquire()
        self.found: Counts | BaseException = np.zeros(3, dtype=np.int64)

    def run(self) -> None:
        stage = 0
        while True:
            stage += 1
            self.of.watch(self.of.stages, 0, stage, PATIENCE)
            self.go.acquire()
            if self.of.job is None:
                return
            try:
                self.found = self.of.job()
            except BaseException as error:  # the caller raises it
                self.found = error
            self.of.stages[self.place] = stage
            self.done.release()

    def result(self) -> Counts:
        """What it has counted in the stage that the caller has begun."""
        self.of.watch(self.of.stages, self.place, int(self.of.stages[0]), PATIENCE)
        self.done.acquire()
        if isinstance(self.found, BaseException):
            raise self.found
        return self.found
