"""Parameter sweeps of a scenario in worker processes, stored on disk: `holdfast sweep`.

One part of a cell is the work of a process, local or on a cluster. A finished part is stored, and a
kill at any time loses none: the store is an SQLite file, whose transactions are atomic.

An axis is a text such as k1=0.05:0.5:20; together the axes give the values of every cell, and the
answers are one table.
"""

from __future__ import annotations

import hashlib
import json
import math
import shlex
import sqlite3
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from holdfast._version import __version__
from holdfast.analysis.simulation.law_comparison import Entry, as_table, from_table, put_together
from holdfast.analysis.simulation.sweep_table import Campaign
from holdfast.arguments import checked
from holdfast.errors import GainWarning, HoldfastError, OutputError, ScenarioError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.resources import available_cores
from holdfast.host.files import code_digest, make_folder, version_digest
from holdfast.maths.definitions.quantity import split
from holdfast.scenario.files import (
    Overrides,
    changes_of,
    files_digest,
    overridden,
    read_tables,
)
from holdfast.scenario.kinds.base import Composed
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import check_overrides, scenario_of
from holdfast.studies.process_pool import answers, processes
from holdfast.studies.scenario_parameter import CURRENT, Knob, find_knob, last_part

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


def _count(shown: str, text: str) -> int:
    if not text.isdecimal() or not 2 <= int(text) <= MOST_CELLS:
        raise ScenarioError(
            f"{shown}: got '{text}' values",
            expected="a whole number, at least 2",
            remedy="for one value use --set",
        )
    return int(text)


def _values(shown: str, parts: Sequence[str], expected: str) -> tuple[list[float], str]:
    numbers, units = [], set()
    for part in parts:
        number, unit = split(part) or (math.nan, "")
        if not math.isfinite(number):
            raise ScenarioError(f"{shown}: '{part}' is not a number", expected=expected)
        numbers.append(number)
        if unit:
            units.add(unit)
    if len(units) > 1:
        raise ScenarioError(f"{shown}: mixes {' and '.join(sorted(units))}", expected="one unit")
    return numbers, units.pop() if units else ""


def grid_cells(axes: Sequence[Over]) -> Array:
    """Every combination, the last name fastest; shape (cells, names)."""
    total = math.prod(len(axis.values) for axis in axes)
    if total > MOST_CELLS:
        raise ScenarioError(f"{total:,} cells", expected=f"at most {MOST_CELLS:,}")
    return np.array(list(product(*(axis.values for axis in axes))), dtype=np.float64)


def latin_cells(axes: Sequence[Over], count: int, seed: int) -> Array:
    """A Latin hypercube: each name's range in `count` slices, one cell in each of them. The shape
    is (cells, names)."""
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
        variables[name] = (dims, _text_column(texts).reshape(shape), {"long_name": says})
    fixed = {"Conventions": "CF-1.11", "holdfast_version": __version__, "over": " ".join(names)}
    return xr.Dataset(variables, coordinates, {**fixed, **attributes})


def check_variable(name: str | None, answer: Mapping[str, Any]) -> None:
    """Raises `OutputError` if the table will not have a variable of that name."""
    if name in (None, REFUSED) or "numbers" not in answer:
        return
    entries = from_table(answer["numbers"]).items()
    columns = [column for entry_name, e in entries for column, *_ in e.numbers(entry_name)]
    if name not in columns:
        raise OutputError(
            f"a campaign has no '{name}'", remedy=suggestion(str(name), [*columns, REFUSED])
        )


def _text_column(texts: Sequence[str]) -> np.ndarray[Any, np.dtype[np.str_]]:
    column = np.array(texts, dtype=str)
    return column if column.dtype.itemsize else column.astype("<U1")


@dataclass(frozen=True)
class Part:
    """The runs first..last-1 of the scenario of these tables, with the settings of a cell.

    last = 0: the scenario is not a batch of runs. code: the digest of the requesting holdfast;
    threads: 0 for one per core.
    """

    file: str
    tables: Mapping[str, Any]
    settings: tuple[str, ...]
    runs: int | None
    seed: int | None
    first: int
    last: int
    threads: int
    code: str


_one_at_a_time = threading.Lock()  # threads of a process would share its cores and warnings
_last: tuple[object, Composed] | None = None


