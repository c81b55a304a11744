"""Interruption (Ctrl-C, SIGINT): it ends the program at any point and leaves no unfinished file.

Python raises an interruption between two of its own instructions. It comes late where a library
computes, it is lost where a library calls back, and it may leave a lock taken that the program
then waits for. So a thread hears the signal too: it ends the program that has not ended by
itself within `GRACE`.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

from holdfast.host.files import discard_unfinished

INTERRUPTED = 128 + signal.SIGINT
GRACE = 1.0
"""Seconds."""

_goes_on: list[str] = []
_TERMINATIONS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
)
_told_to_stop = threading.Event()
_postponing = threading.Event()
_asked: list[int] = []
_ends = threading.Lock()
_ears: list[socket.socket] = []
"""The handlers, referenced here because the operating system keeps only numbers of them."""


def said() -> str:
    """What an interruption says: what is left, and how to go on."""
    left = _goes_on[-1] if _goes_on else "no unfinished result is left"
    return f"holdfast: interrupted; {left}\n"


@contextmanager
def going_on(what: str, folder: object) -> Iterator[None]:
    """While results are kept one by one in a folder, from which the same command goes on."""
    _goes_on.append(f"{what} are kept in {folder}, and the same command goes on from there")
    yield
    _goes_on.pop()  # not where it was interrupted


@contextmanager
def listening() -> Iterator[None]:
    """End on an interruption, with `INTERRUPTED`, and when terminated, with 128 + the signal.

    An interruption is first raised, once, as `KeyboardInterrupt`. One that the caller ignores, as
    the shell does for a program in the background, stays ignored.
    """
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread() and not _ears:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            before[signal.SIGINT] = signal.signal(signal.SIGINT, _stop)
            sys.unraisablehook = _report_lost
        before |= _hear_terminations()
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if before:
            signal.set_wakeup_fd(-1)
            for ear in _ears:
                ear.close()
            _ears.clear()


def end_with_parent() -> None:
    """In a worker process: only the waiting parent is interrupted, and the worker ends with it."""
    import multiprocessing
    from multiprocessing.connection import wait

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    _hear_terminations()
    parent = multiprocessing.parent_process()
    if parent is not None:
        sentinel = parent.sentinel

        def end_too() -> None:
            wait([sentinel])
            end(128 + signal.SIGTERM)

        threading.Thread(target=end_too, name="holdfast-parent", daemon=True).start()


@contextmanager
def postponed() -> Iterator[Callable[[], int]]:
    """Leave `GRACE` to finish what is open; the function gives the exit status asked for, or 0.

    Within it neither an interruption nor a termination raises anything: the work asks, between two
    steps. Whoever does not end within `GRACE` is ended.
    """
    _asked.clear()
    _postponing.set()
    try:
        yield lambda: _asked[0] if _asked else 0
    finally:
        _postponing.clear()


@contextmanager
def ended_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C, SIGTERM and SIGHUP call `stop`, in place of what they did; in the main thread only.

    For a loop that serves until it is told to end, which is its ordinary end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    woken = signal.set_wakeup_fd(-1)  # of `listening`, which would end the process at once
    ends = (signal.SIGINT, *_TERMINATIONS)
    heard = [n for n in ends if signal.getsignal(n) not in (signal.SIG_IGN, None)]
    before = {n: signal.signal(n, lambda *_: stop()) for n in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(woken)


def heed() -> None:
    """Raise the interruption that was lost, if there was one."""
    if _told_to_stop.is_set():
        raise KeyboardInterrupt


def end(status: int, said: str = "") -> NoReturn:
    """Remove unfinished files, print that, and exit at once.

    Where the interruption hit code that runs text (as `exec` in a library's import), CPython
    remembers it as unhandled and would turn a plain exit into death by the signal.
    """
    if not _ends.acquire(blocking=False):
        time.sleep(60.0)  # another thread is already doing it
    try:
        discard_unfinished()
        if said:
            os.write(2, said.encode())  # bypasses the locks of the streams
    finally:
        os._exit(status)


def _hear_terminations() -> dict[int, Any]:
    """Install handlers and return the previous ones. The thread hears every handled signal."""
    before = {
        number: signal.signal(number, _ignored)
        for number in _TERMINATIONS
        if signal.getsignal(number) is signal.SIG_DFL
    }
    ear, mouth = socket.socketpair()
    mouth.setblocking(False)
    _ears[:] = [ear, mouth]
    signal.set_wakeup_fd(mouth.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_hear, args=(ear,), name="holdfast-signals", daemon=True).start()
    return before


def _hear(ear: socket.socket) -> None:
    with suppress(OSError):
        while heard := ear.recv(1):
            if heard[0] == signal.SIGINT:
                time.sleep(GRACE)
                end(INTERRUPTED, "\n" + said())
            if heard[0] in _TERMINATIONS:
                if _postponing.is_set():
                    time.sleep(GRACE)
                end(128 + heard[0])


def _ignored(number: int, frame: object) -> None:
    """The thread hears it."""
    _asked.append(128 + number)


def _stop(number: int, frame: object) -> None:
    if _postponing.is_set():
        _asked.append(INTERRUPTED)
        return
    if not _told_to_stop.is_set():  # a second one would only disturb what ends
        _told_to_stop.set()
        raise KeyboardInterrupt


def _report_lost(lost: sys.UnraisableHookArgs) -> None:
    if lost.exc_type is not KeyboardInterrupt:  # that one is remembered
        sys.__unraisablehook__(lost)
