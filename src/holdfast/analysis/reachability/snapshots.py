"""The records of a march: values at the requested times, and the times when nodes were reached."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from holdfast.analysis.reachability.problem import Posed
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.working_room import Room

TOGETHER = 1 << 20
"""Nodes that are looked at together, to save memory."""


class Record:
    """Filled at every one of `stops` [s]; `arrays` and `restore` carry it over an interruption."""

    def __init__(self, posed: Posed, first: Array, room: Room) -> None:
        self.posed, self._room = posed, room
        self.found: dict[float, Array] = {}
        self.arrival: Array | None = None
        self.then = 0.0
        if posed.arrival_steps:
            self.arrival = room.empty(len(first), np.float64)
            for part in _parts(len(first)):
                self.arrival[part] = np.where(first[part] > 0, 0.0, math.nan)
            self.before = room.copy(first)
        self.keep(0.0, first)

    def keep(self, time: float, values: Array) -> None:
        if self.posed.several and time in self.posed.asked:
            self.found[time] = self._room.copy(values)
        if self.arrival is not None and time > self.then:
            for part in _parts(len(values)):
                now, was, arrival = values[part], self.before[part], self.arrival[part]
                new = (now > 0) & np.isnan(arrival)
                share = -was[new] / (now[new] - was[new])
                arrival[new] = self.then + share * (time - self.then)
            self.before[:] = values
            self.then = time

    def arrays(self) -> dict[str, Array]:
        """All that is kept so far."""
        kept: dict[str, Array] = {named(t): v for t, v in self.found.items()}
        if self.arrival is not None:
            kept |= {"arrival": self.arrival, "before": self.before}
        return kept

    def restore(self, known: Callable[[str], Any | None], own: slice, then: float) -> None:
        """known: what was kept, over the grid, by name; own: the nodes of this record."""
        for time in self.posed.asked:
            if (values := known(named(time))) is not None:
                count, kind = own.stop - own.start, self.posed.marching.precision
                self.found[time] = self._room.empty(count, kind)
                _fill(self.found[time], values, own)
        if self.arrival is not None:
            for name, array in (("arrival", self.arrival), ("before", self.before)):
                values = known(name)
                assert values is not None
                _fill(array, values, own)
            self.then = then


def stops(posed: Posed) -> list[float]:
    """The times [s] at which a march is recorded."""
    if not posed.arrival_steps:
        return sorted(posed.asked)
    steps = np.linspace(0, posed.horizon, posed.arrival_steps + 1)[1:]
    close = 1e-9 * posed.horizon  # the same time but for rounding
    new = [float(t) for t in steps if min(abs(t - s) for s in posed.asked) > close]
    return sorted([*posed.asked, *new])


def named(time: float) -> str:
    """What the values of a time are called among the arrays of a record."""
    return f"at_{time!r}"


def _fill(array: Array, values: Any, own: slice) -> None:
    """With these of the values, some at a time."""
    for part in _parts(len(array)):
        stop = min(own.start + part.stop, own.stop)
        array[part] = values[own.start + part.start : stop]


def _parts(count: int) -> list[slice]:
    return [slice(k, k + TOGETHER) for k in range(0, count, TOGETHER)]
