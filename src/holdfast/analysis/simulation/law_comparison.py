"""Comparison of laws: the share of common starts that each keeps in the region and brings home.

The share is also given among the starts inside a viability kernel, which some law can keep.

Counts, shares, means, maxima and minima are combined from parts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from holdfast.analysis.simulation.result import Result
from holdfast.arguments import checked
from holdfast.errors import ScenarioError
from holdfast.execution.arrays import AnyArray, Array, Truths, Wholes
from holdfast.execution.simulation.settings import Outcome

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
        from scipy.stats import binomtest  # 22 MB, not needed by a march

        ends = binomtest(self.count, self.total).proportion_ci(CONFIDENCE, method="wilson")
        return float(ends.low), float(ends.high)

    def summary(self) -> dict[str, Any]:
        return {"count": self.count, "rate": self.value, "interval": list(self.interval)}


@dataclass(frozen=True)
class Trial:
    """One law in one case: the outcome of every run.

    viable (run): never left the region; rescued (run): viable, and in the goal at the end if the
    case has one; length (run): of the path in the plane [m], NaN without a plane; vertices: the
    outcomes at each vertex of the varied parameters.
    """

    law: str
    case: str
    viable: Truths
    rescued: Truths
    length: Array
    in_goal_since: Array
    switches: Wholes
    chattered: int
    diverged: int
    relaxed: int
    worst: dict[str, float | None]
    wall_time: float
    vertices: Sequence[Mapping[str, Any]] = ()


def trial(law: str, case: str, result: Result, plane: tuple[str, str] | None) -> Trial:
    """The part of a result that a comparison needs, without the trajectories."""
    data, summary = result.arrays, result.summary()
    outcome = data["outcome"].values
    length = np.full(len(outcome), np.nan)
    if plane is not None:
        names = [str(n) for n in data["state_name"].values]
        steps = [np.diff(data["state"].values[:, :, names.index(n)], axis=1) for n in plane]
        length = np.hypot(*steps).sum(axis=1)
    viable = np.isin(
        outcome, (Outcome.STAYED, Outcome.REACHED, Outcome.CHATTERED, Outcome.OFF_GRID)
    )
    return Trial(
        law=law,
        case=case,
        viable=viable,
        rescued=outcome == Outcome.REACHED if data.attrs["goal"] else viable,
        length=length,
        in_goal_since=data["goal_time"].values,
        switches=data["switches"].values,
        chattered=int((outcome == Outcome.CHATTERED).sum()),
        diverged=int((outcome == Outcome.DIVERGED).sum()),
        relaxed=int((data["infeasible"].values > 0).sum()),
        worst=summary["worst_constraint"],
        wall_time=float(summary["wall_time_s"]),
        vertices=tuple(summary["vertices"]),
    )


@dataclass(frozen=True)
class Reference:
    """The reference kernel of a case: its value V at every start.

    value (run) [unit]: NaN beyond the grid; margin [unit]: the least depth inside, or outside, of a
    counted start; horizon [s]: the time that the kernel covers, infinite if it has converged.
    """

    kernel: str
    value: Array
    margin: float
    unit: str
    horizon: float

    @property
    def inside(self) -> Truths:
        """Starts with V > margin, which some input keeps: shape (starts,)."""
        return self.value > self.margin

    @property
    def given_up(self) -> Truths:
        """Starts with V < -margin, which no input keeps by the kernel: shape (starts,)."""
        return self.value < -self.margin

    def summary(self) -> dict[str, Any]:
        return {
            "kernel": self.kernel,
            "horizon_s": self.horizon if np.isfinite(self.horizon) else None,
            "margin": self.margin,
            "unit": self.unit,
            "starts_inside": int(self.inside.sum()),
            "starts_given_up": int(self.given_up.sum()),
            "starts_beyond_grid": int(np.isnan(self.value).sum()),
        }


@dataclass(frozen=True)
class Comparison:
    """Every law in every case, on the same starts within a case.

    The rescue rate of a law is the fraction of the starts from which the closed loop stays in the
    region over the horizon and ends in the goal, if there is one. A detour is the ratio of a
    rescued run's path length to the shortest that any of the laws found from that start (not below
    1 cm). references: the kernels of the cases, as far as one can be computed; unjudged: the cases
    without one, and the reasons.
    """

    title: str
    scenario: str
    laws: dict[str, str]
    cases: dict[str, str]
    trials: tuple[Trial, ...]
    horizon: float
    seed: int
    to_goal: bool = True
    references: Mapping[str, Reference] = field(default_factory=dict)
    unjudged: Mapping[str, str] = field(default_factory=dict)

    @checked
    def of(self, law: str, case: str) -> Trial:
        """The trial of that law in that case; `ScenarioError` if it does not exist."""
        trials = {(t.law, t.case): t for t in self.trials}
        if (law, case) not in trials:
            names = "; ".join(", ".join(pair) for pair in trials)
            raise ScenarioError(f"no trial of '{law}' in '{case}'", expected=f"one of {names}")
        return trials[law, case]

    def viable(self, law: str, case: str) -> Rate:
        trial = self.of(law, case)
        return Rate(int(trial.viable.sum()), len(trial.viable))

    def rescued(self, law: str, case: str) -> Rate:
        trial = self.of(law, case)
        return Rate(int(trial.rescued.sum()), len(trial.rescued))

    def of_kernel(self, law: str, case: str) -> Rate | None:
        """The rescued share of the starts inside the case's kernel; None without such starts."""
        return self._among(self.of(law, case).rescued, case, "inside")

    def of_given_up(self, law: str, case: str) -> Rate | None:
        """The share of the starts outside the kernel that stayed in the region nevertheless."""
        return self._among(self.of(law, case).viable, case, "given_up")

    def _among(self, good: Truths, case: str, which: str) -> Rate | None:
        if case not in self.references:
            return None
        chosen = getattr(self.references[case], which)
        return Rate(int(good[chosen].sum()), int(chosen.sum())) if chosen.any() else None

    def detours(self, law: str, case: str) -> Array:
        """The detours of the rescued runs; empty if no run was rescued. Their shape is (rescued
        runs,)."""
        rows = [self.of(other, case) for other in self.laws]
        lengths = np.array([np.where(t.rescued, t.length, np.inf) for t in rows])
        shortest = np.maximum(lengths.min(axis=0), 0.01)
        mine = self.of(law, case)
        ratio: Array = (mine.length / shortest)[mine.rescued]
        return np.maximum(ratio[np.isfinite(ratio)], 1.0)

    def summary(self) -> dict[str, Any]:
        """The content of comparison.json."""
        return {
            "scenario": self.scenario,
            "title": self.title,
            "seed": self.seed,
            "horizon_s": self.horizon,
            "confidence": CONFIDENCE,
            "laws": dict(self.laws),
            "cases": dict(self.cases),
            "kernels": {case: r.summary() for case, r in self.references.items()},
            "cases_without_kernel": dict(self.unjudged),
            "trials": [self._summary(t) for t in self.trials],
        }

    def _summary(self, t: Trial) -> dict[str, Any]:
        detours = self.detours(t.law, t.case)
        since = t.in_goal_since[t.rescued & np.isfinite(t.in_goal_since)]
        kernel, given_up = (f(t.law, t.case) for f in (self.of_kernel, self.of_given_up))
        return {
            "law": t.law,
            "case": t.case,
            "runs": len(t.viable),
            "viable": self.viable(t.law, t.case).summary(),
            "rescued": self.rescued(t.law, t.case).summary(),
            "rescued_of_kernel": kernel.summary() if kernel else None,
            "viable_of_given_up": given_up.summary() if given_up else None,
            "detour": _spread(detours),
            "in_goal_since": _spread(since),
            "switches": _spread(t.switches[t.rescued]),
            "runs_chattered": t.chattered,
            "runs_diverged": t.diverged,
            "runs_relaxed": t.relaxed,
            "worst_constraint": t.worst,
            "vertices": [*t.vertices],
            "wall_time_s": t.wall_time,
        }


