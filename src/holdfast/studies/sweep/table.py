"""The axes of a sweep, and the answers of its cells as one table.

An axis is a text such as k1=0.05:0.5:20; together they give the values of every cell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from holdfast._version import __version__
from holdfast.analysis.simulation.aggregates import from_table, put_together
from holdfast.errors import OutputError, ScenarioError, suggestion
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.units import split
from holdfast.studies.scenario_parameter import Knob

MOST_CELLS = 10_000_000
LOG = "log"
EXPECTED = "KEY=LOW:HIGH:COUNT, KEY=LOW:HIGH:COUNT:log, or KEY=VALUE,VALUE,..."
EXPECTED_LATIN = "KEY=LOW:HIGH or KEY=LOW:HIGH:log, with --latin"


@dataclass(frozen=True)
class Over:
    """A name, and its values in a grid, or the ends of its range in a sample.

    unit: the unit written after the values, if any; log: equally many values in every decade.
    """

    name: str
    values: tuple[float, ...]
    unit: str
    log: bool


def read_over(
    text: str, *, latin: bool = False, option: str = "--over", expected: str = ""
) -> Over:
    """KEY=LOW:HIGH:COUNT[:log] or KEY=VALUE,VALUE,...; with latin KEY=LOW:HIGH[:log].

    A unit after the last value applies to all; the default is that of the key. Raises
    `ScenarioError` for anything else, which names the `option` that gave the text and what it
    expects.
    """
    shown = f"{option} {text}"
    name, _, rest = (part.strip() for part in text.partition("="))
    expected = expected or (EXPECTED_LATIN if latin else EXPECTED)
    parts = [part.strip() for part in rest.split(":")]
    log = parts[-1] == LOG
    parts = parts[: len(parts) - log]
    listed = len(parts) == 1 and not log and not latin
    if not name or not rest or (not listed and len(parts) != (2 if latin else 3)):
        raise ScenarioError(shown, expected=expected)
    count = 2 if latin or listed else _count(shown, parts.pop())
    values, unit = _values(
        shown, [p.strip() for p in parts[0].split(",")] if listed else parts, expected
    )
    if listed:
        if len(set(values)) < len(values):
            raise ScenarioError(f"{shown}: a value occurs twice")
        return Over(name, tuple(sorted(values)), unit, log)
    low, high = values
    if not low < high:
        raise ScenarioError(f"{shown}: from {low:g} to {high:g}", expected="LOW < HIGH")
    if log and low <= 0:
        raise ScenarioError(f"{shown}: {low:g} has no logarithm", expected="LOW > 0")
    spaced = np.geomspace(low, high, count) if log else np.linspace(low, high, count)
    return Over(name, tuple(float(f"{v:.12g}") for v in spaced), unit, log)  # 0.15, as written


def _count(shown: str, given: str) -> int:
    if not given.isdecimal() or not 2 <= int(given) <= MOST_CELLS:
        raise ScenarioError(
            f"{shown}: got '{given}' values",
            expected="a whole number, at least 2",
            remedy="for one value use --set",
        )
    return int(given)


def _values(shown: str, parts: Sequence[str], expected: str) -> tuple[list[float], str]:
    found, units = [], set()
    for part in parts:
        number, unit = split(part) or (math.nan, "")
        if not math.isfinite(number):
            raise ScenarioError(f"{shown}: '{part}' is not a number", expected=expected)
        found.append(number)
        if unit:
            units.add(unit)
    if len(units) > 1:
        raise ScenarioError(f"{shown}: mixes {' and '.join(sorted(units))}", expected="one unit")
    return found, units.pop() if units else ""


def grid_cells(axes: Sequence[Over]) -> Array:
    """Every combination, the last name fastest; shape (cells, names)."""
    total = math.prod(len(axis.values) for axis in axes)
    if total > MOST_CELLS:
        raise ScenarioError(f"{total:,} cells", expected=f"at most {MOST_CELLS:,}")
    return np.array(list(product(*(axis.values for axis in axes))), dtype=np.float64)


def latin_cells(axes: Sequence[Over], count: int, seed: int) -> Array:
    """A Latin hypercube: each name's range in `count` slices, one cell in each of them."""
    from scipy.stats import qmc

    if not 2 <= count <= MOST_CELLS:
        raise ScenarioError(f"--latin {count}", expected=f"2 to {MOST_CELLS:,} cells")
    low, high = (
        np.array([math.log(a.values[i]) if a.log else a.values[i] for a in axes]) for i in (0, 1)
    )
    unit = qmc.LatinHypercube(len(axes), rng=np.random.default_rng(seed)).random(count)
    cells = low + unit * (high - low)
    logs = [i for i, axis in enumerate(axes) if axis.log]
    cells[:, logs] = np.exp(cells[:, logs])
    return cells


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
