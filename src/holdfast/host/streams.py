"""Standard output and standard error that may be closed or full, or whose reader has ended."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any


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
