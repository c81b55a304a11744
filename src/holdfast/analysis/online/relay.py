"""A safety filter between streams: measurements and commands that may be late, or cease."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.analysis.online.certified_filter import CertifiedFilter
from holdfast.analysis.online.decision import Decision, Status
from holdfast.analysis.online.decision_record import DecisionRecord
from holdfast.analysis.online.measurements import Given, numbers, time_of
from holdfast.analysis.online.safety_filter import SafetyFilter
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array

AGAIN = 0.25
"""Seconds after which the sentence of an intervention that goes on is made again."""


class Relay:
    """The newest measurement and the newest command, and a decision on them at every sample.

    keep: the filter; one of a certificate is asked at its sample time. patience [s]: how old a
    measurement or a command may be. Without a newer command the filter is asked about its
    `fallback` instead, so that the vehicle slows down inside its constraints; without a newer
    measurement the input is the `fallback`, and nothing is promised; afterwards an observer begins
    anew. All times are those of one clock, in seconds: that of the receiver. Where it goes back,
    what was received before counts no more.

    Raises `SimulationError` for a patience that is not positive; its methods do for wrong names or
    shapes, for measured disturbances that are missing, and for times that are not finite.
    """

    @checked
    def __init__(self, keep: SafetyFilter | CertifiedFilter, *, patience: float = 0.25) -> None:
        if not (math.isfinite(patience) and patience > 0):
            raise SimulationError(f"patience is {patience}", expected="seconds, above 0")
        self.keep, self.patience = keep, float(patience)
        self.states, self.commands = keep.measured_states, keep.system.input_names
        keep.prepare()
        self._nothing = np.full(len(self.states), math.nan)
        self.reset()

    def reset(self) -> None:
        """Begin anew: nothing was received, and the time of the filter is 0."""
        self.keep.reset()
        self._state, self._command = self._nothing, self.keep.fallback
        self._felt: Array | None = None
        self._measured_at = self._commanded_at = -math.inf
        self._began, self._missing, self._last = math.nan, False, -math.inf
        self._said, self._said_at = "", -math.inf

    def measured(self, state: Given, now: float, disturbance: Given | None = None) -> None:
        """A measurement of the states that the filter is given, received at `now` [s]."""
        now, found, felt = self._time(now), numbers(state, self.states, "state"), None
        if self.keep.measured_disturbances:
            names = self.keep.measured_disturbances
            felt = numbers(() if disturbance is None else disturbance, names, "disturbance")
        self._state, self._felt, self._measured_at = found, felt, now

    def commanded(self, command: Given, now: float) -> None:
        """A command, received at `now` [s]."""
        now, self._command = self._time(now), numbers(command, self.commands, "command")
        self._commanded_at = now

    def decide(self, now: float) -> DecisionRecord:
        """The decision at `now` [s], and what the vehicle is to be given."""
        now = self._time(now)
        lost, age = "", 0.0
        if not now - self._commanded_at <= self.patience:
            lost, age = "command", now - self._commanded_at
        if not now - self._measured_at <= self.patience:
            lost, age = "measurement", now - self._measured_at
        if self._missing and lost != "measurement":
            self._begin_again(now)
        self._missing = lost == "measurement"
        state = self._nothing if self._missing else self._state
        command = self.keep.fallback if lost else self._command
        return self._recorded(self._asked(state, command, now), now, lost, age, state)

    def unknown(self, now: float) -> DecisionRecord:
        """The decision where a sample came of which nothing can be believed: the fallback."""
        now = self._time(now)
        nothing = np.full(len(self.commands), math.nan)
        decision = self._asked(self._nothing, nothing, now)
        return self._recorded(decision, now, "", 0.0, self._nothing)

    def _asked(self, state: Array, command: Array, now: float) -> Decision:
        """The decision of the filter; disturbances that never came are 0."""
        if math.isnan(self._began):
            self._began = now
        felt = self._felt
        if felt is None and self.keep.measured_disturbances:
            felt = np.zeros(len(self.keep.measured_disturbances))
        return self.keep.step(state, command, t=now - self._began, disturbance=felt)

    def _time(self, now: float) -> float:
        """The time, checked; where it goes back, what was received before counts no more."""
        found = time_of(now, 0, 0.0) if now is not None else math.nan
        if not math.isfinite(found):
            raise SimulationError(f"now is {now!r}"[:80], expected="a number of seconds")
        if found < self._last:
            self.reset()
        self._last = found
        return found

    def _begin_again(self, now: float) -> None:
        """Forget what was estimated before the gap, and not that the fallback was given in it."""
        self.keep.reset()
        self._asked(self._nothing, self.keep.fallback, now)

    def _recorded(
        self, decision: Decision, now: float, lost: str, age: float, state: Array
    ) -> DecisionRecord:
        known = lost != "measurement"
        kind = f"{lost}/{decision.status.value}"
        if kind == self._said and now - self._said_at < AGAIN:
            why = ""
        elif lost == "measurement":
            why = f"no measurement {_since(age)}: the input is the fallback"
        elif decision.status is Status.PASSED:
            why = f"no command {_since(age)}: the filter's fallback is taken" if lost else ""
        else:
            why = f"no command {_since(age)}: " if lost else ""
            why += decision.why
        if kind != self._said or why:
            self._said, self._said_at = kind, now
        return DecisionRecord(
            t=now,
            status="no measurement" if not known else decision.status.value,
            lost=lost,
            state=_named(self.states, state if known else self._nothing),
            command=_named(self.commands, decision.nominal),
            input=_named(self.commands, decision.input),
            actuators=_named(self.keep.actuator_names, decision.actuators),
            overruled=decision.overruled,
            slack=decision.slack,
            value=decision.value if known else math.nan,
            gave_way=decision.gave_way,
            why=why,
        )


def _since(age: float) -> str:
    return "yet" if math.isinf(age) else f"for {age:.2g} s"


def _named(names: tuple[str, ...], values: Any) -> Mapping[str, float]:
    return dict(zip(names, map(float, values), strict=True))
