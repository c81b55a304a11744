"""A few lines at the foot of a terminal that are drawn again, below others that stay."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from typing import Any

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
        found = shutil.get_terminal_size()
        return found.columns, found.lines

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
