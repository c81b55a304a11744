"""A checkpoint that every part of a march writes for itself, into a folder that all of them see.

    said.json                 the problem, what has been done, the generation that holds
    7-120-values.npy          generation 7: the values of the part from place 120 of the first axis

The parts write a new generation beside the old one, which is removed when `said.json` names the
new. So whenever a process ends, one of them is complete. A march cut otherwise reads it too.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.errors import OutputError
from holdfast.host.writing import atomic_file

Values = npt.NDArray[Any]

SAID = "said.json"
_FILE = re.compile(r"(?P<generation>\d+)-(?P<first>\d+)-(?P<name>[a-z]+(_.+)?)\.npy")


class PartFiles:
    """The folder of the checkpoint of a march."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._generation = 0

    @property
    def next(self) -> int:
        """The number of the generation to be written."""
        return self._generation + 1

    def said(self) -> dict[str, Any] | None:
        """What it says of itself; None where no generation is complete."""
        if not (self.path / SAID).exists():
            return None
        said: dict[str, Any] = json.loads((self.path / SAID).read_text("utf-8"))
        self._generation = int(said["generation"])
        return said

    def folder(self) -> Path:
        """The folder, made where its parent exists."""
        try:
            self.path.mkdir(exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self.path} cannot be written ({error.strerror})") from None
        return self.path

    def finish(self, said: Mapping[str, Any], generation: int) -> None:
        """All parts have written this generation: it holds from now on."""
        with atomic_file(self.path / SAID) as partial:
            partial.write_text(json.dumps({**said, "generation": generation}), "utf-8")
        self._generation = generation
        for file, known in _files(self.path):
            if int(known["generation"]) != generation:
                file.unlink(missing_ok=True)


def write_part(folder: Path, generation: int, first: int, arrays: Mapping[str, Values]) -> None:
    """The arrays of a part whose own nodes begin at place `first` of the first axis."""
    for name, values in arrays.items():
        path = folder / f"{generation}-{first}-{name}.npy"
        try:
            with path.open("wb") as file:
                np.save(file, np.asarray(values))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OutputError(f"{path} cannot be written ({error.strerror})") from None


def read_parts(path: Path) -> Callable[[str], Any | None]:
    """The arrays of a checkpoint by name, over the whole grid, of which slices are read."""
    if path.is_file():
        kept = np.load(path, allow_pickle=False)
        return lambda name: kept.get(name)
    generation = str(json.loads((path / SAID).read_text("utf-8"))["generation"])
    found: dict[str, list[tuple[int, Values]]] = {}
    for file, known in _files(path):
        if known["generation"] == generation:
            array = np.load(file, mmap_mode="r", allow_pickle=False)
            found.setdefault(known["name"], []).append((int(known["first"]), array))
    return lambda name: _Joined(sorted(found[name], key=lambda p: p[0])) if name in found else None


class _Joined:
    """Arrays that follow one another, of which slices are taken as if they were one."""

    def __init__(self, parts: list[tuple[int, Values]]) -> None:
        self._arrays = [array for _, array in parts]
        self._ends = np.cumsum([0, *(len(a) for a in self._arrays)])

    def __getitem__(self, wanted: slice) -> Values:
        pieces = []
        for array, begin in zip(self._arrays, self._ends[:-1], strict=True):
            first, last = max(wanted.start - begin, 0), min(wanted.stop - begin, len(array))
            if first < last:
                pieces.append(array[first:last])
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _files(folder: Path) -> Iterator[tuple[Path, Mapping[str, str]]]:
    for file in folder.iterdir():
        if match := _FILE.fullmatch(file.name):
            yield file, match.groupdict()
