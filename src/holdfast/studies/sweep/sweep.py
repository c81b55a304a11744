"""Parameter sweeps of a scenario in worker processes, stored on disk: `holdfast sweep`.

One part of a cell is the work of a process, local or on a cluster. A finished part is stored, and a
kill at any time loses none: the store is an SQLite file, whose transactions are atomic.
"""

from __future__ import annotations

import hashlib
import json
import shlex
import sqlite3
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.analysis.simulation.aggregates import Entry, as_table
from holdfast.analysis.simulation.sweep_table import Campaign
from holdfast.arguments import checked
from holdfast.errors import GainWarning, HoldfastError, OutputError, ScenarioError
from holdfast.execution.arrays import Array
from holdfast.execution.cache import code_digest
from holdfast.execution.resources import available_cores
from holdfast.host.writing import make_folder
from holdfast.scenario.files import files_digest, overridden, read_tables
from holdfast.scenario.kinds.base import Composed
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import check_overrides, scenario_of
from holdfast.studies.process_pool import answers, processes
from holdfast.studies.scenario_parameter import CURRENT, find_knob, last_part
from holdfast.studies.sweep.table import (
    Axis,
    Over,
    campaign_table,
    check_variable,
    grid_cells,
    latin_cells,
    read_over,
)


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
    if part.code != code_digest():
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
        found = {number: json.loads(text) for number, text in rows}
        found |= self.failed.get(cell, {})
        return [found[number] for number in sorted(found)]


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
    overrides: Iterable[str] = (),
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
    """
    overrides = tuple(overrides)
    shown, text, data = read_tables(scenario, overrides)
    own = scenario_of(shown, text, data, runs, seed)
    read = [read_over(given, latin=latin is not None) for given in over]
    if not read:
        raise ScenarioError("a sweep needs at least one axis", expected="--over KEY=LOW:HIGH:COUNT")
    axes = _axes(own, data, read)
    cells = grid_cells(read) if latin is None else latin_cells(read, latin, own.seed)
    settings = [_settings(axes, cell) for cell in cells]
    _check_some(shown, data, [settings[k] for k in (0, -1, len(cells) // 2)], runs, seed)
    total = own.independent_runs
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
        kept = stack.enter_context(store(place, _digest(data, settings, runs, seed)))
        there = kept.finished()
        keys = ((cell, part) for cell in range(len(cells)) for part in range(parts))
        missing = [key for key in keys if key not in there]
        at_once = workers or (1 if own.uses_all_cores else available_cores())
        threads = 0
        if missing and executor is None:
            at_once = min(at_once, len(missing))
            threads = 0 if own.uses_all_cores else available_cores() // at_once or 1
            executor = stack.enter_context(processes(at_once))

        def part(key: Key) -> Part:
            cell, first = key[0], key[1] * PART
            runs_of_it = (first, min(first + PART, total))
            return Part(
                shown, data, settings[cell], runs, seed, *runs_of_it, threads, code_digest()
            )

        def tell() -> None:
            if progress is not None:
                done = f"{len(there) // parts} of {len(cells)} cells"
                progress(done, 1 - (len(cells) * parts - len(there)) / max(len(missing), 1))

        tell()
        asked = ((key, part(key)) for key in missing)
        if executor is not None:
            for key, answer in answers(executor, run_part, asked, 2 * at_once, tell):
                kept.put(key, answer)
                there.add(key)
                if isinstance(own, Scenario):  # its numbers depend on emptiness
                    check_variable(show, answer)
                tell()
        found = [kept.answers(cell) for cell in range(len(cells))]
    attributes = {
        "title": own.title, "scenario": own.name, "kind": own.kind, "scenario_text": text,
        "seed": str(own.seed), "command": _command(scenario, overrides, runs, seed),
        ASKED: json.dumps({
            "scenario": scenario, "overrides": overrides, "runs": runs, "seed": seed,
            "digest": content_digest(text, data),
        }),
    }  # fmt: skip
    shown_settings = [_shown(given) for given in settings]
    return Campaign(
        campaign_table(
            axes, cells, shown_settings, found, grid=latin is None, attributes=attributes
        )
    )


def _axes(own: Any, data: Mapping[str, Any], read: Sequence[Over]) -> list[Axis]:
    """The keys by their names in the table: their last parts, where these differ."""
    knobs = [find_knob(own, data, over.name) for over in read]
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
    given = {"runs": runs, "seed": seed}
    numbers = [f"--{name} {value}" for name, value in given.items() if value is not None]
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
    found = hashlib.sha256((code_digest() + files_digest()).encode())
    found.update(json.dumps(asked, sort_keys=True, default=str).encode())
    found.update(content_digest("", data).encode())
    return found.hexdigest()[:20]


def content_digest(text: str, data: Mapping[str, Any]) -> str:
    """The digest of the text of a scenario, and of the files that its tables name."""
    found = hashlib.sha256(text.encode())
    for named in _texts(data):
        if named.endswith((".toml", ".nc", "json")) and Path(named).is_file():
            found.update(Path(named).read_bytes())
    return found.hexdigest()[:20]


def _texts(table: object) -> Iterator[str]:
    if isinstance(table, str):
        yield table
    elif isinstance(table, Mapping):
        yield from (text for pair in table.items() for part in pair for text in _texts(part))
    elif isinstance(table, list):
        yield from (text for part in table for text in _texts(part))