def _spread(values: Sequence[float] | AnyArray) -> dict[str, float | None]:
    numbers = np.asarray(values, dtype=float)
    if not len(numbers):
        return {"median": None, "worst": None}
    return {"median": float(np.median(numbers)), "worst": float(numbers.max())}


@dataclass(frozen=True)
class Entry:
    """An aggregate of some runs. first, second: count and total of a share, sum and count of a
    mean; otherwise only the number.
    """

    rule: Literal["sum", "share", "mean", "most", "least"]
    first: float
    second: float = 0.0
    unit: str = "1"
    meaning: str = ""

    def with_more(self, other: Entry) -> Entry:
        """The aggregate of both sets of runs."""
        first, second = self.first + other.first, self.second + other.second
        if self.rule in ("most", "least"):  # NaN stays NaN
            chosen = np.maximum if self.rule == "most" else np.minimum
            first = float(chosen(self.first, other.first))
        return Entry(self.rule, first, second, self.unit, self.meaning)

    def numbers(self, name: str) -> Iterator[tuple[str, float, str]]:
        """The columns of a table: names, numbers, meanings; a share has its interval."""
        if self.rule in ("share", "mean"):
            value = self.first / self.second if self.second else math.nan
            yield name, value, self.meaning
        else:
            nothing = self.rule in ("most", "least") and math.isinf(self.first)
            yield name, math.nan if nothing else self.first, self.meaning
        if self.rule == "share":
            rate = Rate(int(self.first), int(self.second))
            low, high = rate.interval if self.second else (math.nan, math.nan)
            yield f"{name}_low", low, f"lower end of the 95 % interval (Wilson): {self.meaning}"
            yield f"{name}_high", high, f"upper end of the 95 % interval (Wilson): {self.meaning}"


