"""Progress of long work, and its end after a time limit.

Bars appear only on terminals. Elsewhere, as in a log, they would be one endless line.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from holdfast.errors import ScenarioError
from holdfast.host.interruption import heed

BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
_SILENT, _TICK = 2.0, 0.5
_BETWEEN_LINES = 60.0


def _bar(what: str, delay: float = 0.0) -> Any:
    from tqdm import tqdm

    return tqdm(
        total=100,
        desc=what,
        unit="%",
        leave=False,
        delay=delay,
        file=sys.stderr,
        disable=None,  # except on a terminal
        bar_format=BAR,
    )


def _line(what: str, fraction: float, elapsed: float) -> str:
    """The finished percentage and the estimated remaining time."""
    if not 0 < fraction < 1:
        return f"{what}: {100 * fraction:.0f} %"
    from tqdm import tqdm

    left = tqdm.format_interval(elapsed * (1 - fraction) / fraction)
    return f"{what}: {100 * fraction:.0f} %, {left} left"


@contextmanager
def bar(first: str) -> Iterator[Callable[[str, float], None]]:
    """A progress bar, and the function that updates its label and finished fraction.

    If standard error is not a terminal, one line per minute.
    """
    with _bar(first) as shown:
        begun = written = time.monotonic()

        def tell(what: str, fraction: float) -> None:
            nonlocal written
            heed()
            shown.set_description_str(what, refresh=False)
            shown.update(100 * fraction - shown.n)
            if shown.disable and time.monotonic() - written >= _BETWEEN_LINES:
                written = time.monotonic()
                print(_line(what, fraction, written - begun), file=sys.stderr, flush=True)

        yield tell
    heed()


@contextmanager
def bounded(what: str, seconds: float, remedy: str) -> Iterator[Callable[[float], None]]:
    """Context manager with a time limit: gives a function that takes the finished fraction.

    The bar appears after two seconds and also moves by itself. After `seconds` the work ends with
    `ScenarioError` at any point; on systems without alarms it may take longer.
    """
    with _bar(what, delay=_SILENT) as bar:
        done = threading.Event()

        def tick() -> None:
            if not done.wait(_SILENT):
                bar.refresh()
            while not done.wait(_TICK):
                bar.refresh()

        def tell(fraction: float) -> None:
            heed()
            bar.update(100 * fraction - bar.n)

        ticker = threading.Thread(target=tick, daemon=True)
        ticker.start()
        try:
            with _alarm(seconds, f"{what} took longer than {seconds:g} s", remedy):
                yield tell
        finally:
            done.set()
            ticker.join()


@contextmanager
def _alarm(seconds: float, complaint: str, remedy: str) -> Iterator[None]:
    if not hasattr(signal, "setitimer"):
        yield
        return

    def ring(number: int, frame: object) -> NoReturn:
        raise ScenarioError(complaint, remedy=remedy)

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
