"""Problems to be marched over a grid, and options of the march."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.analysis.reachability.given import by_name, number, whole
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.device.program import DEVICES
from holdfast.execution.level_set.march import Method
from holdfast.execution.level_set.rate_leaves import DISSIPATIONS
from holdfast.execution.level_set.schemes import schemes
from holdfast.maths.definitions.region import Region

REFINEMENTS = (1, 2, 4, 8)
"""How many times shorter the cells near a boundary may be."""


@dataclass(frozen=True)
class Marching:
    """Options for solving a problem.

    scheme: "upwind", "eno2", "eno3" or "weno5"; order: of the Runge-Kutta method, 1 to 3, by
    default that of the scheme; dissipation: "global", "local" or "local-local"; cfl: share of the
    largest stable Euler step, of which a step of order 2 or 3 has two (the march that is filtered,
    beside one that does not come to rest, is of order 2 at most and has steps up to a quarter
    longer); precision: "float64" or "float32"; band: the value is cut off at this
    distance from zero on either side, and what is beyond is settled and skipped, so that the cost
    is that of the boundary; skip: leave out what is settled, which does not change the answer;
    threads: by default all cores; of every worker of a cluster, by default those that it has.

    tolerance [cells]: the march has converged when the boundary of the set, at the speed that it
    still has, moves by no more than this share of a cell over the rest of the horizon, in as long
    again as the march has gone, and while a cell is crossed along the slowest axis; and when that
    speed falls. A node that is deeper inside counts by the share of its value that it loses. No
    unit enters: seconds, metres and radians may be rescaled. `residual_cells` of the result is
    what is left to move.

    checkpoint: a file that the state of the march is written to, at the start, every
    `checkpoint_every` s of wall time (60) and at the end, or a folder to put one in, named after
    the problem. The same problem goes on from it, to the same bit; another is refused. It stays
    when the march has ended, so that a result that was not saved is not lost: remove it then.

    symmetry: state -> -1 for those that change sign in a reflection that leaves the problem as it
    is; half of the grid is computed then. It is checked symbolically (`maths/symmetry.py`).

    refine: cells so many times shorter near the boundary of the set: 1, 2, 4 or 8. The value is
    that of the finer grid at all of its nodes, of which only blocks around the boundary are
    marched (`refinement.py`).

    samples: where the rates have no closed form in an input or a disturbance, the points along
    every coordinate of its set that are looked at (`maths/sampled.py`); by default the system's.

    estimate_error, check_outside: what the answer is worth, by further marches (`worth.py`).

    device: "cpu", or "gpu": the same definition as kernels of CUDA, by way of CuPy (an extra of
    this package); values differ from those of the processor by roundings. "c++" compiles the text
    of these kernels with the C++ compiler of this machine, to check it.

    on_disk: a folder for the arrays, of a grid that is larger than the memory; the march reads and
    writes them there. cluster: the workers that the grid is divided among (`march_cluster.py`).
    The answer is that of one machine in its memory, to the same bit.
    """

    scheme: str = "weno5"
    order: int | None = None
    dissipation: str = "local-local"
    cfl: float = 0.75
    precision: str = "float64"
    band: float = math.inf
    tolerance: float = 0.01
    skip: bool = True
    threads: int | None = None
    symmetry: Mapping[str, int] | None = None
    checkpoint: str | Path | None = None
    checkpoint_every: float = 60.0
    refine: int = 1
    samples: int | None = None
    estimate_error: bool | str = False
    check_outside: bool = False
    device: str = "cpu"
    on_disk: str | Path | None = None
    cluster: Any = None

    def __post_init__(self) -> None:
        for name, known in (
            ("scheme", tuple(schemes())),
            ("dissipation", DISSIPATIONS),
            ("precision", ("float64", "float32")),
            ("device", DEVICES),
        ):
            if (value := getattr(self, name)) not in known:
                raise SimulationError(f"{name}: {value!r}", remedy=suggestion(str(value), known))
        if self.order is not None:
            whole("order: ", self.order, 1, 3)
        number("cfl: ", self.cfl, "a number above 0, at most 1", lambda v: 0 < v <= 1)
        number("band: ", self.band, "a number above 0; infinite for none", lambda v: v > 0)
        number("tolerance: ", self.tolerance, "a number of cells above 0", lambda v: v > 0)
        if self.threads is not None:
            whole("threads: ", self.threads, 1, 1024)
        for name in ("skip", "check_outside", "estimate_error"):
            value = getattr(self, name)
            also = name == "estimate_error" and value == "order"
            if not (isinstance(value, (bool, np.bool_)) or also):
                both = name == "estimate_error"
                expected = 'True, False or "order"' if both else "True or False"
                raise SimulationError(f"{name}: {value!r}", expected=expected)
        if self.symmetry is not None:
            by_name("symmetry", self.symmetry, '{"y": -1}')
        if self.checkpoint is not None and not isinstance(self.checkpoint, (str, Path)):
            raise SimulationError(f"checkpoint: {self.checkpoint!r}", expected="a file or a folder")
        if self.on_disk is not None and not (
            isinstance(self.on_disk, (str, Path)) and str(self.on_disk)
        ):
            raise SimulationError(f"on_disk: {self.on_disk!r}", expected="a folder")
        if self.cluster is not None and not hasattr(self.cluster, "parts"):
            raise SimulationError(
                f"cluster: {self.cluster!r}",
                expected="a cluster",
                remedy="make one: holdfast.interop.march_cluster.march_cluster(address)",
            )
        for name in ("cluster", "on_disk"):
            if self.device != "cpu" and getattr(self, name) is not None:
                raise SimulationError(
                    f'device="{self.device}" with {name}', remedy="leave one of them out"
                )
        number("checkpoint_every: ", self.checkpoint_every, "seconds, at least 0", lambda v: v >= 0)
        if whole("refine: ", self.refine, 1) not in REFINEMENTS:
            raise SimulationError(f"refine: {self.refine}", expected="1, 2, 4 or 8")
        if self.refine > 1:
            for name in ("symmetry", "checkpoint", "check_outside", "cluster", "on_disk"):
                if getattr(self, name):
                    raise SimulationError(
                        f"refine with {name}, which needs a march of every node of the finer grid",
                        remedy=f"leave out {name}, or take more nodes in place of refine",
                    )
        if self.checkpoint is None and self.checkpoint_every != 60.0:
            raise SimulationError(
                "checkpoint_every without a checkpoint", remedy="say checkpoint=a file or a folder"
            )

    @property
    def method(self) -> Method:
        order = self.order or schemes()[self.scheme].order
        return Method(self.scheme, order, self.dissipation, self.cfl, self.skip)

    @property
    def first_order(self) -> bool:
        """Whether the slopes of the scheme are the plain differences."""
        return schemes()[self.scheme].one_slope

    @property
    def smeared(self) -> bool:
        """Whether a scheme of first order has speeds beyond those that the two slopes allow."""
        return self.first_order and self.dissipation != "local-local"

    @property
    def monotone(self) -> bool:
        """Whether a step keeps the order of two values, less everywhere before, less after, of a
        Hamiltonian that `is_sharp` (`maths/games/monotone_flux.py`)."""
        return self.first_order and self.method.order == 1 and not self.smeared

    def aside(self, name: str, kind: str) -> Marching:
        """For a further march that tells what the first is worth; its checkpoint is named so."""
        path = self.checkpoint
        if path is not None:
            path = self.checkpoint_file(kind)
            path = path.with_name(f"{path.name}.{name}")
        return replace(self, checkpoint=path, estimate_error=False, check_outside=False)

    def checkpoint_file(self, kind: str) -> Path:
        path = Path(self.checkpoint or ".")
        return path / f"{kind}.checkpoint" if path.is_dir() else path


def marching_of(options: Mapping[str, Any]) -> Marching:
    """The options as they were given, with a refusal of unknown names."""
    for name in options:
        if name not in Marching.__dataclass_fields__:
            raise SimulationError(
                f"unknown option '{name}'", remedy=suggestion(name, Marching.__dataclass_fields__)
            )
    return Marching(**options)


@dataclass(frozen=True)
class Problem:
    """A problem: the initial region, how the set changes, and the obstacles.

    limit: "shrink" if `start` is to be kept, "grow" if it is to be reached, "free" if it is to be
    reached within `above`, "exact" if it is to be reached at the horizon itself. inputs,
    disturbances: "max" or "min", what each player makes of the value. backwards: the dynamics run
    in reverse.
    """

    kind: str
    limit: str
    start: Region
    inputs: str = "max"
    disturbances: str = "min"
    above: Region | None = None
    backwards: bool = False

    @property
    def regions(self) -> tuple[Region, ...]:
        return (self.start,) if self.above is None else (self.start, self.above)
