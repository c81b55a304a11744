"""Scenario files with changes: a refusal in one line with status 2, or a run; never a traceback.

The base is a shipped scenario, made small: few nodes, short horizons, few starts. A change takes a
key away, misspells it, copies it elsewhere, or gives it another value. The command is that of a
user (`holdfast run FILE`), called in this process, which the engine ends if it hangs.
"""

from __future__ import annotations

import copy
import io
import os
import re
import sys
import tempfile
import tomllib
import warnings
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from attacks import writing
from attacks.case import Fault, Kind, Outcome, raised

LIMITS = {
    "nodes": 11,
    "horizon": 1.0,
    "random": 4,
    "runs": 4,
    "cells": 8,
    "refine": 0,
    "lattice": 4,
}
"""Numbers that a scenario takes time by, and what they are made at most."""
LEFT_OUT = (
    "ch6",
    "ch7-six",
    "ch3-dynamic",
    "otter",
    "ch7-forward",
    "ch7-rescue",
    "craft",
    "slipping",
)
"""Beginnings of scenarios whose derivation alone takes many seconds."""
VALUES: tuple[Any, ...] = (
    0,
    -1,
    1,
    3,
    1e300,
    -1e-300,
    float("nan"),
    float("inf"),
    True,
    "",
    "x",
    "1 m",
    "-3 deg",
    "sin(x)",
    "1/0",
    "x**2 - 1",
    "u0 - u0",
    "hypot(x, y) - 1",
    "log(-1)",
    "__import__('os')",
    "é\u202e",
    "a" * 3000,
    [],
    [1],
    [1, 2],
    [2, 1],
    ["x"],
    [[1, 2], [3, 4]],
    {},
    {"x": 1},
    {"value": 1, "unit": "m"},
    {"expression": "x", "unit": "kg"},
    10**20,
)
ANSWERS = {0: "runs", 1: "runs without the answer", 2: "refused in a line"}
"""What the statuses of the command mean."""


def shipped() -> tuple[str, ...]:
    """Names of the scenarios that are tried."""
    folder = files("holdfast") / "scenarios"
    names = sorted(
        f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")
    )
    return tuple(n for n in names if not n.startswith(LEFT_OUT))


SHORTEST = 1e-4
"""A sample time [s] below which a run takes as long as it was asked for."""


def made_small(table: Any, key: str = "") -> Any:
    """A scenario whose march, runs and validations take little time."""
    if isinstance(table, dict):
        return {k: made_small(v, k) for k, v in table.items() if k not in ("figures",)}
    if key in LIMITS:
        most = LIMITS[key]
        if isinstance(table, bool):
            return table
        if isinstance(table, int | float):
            return type(table)(min(table, most))
        if isinstance(table, list) and key in ("nodes", "cells"):
            return [min(v, most) if isinstance(v, int) else v for v in table]
    if isinstance(table, list):
        return [made_small(v) for v in table]
    return table


def base(name: str) -> dict[str, Any]:
    text = (files("holdfast") / "scenarios" / f"{name}.toml").read_text("utf-8")
    small: dict[str, Any] = made_small(tomllib.loads(text))
    return small


