"""Folders of results, checked before the work, and files that appear whole."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any, Protocol

from holdfast.errors import OutputError
from holdfast.host.writing import atomic_file


class Saves(Protocol):
    """An object that writes itself to a file."""

    def save(self, path: Path) -> Path: ...


def check_writable(folder: Path, option: str = "--out") -> None:
    """Find out before the work whether the folder can be made and written."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        raise OutputError(
            f"the folder {folder} cannot be written "
            f"({place} is not a folder, or belongs to another user)",
            remedy=f"choose another with {option}",
        )


def make_folder(folder: Path, option: str = "--out") -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"the folder {folder} cannot be made ({error.strerror})",
            remedy=f"choose another with {option}",
        ) from None


def saved(result: Saves, path: Path) -> Path:
    """The file; where it cannot be written the result is not lost, but beside other such."""
    try:
        return result.save(path)
    except OutputError as error:
        spare = Path(tempfile.mkdtemp(prefix="holdfast-")) / path.name
        try:
            result.save(spare)
        except OutputError:
            raise error from None
        raise OutputError(error.cause, remedy=f"the results are in {spare}") from None


def write_summary(path: Path, said: dict[str, Any]) -> Path:
    return write_text(path, json.dumps(said, indent=2) + "\n")


def write_text(path: Path, text: str) -> Path:
    """The file with this text, whole or not at all."""
    with atomic_file(path) as partial:
        partial.write_text(text, "utf-8")
    return path
