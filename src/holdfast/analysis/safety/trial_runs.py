"""The outcomes of the runs of a promise, counted for the layers of its set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.safety.depth import Outer
from holdfast.analysis.safety.verdict import Layer, Trials
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.execution.arrays import Array

NO_DISTURBANCE = "no disturbance"
ALL = "every disturbance tried"


@dataclass(frozen=True)
class Runs:
    """Outcomes of runs: kept, left the grid first, nearness to the boundary (large: near), time.

    worst: the largest constraint of each run, NaN for a basin; missed: the negative value of the
    run, by how much it leaves the region, or of a basin misses the goal or leaves it before.
    """

    kept: npt.NDArray[np.bool_]
    off_grid: npt.NDArray[np.bool_]
    near: Array
    time: Array
    outcome: npt.NDArray[Any]
    worst: Array
    missed: Array
    relaxed: npt.NDArray[np.bool_]

    @property
    def excursion(self) -> float:
        return float(np.max(self.worst))

    def part(self, which: slice) -> Runs:
        """Those of some starts."""
        return Runs(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def trials(self, what: str) -> Trials:
        kept = Rate(int(self.kept.sum()), len(self.kept))
        return Trials(what, kept, int(self.off_grid.sum()), self.excursion, int(self.relaxed.sum()))


def layers_of(outer: Outer, every: Sequence[Runs], loss: float | None) -> tuple[Layer, ...]:
    """The layers of a set around the states inside, whose runs are the last of every kind.

    loss: of a held input, where the set claims what is a cell inside.
    """
    parts = (
        (outer.between, outer.between_share, "at least a cell inside", "a cell", loss),
        (outer.edge, outer.edge_share, "within a cell of the edge", "the edge", None),
    )
    layers, ahead = [], len(every[0].kept) - sum(len(states) for states, *_ in parts)
    for states, share, where, down_to, allowed in parts:
        runs = [r.part(slice(ahead, ahead + len(states))) for r in every]
        ahead += len(states)
        if len(states):
            missed = max(float(np.where(r.kept, 0.0, r.missed).max()) for r in runs)
            trials = _against_all(runs)
            layers.append(Layer(where, down_to, share, trials, max(missed, 0.0), allowed))
    return tuple(layers)


def _against_all(every: Sequence[Runs]) -> Trials:
    """The starts against all that was tried."""
    kept: Any = np.stack([r.kept for r in every]).all(axis=0)
    off: Any = np.stack([r.off_grid for r in every]).any(axis=0) & ~kept
    relaxed: Any = np.stack([r.relaxed for r in every]).any(axis=0)
    worst = float(np.max([r.excursion for r in every]))
    what = ALL if len(every) > 1 else NO_DISTURBANCE
    rate = Rate(int(kept.sum()), len(kept))
    return Trials(what, rate, int(off.sum()), worst, int(relaxed.sum()))
