"""A checkpoint that every part of a march writes for itself, into a folder that all of them see.

    said.json               the problem, what has been done, which generation holds and its parts
    3fa9.../120-values.npy  a generation: the values of the part from place 120 of the first axis

The parts write a new generation beside the old one, which is removed when `said.json` names the
new. So whenever a process ends, one of them is complete. No two have the same name: a part that was
given up, and still writes, does not write into one that holds. A march cut otherwise reads it too.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.errors import OutputError, SimulationError
from holdfast.host.writing import atomic_file, discarded_at_the_end, kept_at_the_end

Values = npt.NDArray[Any]

SAID = "said.json"
_GENERATION = re.compile(r"[0-9a-f]{16}")

Written = tuple[int, list[str]]
"""What a part has written: the place of the first axis that it begins at, and names of arrays."""


class PartFiles:
    """The folder of the checkpoint of a march."""

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()  # whoever reads and writes there may be in another folder

    def said(self) -> dict[str, Any] | None:
        """What it says of itself; None where no generation is complete."""
        if not (self.path / SAID).exists():
            return None
        said: dict[str, Any] = json.loads((self.path / SAID).read_text("utf-8"))
        return said

    def begin(self) -> Path:
        """A folder for a new generation; it is made where the parent of `path` exists."""
        new = self.path / secrets.token_hex(8)
        try:
            self.path.mkdir(exist_ok=True)
            discarded_at_the_end(new).mkdir()
        except OSError as error:
            raise OutputError(f"{self.path} cannot be written ({error.strerror})") from None
        return new

    def finish(self, said: Mapping[str, Any], new: Path, written: Sequence[Written]) -> None:
        """All parts have written this generation: it holds from now on."""
        names = sorted({name for _, arrays in written for name in arrays})
        found = {"generation": new.name, "parts": [first for first, _ in written], "arrays": names}
        kept_at_the_end(new)  # before it holds: an interruption may come at any time
        with atomic_file(self.path / SAID) as partial:
            partial.write_text(json.dumps({**said, **found}), "utf-8")
        for other in self.path.iterdir():
            if _GENERATION.fullmatch(other.name) and other != new:
                self.remove(other)

    def remove(self, generation: Path) -> None:
        """Remove a generation that does not hold."""
        shutil.rmtree(generation, ignore_errors=True)
        kept_at_the_end(generation)


def write_part(generation: Path, first: int, arrays: Mapping[str, Values]) -> Written:
    """Write the arrays of a part whose own nodes begin at place `first` of the first axis."""
    for name, values in arrays.items():
        path = _file(generation, first, name)
        try:
            with path.open("wb") as file:
                np.save(file, np.asarray(values))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OutputError(f"{path} cannot be written ({error.strerror or error})") from None
    return first, list(arrays)


@contextmanager
def readable(path: Path, expected: str = "") -> Iterator[None]:
    """Refuse what is at a path where it cannot be read as a checkpoint."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
        raise SimulationError(
            f"{path} cannot be read as a checkpoint",
            expected=expected,
            remedy="remove it to begin anew, or choose another file",
        ) from None


def read_parts(path: Path, plane: int) -> Callable[[str], Any | None]:
    """The arrays of a checkpoint by name, over the whole grid, of which slices are read.

    plane: the number of nodes at a place of the first axis.
    """
    if path.is_file():
        kept = np.load(path, allow_pickle=False)
        return lambda name: kept.get(name)
    said = json.loads((path / SAID).read_text("utf-8"))
    folder = path / said["generation"]

    def known(name: str) -> _Joined | None:
        if name not in said["arrays"]:
            return None
        files = {first * plane: _file(folder, first, name) for first in said["parts"]}
        return _Joined({k: np.load(f, mmap_mode="r", allow_pickle=False) for k, f in files.items()})

    return known


class _Joined:
    """Arrays by their first place, of which slices are taken as if they were one."""

    def __init__(self, arrays: Mapping[int, Values]) -> None:
        self._arrays = arrays

    def __getitem__(self, wanted: slice) -> Values:
        pieces = []
        for begin, array in sorted(self._arrays.items()):
            first, last = max(wanted.start - begin, 0), min(wanted.stop - begin, len(array))
            if first < last:
                pieces.append(array[first:last])
        if sum(map(len, pieces)) != wanted.stop - wanted.start:
            raise ValueError("some of the values are missing")
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _file(generation: Path, first: int, name: str) -> Path:
    return generation / f"{first}-{name}.npy"
