"""Results of campaigns: the table of a sweep, with the numbers of every cell; a search for gains.

A search says what was tried, what each cost, and what was chosen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from holdfast.analysis.safety.gain_conditions import JudgedCondition
from holdfast.analysis.simulation.files import write_netcdf
from holdfast.arguments import checked
from holdfast.errors import OutputError, check_name

COSTS = ("time", "effort", "clearance")
"""What gains may be best for."""


@dataclass(frozen=True)
class Costs:
    """What a candidate costs in closed loop: means over the starts, at the worst corner.

    time: seconds until a run is in the goal for good, the horizon for a run that is not; NaN
    without a goal. effort: the integral of sum (input / its limit)^2 [s], actuators in place of
    inputs where there are any; an input without limits counts in its own unit. clearance: the
    share of its distance at the start that the run keeps from each constraint, of the worst one, 1
    at most and 0 where it touches; a start nearer than a twentieth of the farthest counts as that
    far; NaN without a region. lost: the share of runs that end outside the goal, or without one
    leave the region.
    """

    time: float
    effort: float
    clearance: float
    lost: float

    def of(self, cost: str) -> float:
        """The number to minimise: clearance counts as its negative."""
        value: float = getattr(self, cost)
        return -value if cost == "clearance" else value

    def dominates(self, other: Costs) -> bool:
        """No cost is larger, and one is smaller; costs that do not exist are left out."""
        pairs = [(self.of(c), other.of(c)) for c in COSTS if not math.isnan(self.of(c))]
        return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)


@dataclass(frozen=True)
class Candidate:
    """Gains by their keys, the least slack of their conditions, and their costs."""

    gains: Mapping[str, float]
    slack: float
    costs: Costs


@dataclass(frozen=True)
class Tuning:
    """Gains that meet every condition of a law, best for a cost.

    case: of the scenario's comparison, "" for none. gains, shipped: the chosen gains and those of
    the scenario, by key. conditions, shipped_conditions: each where its slack is least.
    candidates: all admissible ones that were simulated, from `starts` starts. before, after: the
    costs of the scenario's gains and of the chosen ones, from one simulation of `checked` fresh
    starts. tried: gains whose conditions were
    judged. corners: of the varied numbers. instants: samples of the inputs that the effort is
    taken from. text: the scenario file with the chosen gains.
    """

    title: str
    scenario: str
    case: str
    cost: str
    margin: float
    seed: int
    gains: Mapping[str, float]
    shipped: Mapping[str, float]
    units: Mapping[str, str]
    conditions: tuple[JudgedCondition, ...]
    shipped_conditions: tuple[JudgedCondition, ...]
    candidates: tuple[Candidate, ...]
    shipped_costs: Costs
    before: Costs
    after: Costs
    tried: int
    starts: int
    checked: int
    corners: int
    instants: int
    text: str

    @property
    def settings(self) -> tuple[str, ...]:
        """The overrides KEY=VALUE that give the scenario the chosen gains."""
        return tuple(f"{key}={value!r}" for key, value in self.gains.items())

    @property
    def front(self) -> tuple[Candidate, ...]:
        """The candidates that no other betters in every cost (Pareto)."""
        able = [c for c in self.candidates if c.costs.lost <= self.shipped_costs.lost]
        return tuple(c for c in able if not any(o.costs.dominates(c.costs) for o in able))

    @property
    def shipped_violations(self) -> tuple[JudgedCondition, ...]:
        """The conditions that the scenario's own gains violate at some corner."""
        return tuple(c for c in self.shipped_conditions if c.slack < -1e-12)

    def summary(self) -> dict[str, Any]:
        """Everything but the text as plain data; NaN appears as None."""
        whole = asdict(self) | {
            "settings": list(self.settings),
            "front": [asdict(c) for c in self.front],
        }
        del whole["text"]
        plain: dict[str, Any] = _plain(whole)
        return plain


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


NAMES = ("success", "viable", "fraction")
"""The default variable of a campaign: the first of these that it has."""

