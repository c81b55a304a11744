"""The records of a march: values at the requested times, and the times when nodes were reached."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.problem import Posed
from holdfast.analysis.reachability.value_function import ValueFunction, to_value_function
from holdfast.execution.arrays import AnyArray as Array


class Record:
    """Filled at every one of `stops` [s]; `arrays` and `restore` carry it over an interruption."""

    def __init__(self, posed: Posed, first: Array) -> None:
        self.posed = posed
        self.found: dict[float, Array] = {}
        self.arrival: Array | None = None
        self.before, self.then = first, 0.0
        self.stops = sorted(posed.asked)
        if posed.arrival_steps:
            steps = np.linspace(0, posed.horizon, posed.arrival_steps + 1)[1:]
            close = 1e-9 * posed.horizon  # the same time but for rounding
            new = [float(t) for t in steps if min(abs(t - s) for s in posed.asked) > close]
            self.stops = sorted([*posed.asked, *new])
            self.arrival = np.where(first > 0, 0.0, math.nan)
            self.before = first.copy()
        self.keep(0.0, first)

    def keep(self, time: float, values: Array) -> None:
        if self.posed.several and time in self.posed.asked:
            self.found[time] = values.copy()
        if self.arrival is not None and time > self.then:
            new = (values > 0) & np.isnan(self.arrival)
            rise = values[new] - self.before[new]
            share = -self.before[new] / rise
            self.arrival[new] = self.then + share * (time - self.then)
            self.before, self.then = values.copy(), time

    def arrays(self) -> dict[str, Array]:
        """All that is kept so far."""
        kept: dict[str, Array] = {f"at_{t!r}": v for t, v in self.found.items()}
        if self.arrival is not None:
            kept |= {"arrival": self.arrival, "before": self.before, "then": np.array(self.then)}
        return kept

    def restore(self, kept: Mapping[str, Array]) -> None:
        for time in self.posed.asked:
            if (name := f"at_{time!r}") in kept:
                self.found[time] = kept[name]
        if self.arrival is not None:
            self.arrival, self.before = kept["arrival"], kept["before"]
            self.then = float(kept["then"])

    def value_function(self, values: Array, report: Report) -> ValueFunction:
        grid, asked = self.posed.grid, self.posed.asked
        arrival = None if self.arrival is None else self.arrival.reshape(grid.shape)
        if not self.posed.several:
            values = values.reshape(grid.shape)
            return to_value_function(grid, values, report, arrival=arrival)
        # converged before: it stays as it is
        stack = np.stack([self.found.get(t, values).reshape(grid.shape) for t in asked])
        return to_value_function(grid, stack, report, times=asked, arrival=arrival)
