"""A log as a table: CSV with a header, commas, semicolons or tabs between the columns."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from holdfast.errors import SimulationError
from holdfast.host.reading import check_file
from holdfast.interop.logs.recording import Column, Floats, Recording, with_unit
from holdfast.maths.definitions.units import UnitError, convert

TIMES = ("time", "t", "timestamp", "stamp", "seconds", "header.stamp")
"""Names of the column of times."""

_ENDINGS = {"_ns": "ns", "_us": "us", "_ms": "ms", "_s": "s", "_sec": "s"}
_SCALES = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
_LARGE = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Times from 1970 on: above the number they are in the unit."""

MOST = 2**30
"""Bytes of a table."""


class Table(Recording):
    """The columns of a CSV file.

    time: the column of times, by default one that is called time, t, stamp ...; its unit stands in
    brackets or at the end (time_ms), or is recognised for times since 1970. Raises
    `SimulationError` for a file without such a column or without numbers.
    """

    def __init__(self, path: Path, time: str = "") -> None:
        self.name = path.name
        check_file(path)
        if path.stat().st_size > MOST:
            raise SimulationError(
                f"{path} has {path.stat().st_size / 2**30:.1f} GiB", expected="at most 1 GiB"
            )
        self._frame, skipped = _read(path)
        self._headers = {with_unit(str(c))[0]: str(c) for c in self._frame.columns}
        chosen = self._time_column(time)
        self._time, note = _times(self._frame[chosen], chosen, self.name)
        self._time_name = chosen
        self.notes = tuple(n for n in (note, skipped) if n)

    def columns(self) -> tuple[str, ...]:
        return tuple(str(c) for c in self._frame.columns if str(c) != self._time_name)

    def usual(self, wanted: str) -> str:
        return self._headers.get(wanted, "")

    def column(self, name: str) -> Column:
        header, unit = name, with_unit(name)[1]
        if header not in self.columns():
            header = self._headers.get(with_unit(name)[0], "")
        if not header or header == self._time_name:
            raise self.unknown(name)
        value, faults = _numbers(self._frame[header])
        return Column(self._time, value, unit or with_unit(header)[1], faults)

    def _time_column(self, wanted: str) -> str:
        if wanted:
            found = wanted if wanted in self._frame.columns else self._headers.get(wanted, "")
            if not found:
                raise SimulationError(
                    f"{self.name} has no column '{wanted}'", expected=", ".join(self._headers)
                )
            return found
        for bare, header in self._headers.items():
            name = bare.lower()
            for ending in _ENDINGS:
                name = name.removesuffix(ending)
            if name in TIMES:
                return header
        raise SimulationError(
            f"{self.name} has no column of times",
            expected=f"one of {', '.join(TIMES)} in its header, or its name (--time)",
        )


def _read(path: Path) -> tuple[Any, str]:
    """The table, and a sentence on lines that were left out."""
    try:
        with open(path, encoding="utf-8-sig", errors="strict") as file:
            first = file.readline(1 << 16)
    except (OSError, ValueError):
        raise SimulationError(f"{path} is not a table of text in UTF-8") from None
    if not first.strip():
        raise SimulationError(f"{path} begins with an empty line", expected="a header of names")
    mark = max(",;\t", key=first.count)
    if first.count(mark) == 0:
        raise SimulationError(
            f"{path} has one column only", expected="commas, semicolons or tabs between columns"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pd.errors.DtypeWarning)
            frame = pd.read_csv(path, sep=mark, encoding="utf-8-sig", on_bad_lines="skip",
                                skipinitialspace=True, index_col=False)  # fmt: skip
    except (ValueError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise SimulationError(f"{path} cannot be read as a table ({error})"[:200]) from None
    with open(path, "rb") as raw:
        lines = sum(1 for line in raw if line.strip()) - 1
    left = lines - len(frame)
    return frame, f"{left} lines with another number of columns left out" if left > 0 else ""


def _numbers(series: Any) -> tuple[Floats, tuple[str, ...]]:
    """The numbers of a column, and what is none. An empty place is no fault."""
    value = pd.to_numeric(series, errors="coerce")
    text = int((value.isna() & series.notna()).sum())
    faults = (f"{text} values that are not numbers left out",) if text else ()
    return np.asarray(value, dtype=np.float64), faults


def _times(series: Any, name: str, file: str) -> tuple[Floats, str]:
    """The times [s] from the first one on, and what was assumed of their unit."""
    bare, unit = with_unit(name)
    ending = next((u for e, u in _ENDINGS.items() if bare.lower().endswith(e)), "")
    numbers = pd.to_numeric(series, errors="coerce")
    if numbers.isna().all():
        dates = pd.to_datetime(series, errors="coerce", utc=True, format="ISO8601")
        if dates.isna().all():
            raise SimulationError(
                f"{file}: the column '{name}' has no times", expected="numbers, or ISO 8601"
            )
        seconds = (dates - dates.min()).dt.total_seconds()
        return np.asarray(seconds, dtype=np.float64), f"'{name}' read as dates"
    first = numbers.min()
    since = np.asarray(numbers - first, dtype=np.float64)
    note = ""
    if not unit and not ending:
        ending = next((u for least, u in _LARGE if abs(first) > least), "s")
        note = f"'{name}' read as {ending} since 1970" if ending != "s" else ""
    scale = _SCALES.get(unit or ending)
    if scale is None:
        try:
            scale = convert(1.0, unit, "s")
        except UnitError as error:
            raise SimulationError(f"{file}: column '{name}': {error}") from None
    return since * scale, note
