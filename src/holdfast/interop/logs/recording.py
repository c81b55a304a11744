"""What every format of a log gives: named columns of numbers at their own times."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError, suggestion

Floats = npt.NDArray[np.float64]
_UNIT = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*\Z")


@dataclass(frozen=True)
class Column:
    """Numbers at times [s], in a unit, "" for that of the system; NaN where there is none.

    faults: what could not be read, as "3 values are not numbers". unreadable: how many entries of
    `value` are NaN because they are not numbers; the others are NaN because nothing is there.
    """

    time: Floats
    value: Floats
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
