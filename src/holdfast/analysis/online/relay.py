"""A safety filter between streams: measurements and commands that may be late, or cease.

One kind of stream are samples as lines of JSON, each answered with a decision:

    {"t": 0.02, "state": {"x": -1.3, "y": 0.75}, "command": {"u": 0.3}, "disturbance": {"Vx": 0.1}}

t [s]: by default a sample time after that of the line before. A state or a command that is left out
has not come: the newest before it counts for the patience of the `Relay`. The disturbance is for a
filter that measures some, and "obstacles" is a list for a filter that keeps clear of some, where a
list that is left out has not come either. null is a number that is not known.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np

from holdfast.analysis.online.certified_filter import CertifiedFilter
from holdfast.analysis.online.controller import Given, numbers, time_of
from holdfast.analysis.online.decision import Decision, DecisionRecord, Obstructs, Status
from holdfast.analysis.online.safety_filter import SafetyFilter
from holdfast.arguments import checked
from holdfast.errors import HoldfastError, SimulationError, check_name
from holdfast.execution.arrays import Array

Item = TypeVar("Item")

AGAIN = 0.25
"""Seconds after which the sentence of an intervention that goes on is made again."""
UNSEEN = "list of obstacles"
"""What is lost where none of them came in time."""
BLIND = ("measurement", UNSEEN)
"""What a decision cannot be made without."""


class Relay:
    """The newest measurement and the newest command, and a decision on them at every sample.

    keep: the filter; one of a certificate is asked at its sample time. patience [s]: how old a
    measurement, a command or a list of obstacles may be. Without a newer command the filter is
    asked about its `fallback` instead, so that the vehicle slows down inside its constraints;
    without a newer measurement, or a newer list for a filter with obstacles, the input is the
    `fallback`, and nothing is promised; afterwards an observer begins anew. An obstacle counts as
    so much older as its list is (`Obstacle.aged`).

    All times are those of one clock, in seconds: that of the receiver. The clock is read at
    decisions. A measurement or a command has the time at which it was taken or received, which may
    lie before the last decision and before the time of the other: that is its age. Of several the
    one with the latest time counts, in whatever order they come; a time that the clock has not
    reached counts as that of the next decision. Where a decision is earlier than the one before,
    the clock was set back: what was received before counts no more, because its age is not known.

    Raises `SimulationError` for a patience that is not positive; its methods do for wrong names or
    shapes, for measured disturbances that are missing, and for times that are not finite.

    >>> relay = hf.Relay(hf.SafetyFilter(cart, track))
    >>> relay.measured([0.5, 0.3], 0.0)
    >>> relay.commanded([1.0], 0.0)
    >>> print(relay.decide(0.01).status)
    changed
    """

    @checked
    def __init__(
        self,
        keep: SafetyFilter | CertifiedFilter,
        *,
        patience: float = 0.25,
    ) -> None:
        if not (math.isfinite(patience) and patience > 0):
            raise SimulationError(f"patience is {patience}", expected="seconds, above 0")
        self.keep, self.patience = keep, float(patience)
        self.states, self.commands = keep.measured_states, keep.system.input_names
        keep.prepare()
        self._nothing = np.full(len(self.states), math.nan)
        self._measurement = _Stream[tuple[Array, Array | None]]()
        self._command = _Stream[Array]()
        self._around = _Stream[tuple[Obstructs, ...]]()
        self._clears = getattr(keep, "clearing", None) is not None
        self.reset()

    def reset(self) -> None:
        """Begin anew: nothing was received, and the time of the filter is 0."""
        for stream in self._streams:
            stream.forget()
        self._begin(-math.inf, "yet")

    @property
    def _streams(self) -> tuple[_Stream[Any], ...]:
        return self._measurement, self._command, self._around

    def _begin(self, now: float, since: str) -> None:
        """Begin with the clock at `now` [s]; since: when what never came was last waited for."""
        self.keep.reset()
        self._felt: Array | None = None
        self._began, self._missing, self._clock = math.nan, False, now
        self._since, self._said, self._said_at = since, "", -math.inf

    def measured(self, state: Given, now: float, disturbance: Given | None = None) -> None:
        """A measurement of the states that the filter is given, taken or received at `now` [s]."""
        at, row, felt = _time(now), numbers(state, self.states, "state"), None
        if self.keep.measured_disturbances:
            names = self.keep.measured_disturbances
            felt = numbers(() if disturbance is None else disturbance, names, "disturbance")
        self._measurement.take(at, (row, felt))

    def commanded(self, command: Given, now: float) -> None:
        """A command, given or received at `now` [s]."""
        self._command.take(_time(now), numbers(command, self.commands, "command"))

    @checked
    def surrounded(self, obstacles: Sequence[Obstructs], now: float) -> None:
        """All obstacles that are known, of a time `now` [s]; an empty list says that none is there.

        obstacles: of `hf.Obstacle`. Raises `SimulationError` for a filter without obstacles, and
        for what is no list of them.

        >>> clear = hf.SafetyFilter(robot, obstacles=hf.Obstacles(5, lead=0.3), gains=(1, 4))
        >>> relay = hf.Relay(clear)
        >>> relay.surrounded([hf.Obstacle.disc((1, 0), 0.3)], 0.0)
        >>> relay.measured([0, 0, 0], 0.0)
        >>> relay.commanded([1, 0], 0.0)
        >>> print(relay.decide(0.01).status)
        changed
        """
        at = _time(now)
        if not self._clears:
            raise SimulationError(
                "obstacles are given to a filter without room for any",
                remedy="make it with obstacles=20, as many as it is to count with",
            )
        listed = isinstance(obstacles, list | tuple)
        if not listed or not all(hasattr(o, "records") for o in obstacles):
            raise SimulationError(
                f"the obstacles are {obstacles!r}"[:80], expected="a list of hf.Obstacle"
            )
        self._around.take(at, tuple(obstacles))

    def decide(self, now: float) -> DecisionRecord:
        """The decision at `now` [s], and what the vehicle is to be given."""
        now = self._advance(now)
        lost, age = "", 0.0
        needed = {"command": now - self._command.at}
        if self._clears:
            needed[UNSEEN] = now - self._around.at
        needed["measurement"] = now - self._measurement.at  # the gravest last
        for what, since in needed.items():
            if not since <= self.patience:
                lost, age = what, since
        if self._missing and lost not in BLIND:
            self._begin_again(now)
        self._missing = lost in BLIND
        state, command = self._nothing, self.keep.fallback
        if self._measurement.newest is not None:
            measured, self._felt = self._measurement.newest
            state = self._nothing if self._missing else measured
        if self._command.newest is not None and not lost:
            command = self._command.newest
        return self._recorded(self._asked(state, command, now), now, lost, age, state)

    def unknown(self, now: float) -> DecisionRecord:
        """The decision where a sample came of which nothing can be believed: the fallback."""
        now = self._advance(now)
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
        if not self._clears:
            return self.keep.step(state, command, t=now - self._began, disturbance=felt)
        assert isinstance(self.keep, SafetyFilter)
        elapsed = now - self._around.at
        around = [o.aged(elapsed) for o in self._around.newest or ()]
        return self.keep.step(
            state, command, t=now - self._began, disturbance=felt, obstacles=around
        )

    def _advance(self, now: float) -> float:
        """The clock, checked; where it was set back, what was received before counts no more."""
        now = _time(now)
        back = self._clock - now
        for stream in self._streams:
            stream.advance(now, set_back=back > 0.0)
        if back > 0.0:
            self._begin(now, f"since the clock was set back by {back:.2g} s")
        self._clock = now
        return now

    def _begin_again(self, now: float) -> None:
        """Forget what was estimated before the gap, and not that the fallback was given in it."""
        if not isinstance(self.keep, SafetyFilter) or self.keep.observes:
            self.keep.reset()
            self._asked(self._nothing, self.keep.fallback, now)

    def _while(self, age: float) -> str:
        return self._since if math.isinf(age) else f"for {age:.2g} s"

    def _recorded(
        self, decision: Decision, now: float, lost: str, age: float, state: Array
    ) -> DecisionRecord:
        measured = lost not in BLIND
        kind = f"{lost}/{decision.status.value}"
        if kind == self._said and now - self._said_at < AGAIN:
            why = ""
        elif lost in BLIND:
            why = f"no {lost} {self._while(age)}: the input is the fallback"
        elif decision.status is Status.PASSED:
            why = f"no command {self._while(age)}: the filter's fallback is taken" if lost else ""
        else:
            why = f"no command {self._while(age)}: " if lost else ""
            why += decision.why
        if kind != self._said or why:
            self._said, self._said_at = kind, now
        return DecisionRecord(
            t=now,
            status="no measurement" if not measured else decision.status.value,
            lost=lost,
            state=_named(self.states, state if measured else self._nothing),
            command=_named(self.commands, decision.nominal),
            input=_named(self.commands, decision.input),
            actuators=_named(self.keep.actuator_names, decision.actuators),
            overruled=decision.overruled,
            slack=decision.slack,
            value=decision.value if measured else math.nan,
            gave_way=decision.gave_way,
            why=why,
        )


class _Stream(Generic[Item]):
    """The item with the latest time among those that came, and that time [s]."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Nothing came."""
        self.newest: Item | None = None
        self.at = -math.inf
        self._latest: tuple[float, Item] | None = None
        self._last: tuple[float, Item] | None = None

    def take(self, at: float, item: Item) -> None:
        """An item of the time `at` [s], for the next decision."""
        self._last = (at, item)
        if self._latest is None or at >= self._latest[0]:
            self._latest = self._last

    def advance(self, now: float, *, set_back: bool) -> None:
        """The decision at `now` [s]: what came since the one before is judged by that clock.

        Where the clock was set back, only an item that came since then can be of the new clock,
        and only the last one is taken to be.
        """
        come, last = self._latest, self._last
        if set_back:
            self.forget()
            come = last if last is not None and last[0] <= now else None
        if come is not None and come[0] >= self.at:
            self.at, self.newest = min(come[0], now), come[1]
        self._latest = self._last = None


