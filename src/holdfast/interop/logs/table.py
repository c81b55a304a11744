"""A log as a table: CSV with a header, commas, semicolons or tabs between the columns.

Every format of a log gives the same: named columns of numbers at their own times.
"""

from __future__ import annotations

import re
import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.host.files import check_file
from holdfast.maths.definitions.quantity import UnitError, convert

_UNIT = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*\Z")


@dataclass(frozen=True)
class Column:
    """Numbers at times [s], in a unit, "" for that of the system; NaN where there is none.

    faults: what could not be read, as "3 values are not numbers". unreadable: how many entries of
    `value` are NaN because they are not numbers; the others are NaN because nothing is there.
    """

    time: Array
    value: Array
    unit: str
    faults: tuple[str, ...] = ()
    unreadable: int = 0


class Recording(ABC):
    """A log that has been opened.

    name: of the file. notes: what was assumed in reading it.
    """

    name: str
    notes: tuple[str, ...]

    @abstractmethod
    def columns(self) -> tuple[str, ...]:
        """The names that `column` takes."""

    @abstractmethod
    def usual(self, wanted: str) -> str:
        """The column that a state or input is in if nothing is said; "" if there is none."""

    @abstractmethod
    def column(self, name: str) -> Column:
        """The column of that name. Raises `SimulationError` if there is none."""

    def unknown(self, name: str) -> SimulationError:
        """The refusal of a name."""
        columns = self.columns()
        shown = suggestion(name, columns)
        return SimulationError(
            f"{self.name} has no column '{name[:60]}'",
            remedy=shown if len(shown) < 400 else shown[:397] + "...",
        )


def with_unit(text: str) -> tuple[str, str]:
    """The name and the unit of "heading [deg]" or "heading (deg)"; "" for no unit."""
    match = _UNIT.match(text.strip())
    return (match["name"], match["unit"].strip()) if match else (text.strip(), "")


TIMES = ("time", "t", "timestamp", "stamp", "seconds", "header.stamp")
"""Names of the column of times."""

_ENDING = re.compile(r"(?:[_. ]|(?<=time)|(?<=stamp))(ns|us|ms|s|sec)\Z")
"""A unit at the end of a name in small letters: time_ms, timeus."""
_SCALES = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
_LARGE = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Times from 1970 on: above the number they are in the unit."""

SLOW = 5.0
"""Seconds from a value to the next, above which times without a unit are worth a sentence."""

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
        self._headers: dict[str, str] = {}
        self._twice: dict[str, list[str]] = {}
        for header in map(str, self._frame.columns):
            bare = with_unit(header)[0]
            if bare in self._headers:
                self._twice.setdefault(bare, [self._headers[bare]]).append(header)
            self._headers[bare] = header
        chosen = self._time_column(time)
        unit = with_unit(time)[1] if time != chosen else ""
        self._time, note = _times(self._frame[chosen], chosen, unit, self.name)
        self._time_name = chosen
        self.notes = tuple(n for n in (note, skipped) if n)

    def columns(self) -> tuple[str, ...]:
        return tuple(str(c) for c in self._frame.columns if str(c) != self._time_name)

    def usual(self, wanted: str) -> str:
        return wanted if wanted in self._headers else ""

    def column(self, name: str) -> Column:
        header, unit = name, with_unit(name)[1]
        if header not in self._frame.columns:
            bare = with_unit(name)[0]
            header = self._headers.get(bare, "")
            if bare in self._twice:
                raise SimulationError(
                    f"{self.name} has several columns '{bare}'",
                    expected="one of " + ", ".join(f"'{h}'" for h in self._twice[bare]),
                )
        if not header or header == self._time_name:
            raise self.unknown(name)
        value, text = _numbers(self._frame[header])
        faults = (f"{text} values that are not numbers left out",) if text else ()
        return Column(self._time, value, unit or with_unit(header)[1], faults, text)

    def _time_column(self, wanted: str) -> str:
        if wanted:
            bare = with_unit(wanted)[0]
            column = wanted if wanted in self._frame.columns else self._headers.get(bare, "")
            if not column:
                raise SimulationError(
                    f"{self.name} has no column '{wanted}'", expected=", ".join(self._headers)
                )
            return column
        for bare, header in self._headers.items():
            if _ENDING.sub("", bare.lower()) in TIMES or bare.lower() in TIMES:
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
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            frame = pd.read_csv(path, sep=mark, encoding="utf-8-sig", on_bad_lines="skip",
                                skipinitialspace=True, index_col=False)  # fmt: skip
    except (ValueError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise SimulationError(f"{path} cannot be read as a table ({error})"[:200]) from None
    with open(path, "rb") as raw:
        lines = sum(1 for line in raw if line.strip()) - 1
    left = lines - len(frame)
    return frame, f"{left} lines with another number of columns left out" if left > 0 else ""


def _numbers(series: Any) -> tuple[Array, int]:
    """The numbers of a column, and how many entries are none. An empty place is no fault."""
    value = pd.to_numeric(series, errors="coerce")
    return np.asarray(value, dtype=np.float64), int((value.isna() & series.notna()).sum())


def _times(series: Any, name: str, unit: str, file: str) -> tuple[Array, str]:
    """The times [s] from the first one on, and what was assumed of their unit.

    unit: as the user says it, "" where the header does, or nothing.
    """
    bare, stated = with_unit(name)
    ending = _ENDING.search(bare.lower())
    unit = unit or stated or (ending[1] if ending else "")
    numbers = pd.to_numeric(series, errors="coerce")
    if numbers.isna().all():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            dates = pd.to_datetime(series, errors="coerce", utc=True, format="ISO8601")
        if dates.isna().all():
            raise SimulationError(
                f"{file}: the column '{name}' has no times", expected="numbers, or ISO 8601"
            )
        seconds = (dates - dates.min()).dt.total_seconds()
        return np.asarray(seconds, dtype=np.float64), f"'{name}' read as dates"
    numbers = numbers.where(np.isfinite(np.asarray(numbers, dtype=np.float64)))
    since = np.asarray(numbers - numbers.min(), dtype=np.float64)
    guessed = ""
    if not unit:
        usual = abs(float(numbers.median()))
        guessed = next((u for least, u in _LARGE if usual > least), "s")
    scale = _SCALES.get(unit or guessed)
    if scale is None:
        try:
            scale = convert(1.0, unit, "s")
        except UnitError as error:
            raise SimulationError(f"{file}: column '{name}': {error}") from None
    since = since * scale
    if guessed and guessed != "s":
        return since, f"'{name}' read as {guessed} since 1970"
    period = float(np.median(np.abs(np.diff(since[np.isfinite(since)])))) if len(since) > 2 else 0.0
    if guessed and period > SLOW:
        return since, (
            f"'{name}' has no unit: taken as seconds, with a value every {period:.3g} s; if it is "
            f'in another unit, say it: --time "{name} [ms]"'
        )
    return since, ""
