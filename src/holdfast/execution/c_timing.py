"""How long an exported law takes on this machine, by the compiler that is here."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError
from holdfast.execution.c_text import c_file, c_name

COMPILERS = ("cc", "gcc", "clang")
OPTIONS = ("-std=c99", "-O2")
PATIENCE = 300.0
"""Seconds after which a compiler, or the program, is given up."""


@dataclass(frozen=True)
class Timing:
    """Nanoseconds of a call of the step, and what compiled it."""

    nanoseconds: float
    compiler: str


def time_law(text: str, name: str, states: npt.NDArray[np.float64], sample_time: float) -> Timing:
    """The time of a step of the law that `export_c` wrote for `name`.

    states: shape (..., states); the law is asked at one after the other, as in a run, but not at
    what is no number, with what it is told of disturbances zero. The fastest of five times a fifth
    of a second of a core.

    Raises `SimulationError` where there is no compiler, or it does not make a program that runs.
    """
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise SimulationError(f"there is no C compiler here ({', '.join(COMPILERS)})")
    called, states = c_name(name), states.reshape(-1, states.shape[-1])
    states = states[np.isfinite(states).all(axis=1)]
    main = c_file("timing").replace("NAME", called).replace("UPPER", called.upper())
    with tempfile.TemporaryDirectory(prefix="holdfast-") as folder:
        source, program, rows = (Path(folder) / n for n in ("law.c", "law", "states"))
        source.write_text(text + main, encoding="utf-8")
        rows.write_bytes(np.ascontiguousarray(states, dtype=np.float64).tobytes())
        _done([compiler, *OPTIONS, str(source), "-o", str(program), "-lm"])
        count, width = states.shape
        told = _done([str(program), str(rows), str(count), str(width), repr(sample_time)])
    return Timing(float(told), f"{Path(compiler).name} {OPTIONS[-1]}")


def _done(command: list[str]) -> str:
    """What it prints."""
    name = Path(command[0]).name
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SimulationError(f"'{name}' could not be run ({error})") from None
    if done.returncode:
        said = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[0]
        raise SimulationError(f"'{name}' failed: {said}")
    return done.stdout
