"""Aggregates combined from parts: counts, shares, means, maxima and minima."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.analysis.simulation.result import Result
from holdfast.execution.arrays import Array


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
    found: dict[str, Entry] = {}
    for part in parts:
        for name, entry in part.items():
            found[name] = found[name].with_more(entry) if name in found else entry
    return found


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
    found = {"runs": Entry("sum", runs, meaning="runs")}
    for label, count in result.outcomes.items():
        name = label.replace(" ", "_")
        found[name] = Entry("sum", count, meaning=f"runs that ended so: {label}")
    if result.success_fraction is not None:
        reached = found["reached_goal"].first
        found["success"] = Entry("share", reached, runs, meaning="share that reached the goal")
    found["viable"] = Entry("share", result.viable, runs, meaning="share that kept the region")

    def add(name: str, values: Array, unit: str, meaning: str) -> None:
        known = values[np.isfinite(values)]
        found[f"{name}_mean"] = Entry(
            "mean", float(known.sum()), known.size, unit, f"mean {meaning}"
        )

    def most(name: str, values: Array, unit: str, meaning: str) -> None:
        found[name] = Entry("most", float(values.max(initial=-np.inf)), 0.0, unit, meaning)

    since = data["goal_time"].values
    if result.success_fraction is not None:
        add("goal_time", since, "s", "time since when a run is in the goal at its end")
        most("goal_time_worst", since[np.isfinite(since)], "s", "latest time of coming to the goal")

    def units(axis: str) -> dict[str, str]:
        names, found = (map(str, data[f"{axis}_{w}"].values) for w in ("name", "unit"))
        return dict(zip(names, found, strict=True))

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
        found["relaxed"] = Entry("sum", relaxed, meaning="runs whose safeguard found no input")
        overruled = float((data["overruled"].values > 0).sum())
        found["overruled"] = Entry("sum", overruled, meaning="runs whose safeguard overruled")
    return found
