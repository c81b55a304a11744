"""The cells of a value function's set, as a candidate of what is certified.

The set that a march has found is an approximation. Which of its cells held inputs keep, or lead to
the target, is then proved as for any others, and nothing is lost by trying no further ones than
those that the set touches.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from holdfast.analysis.certificates.cells import Cells, Truths
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.march_report import Report
from holdfast.errors import SimulationError
from holdfast.maths.definitions.system import System

KEPT, REACHED = (
    ("viability-kernel", "discriminating-kernel"),
    ("capture-basin", "backward-reachable-tube"),
)
"""Kinds of sets that are tried without, and with, a target."""


@runtime_checkable
class SetOnGrid(Protocol):
    """What is read of a value function: V at the nodes of a grid, and of which problem it is."""

    @property
    def grid(self) -> Grid:
        """One axis for each state."""

    @property
    def names(self) -> tuple[str, ...]:
        """The states, in the order of the axes."""

    @property
    def report(self) -> Report:
        """The problem, the march and its error estimates."""

    def values(self, time: float | None = None) -> npt.NDArray[Any]:
        """V at the nodes, with an axis for each state."""


def check_candidate(value: SetOnGrid, system: System, *, target: bool) -> None:
    """Refuse the set of another system or problem, and an empty one."""
    report, kinds = value.report, REACHED if target else KEPT
    if value.names != system.state_names or report.system != system.name:
        raise SimulationError(
            f"the candidate belongs to system '{report.system}' with the states "
            + ", ".join(value.names),
            expected=f"system '{system.name}' with " + ", ".join(system.state_names),
        )
    if report.kind not in kinds:
        raise SimulationError(
            f"a candidate of the kind '{report.kind}' {'with' if target else 'without'} a target",
            expected="one of " + ", ".join(kinds),
        )
    if report.depends_on_time:
        raise SimulationError("the candidate depends on time, and a certificate does not")


def touched_by(value: SetOnGrid, margin: float) -> Callable[[Cells], Truths]:
    """Which cells may have a state with V > margin: those with such a node in or around them.

    Raises `SimulationError` where no node has it.
    """
    from scipy.ndimage import maximum_filter

    high, axes = value.values() > margin, value.grid.axes
    if not high.any():
        raise SimulationError(
            f"no node of the candidate has V > {margin:g}", remedy="take a smaller margin"
        )
    modes = ["wrap" if a.ends == "periodic" else "nearest" for a in axes]

    def touched(cells: Cells) -> Truths:
        wide = [float(np.diff(e).max()) for e in cells.edges]
        sizes = [2 * (math.ceil(w / 2 / a.step) + 1) + 1 for w, a in zip(wide, axes, strict=True)]
        near = maximum_filter(high, size=sizes, mode=modes)
        places = []
        for edges, a in zip(cells.edges, axes, strict=True):
            middle = np.rint((0.5 * edges[:-1] + 0.5 * edges[1:] - a.low) / a.step).astype(np.int64)
            turns = a.ends == "periodic"
            places.append(middle % a.count if turns else np.clip(middle, 0, a.count - 1))
        hits: Truths = near[np.ix_(*places)].reshape(-1)
        return hits

    return touched