def run_part(part: Part) -> dict[str, Any]:
    """{"numbers": a tally as lists, "note": warnings} or {"refused": why}.

    The key "failed" marks a failure, which may not recur, in contrast to a refusal. Raises
    `ScenarioError` if the request comes from another version of holdfast.
    """
    if part.code != version_digest():
        raise ScenarioError(
            "a process of the cluster has another version of holdfast",
            remedy="install the same version everywhere",
        )
    with _one_at_a_time, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            numbers = _numbers(part)
        except HoldfastError as error:
            return {"refused": str(error)}
        except Exception as error:  # a failing cell must not end the others
            return {"refused": f"{type(error).__name__}: {error}", "failed": True}
    said = [str(w.message) for w in heard if issubclass(w.category, GainWarning)]
    return {"numbers": as_table(numbers), "note": "; ".join(dict.fromkeys(said))}


def _numbers(part: Part) -> dict[str, Entry]:
    runs = range(part.first, part.last) if part.last else None
    return _composed(part).tally(runs, part.threads)


def _composed(part: Part) -> Composed:
    """The scenario; the last one is kept, for the next part of the same cell."""
    global _last
    asked = (part.file, repr(part.tables), part.settings, part.runs, part.seed)
    if _last is None or _last[0] != asked:
        _, tables = overridden("", dict(part.tables), part.settings)
        _last = asked, scenario_of(part.file, "", tables, part.runs, part.seed)
    return _last[1]


Key = tuple[int, int]
"""The cell, and the part of it."""


class Store:
    """The answers of the parts of one campaign, by `campaign`, its digest.

    Answers of other campaigns in the same file are left untouched. Failures are not kept beyond
    this call: the next one tries again.
    """

    def __init__(self, connection: sqlite3.Connection, campaign: str) -> None:
        self.connection, self.campaign = connection, campaign
        self.failed: dict[int, dict[int, dict[str, Any]]] = {}  # cell, part
        with connection:
            connection.execute(
                "CREATE TABLE IF NOT EXISTS part (campaign TEXT, cell INTEGER, number INTEGER, "
                "answer TEXT, PRIMARY KEY (campaign, cell, number))"
            )

    def finished(self) -> set[Key]:
        """The finished parts."""
        rows = self.connection.execute(
            "SELECT cell, number FROM part WHERE campaign = ?", (self.campaign,)
        )
        return set(rows)

    def put(self, key: Key, answer: dict[str, Any]) -> None:
        """Store the answer of a part; it is on disk when this returns."""
        if answer.get("failed"):
            self.failed.setdefault(key[0], {})[key[1]] = answer
            return
        with self.connection:
            self.connection.execute(
                "INSERT OR IGNORE INTO part VALUES (?, ?, ?, ?)",
                (self.campaign, *key, json.dumps(answer)),
            )

    def answers(self, cell: int) -> list[dict[str, Any]]:
        """The answers of all parts of a cell, in order."""
        rows = self.connection.execute(
            "SELECT number, answer FROM part WHERE campaign = ? AND cell = ?",
            (self.campaign, cell),
        )
        by_number = {number: json.loads(text) for number, text in rows}
        by_number |= self.failed.get(cell, {})
        return [by_number[number] for number in sorted(by_number)]


@contextmanager
def store(path: Path | None, campaign: str) -> Iterator[Store]:
    """The store in that file, or in memory.

    Raises `OutputError` if the file cannot be written, is not a store, or the disk is full.
    """
    shown = path if path is not None else ":memory:"
    try:
        connection = sqlite3.connect(shown)
        try:
            yield Store(connection, campaign)
        finally:
            connection.close()
    except sqlite3.DatabaseError as error:
        raise OutputError(
            f"{shown} cannot be used ({error})",
            remedy="make room or choose another folder with --out: its content is kept",
        ) from None


PART = 5_000
"""Runs of a cell that are simulated together, which bounds the memory."""

MOST_PARTS = 20_000_000

CELLS_FILE = "sweep-cells.db"
COUNTS = ("starts.random", "starts.states")
"""Keys that would change the number of runs of a cell."""

ASKED = "asked"
"""The attribute of a table with what was asked for: scenario, overrides, runs, seed, digest."""

TAKEN = ("cell", "note", "settings", "refused", "runs", "success", "viable", "fraction", "volume")
"""Names with another meaning in a table."""