TEXTS = ("note", "settings")


@dataclass(frozen=True)
class Campaign:
    """The table as `dataset`.

    The axes of a grid are the swept names; a sample has one axis, "cell", along which the names
    have their values. Every variable has a unit and a description. For a refused cell, `refused` is
    1, `note` holds the reason, and its numbers are NaN (counts: 0).
    """

    dataset: xr.Dataset

    @property
    def keys(self) -> dict[str, str]:
        """The key of the scenario of every name."""
        return {str(n): str(self.dataset[n].attrs["key"]) for n in self.names}

    @property
    def names(self) -> tuple[str, ...]:
        """The swept names."""
        return tuple(str(self.dataset.attrs["over"]).split())

    @property
    def is_grid(self) -> bool:
        """Whether every combination was run."""
        return "cell" not in self.dataset.dims

    @checked
    def variable(self, name: str | None = None) -> xr.DataArray:
        """The variable of that name, by default the main one of the campaign.

        Raises `OutputError` for an unknown name, or one that is not a number of a cell.
        """
        names = [str(n) for n in self.dataset.data_vars if n not in TEXTS]
        if name is None:
            name = next((n for n in NAMES if n in names), "refused")
        check_name(name, names, OutputError, f"a campaign has no '{name}'")
        return self.dataset[name]

    @property
    def refused(self) -> int:
        """The number of refused cells."""
        return int(self.dataset["refused"].sum())

    @property
    def notes(self) -> tuple[str, ...]:
        """The refusals, each once, in the order of the cells."""
        texts = self.dataset["note"].values.ravel()
        chosen = texts[self.dataset["refused"].values.ravel() == 1]
        return tuple(dict.fromkeys(str(t) for t in chosen))

    @checked
    def values_of(self, cell: int) -> dict[str, float]:
        """The values of a cell by name, the cells counted in the order of the arrays."""
        self._check(cell)
        if self.is_grid:
            shape = tuple(self.dataset.sizes[n] for n in self.names)
            places = np.unravel_index(cell, shape)
            pairs = zip(self.names, places, strict=True)
            return {n: float(self.dataset[n].values[place]) for n, place in pairs}
        return {n: float(self.dataset[n].values[cell]) for n in self.names}

    def _check(self, cell: int) -> None:
        if not 0 <= cell < self.dataset["refused"].size or cell != int(cell):
            raise OutputError(
                f"no cell {cell}", expected=f"0 to {self.dataset['refused'].size - 1}"
            )

    @checked
    def command(self, cell: int) -> str:
        """The command that runs only that cell."""
        self._check(cell)
        return f"{self.dataset.attrs['command']} {self.dataset['settings'].values.ravel()[cell]}"

    def summary(self, variable: str | None = None) -> dict[str, Any]:
        """The cells, their outcomes, and the best and the worst of a variable."""
        about = self.variable(variable)
        values = about.values.ravel()
        finite = np.flatnonzero(np.isfinite(values))
        facts: dict[str, Any] = {
            "title": str(self.dataset.attrs["title"]),
            "scenario": str(self.dataset.attrs["scenario"]),
            "over": {k: [float(v) for v in self.dataset[n].values] for n, k in self.keys.items()}
            if self.is_grid
            else self.keys,
            "cells": int(values.size),
            "refused": self.refused,
            "variable": str(about.name),
        }
        for word, chosen in (("most", np.argmax), ("least", np.argmin)):
            if finite.size:
                cell = int(finite[chosen(values[finite])])
                facts[word] = {
                    "value": float(values[cell]), "cell": cell, "at": self.values_of(cell),
                }  # fmt: skip
        for name in ("runs", "diverged", "chattered"):
            if name in self.dataset:
                facts[name] = int(self.dataset[name].sum())
        return facts

    @checked
    def save(self, path: str | Path) -> Path:
        """Write NetCDF-4, whole or not at all; `OutputError` when the folder cannot be written."""
        return write_netcdf(self.dataset, path)
