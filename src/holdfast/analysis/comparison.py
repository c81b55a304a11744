"""Laws side by side: of the same starts, how many each keeps in the region and brings home."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

from holdfast.analysis.result import Result
from holdfast.execution.closed_loop import Outcome

Array = npt.NDArray[np.float64]

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Rate:
    """count of total, with Wilson's interval at the level `CONFIDENCE`."""

    count: int
    total: int

    @property
    def value(self) -> float:
        return self.count / self.total

    @property
    def interval(self) -> tuple[float, float]:
        found = binomtest(self.count, self.total).proportion_ci(CONFIDENCE, method="wilson")
        return float(found.low), float(found.high)

    def summary(self) -> dict[str, Any]:
        return {"count": self.count, "rate": self.value, "interval": list(self.interval)}


@dataclass(frozen=True)
class Trial:
    """One law in one case: what became of every run.

    viable (run): never left the region; rescued (run): viable, and in the goal at the end;
    length (run): of the path in the plane [m], not a number without a plane.
    """

    law: str
    case: str
    viable: npt.NDArray[np.bool_]
    rescued: npt.NDArray[np.bool_]
    length: Array
    in_goal_since: Array
    switches: npt.NDArray[np.int64]
    chattered: int
    diverged: int
    relaxed: int
    worst: dict[str, float | None]
    wall_time: float


def trial(law: str, case: str, result: Result, plane: tuple[str, str] | None) -> Trial:
    """What a comparison keeps of a result; the trajectories can be dropped then."""
    data, summary = result.dataset, result.summary()
    outcome = data["outcome"].values
    length = np.full(len(outcome), np.nan)
    if plane is not None:
        steps = [np.diff(data["state"].sel(state_name=n).values, axis=1) for n in plane]
        length = np.hypot(*steps).sum(axis=1)
    kept = (Outcome.STAYED, Outcome.REACHED, Outcome.CHATTERED)
    return Trial(
        law=law,
        case=case,
        viable=np.isin(outcome, kept),
        rescued=outcome == Outcome.REACHED,
        length=length,
        in_goal_since=data["goal_time"].values,
        switches=data["switches"].values,
        chattered=int((outcome == Outcome.CHATTERED).sum()),
        diverged=int((outcome == Outcome.DIVERGED).sum()),
        relaxed=int((data["infeasible"].values > 0).sum()),
        worst=summary["worst_constraint"],
        wall_time=float(summary["wall_time_s"]),
    )


@dataclass(frozen=True)
class Comparison:
    """Every law in every case, on the same starts within a case.

    The rescue rate of a law is the fraction of the starts from which the closed loop stays in the
    region over the horizon and ends in the goal. A detour is the length of a rescued run's path
    over the shortest that any of the laws found from that start (not below 1 cm).
    """

    title: str
    scenario: str
    laws: dict[str, str]
    cases: dict[str, str]
    trials: tuple[Trial, ...]
    horizon: float
    seed: int

    def of(self, law: str, case: str) -> Trial:
        """The trial of that law in that case (KeyError if there is none)."""
        return {(t.law, t.case): t for t in self.trials}[law, case]

    def viable(self, law: str, case: str) -> Rate:
        found = self.of(law, case)
        return Rate(int(found.viable.sum()), len(found.viable))

    def rescued(self, law: str, case: str) -> Rate:
        found = self.of(law, case)
        return Rate(int(found.rescued.sum()), len(found.rescued))

    def detours(self, law: str, case: str) -> Array:
        """Of the rescued runs; empty where there is none."""
        rows = [self.of(other, case) for other in self.laws]
        lengths = np.array([np.where(t.rescued, t.length, np.inf) for t in rows])
        shortest = np.maximum(lengths.min(axis=0), 0.01)
        mine = self.of(law, case)
        ratio: Array = (mine.length / shortest)[mine.rescued]
        return np.maximum(ratio[np.isfinite(ratio)], 1.0)

    def summary(self) -> dict[str, Any]:
        """For comparison.json."""
        return {
            "scenario": self.scenario,
            "title": self.title,
            "seed": self.seed,
            "horizon_s": self.horizon,
            "confidence": CONFIDENCE,
            "laws": dict(self.laws),
            "cases": dict(self.cases),
            "trials": [self._summary(t) for t in self.trials],
        }

    def _summary(self, t: Trial) -> dict[str, Any]:
        detours = self.detours(t.law, t.case)
        since = t.in_goal_since[t.rescued]
        return {
            "law": t.law,
            "case": t.case,
            "runs": len(t.viable),
            "viable": self.viable(t.law, t.case).summary(),
            "rescued": self.rescued(t.law, t.case).summary(),
            "detour": _spread(detours),
            "in_goal_since": _spread(since),
            "switches": _spread(t.switches[t.rescued]),
            "runs_chattered": t.chattered,
            "runs_diverged": t.diverged,
            "runs_relaxed": t.relaxed,
            "worst_constraint": t.worst,
            "wall_time_s": t.wall_time,
        }


def _spread(values: Sequence[float] | npt.NDArray[Any]) -> dict[str, float | None]:
    known = np.asarray(values, dtype=float)
    if not len(known):
        return {"median": None, "worst": None}
    return {"median": float(np.median(known)), "worst": float(known.max())}