def _time(now: float) -> float:
    seconds = time_of(now, 0, 0.0) if now is not None else math.nan
    if not math.isfinite(seconds):
        raise SimulationError(f"now is {now!r}"[:80], expected="a number of seconds")
    return seconds


def _named(names: tuple[str, ...], values: Any) -> Mapping[str, float]:
    return dict(zip(names, map(float, values), strict=True))


KEYS = ("t", "state", "command", "disturbance", "obstacles")


LATEST = 1e12
"""A larger time [s] is none."""


class SampleLines:
    """A filter that is told samples line by line.

    A line that is no sample is answered with the fallback of the filter, and `refused` says why;
    nothing of it is believed. The first line has to be a sample: `answer` raises `SimulationError`
    where it is none, because sender and filter then do not agree. obstacle: makes one of a table.
    """

    def __init__(
        self,
        keep: SafetyFilter,
        *,
        patience: float = 0.25,
        obstacle: Callable[[Any], Obstructs] | None = None,
    ) -> None:
        self.keep, self.relay = keep, Relay(keep, patience=patience)
        self._obstacle = obstacle
        self.count, self.refused = 0, ""
        self._t, self._given_t, self._given = -math.inf, 0.0, 0

    def answer(self, line: bytes) -> DecisionRecord:
        """The decision on the next line."""
        before, self._t = self._t, self._usual(self.count)
        self.count += 1
        self.refused = ""
        try:
            said = _table(line)
            t = None if said.get("t") is None else _time_of_line(said["t"], before)
            state, command, felt = self._numbers(said)
            around = self._surroundings(said.get("obstacles"))
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
        if around is not None:
            self.relay.surrounded(around, self._t)
        return self.relay.decide(self._t)

    def _surroundings(self, said: Any) -> list[Obstructs] | None:
        """The obstacles of a line; None where no list came."""
        if said is None:
            return None
        if self.keep.clearing is None or self._obstacle is None:
            raise SimulationError(
                "the filter keeps clear of no obstacles",
                remedy="say how many it is to count with, as [obstacles] most = 20",
            )
        if not isinstance(said, list):
            raise SimulationError(f"the obstacles are {_shown(said)}", expected="a list")
        return [self._obstacle(table) for table in said]

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
        if self.keep.clearing is not None:
            said["obstacles"] = [{"disc": [3.0, 0.0, 0.5], "velocity": [-0.1, 0.0]}]
        return json.dumps(said)

    def _numbers(self, said: Mapping[str, Any]) -> list[list[float] | None]:
        """State, command and disturbance; None for what did not come."""
        felt = self.keep.measured_disturbances
        names = {"state": self.relay.states, "command": self.relay.commands, "disturbance": felt}
        rows = [_by_name(said.get(what), names[what], what) for what in names]
        if felt and rows[0] is not None and rows[2] is None:
            raise SimulationError(f"the disturbance lacks {', '.join(felt)}")
        return rows

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
        check_name(name, KEYS, SimulationError, f"unknown key {_shown(name)}")
    return said


def _time_of_line(t: Any, before: float) -> float:
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
    values = {name: math.nan if v is None else v for name, v in said.items()}
    row: list[float] = numbers(values, names, what).tolist()
    return row


def _shown(said: Any) -> str:
    text = repr(said.decode(errors="replace") if isinstance(said, bytes) else said)
    return text if len(text) < 80 else f"{text[:77]}..."