@checked
def sweep(
    scenario: str,
    over: Iterable[str],
    *,
    latin: int | None = None,
    runs: int | None = None,
    seed: int | None = None,
    overrides: Overrides = (),
    show: str | None = None,
    folder: Path | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Campaign:
    """A scenario in every cell of a grid, or of a Latin hypercube, over any of its numbers.

    over: "law.k1=0.05:0.5:20" (lowest, highest, count), "k1=0.01:1:9:log", "k1=0.1,0.2"; with
    units "half_angle=20:40 deg:5". The name is a key of the scenario, its last part if unique, or
    "current.speed". latin: the number of cells of a Latin hypercube instead of a grid; then
    "k1=0.05:0.5". runs: the number of starts in every cell, the same starts in all of them.
    overrides: of all cells.

    Every cell equals the result of `run` with its settings, runs and seed, on any machine. Memory
    is bounded for any number of runs: they are simulated 5,000 at a time, and counted. The table
    gives the reason for a refused cell.

    show: a variable that the table must have; checked as soon as one part of a cell is finished.

    folder: the place of the file of finished parts; a second call with the same scenario, code and
    arguments continues from it. workers: the number of processes, one per core by default (one for
    a kernel, which uses all cores itself). executor: computes in place of them, such as
    `dask.distributed.Client(...).get_executor()`; `workers` then limits the concurrent requests.

    Raises `ScenarioError` for an invalid key or scenario and if all cells tried first are refused,
    `OutputError` for a folder that cannot be written and an unknown variable.

    >>> from concurrent.futures import ThreadPoolExecutor
    >>> few = {"runs": 2, "overrides": ["run.horizon=1"], "executor": ThreadPoolExecutor(1)}
    >>> hf.sweep("ch2-unicycle", ["k=1:2:2"], **few).dataset.sizes["k"]
    2
    """
    overrides = tuple(changes_of(overrides))
    shown, text, data = read_tables(scenario, overrides)
    loaded = scenario_of(shown, text, data, runs, seed)
    read = [read_over(entry, latin=latin is not None) for entry in over]
    if not read:
        raise ScenarioError("a sweep needs at least one axis", expected="--over KEY=LOW:HIGH:COUNT")
    axes = _axes(loaded, data, read)
    cells = grid_cells(read) if latin is None else latin_cells(read, latin, loaded.seed)
    settings = [_settings(axes, cell) for cell in cells]
    _check_some(shown, data, [settings[k] for k in (0, -1, len(cells) // 2)], runs, seed)
    total = loaded.independent_runs
    parts = max(1, -(-total // PART))
    if len(cells) * parts > MOST_PARTS:
        raise ScenarioError(
            f"{len(cells):,} cells of {total:,} runs",
            expected=f"at most {MOST_PARTS * PART:,} runs",
        )
    if workers is not None and workers < 1:
        raise ScenarioError(f"{workers} workers", expected="at least 1")
    if folder is not None:
        make_folder(folder)
    with ExitStack() as stack:
        place = folder / CELLS_FILE if folder is not None else None
        stored = stack.enter_context(store(place, _digest(data, settings, runs, seed)))
        there = stored.finished()
        keys = ((cell, part) for cell in range(len(cells)) for part in range(parts))
        missing = [key for key in keys if key not in there]
        at_once = workers or (1 if loaded.uses_all_cores else available_cores())
        threads = 0
        if missing and executor is None:
            at_once = min(at_once, len(missing))
            threads = 0 if loaded.uses_all_cores else available_cores() // at_once or 1
            executor = stack.enter_context(processes(at_once))

        def part(key: Key) -> Part:
            cell, first = key[0], key[1] * PART
            runs_of_it = (first, min(first + PART, total))
            return Part(
                shown, data, settings[cell], runs, seed, *runs_of_it, threads, version_digest()
            )

        def tell() -> None:
            if progress is not None:
                done = f"{len(there) // parts} of {len(cells)} cells"
                progress(done, 1 - (len(cells) * parts - len(there)) / max(len(missing), 1))

        tell()
        asked = ((key, part(key)) for key in missing)
        if executor is not None:
            for key, answer in answers(executor, run_part, asked, 2 * at_once, tell):
                stored.put(key, answer)
                there.add(key)
                if isinstance(loaded, Scenario):  # its numbers depend on emptiness
                    check_variable(show, answer)
                tell()
        by_cell = [stored.answers(cell) for cell in range(len(cells))]
    attributes = {
        "title": loaded.title, "scenario": loaded.name, "kind": loaded.kind, "scenario_text": text,
        "seed": str(loaded.seed), "command": _command(scenario, overrides, runs, seed),
        ASKED: json.dumps({
            "scenario": scenario, "overrides": overrides, "runs": runs, "seed": seed,
            "digest": content_digest(text, data),
        }),
    }  # fmt: skip
    shown_settings = [_shown(entry) for entry in settings]
    return Campaign(
        campaign_table(
            axes, cells, shown_settings, by_cell, grid=latin is None, attributes=attributes
        )
    )


def _axes(loaded: Any, data: Mapping[str, Any], read: Sequence[Over]) -> list[Axis]:
    """The keys by their names in the table: their last parts, where these differ."""
    knobs = [find_knob(loaded, data, over.name) for over in read]
    keys = [knob.key for knob in knobs]
    for key in keys:
        if keys.count(key) > 1:
            raise ScenarioError(f"--over {key}: occurs twice")
        if key.startswith(COUNTS):
            raise ScenarioError(
                f"--over {key}: every cell has equally many runs", remedy="use --runs"
            )
    whole = [key.replace(".", "_") for key in keys]
    short = [
        long if key == CURRENT else last_part(key) for key, long in zip(keys, whole, strict=True)
    ]
    clear = {n for n in short if short.count(n) == 1 and n.isidentifier() and n not in TAKEN}
    names = [n if n in clear else long for n, long in zip(short, whole, strict=True)]
    return [Axis(*each) for each in zip(names, knobs, read, strict=True)]


def _settings(axes: Sequence[Axis], cell: Array) -> tuple[str, ...]:
    pairs = zip(axes, cell, strict=True)
    return tuple(setting for axis, value in pairs for setting in axis.settings(float(value)))


def _shown(settings: Iterable[str]) -> str:
    return " ".join(f"--set {shlex.quote(s)}" for s in settings)


def _command(scenario: str, overrides: Sequence[str], runs: int | None, seed: int | None) -> str:
    """The command that runs the scenario with the settings of all cells."""
    options = {"runs": runs, "seed": seed}
    numbers = [f"--{name} {value}" for name, value in options.items() if value is not None]
    parts = ["holdfast run", shlex.quote(scenario), *numbers, _shown(overrides)]
    return " ".join(part for part in parts if part)


def _check_some(
    shown: str,
    data: dict[str, Any],
    some: Sequence[tuple[str, ...]],
    runs: int | None,
    seed: int | None,
) -> None:
    """Refuse at once the errors of every cell: an unknown key, a number without effect."""
    refusal: HoldfastError | None = None

    def compose(settings: Sequence[str]) -> list[Composed]:
        return [scenario_of(shown, *overridden("", data, settings), runs, seed)]

    for settings in some:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", GainWarning)
                made = compose(settings)
        except HoldfastError as error:
            refusal = refusal or error
        else:
            check_overrides(settings, made, compose)
            return
    assert refusal is not None
    raise refusal


def _digest(
    data: Mapping[str, Any], settings: Sequence[tuple[str, ...]], runs: int | None, seed: int | None
) -> str:
    """The digest of a campaign: of everything that determines its numbers, with named files."""
    asked = [data, settings, runs, seed, PART]
    digest = hashlib.sha256((code_digest() + files_digest()).encode())
    digest.update(json.dumps(asked, sort_keys=True, default=str).encode())
    digest.update(content_digest("", data).encode())
    return digest.hexdigest()[:20]


def content_digest(text: str, data: Mapping[str, Any]) -> str:
    """The digest of the text of a scenario, and of the files that its tables name."""
    digest = hashlib.sha256(text.encode())
    for named in _texts(data):
        if named.endswith((".toml", ".nc", "json")) and Path(named).is_file():
            digest.update(Path(named).read_bytes())
    return digest.hexdigest()[:20]


def _texts(table: object) -> Iterator[str]:
    if isinstance(table, str):
        yield table
    elif isinstance(table, Mapping):
        yield from (text for pair in table.items() for part in pair for text in _texts(part))
    elif isinstance(table, list):
        yield from (text for part in table for text in _texts(part))
