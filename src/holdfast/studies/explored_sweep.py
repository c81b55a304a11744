"""The page of a scenario, or of the table of a sweep: the cell under the pointer is what runs."""

from __future__ import annotations

import json
import os
import shlex
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from holdfast._version import __version__
from holdfast.analysis.load import load
from holdfast.analysis.simulation.sweep_table import TEXTS, Campaign
from holdfast.arguments import checked
from holdfast.errors import HoldfastError, OutputError, ScenarioError
from holdfast.execution.arrays import Array
from holdfast.execution.resources import Progress
from holdfast.maths.definitions.quantity import in_base_units
from holdfast.scenario.files import read_tables, scenario_names
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import load_scenario
from holdfast.studies.exploration import (
    DELAY,
    DRAWS,
    VALUES,
    Explored,
    Place,
    beside,
    composed_quietly,
    first_starts,
    numbers_of,
    of_loop,
    page,
    page_of,
    rest_of,
)
from holdfast.studies.sweep import ASKED, content_digest

TABLE = "sweep.nc"


@checked
def explore(
    scenario: str | Path, overrides: Iterable[str] = (), *, progress: Progress | None = None
) -> str:
    """The page of a scenario: one self-contained HTML file, as text.

    What moves in it is the loop of `simulate`, compiled to WebAssembly; its numbers are those of
    `simulate`, bit for bit. A kernel or a capture basin is shown with the law that keeps it.
    scenario may also be the table of a sweep, "runs/inspection/sweep.nc", or its folder: the page
    of the swept scenario has a map of the table, and the cell under the pointer runs.

    Raises `ScenarioError` for a scenario of one state or without a law, a law that another
    controller has, a kernel that is too large, and a sweep that the loop of one page cannot follow;
    `OutputError` for a file that is damaged.

    >>> hf.explore("ch2-unicycle", ["run.horizon=1"])[:15]
    '<!doctype html>'
    """
    scenario, changes = str(scenario), list(overrides)
    table = sweep_file(scenario)
    if table is not None:
        return page(explored_sweep(table, changes, progress))
    return page_of(load_scenario(scenario, changes), scenario, changes, progress)


@dataclass(frozen=True)
class _Swept:
    """The scenario of a sweep as it was asked for, and the texts KEY=VALUE of every cell."""

    path: Path
    found: Campaign
    scenario: str
    changes: tuple[str, ...]
    runs: int | None
    loaded: Scenario
    texts: tuple[Mapping[str, str], ...]

    @property
    def good(self) -> list[int]:
        """The cells that were not refused."""
        return [int(k) for k in np.flatnonzero(self.found.dataset["refused"].values.ravel() == 0)]

    def cell(self, number: int, more: Sequence[str] = ()) -> Scenario | None:
        """The closed loops of a cell, with more overrides; None where they are refused."""
        settings = [f"{key}={value}" for key, value in self.texts[number].items()]
        return composed_quietly(self.scenario, [*self.changes, *settings, *more], self.runs)

    def alone(self, number: int) -> str:
        """What to do where the cells have no page together."""
        settings = str(self.found.dataset["settings"].values.ravel()[number])
        common = "".join(f"--set {shlex.quote(change)} " for change in self.changes)
        return f"explore one cell: holdfast explore {shlex.quote(self.scenario)} {common}{settings}"


def sweep_file(scenario: str) -> Path | None:
    """The file of a table: a path that ends in .nc, or that in a folder; None for a scenario."""
    path = Path(scenario)
    if path.suffix == ".nc":
        return path
    named = scenario in scenario_names() or path.suffix == ".toml"
    return path / TABLE if os.path.isdir(path) and not named else None  # no name is too long for it


