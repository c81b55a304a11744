"""Work that may take long: a bar after two seconds, an end after the time allowed or when told."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from holdfast.errors import ScenarioError

BAR = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
_SILENT, _TICK = 2.0, 0.5
_told_to_stop = threading.Event()


def listen() -> None:
    """Remember an interruption, also where the code that it hits loses it.

    Libraries that load machine code run callbacks from C, where an exception is only reported.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _stop)
        sys.unraisablehook = _report_lost


def _stop(number: int, frame: object) -> NoReturn:
    _told_to_stop.set()
    raise KeyboardInterrupt


def _report_lost(lost: sys.UnraisableHookArgs) -> None:
    if lost.exc_type is not KeyboardInterrupt:  # that one is remembered
        sys.__unraisablehook__(lost)


def heed() -> None:
    """Raise the interruption that was lost, if there was one."""
    if _told_to_stop.is_set():
        raise KeyboardInterrupt


@contextmanager
def bar(first: str) -> Iterator[Callable[[str, float], None]]:
    """A bar, and the function that tells it what is worked on and the finished fraction."""
    from tqdm import tqdm

    with tqdm(
        total=100, desc=first, unit="%", leave=False, file=sys.stderr, bar_format=BAR
    ) as shown:

        def tell(what: str, fraction: float) -> None:
            heed()
            shown.set_description_str(what, refresh=False)
            shown.update(100 * fraction - shown.n)

        yield tell
    heed()


@contextmanager
def bounded(what: str, seconds: float, remedy: str) -> Iterator[Callable[[float], None]]:
    """Gives a function to tell the finished fraction to; the bar moves on without it too.

    After `seconds` the work is refused with `ScenarioError`, wherever it is; on systems
    without alarms it may take longer.
    """
    from tqdm import tqdm

    with tqdm(
        total=100, desc=what, unit="%", leave=False, delay=_SILENT, file=sys.stderr, bar_format=BAR
    ) as bar:
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
