"""Reading the user's files: regular files of bounded size, never a device or a pipe, and from the
web what the user asked for."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from holdfast.errors import ScenarioError

MOST_TEXT = 10 * 2**20
"""Bytes of a text file: a scenario takes a few thousand."""

FETCH_VARIABLE = "HOLDFAST_FETCH"
"""Environment variable, 1 where scenarios may fetch what they name from the web."""


def scenarios_may_fetch() -> bool:
    """Whether a scenario, which may be a stranger's, opens addresses that it names."""
    return os.environ.get(FETCH_VARIABLE, "") == "1"


def check_file(path: str | Path) -> None:
    """Refuse a path that is missing or is not a regular file, after following links."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the name
        reason = getattr(error, "strerror", None) or "not a valid file name"
        raise ScenarioError(f"{path}: cannot be read ({reason})") from None
    if not stat.S_ISREG(mode):
        raise ScenarioError(f"{path}: cannot be read ({_kind(mode)})", expected="a file")


def read_small_text(path: str | Path, most: int = MOST_TEXT) -> str:
    """The text of a file in UTF-8, with or without a byte order mark.

    Raises `ScenarioError` if the path cannot be read, is not a regular file, is not text or is too
    """
    check_file(path)
    try:
        with open(path, "rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > most:
        size = os.stat(path).st_size / 2**20
        raise ScenarioError(
            f"{path}: is too large ({size:,.0f} MiB)", expected=f"at most {most // 2**20} MiB"
        )
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except ValueError:
        raise ScenarioError(f"{path}: is not a text file in UTF-8") from None


def _kind(mode: int) -> str:
    for kind, name in (
        (stat.S_ISDIR, "it is a folder"),
        (stat.S_ISFIFO, "it is a pipe"),
        (stat.S_ISCHR, "it is a device"),
        (stat.S_ISBLK, "it is a device"),
        (stat.S_ISSOCK, "it is a socket"),
    ):
        if kind(mode):
            return name
    return "it is not a file"