def places(table: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to all values."""
    items = table.items() if isinstance(table, dict) else enumerate(table)
    for k, v in items:
        yield (*way, k)
        if isinstance(v, dict | list):
            yield from places(v, (*way, k))


def mutated(name: str, g: np.random.Generator) -> dict[str, Any]:
    """One to three changes of a scenario."""
    tables = copy.deepcopy(base(name))
    for _ in range(int(g.integers(1, 4))):
        ways = list(places(tables))
        if not ways:
            break
        *way, last = ways[int(g.integers(len(ways)))]
        place = tables
        for k in way:
            place = place[k]
        change = int(g.integers(6))
        old = place[last]
        if change == 0:
            del place[last]
        elif change == 1 and isinstance(place, dict):
            place[_misspelt(str(last), g)] = place.pop(last)
        elif change == 2 and isinstance(old, int | float) and not isinstance(old, bool):
            place[last] = old * float(g.choice([-1, 0, 0.1, 10, 1e-6]))
        elif change == 3 and isinstance(old, str) and old:
            k = int(g.integers(len(old)))
            place[last] = old[:k] + str(g.choice(list("()*+-/^.x0 ,_é"))) + old[k + 1 :]
        elif change == 4:
            other = ways[int(g.integers(len(ways)))]
            taken: Any = tables
            try:
                for k in other:
                    taken = taken[k]
            except (KeyError, IndexError):
                continue
            place[last] = copy.deepcopy(taken)
        else:
            place[last] = copy.deepcopy(VALUES[int(g.integers(len(VALUES)))])
    return _finite_work(tables)


def _misspelt(word: str, g: np.random.Generator) -> str:
    k = int(g.integers(len(word) + 1))
    return word[:k] + str(g.choice(list("aeioxz_-"))) + word[k + int(g.integers(2)) :]


def _finite_work(tables: dict[str, Any]) -> dict[str, Any]:
    """Not so much work asked for that time alone decides: a long horizon, or a sample time of
    nanoseconds, is no fault."""
    capped: dict[str, Any] = made_small(tables)
    for *way, last in places(capped):
        place: Any = capped
        for k in way:
            place = place[k]
        if last == "sample_time" and isinstance(place[last], int | float):
            place[last] = max(place[last], SHORTEST) if place[last] > 0 else place[last]
    return capped


def text_of(tables: dict[str, Any]) -> str | None:
    """The file; None where TOML cannot say it."""
    try:
        return tomlkit.dumps(tables)
    except Exception:
        return None


def run(text: str) -> tuple[int, str, BaseException | None]:
    """(status, standard error, what escaped) of `holdfast run` on a file of this text."""
    from holdfast.commands.main import main

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.toml"
        path.write_text(text, "utf-8")
        here, arguments, shown = os.getcwd(), sys.argv, warnings.showwarning
        err, out = io.StringIO(), io.StringIO()
        os.chdir(folder)
        sys.argv = ["holdfast", "run", "scenario.toml", "--no-figures"]
        try:
            with redirect_stderr(err), redirect_stdout(out), warnings.catch_warnings():
                main()
            return 0, err.getvalue(), None
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
            return status, err.getvalue(), None
        except BaseException as error:
            return 99, err.getvalue(), error
        finally:
            sys.argv, warnings.showwarning = arguments, shown
            os.chdir(here)


def answer_of(text: str) -> tuple[int, list[Fault]]:
    """(status, what is wrong) of the answer to a file."""
    status, err, error = run(text)
    return status, _faults_in(status, err, error)


def _faults_in(status: int, err: str, error: BaseException | None) -> list[Fault]:
    if isinstance(error, MemoryError):
        return [Fault("more memory than the limit", err[-300:])]
    if error is not None:
        return [raised(error)]
    if "Traceback (most recent call last)" in err:
        return [Fault("a traceback on standard error", err[-800:])]
    lines = [v for v in err.splitlines() if v.strip() and "warning:" not in v and "\r" not in v]
    if status not in ANSWERS:
        return [Fault(f"status {status}", err[-300:])]
    if status == 2 and not lines:
        return [Fault("status 2 without a message", err[-300:])]
    if status == 2 and not any(v.startswith(("holdfast: ", "Error: ")) for v in lines):
        return [Fault("a message that does not name the program", err[-300:])]
    if status == 2 and len(lines) > 1:
        return [Fault("a refusal in more than one line", "\n".join(lines)[:600])]
    if found := re.search(r"(\w+Warning): ", err):
        return [Fault(f"{found.group(1)} reaches the user", err[-300:])]
    return []


def name_and_tables(seed: int, number: int) -> tuple[str, dict[str, Any]]:
    g = np.random.default_rng([seed, number, 12])
    names = shipped()
    name = names[(number // 20) % len(names)]
    return name, mutated(name, g)


def attempt(seed: int, number: int) -> Outcome:
    _, tables = name_and_tables(seed, number)
    outcome = Outcome()
    text = text_of(tables)
    if text is None:
        outcome.counts = {"no TOML": 1}
        return outcome
    outcome.judged = 1
    status, outcome.faults = answer_of(text)
    outcome.counts = {ANSWERS.get(status, "other"): 1}
    return outcome


def smaller(tables: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """A file with a key less."""
    for *way, last in list(places(tables)):
        less = copy.deepcopy(tables)
        place: Any = less
        for k in way:
            place = place[k]
        del place[last]
        yield less


def shrink(seed: int, number: int, fault: Fault) -> None:
    _, tables = name_and_tables(seed, number)

    def has(t: dict[str, Any]) -> bool:
        text = text_of(t)
        return text is not None and any(f.signature == fault.signature for f in answer_of(text)[1])

    least = writing.shrunk(tables, smaller, has, seconds=30)
    fault.suffix = ".toml"
    told = "\n".join(f"# {line}" for line in (fault.signature, *fault.message.splitlines()[-3:]))
    fault.text = f"{told}\n# holdfast run THIS_FILE --no-figures\n{text_of(least)}"


KIND = Kind(
    "scenario files", attempt, shrink, share=1.0, seconds=40.0, shown=tuple(ANSWERS.values())
)
