"""Execution time of an exported law on this machine: replay recorded runs."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError
from holdfast.execution.codegen.c_source import c_file, c_name

COMPILERS = ("cc", "gcc", "clang")
OPTIONS = ("-std=c99", "-O2")
COMPILER_TIMEOUT = 300.0
"""Time limit in seconds of the compiler and of the program."""


@dataclass(frozen=True)
class Timing:
    """Nanoseconds per call of the step, and the compiler."""

    nanoseconds: float
    compiler: str


def time_law(
    text: str,
    name: str,
    times: npt.NDArray[np.float64],
    states: npt.NDArray[np.float64],
    sample_time: float,
    table: Path | None = None,
) -> Timing:
    """The time of a step of the law that `export_c` wrote for `name`.

    times [s], states: shapes (times,) and (runs, times, states). The program replays the runs, with
    measured disturbances zero; a run that ended early is replayed to its end. The result is the
    fastest of five repetitions of a fifth of a second on one core.

    Raises `SimulationError` if no state is a number, if no compiler is found, or if compilation or
    the program fails.
    """
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise SimulationError(f"no C compiler was found ({', '.join(COMPILERS)})")
    rows = timed_rows(times, states)
    if not len(rows):
        raise SimulationError("all states of its runs are NaN")
    names = {"NAME": c_name(name), "UPPER": c_name(name).upper()}
    loaded = f"\nstatic int loaded(void) {{ return NAME_load({json.dumps(str(table))}); }}\n"
    loaded = loaded if table else "\nstatic int loaded(void) { return 0; }\n"
    main = re.sub("|".join(names), lambda match: names[match[0]], loaded + c_file("timing"))
    with tempfile.TemporaryDirectory(prefix="holdfast-") as folder:
        source, program, data = (Path(folder) / n for n in ("law.c", "law", "rows"))
        source.write_text(text + main, encoding="utf-8")
        data.write_bytes(rows.tobytes())
        _done([compiler, *OPTIONS, str(source), "-o", str(program), "-lm"])
        printed = _done([str(program), str(data), *map(str, rows.shape), repr(float(sample_time))])
    return Timing(float(printed), f"{Path(compiler).name} {OPTIONS[-1]}")


def timed_rows(
    times: npt.NDArray[np.float64], states: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Rows (1 at the start of a run else 0, time, state); shape (rows, 2 + states)."""
    begins = np.broadcast_to(np.arange(len(times)) == 0, states.shape[:2])
    rows = np.dstack([begins, np.broadcast_to(times, states.shape[:2]), states])
    return np.ascontiguousarray(rows[np.isfinite(states).all(axis=2)], dtype=np.float64)


def _done(command: list[str]) -> str:
    """The output of the program."""
    name = Path(command[0]).name
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=COMPILER_TIMEOUT)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SimulationError(f"'{name}' could not be run ({error})") from None
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        said = next((line for line in lines if "error" in line), lines[-1])
        raise SimulationError(f"'{name}' failed: {said}")
    return done.stdout