Tally = Mapping[str, Entry]


def put_together(parts: Iterable[Tally]) -> dict[str, Entry]:
    """The combined aggregates of all parts, in the given order."""
    entries: dict[str, Entry] = {}
    for part in parts:
        for name, entry in part.items():
            entries[name] = entries[name].with_more(entry) if name in entries else entry
    return entries


def as_table(tally: Tally) -> dict[str, list[Any]]:
    """The arrays as lists, for JSON."""
    return {name: list(asdict(entry).values()) for name, entry in tally.items()}


def from_table(table: Mapping[str, list[Any]]) -> dict[str, Entry]:
    """The inverse of `as_table`."""
    return {name: Entry(*values) for name, values in table.items()}


def tally_of(result: Result) -> dict[str, Entry]:
    """The aggregates of the runs of a result."""
    data = result.arrays
    runs = int(data.sizes["run"])
    entries = {"runs": Entry("sum", runs, meaning="runs")}
    for label, count in result.outcomes.items():
        name = label.replace(" ", "_")
        entries[name] = Entry("sum", count, meaning=f"runs that ended so: {label}")
    if result.success_fraction is not None:
        reached = entries["reached_goal"].first
        entries["success"] = Entry("share", reached, runs, meaning="share that reached the goal")
    entries["viable"] = Entry("share", result.viable, runs, meaning="share that kept the region")

    def add(name: str, values: Array, unit: str, meaning: str) -> None:
        finite = values[np.isfinite(values)]
        entries[f"{name}_mean"] = Entry(
            "mean", float(finite.sum()), finite.size, unit, f"mean {meaning}"
        )

    def most(name: str, values: Array, unit: str, meaning: str) -> None:
        entries[name] = Entry("most", float(values.max(initial=-np.inf)), 0.0, unit, meaning)

    since = data["goal_time"].values
    if result.success_fraction is not None:
        add("goal_time", since, "s", "time since when a run is in the goal at its end")
        most("goal_time_worst", since[np.isfinite(since)], "s", "latest time of coming to the goal")

    def units(axis: str) -> dict[str, str]:
        names, entries = (map(str, data[f"{axis}_{w}"].values) for w in ("name", "unit"))
        return dict(zip(names, entries, strict=True))

    for k, (name, unit) in enumerate(units("constraint").items()):
        says = f"largest value of a constraint, safe at most 0: {name}"
        most(f"worst_{name}", data["worst_constraint"].values[:, k], unit, says)
    for k, (name, unit) in enumerate(units("input").items()):
        says = f"largest magnitude of an input: {name}"
        most(f"peak_{name}", data["peak_input"].values[:, k], unit, says)
    for name, error in result.final_errors().items():
        unit = units("state")[name]
        add(f"error_{name}", error, unit, f"error of {name} at the end")
        most(f"error_{name}_worst", error, unit, f"largest error of {name} at the end")
    rate = data["switches"].values * (60.0 / float(data["time"].values[-1]))
    add("switches", rate, "1/min", "changes of mode a minute")
    if data.attrs.get("safeguarded", 0):
        relaxed = float((data["infeasible"].values > 0).sum())
        entries["relaxed"] = Entry("sum", relaxed, meaning="runs whose safeguard found no input")
        overruled = float((data["overruled"].values > 0).sum())
        entries["overruled"] = Entry("sum", overruled, meaning="runs whose safeguard overruled")
    return entries
