"""Parameter sweeps (campaigns): a table with the numbers of every cell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from holdfast.analysis.simulation.files import write_netcdf
from holdfast.arguments import checked
from holdfast.errors import OutputError, suggestion

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
        known = [str(n) for n in self.dataset.data_vars if n not in TEXTS]
        if name is None:
            name = next((n for n in NAMES if n in known), "refused")
        if name not in known:
            raise OutputError(f"a campaign has no '{name}'", remedy=suggestion(name, known))
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
        known = np.flatnonzero(np.isfinite(values))
        found: dict[str, Any] = {
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
            if known.size:
                cell = int(known[chosen(values[known])])
                found[word] = {
                    "value": float(values[cell]), "cell": cell, "at": self.values_of(cell),
                }  # fmt: skip
        for name in ("runs", "diverged", "chattered"):
            if name in self.dataset:
                found[name] = int(self.dataset[name].sum())
        return found

    @checked
    def save(self, path: str | Path) -> Path:
        """Write NetCDF-4, whole or not at all; `OutputError` when the folder cannot be written."""
        return write_netcdf(self.dataset, path)
