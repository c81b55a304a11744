"""A function at every sample, by a clock that only goes forward."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Loop:
    """Calls `step(now)` every `sample_time` [s]; now is the monotonic clock [s].

    skipped: the samples that passed while a step took longer. `stop` ends it after the sample.
    """

    def __init__(self, sample_time: float) -> None:
        self.sample_time, self.skipped = sample_time, 0
        self._ended = threading.Event()

    def run(self, step: Callable[[float], object], seconds: float | None = None) -> None:
        """Until `stop`, or for so many seconds."""
        began = time.monotonic()
        sample = 0
        while not self._ended.is_set():
            step(time.monotonic())
            sample += 1
            late = int((time.monotonic() - began) / self.sample_time) - sample
            if late > 0:
                self.skipped += late
                sample += late
            if seconds is not None and sample * self.sample_time >= seconds:
                return
            self._ended.wait(max(0.0, began + sample * self.sample_time - time.monotonic()))

    def stop(self) -> None:
        """End it; any thread may call this, and the handler of a signal."""
        self._ended.set()
