"""The state of a march in a file, to go on from.

The file is replaced as a whole, so that whenever a process ends, the last state or the one before
is there. What is skipped in a march is only what would not change: begun again from its values and
the number of its steps alone, it goes on to the same bit. A march that is divided, or on a disk,
has a folder instead, into which every part writes for itself and which all of them see; any march
goes on from either, whichever is further.

    said.json               the problem, what has been done, which generation holds and its parts
    3fa9.../120-values.npy  a generation: the values of the part from place 120 of the first axis

A new generation is written beside the old one, which is removed when `said.json` names the new. So
whenever a process ends, one of them is complete. No two have the same name: a part that was given
up, and still writes, does not write into one that holds. A march cut otherwise reads it too.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import sympy as sp

from holdfast._version import __version__
from holdfast.analysis.reachability.problem import Posed
from holdfast.errors import OutputError, SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import Done
from holdfast.execution.resources import Memory, Room
from holdfast.host.files import (
    atomic_file,
    discarded_at_the_end,
    kept_at_the_end,
    remove_left_over,
)
from holdfast.maths.definitions.quantity import stated

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
        contents = {
            "generation": new.name,
            "parts": [first for first, _ in written],
            "arrays": names,
        }
        kept_at_the_end(new)  # before it holds: an interruption may come at any time
        with atomic_file(self.path / SAID) as partial:
            partial.write_text(json.dumps({**said, **contents}), "utf-8")
        for other in self.path.iterdir():
            if _GENERATION.fullmatch(other.name) and other != new:
                self.remove(other)

    def remove(self, generation: Path) -> None:
        """Remove a generation that does not hold."""
        shutil.rmtree(generation, ignore_errors=True)
        kept_at_the_end(generation)


def write_part(generation: Path, first: int, arrays: Mapping[str, Array]) -> Written:
    """Write the arrays of a part whose own nodes begin at place `first` of the first axis; each is
    flat, shape (nodes of the part,)."""
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
        arrays = np.load(path, allow_pickle=False)
        return lambda name: arrays.get(name)
    said = json.loads((path / SAID).read_text("utf-8"))
    folder = path / said["generation"]

    def array_of(name: str) -> _Joined | None:
        if name not in said["arrays"]:
            return None
        files = {first * plane: _file(folder, first, name) for first in said["parts"]}
        return _Joined({k: np.load(f, mmap_mode="r", allow_pickle=False) for k, f in files.items()})

    return array_of


class _Joined:
    """Arrays by their first place, of which slices are taken as if they were one."""

    def __init__(self, arrays: Mapping[int, Array]) -> None:
        self._arrays = arrays

    def __getitem__(self, wanted: slice) -> Array:
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


class Resumable(Protocol):
    """A march whose state can be written and put back."""

    @property
    def divided(self) -> bool:
        """Whether its values are in several parts, or not in this process."""

    def code(self) -> str:
        """What the compiled march is called."""

    def recorded(self) -> float:
        """The time [s] up to which arrivals are recorded."""

    def arrays(self, room: Room) -> dict[str, Array]:
        """The values and the records over the grid, each of shape (nodes,); those of a divided
        march are brought together in the room."""

    def write(self, generation: Path) -> list[Written]:
        """Write what is held into the folder of a generation of a checkpoint."""

    def restore(self, path: Path, then: float) -> None:
        """Go on from the checkpoint at a path, which was recorded up to the time `then` [s]."""


SHOWN = 40
"""Characters up to which two texts that differ are shown."""


class Checkpoint:
    """The state of the march of a problem, written every `checkpoint_every` s of wall time.

    in_parts: whether every part of the march writes its own.
    """

    def __init__(self, posed: Posed, march: Resumable, in_parts: bool) -> None:
        self.path = path = posed.marching.checkpoint_file(posed.problem.kind)
        self.every = posed.marching.checkpoint_every
        self.identity = identity(posed) | {"the code of the march": march.code()}
        self.written = time.monotonic()
        self._files = PartFiles(path.with_name(f"{path.name}.parts"))
        self._march, self._in_parts = march, in_parts

    def load(self) -> Done:
        """Put back what was held; a march that has not begun where there is nothing.

        Raises `SimulationError` for another file than a checkpoint, and for one of another problem.
        """
        remove_left_over(self.path.parent)  # of a process that ended while it wrote
        saved = {p: said for p in (self.path, self._files.path) if (said := self._said(p))}
        if not saved:
            return Done()
        path = max(saved, key=lambda p: saved[p]["done"]["steps"])
        with readable(path):
            done = Done(**saved[path]["done"])
        self._march.restore(path.absolute(), saved[path].get("then", 0.0))
        return done

    def _said(self, path: Path) -> dict[str, Any] | None:
        """What a checkpoint says of itself; None where there is none."""
        if not path.exists():
            return None
        with readable(path):
            if path == self._files.path:
                said = self._files.said()
            elif path.is_file():
                with np.load(path, allow_pickle=False) as arrays:
                    said = json.loads(str(arrays["said"]))
            else:
                raise SimulationError(
                    f"{path} is not a regular file", remedy="choose another for it"
                )
            if said is not None:
                self._check(said["problem"])
        return said

    def save(self, done: Done) -> None:
        march = self._march
        said = {"problem": self.identity, "done": asdict(done), "then": march.recorded()}
        try:
            if self._in_parts:
                self._save_parts(said)
            else:
                with atomic_file(self.path) as partial, partial.open("wb") as file:
                    arrays: dict[str, Any] = march.arrays(Memory())
                    np.savez(file, said=np.array(json.dumps(said)), **arrays)
        except OutputError as error:
            raise OutputError(
                f"the checkpoint {error.cause}",
                remedy="choose a folder that exists, with room for it"
                + (", which all machines of the cluster share" if march.divided else ""),
            ) from None
        self.written = time.monotonic()

    def _save_parts(self, said: Mapping[str, Any]) -> None:
        generation = self._files.begin()
        try:
            written = self._march.write(generation)
        except BaseException:
            self._files.remove(generation)
            raise
        self._files.finish(said, generation, written)

    @property
    def due(self) -> bool:
        """Whether the last time was long enough ago."""
        return time.monotonic() - self.written >= self.every

    def _check(self, other: Mapping[str, str]) -> None:
        here = self.identity
        unlike = [n for n in {**here, **other} if here.get(n) != other.get(n)]
        if not unlike:
            return
        name = unlike[0]
        two = other.get(name, "none"), here.get(name, "none")
        shown = f", {two[0]} there and {two[1]} here" if len("".join(two)) <= SHOWN else ""
        more = f" (and {', '.join(unlike[1:])})" if unlike[1:] else ""
        raise SimulationError(
            f"the checkpoint {self.path} belongs to another problem: {name} differs{shown}{more}",
            remedy="remove it to begin anew, or choose another file",
        )


def identity(posed: Posed) -> dict[str, str]:
    """All that the numbers of a march depend on, by what a user calls it."""
    system, problem, marching = posed.system, posed.problem, posed.marching
    facts = {
        "the version of holdfast": __version__,
        "the problem": problem.kind,
        "the horizon": repr(posed.horizon),
        "start_time": repr(posed.start_time),
        "the times": repr(posed.asked if posed.several else ()),
        "arrival_steps": repr(posed.arrival_steps),
        "what is beyond the grid": posed.beyond or "continued",
    }
    facts |= {f"the axis {a.name}": _text(a) for a in posed.grid.axes}
    facts |= {f"parameter {q.name}": repr(q.value) for q in posed.named}
    facts |= {f"disturbance {n}": _text(v) for n, v in posed.disturbance.items()}
    facts |= {f"the rate of {n}": sp.srepr(r) for n, r in system.rates.items()}
    facts["the bounds of the inputs"] = _text(system.input_bounds)
    facts["the bounds of the disturbances"] = _text(system.disturbance_bounds)
    facts["the players"] = f"{problem.inputs}, {problem.disturbances}"
    for i, region in enumerate(problem.regions):
        facts[f"the {'second ' if i else ''}region"] = f"{region.name}: {sp.srepr(region.margin)}"
    facts |= {
        name: repr(getattr(marching, name))
        for name in (
            "scheme", "dissipation", "precision", "band", "tolerance", "symmetry", "samples"
        )
    }  # fmt: skip
    facts["order"] = repr(posed.method.order)
    facts["cfl"] = repr(posed.method.cfl)
    facts["the Runge-Kutta method"] = repr(posed.method.steps)
    facts["whether it is filtered"] = repr(posed.filtered)
    return facts


def _text(value: object) -> str:
    """A value of the library, by its parts."""
    if is_dataclass(value) and not isinstance(value, type):
        return "; ".join(f"{name} {_text(v)}" for name, v in stated(value).items())
    if isinstance(value, (sp.Basic, sp.MatrixBase)):
        return str(sp.srepr(value))
    if isinstance(value, tuple):
        return "(" + ", ".join(_text(v) for v in value) + ")"
    return repr(value)
