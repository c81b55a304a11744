"""Standard streams: lines that come, output that may be closed or full, a few lines drawn again.

Lines are those of a pipe, a terminal or a file, of bounded length. Those at the foot of a terminal
are drawn again, below others that stay.
"""

from __future__ import annotations

import io
import os
import select
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

LONGEST = 1 << 16
"""Bytes of a line; of a longer one that many are given."""


def lines(descriptor: int, tick: float | None = None) -> Iterator[bytes | None]:
    """The lines, without their ends; None where none came for `tick` seconds.

    What stands behind the last end is a line too.
    """
    held, skipping = b"", False
    while True:
        if tick is not None and not select.select([descriptor], [], [], tick)[0]:
            yield None
            continue
        read = os.read(descriptor, LONGEST)
        if not read:
            break
        *whole, held = (held + read).split(b"\n")
        for line in whole:
            if not skipping:
                yield line[:LONGEST]
            skipping = False
        if len(held) > LONGEST:
            if not skipping:
                yield held[:LONGEST]
            held, skipping = b"", True
    if held and not skipping:
        yield held


_UP, _TO_END_OF_LINE, _TO_END = "\x1b[{}F", "\x1b[K", "\x1b[J"
_NO_WRAP, _WRAP = "\x1b[?7l", "\x1b[?7h"


def is_live(stream: Any) -> bool:
    """Whether the stream is a terminal that moves its cursor."""
    return bool(stream.isatty()) and os.environ.get("TERM", "") not in ("", "dumb")


def has_colours(stream: Any) -> bool:
    """Whether colours are wanted: https://no-color.org."""
    return is_live(stream) and not os.environ.get("NO_COLOR")


def has_blocks(stream: Any) -> bool:
    """Whether the characters of bars can be written."""
    try:
        "▁█".encode(getattr(stream, "encoding", None) or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def plain(text: str, stream: Any) -> str:
    """The text as that stream can show it: whoever wrote it does not move the cursor."""
    shown = "".join(c if c.isprintable() else "?" for c in text)
    encoding = getattr(stream, "encoding", None) or "ascii"
    return shown.encode(encoding, "replace").decode(encoding)


class Foot:
    """Draws lines at the foot of a terminal; what is `said` stands above them and stays."""

    def __init__(self, stream: Any) -> None:
        self.stream, self._drawn = stream, 0

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        terminal = shutil.get_terminal_size()
        return terminal.columns, terminal.lines

    def draw(self, lines: Sequence[str], said: Sequence[str] = ()) -> None:
        """`said`, and below it `lines` in place of those drawn before."""
        rows = self.size[1] - 1
        shown = list(lines)[: max(rows, 1)]
        text = _UP.format(self._drawn) if self._drawn else ""
        text += "".join(f"{line}{_TO_END_OF_LINE}\n" for line in said)
        text += _NO_WRAP + "".join(f"{line}{_TO_END_OF_LINE}\n" for line in shown) + _WRAP
        self.stream.write(text + _TO_END)
        self.stream.flush()
        self._drawn = len(shown)


class Stream:
    """A stream whose failures do not end the program: `trouble` says what could not be written.

    A reader that closes the pipe early, as `head` does, does not count as a failure.
    """

    def __init__(self, stream: Any) -> None:
        self.stream = stream
        self.muted = False
        self.trouble = ""

    def write(self, text: str) -> int:
        if not self.muted:
            self._tried(lambda: self.stream.write(text))
        return len(text)

    def flush(self) -> None:
        if not self.muted:
            self._tried(self.stream.flush)

    def _tried(self, act: Any) -> None:
        try:
            act()
        except OSError as error:
            self.muted = True
            if not isinstance(error, BrokenPipeError):
                self.trouble = error.strerror or str(error)
            with suppress(OSError):  # the rest of its buffer is discarded without a message
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self.stream.fileno())
                os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def forgiving() -> Iterator[Stream]:
    """Wrap both streams; closed ones go to the null device. Returns standard output."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # otherwise the next file opened would get the descriptor of a stream
            os.open(os.devnull, os.O_RDWR)
    before = sys.stdout, sys.stderr
    out, error = (Stream(stream if stream is not None else io.StringIO()) for stream in before)
    sys.stdout, sys.stderr = out, error
    try:
        yield out
    finally:
        out.flush()
        error.flush()
        sys.stdout, sys.stderr = before


def descriptor_of(stream: Any) -> int:
    """The number of a stream, for those who wait for it; of a closed one that of standard input."""
    return 0 if stream is None else int(stream.fileno())


def has_reader(stream: Any) -> bool:
    """Whether what is written there still reaches someone; see `Stream`."""
    return not getattr(stream, "muted", False)
