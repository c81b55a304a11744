"""Samples as lines of JSON, each answered with a decision.

    {"t": 0.02, "state": {"x": -1.3, "y": 0.75}, "command": {"u": 0.3}, "disturbance": {"Vx": 0.1}}

t [s]: by default a sample time after that of the line before. A state or a command that is left out
has not come: the newest before it counts for the patience of the `Relay`. The disturbance is for a
filter that measures some. null is a number that is not known.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from holdfast.analysis.online.decision_record import DecisionRecord
from holdfast.analysis.online.measurements import numbers
from holdfast.analysis.online.relay import Relay
from holdfast.analysis.online.safety_filter import SafetyFilter
from holdfast.errors import HoldfastError, SimulationError, suggestion

KEYS = ("t", "state", "command", "disturbance")


LATEST = 1e12
"""A larger time [s] is none."""


class SampleLines:
    """A filter that is told samples line by line.

    A line that is no sample is answered with the fallback of the filter, and `refused` says why;
    nothing of it is believed. The first line has to be a sample: `answer` raises `SimulationError`
    where it is none, because sender and filter then do not agree.
    """

    def __init__(self, keep: SafetyFilter, *, patience: float = 0.25) -> None:
        self.keep, self.relay = keep, Relay(keep, patience=patience)
        self.count, self.refused = 0, ""
        self._t, self._given_t, self._given = -math.inf, 0.0, 0

    def answer(self, line: bytes) -> DecisionRecord:
        """The decision on the next line."""
        before, self._t = self._t, self._usual(self.count)
        self.count += 1
        self.refused = ""
        try:
            said = _table(line)
            t = None if said.get("t") is None else _time(said["t"], before)
            state, command, felt = self._numbers(said)
            if t is not None:
                self._t, self._given_t, self._given = t, t, self.count - 1
        except HoldfastError as error:
            refusal = SimulationError(
                f"line {self.count} is no sample: {error.cause}",
                expected=error.expected or f"a line such as {self.example()}",
                remedy=error.remedy,
            )
            if self.count == 1:
                raise refusal from None
            self.refused = str(refusal)
            return self._fallback()
        if state is not None:
            self.relay.measured(state, self._t, felt)
        if command is not None:
            self.relay.commanded(command, self._t)
        return self.relay.decide(self._t)

    def _usual(self, number: int) -> float:
        """The time of the line with that number, from 0, where it is not said [s]."""
        return self._given_t + (number - self._given) * self.keep.sample_time

    def example(self) -> str:
        """A line that is a sample."""
        said: dict[str, Any] = {
            "state": dict.fromkeys(self.relay.states, 0.0),
            "command": dict.fromkeys(self.relay.commands, 0.0),
        }
        if self.keep.measured_disturbances:
            said["disturbance"] = dict.fromkeys(self.keep.measured_disturbances, 0.0)
        return json.dumps(said)

    def _numbers(self, said: Mapping[str, Any]) -> list[list[float] | None]:
        """State, command and disturbance; None for what did not come."""
        felt = self.keep.measured_disturbances
        names = {"state": self.relay.states, "command": self.relay.commands, "disturbance": felt}
        found = [_by_name(said.get(what), names[what], what) for what in names]
        if felt and found[0] is not None and found[2] is None:
            raise SimulationError(f"the disturbance lacks {', '.join(felt)}")
        return found

    def _fallback(self) -> DecisionRecord:
        """What the filter answers where nothing is known."""
        record = self.relay.unknown(self._t)
        return replace(record, why=f"line {self.count} is no sample: the input is the fallback")


def _table(line: bytes) -> Mapping[str, Any]:
    try:
        said = json.loads(line)
    except (ValueError, RecursionError):
        said = None
    if not isinstance(said, dict):
        raise SimulationError(f"{_shown(line)} is no table of JSON")
    for name in said:
        if name not in KEYS:
            raise SimulationError(f"unknown key {_shown(name)}", remedy=suggestion(name, KEYS))
    return said


def _time(t: Any, before: float) -> float:
    """The time of a sample."""
    if isinstance(t, bool) or not isinstance(t, int | float) or not abs(t) < LATEST:
        raise SimulationError(f"t is {_shown(t)}", expected="a number of seconds")
    if t < before:
        raise SimulationError(f"t is {t:g} s after {before:g} s", expected="a time that goes on")
    return float(t)


def _by_name(said: Any, names: tuple[str, ...], what: str) -> list[float] | None:
    if said is None:
        return None
    if not isinstance(said, dict) or not all(
        v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in said.values()
    ):
        raise SimulationError(f"the {what} is {_shown(said)}", expected="numbers by name")
    known = {name: math.nan if v is None else v for name, v in said.items()}
    found: list[float] = numbers(known, names, what).tolist()
    return found


def _shown(said: Any) -> str:
    text = repr(said.decode(errors="replace") if isinstance(said, bytes) else said)
    return text if len(text) < 80 else f"{text[:77]}..."