def explored_sweep(
    path: Path, changes: Sequence[str] = (), progress: Progress | None = None
) -> Explored:
    """The swept scenario with the table of the sweep, and the numbers of each cell.

    Raises `OutputError` for a file that cannot be read, `ScenarioError` for one that is not of a
    sweep, whose scenario is gone or has changed, whose cells have kernels of their own, or whose
    swept numbers decide more than numbers of one loop.
    """
    if changes:
        raise ScenarioError(
            f"{path}: --set {changes[0]}: the numbers of a sweep are those of its file",
            remedy="repeat the sweep with --set",
        )
    with _legible(path):
        swept = _opened(path)
        numbers = _numbers(swept)
        table = _table(swept)
    places = {key: _place(swept, key) for key in numbers}
    _check(swept, places, numbers)
    shown = of_loop(swept.loaded, swept.scenario, swept.changes, progress)
    keys = {place[1]: key for key, place in places.items() if place[0] == VALUES}
    delays = [numbers[key].max() for key, place in places.items() if place[0] == DELAY]
    written = str(swept.found.dataset.attrs["holdfast_version"])
    note = f"The table is of holdfast {written}, the page of {__version__}."
    table |= {
        "entries": [
            {"group": place[0], "name": place[1], "values": numbers[key].tolist()}
            for key, place in places.items()
        ],
        **_starts(swept, places, shown.starts),
    }
    return replace(
        shown, keys={**keys, **shown.keys}, sweep=table, latest=max(delays, default=0.0),
        note=shown.note if written == __version__ else note,
    )  # fmt: skip


@contextmanager
def _legible(path: Path) -> Iterator[None]:
    """Say of a table with other contents than `sweep` writes that it is damaged."""
    try:
        yield
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise OutputError(
            f"{path} lacks what a page needs, or is damaged ({error})", remedy="repeat the sweep"
        ) from None


def _opened(path: Path) -> _Swept:
    if not path.exists():
        raise OutputError(f"{path}: there is no such file", expected="the sweep.nc of a sweep")
    campaign = load(path)
    if not isinstance(campaign, Campaign):
        raise ScenarioError(f"{path} is not the table of a sweep", expected="the file sweep.nc")
    if ASKED not in campaign.dataset.attrs:
        raise ScenarioError(
            f"{path} does not say which scenario was swept; a former holdfast wrote it",
            remedy="repeat the sweep",
        )
    asked = json.loads(campaign.dataset.attrs[ASKED])
    scenario, seed = str(asked["scenario"]), asked["seed"]
    try:
        _, text, data = read_tables(scenario, asked["overrides"])
    except HoldfastError as error:
        raise ScenarioError(
            f"{path}: the scenario that was swept cannot be read: {error.cause}",
            remedy="call from the folder in which the sweep was called",
        ) from None
    if content_digest(text, data) != asked["digest"]:
        raise ScenarioError(
            f"{path}: '{scenario}', or a file that it names, has changed since the sweep",
            remedy="repeat the sweep",
        )
    changes = [*asked["overrides"], *([] if seed is None else [f"run.seed={seed}"])]
    loaded = load_scenario(scenario, changes, asked["runs"])
    if not isinstance(loaded, Scenario):
        raise ScenarioError(
            f"{path}: every cell has a {loaded.kind} of its own, which takes longer than a page",
            remedy="explore one cell: holdfast explore SCENARIO --set KEY=VALUE",
        )
    texts = tuple(_texts(str(t)) for t in campaign.dataset["settings"].values.ravel())
    swept = _Swept(path, campaign, scenario, tuple(changes), asked["runs"], loaded, texts)
    if not swept.good:
        raise ScenarioError(f"{path}: every cell was refused: {campaign.notes[0]}")
    return swept


def _texts(settings: str) -> dict[str, str]:
    """Key -> the text of its value, of the overrides of a cell."""
    pairs = (word.partition("=") for word in shlex.split(settings) if word != "--set")
    return {key: value for key, _, value in pairs}


def _number(text: str) -> float:
    """The number that an override stands for, in SI units; of a draw its two ends are one."""
    value = tomllib.loads(f"value = {text}")["value"]
    return in_base_units(value[0] if isinstance(value, list) else value)


