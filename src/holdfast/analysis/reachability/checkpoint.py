"""A march that survives the end of its process: its state in a file, to go on from.

The file is replaced as a whole, so that whenever a process ends, the last state or the one before
is there. What is skipped in a march is only what would not change: begun again from its values and
the number of its steps alone, it goes on to the same bit. A march that is divided, or on a disk,
has a folder instead (`checkpoint_parts.py`); any march goes on from either, whichever is further.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from holdfast._version import __version__
from holdfast.analysis.reachability.checkpoint_parts import PartFiles, readable
from holdfast.analysis.reachability.divided_march import DividedMarch
from holdfast.analysis.reachability.problem import Posed
from holdfast.errors import OutputError, SimulationError
from holdfast.execution.level_set.settling import Done
from holdfast.host.writing import atomic_file, remove_left_over

SHOWN = 40
"""Characters up to which two texts that differ are shown."""


class Checkpoint:
    """The state of the march of `posed` in the file `path`, written every `every` s of wall time.

    code: what the compiled march is called, which is a digest of its text. in_parts: whether every
    part of the march writes its own.
    """

    def __init__(self, path: Path, every: float, posed: Posed, code: str, in_parts: bool) -> None:
        self.path = path
        self.every = every
        self.identity = identity(posed) | {"the code of the march": code}
        self.written = time.monotonic()
        self._files = PartFiles(path.with_name(f"{path.name}.parts"))
        self._in_parts = in_parts

    def load(self, march: DividedMarch) -> Done:
        """Put back what was held; a march that has not begun where there is nothing.

        Raises `SimulationError` for another file than a checkpoint, and for one of another problem.
        """
        remove_left_over(self.path.parent)  # of a process that ended while it wrote
        found = {p: said for p in (self.path, self._files.path) if (said := self._said(p))}
        if not found:
            return Done()
        path = max(found, key=lambda p: found[p]["done"]["steps"])
        with readable(path):
            done = Done(**found[path]["done"])
        march.each("restore", path.absolute(), found[path].get("then", 0.0))
        return done

    def _said(self, path: Path) -> dict[str, Any] | None:
        """What a checkpoint says of itself; None where there is none."""
        if not path.exists():
            return None
        with readable(path):
            if path == self._files.path:
                said = self._files.said()
            elif path.is_file():
                with np.load(path, allow_pickle=False) as kept:
                    said = json.loads(str(kept["said"]))
            else:
                raise SimulationError(
                    f"{path} is not a regular file", remedy="choose another for it"
                )
            if said is not None:
                self._check(said["problem"])
        return said

    def save(self, done: Done, march: DividedMarch) -> None:
        said = {"problem": self.identity, "done": asdict(done), "then": march.recorded()}
        try:
            if self._in_parts:
                self._save_parts(said, march)
            else:
                with atomic_file(self.path) as partial, partial.open("wb") as file:
                    arrays: dict[str, Any] = dict(march.arrays())
                    np.savez(file, said=np.array(json.dumps(said)), **arrays)
        except OutputError as error:
            raise OutputError(
                f"the checkpoint {error.cause}",
                remedy="choose a folder that exists, with room for it"
                + (", which all machines of the cluster share" if march.divided else ""),
            ) from None
        self.written = time.monotonic()

    def _save_parts(self, said: Mapping[str, Any], march: DividedMarch) -> None:
        generation = self._files.begin()
        try:
            written = march.each("write", generation)
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
    found = {
        "the version of holdfast": __version__,
        "the problem": problem.kind,
        "the horizon": repr(posed.horizon),
        "start_time": repr(posed.start_time),
        "the times": repr(posed.asked if posed.several else ()),
        "arrival_steps": repr(posed.arrival_steps),
        "what is beyond the grid": posed.beyond or "continued",
    }
    found |= {f"the axis {a.name}": _text(a) for a in posed.grid.axes}
    found |= {f"parameter {q.name}": repr(q.value) for q in posed.named}
    found |= {f"disturbance {n}": _text(v) for n, v in posed.disturbance.items()}
    found |= {f"the rate of {n}": sp.srepr(r) for n, r in system.rates.items()}
    found["the bounds of the inputs"] = _text(system.input_bounds)
    found["the bounds of the disturbances"] = _text(system.disturbance_bounds)
    found["the players"] = f"{problem.inputs}, {problem.disturbances}"
    for i, region in enumerate(problem.regions):
        found[f"the {'second ' if i else ''}region"] = f"{region.name}: {sp.srepr(region.margin)}"
    found |= {
        name: repr(getattr(marching, name))
        for name in (
            "scheme", "dissipation", "precision", "band", "tolerance", "symmetry", "samples"
        )
    }  # fmt: skip
    found["order"] = repr(posed.method.order)
    found["cfl"] = repr(posed.method.cfl)
    found["the Runge-Kutta method"] = repr(posed.method.steps)
    found["whether it is filtered"] = repr(posed.filtered)
    return found


def _text(value: object) -> str:
    """A value of the library, by its parts."""
    if is_dataclass(value) and not isinstance(value, type):
        return "; ".join(f"{f.name} {_text(getattr(value, f.name))}" for f in fields(value))
    if isinstance(value, (sp.Basic, sp.MatrixBase)):
        return str(sp.srepr(value))
    if isinstance(value, tuple):
        return "(" + ", ".join(_text(v) for v in value) + ")"
    return repr(value)
