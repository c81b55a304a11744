"""Lines of a stream as they come: of a pipe, a terminal or a file, of bounded length."""

from __future__ import annotations

import os
import select
from collections.abc import Iterator

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
