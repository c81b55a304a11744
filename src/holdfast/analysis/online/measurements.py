"""What a controller is given at a sample, as one row of numbers; and what is wrong with it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram

Given = Mapping[str, float] | Sequence[float] | Array
"""Numbers by name, or in the order of their names."""


QUICK = (list, tuple)
"""Types that are numbers in order."""


NO_NUMBERS = (TypeError, ValueError, OverflowError)


class Measurements:
    """The rows of what is seen: the measured states, the measured disturbances, the command.

    Other states, which an observer estimates, are 0 in them and are not used.
    """

    def __init__(
        self,
        program: ClosedLoopProgram,
        states: tuple[str, ...],
        disturbances: tuple[str, ...],
        handed: tuple[str, ...] = (),
    ) -> None:
        all_states = [q.name for q in program.states]
        n, measured = len(all_states), program.measured
        self.states, self.disturbances, self.handed = states, disturbances, handed
        self.row = np.zeros(n + measured + len(program.handed))
        places = [all_states.index(name) for name in states]
        whole = places == list(range(n))
        self._states: slice | list[int] = slice(0, n) if whole else places
        self._disturbances = slice(n, n + measured)
        self._handed = slice(n + measured, len(self.row))
        self._ones = np.ones(len(self.row))
        self.names = (*all_states, *disturbances, *handed)

    def fill(self, state: Given, disturbance: Given | None, command: Given | None = None) -> bool:
        """Write the row; whether all numbers of it are finite."""
        row = self.row
        self._fill(self._states, self.states, state, "state")
        if self.handed:
            if command is None:
                raise SimulationError("the command is None", expected=", ".join(self.handed))
            self._fill(self._handed, self.handed, command, "command")
        if self.disturbances:
            if disturbance is None:
                raise SimulationError(
                    f"the law measures {', '.join(self.disturbances)}",
                    expected="disturbance=..., by name or in that order",
                )
            self._fill(self._disturbances, self.disturbances, disturbance, "disturbance")
        elif disturbance is not None:
            raise SimulationError(
                "a disturbance is given, and the law measures none",
                remedy="leave it out, or make the law measure it (measured=True)",
            )
        return math.isfinite(row.dot(self._ones)) or bool(np.isfinite(row).all())

    def _fill(
        self, places: slice | list[int], names: tuple[str, ...], given: Given, what: str
    ) -> None:
        quick = type(given) in QUICK or (type(given) is np.ndarray and given.dtype.kind in "fiu")
        try:
            if quick and len(given) == len(names):
                self.row[places] = given  # type: ignore[assignment]
                return
        except NO_NUMBERS:
            pass  # it is said below what is wrong
        self.row[places] = numbers(given, names, what)

    def rows(
        self,
        states: npt.ArrayLike,
        disturbances: npt.ArrayLike | None,
        commands: npt.ArrayLike | None = None,
    ) -> Array:
        """Rows for many vehicles: arrays with a row for each of them."""
        given: list[tuple[str, Any, slice | list[int], tuple[str, ...]]]
        given = [("states", states, self._states, self.states)]
        if self.disturbances:
            if disturbances is None:
                raise SimulationError(f"the law measures {', '.join(self.disturbances)}")
            given.append(("disturbances", disturbances, self._disturbances, self.disturbances))
        if self.handed:
            given.append(("commands", commands, self._handed, self.handed))
        found: Array | None = None
        for what, numbers, places, names in given:
            try:
                array = np.asarray(_real(numbers), dtype=np.float64)
            except NO_NUMBERS:
                raise SimulationError(f"{what} is not an array of numbers") from None
            count = len(found) if found is not None else "any number"
            if (
                array.ndim != 2
                or array.shape[1] != len(names)
                or (found is not None and len(array) != len(found))
            ):
                raise SimulationError(
                    f"{what} has the shape {array.shape}",
                    expected=f"({count}, {len(names)}): {', '.join(names)}",
                )
            if found is None:
                found = np.zeros((len(array), len(self.row)))
            found[:, places] = array
        assert found is not None
        return found

    def faulty(self, row: Array) -> str:
        """The names of the numbers of a row that are not finite."""
        return ", ".join(
            f"{name} is {value}"
            for name, value in zip(self.names, row, strict=True)
            if not math.isfinite(value)
        )


def numbers(given: Given, names: tuple[str, ...], what: str) -> Array:
    """The numbers in the order of their names; `SimulationError` for others."""
    if isinstance(given, Mapping):
        for name in given:
            if name not in names:
                raise SimulationError(
                    f"unknown {what} '{name}'", remedy=suggestion(str(name), names)
                )
        if missing := [name for name in names if name not in given]:
            raise SimulationError(f"the {what} lacks {', '.join(missing)}")
        given = [given[name] for name in names]
    try:
        found = np.array(_real(given), dtype=np.float64)
    except NO_NUMBERS:
        shown = repr(given)
        shown = shown if len(shown) < 80 else f"{shown[:77]}..."
        raise SimulationError(f"the {what} is {shown}", expected="numbers") from None
    if found.shape != (len(names),):
        raise SimulationError(
            f"the {what} has the shape {found.shape}",
            expected=f"{len(names)} numbers: {', '.join(names)}",
        )
    return found


def _real(given: Any) -> Any:
    """What is given, unless it is complex or has no value at some place."""
    if np.iscomplexobj(given) or isinstance(given, np.ma.MaskedArray):
        raise TypeError
    return given


def time_of(t: float | None, count: int, sample_time: float) -> float:
    """The time of a sample [s]: as given, or by the number of samples before it."""
    if t is None:
        return count * sample_time
    try:
        return float(t)
    except NO_NUMBERS:
        raise SimulationError(f"t is {t!r}"[:80], expected="a number of seconds") from None
