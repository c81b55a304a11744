"""The answers of the cells as one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from holdfast._version import __version__
from holdfast.analysis.simulation.aggregates import from_table, put_together
from holdfast.errors import OutputError, suggestion
from holdfast.execution.arrays import Array
from holdfast.studies.scenario_parameter import Knob
from holdfast.studies.sweep.axes import Over

CELL, REFUSED = "cell", "refused"


@dataclass(frozen=True)
class Axis:
    """A swept axis: its name in the table, its parameter, and its values."""

    name: str
    knob: Knob
    over: Over

    @property
    def attributes(self) -> dict[str, str]:
        """The key, the unit and the label of the axis."""
        unit = self.over.unit or self.knob.unit
        spacing = {"spacing": "log"} if self.over.log else {}
        return {"units": unit, "long_name": self.knob.name, "key": self.knob.key, **spacing}

    def settings(self, value: float) -> tuple[str, ...]:
        """The overrides KEY=VALUE of the value."""
        return self.knob.settings(f"{value!r} {self.over.unit}" if self.over.unit else value)


def campaign_table(
    axes: Sequence[Axis],
    cells: Array,
    settings: Sequence[str],
    answers: Sequence[Sequence[Mapping[str, Any]]],
    *,
    grid: bool,
    attributes: Mapping[str, Any],
) -> xr.Dataset:
    """cells (cell, axis): the values; settings, answers: of every cell, by parts in order."""
    names = [axis.name for axis in axes]
    shape = tuple(len(axis.over.values) for axis in axes) if grid else (len(cells),)
    dims = tuple(names) if grid else (CELL,)
    coordinates: dict[str, Any] = {
        axis.name: ((axis.name,), np.array(axis.over.values), axis.attributes)
        if grid
        else ((CELL,), cells[:, k], axis.attributes)
        for k, axis in enumerate(axes)
    }
    refused = np.zeros(len(cells), dtype=np.int8)
    notes = [""] * len(cells)
    columns: dict[str, Array] = {}
    about: dict[str, dict[str, str]] = {}
    whole: set[str] = set()
    for cell, parts in enumerate(answers):
        refusals = [str(p["refused"]) for p in parts if "refused" in p]
        notes[cell] = next(iter(refusals), "") or str(parts[0].get("note", ""))
        refused[cell] = bool(refusals)
        if refusals:
            continue
        tally = put_together(from_table(p["numbers"]) for p in parts)
        for name, entry in tally.items():
            for column, value, says in entry.numbers(name):
                if column not in columns:
                    blank = 0.0 if entry.rule == "sum" else np.nan
                    columns[column] = np.full(len(cells), blank)
                    about[column] = {"units": entry.unit, "long_name": says}
                columns[column][cell] = value
            if entry.rule == "sum":
                whole.add(name)
    variables: dict[str, Any] = {
        name: (dims, (v.astype(np.int64) if name in whole else v).reshape(shape), about[name])
        for name, v in columns.items()
    }
    variables[REFUSED] = (
        dims, refused.reshape(shape), {"units": "1", "long_name": "1 where the cell was refused"},
    )  # fmt: skip
    for name, texts, says in (
        ("note", notes, "reason of the refusal, or warnings"),
        ("settings", settings, "overrides that make the cell of the scenario"),
    ):
        variables[name] = (dims, _texts(texts).reshape(shape), {"long_name": says})
    fixed = {"Conventions": "CF-1.11", "holdfast_version": __version__, "over": " ".join(names)}
    return xr.Dataset(variables, coordinates, {**fixed, **attributes})


def check_variable(name: str | None, answer: Mapping[str, Any]) -> None:
    """Raises `OutputError` if the table will not have a variable of that name."""
    if name in (None, REFUSED) or "numbers" not in answer:
        return
    entries = from_table(answer["numbers"]).items()
    known = [column for entry_name, e in entries for column, *_ in e.numbers(entry_name)]
    if name not in known:
        raise OutputError(
            f"a campaign has no '{name}'", remedy=suggestion(str(name), [*known, REFUSED])
        )


def _texts(texts: Sequence[str]) -> np.ndarray[Any, np.dtype[np.str_]]:
    found = np.array(texts, dtype=str)
    return found if found.dtype.itemsize else found.astype("<U1")