def _place(swept: _Swept, key: str) -> Place:
    """Where the page has the number of a key; `ScenarioError` where another changes more."""
    first = swept.good[0]
    text = swept.texts[first][key]
    other = repr(beside(_number(text)))
    near = swept.cell(first, [f"{key}={f'[{other}, {other}]' if text.startswith('[') else other}"])
    cell = swept.cell(first)
    if cell is not None and near is not None and rest_of(near) == rest_of(cell):
        before = numbers_of(cell)
        changed = [place for place, value in numbers_of(near).items() if before[place] != value]
        if len(changed) == 1:
            return changed[0]
    raise ScenarioError(
        f"{swept.path}: {key} decides more than one number of the loop, and a page has one loop",
        remedy=swept.alone(first),
    )


def _numbers(swept: _Swept) -> dict[str, Array]:
    """The number of every cell by key, in SI units."""
    keys = swept.texts[0]
    return {key: np.array([_number(cell[key]) for cell in swept.texts]) for key in keys}


def _check(swept: _Swept, places: Mapping[str, Place], numbers: Mapping[str, Array]) -> None:
    """Compare the first, the middle and the last cell with what the page makes of them."""
    good = swept.good
    for number in sorted({good[0], good[len(good) // 2], good[-1]}):
        wanted = dict(numbers_of(swept.loaded))
        for key, place in places.items():
            value = float(numbers[key][number])
            wanted[place] = (value, value) if place[0] == DRAWS else value
        cell = swept.cell(number)
        if cell is None or numbers_of(cell) != wanted or rest_of(cell) != rest_of(swept.loaded):
            raise ScenarioError(
                f"{swept.path}: the numbers of cell {number} decide more than numbers of one loop",
                remedy=swept.alone(number),
            )


def _table(swept: _Swept) -> dict[str, Any]:
    campaign, data = swept.found, swept.found.dataset
    axes = [
        {
            "name": name, "key": campaign.keys[name], "label": data[name].attrs["long_name"],
            "unit": data[name].attrs["units"], "log": data[name].attrs.get("spacing") == "log",
            "values": data[name].values.tolist(),
        }
        for name in campaign.names
    ]  # fmt: skip
    variables = [
        {
            "name": str(name), "label": v.attrs["long_name"], "unit": v.attrs["units"],
            "share": f"{name}_low" in data, "values": _plain(v.values),
        }
        for name, v in data.data_vars.items()
        if name not in TEXTS
    ]  # fmt: skip
    return {
        "axes": axes, "grid": campaign.is_grid, "variables": variables,
        "shown": str(campaign.variable().name), "notes": data["note"].values.ravel().tolist(),
        "settings": data["settings"].values.ravel().tolist(), "command": data.attrs["command"],
    }  # fmt: skip


def _plain(values: Array) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values.ravel()]


def _starts(swept: _Swept, places: Mapping[str, Place], shown_starts: Array) -> dict[str, Any]:
    """The starts of the cells, where a swept number decides which states lie in the region."""
    region = swept.loaded.region
    used = {
        str(s) for c in (region.inequalities if region else ()) for s in c.expression.free_symbols
    }
    deciding = [key for key, (group, name) in places.items() if group == VALUES and name in used]
    groups: dict[tuple[str, ...], int] = {}
    distinct: list[Array] = []
    of = [-1] * len(swept.texts)
    for number in swept.good if deciding else ():
        group = tuple(swept.texts[number][key] for key in deciding)
        if group not in groups:
            cell = swept.cell(number)
            assert cell is not None
            groups[group] = len(distinct)
            distinct.append(first_starts(cell.kept())[0])
        of[number] = groups[group]
    if all(np.array_equal(starts, shown_starts) for starts in distinct):
        return {}
    return {"starts": [starts.tolist() for starts in distinct], "starts_of": of}
