"""When a filter intervened, and why: intervals of a stream of decisions, and their summary."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

from holdfast.analysis.online.decision import NO_MEASUREMENT, DecisionRecord, Status
from holdfast.errors import SimulationError

GAP = 0.5
"""Seconds: two interventions with at most this between them are one."""

GRAVITY = (
    Status.PASSED.value,
    Status.CHANGED.value,
    Status.INFEASIBLE.value,
    Status.OUTSIDE_GRID.value,
    NO_MEASUREMENT,
    Status.NOT_A_NUMBER.value,
)
"""Statuses, the gravest last."""

_QUOTED = re.compile(r"'([^']+)'")


@dataclass
class Intervention:
    """An interval in which the vehicle was given something else than the command.

    begins, ends [s]: the first sample that was not passed on, and the first that was again, or at
    the end of a stream the last one. status: the gravest. lost: "command",
    "measurement" or both where they did not come. constraints: those that the sentences name, and
    those that gave way. changes: input -> the change of the command that was largest in magnitude.
    value: the least; slack: the largest; NaN and 0 where none is known. why: the first sentence of
    the gravest status. samples: how many were not passed on.
    """

    begins: float
    ends: float = math.nan
    status: str = Status.PASSED.value
    lost: tuple[str, ...] = ()
    constraints: tuple[str, ...] = ()
    changes: dict[str, float] = field(default_factory=dict)
    value: float = math.nan
    slack: float = 0.0
    why: str = ""
    samples: int = 0

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.ends - self.begins

    @property
    def kind(self) -> str:
        """What did not come, and the gravest status."""
        said = [f"no {what}" for what in self.lost]
        if self.status not in (Status.PASSED.value, NO_MEASUREMENT):
            said.append(self.status)
        return ", ".join(said)

    def plain(self) -> dict[str, Any]:
        """For JSON: a number that is not finite is left out."""
        said = asdict(self) | {"duration": self.duration}
        return {k: v for k, v in said.items() if not (isinstance(v, float) and math.isnan(v))}

    def add(self, record: DecisionRecord) -> bool:
        """Take a sample into the interval; whether it is graver than those before."""
        graver = GRAVITY.index(record.status) > GRAVITY.index(self.status)
        known = self.lost
        self.lost = _joined(self.lost, (record.lost,) if record.lost else ())
        self.constraints = _joined(
            self.constraints, (*record.gave_way, *_QUOTED.findall(record.why))
        )
        for name, change in changes_of(record).items():
            if abs(change) > abs(self.changes.get(name, 0.0)):
                self.changes[name] = change
        self.value = min(self.value, record.value, key=_last_if_unknown)
        self.slack = max(self.slack, record.slack) if record.slack > 0 else self.slack
        if graver:
            self.status = record.status
        graver = graver or self.lost != known
        if record.why and (graver or not self.why):
            self.why = record.why
        self.ends = record.t
        self.samples += 1
        return graver


@dataclass(frozen=True)
class Event:
    """What happened to an intervention: it "began", became "graver", or "ended"; t [s]: when."""

    what: str
    t: float
    intervention: Intervention


class Interventions:
    """Decisions in, events out; and the sums over all decisions.

    gap [s]: two interventions with at most this between them are one, where the same is lost in
    both: a stream that ceases or comes back begins another. A time that goes back begins
    a new session, as when the filter is started again.

    Raises `SimulationError` for a gap that is negative or not finite, and `add` for a record
    without a time.
    """

    def __init__(self, gap: float = GAP) -> None:
        if not (math.isfinite(gap) and gap >= 0):
            raise SimulationError(f"the gap is {gap}", expected="seconds, 0 or more")
        self.gap = gap
        self.current: Intervention | None = None
        self.longest: Intervention | None = None
        self.samples = self.count = self.sessions = 0
        self.lost = Counter[str]()
        self.statuses = Counter[str]()
        self.overruled, self.intervened = 0, 0.0
        self.duration, self.silence = 0.0, 0.0
        self.worst, self.worst_at = math.nan, math.nan
        self._t = math.nan
        self._passed, self._lost = True, ""

    def add(self, record: DecisionRecord) -> list[Event]:
        """Take the next decision of the stream."""
        t, events = record.t, []
        if not math.isfinite(t):
            raise SimulationError(f"the time of a decision is {t}", expected="seconds")
        if not t >= self._t:  # also at the first one
            events = self.end()
            self.sessions += 1
        else:
            self.duration += t - self._t
            self.silence = max(self.silence, t - self._t)
            events = self._closed(t)
        if record.intervened and self.current is not None and record.lost != self._lost:
            self.current.ends = t  # what has come back, or ceased, is another one
            events += self.end()
        self._t, self._passed, self._lost = t, not record.intervened, record.lost
        self._count(record)
        if record.intervened:
            if self.current is None:
                self.current, self.count = Intervention(t), self.count + 1
                self.current.add(record)
                events.append(Event("began", t, self.current))
            elif self.current.add(record):
                events.append(Event("graver", t, self.current))
        return events

    def end(self) -> list[Event]:
        """The stream ends, and with it the intervention that goes on."""
        found, self.current = self.current, None
        if found is None:
            return []
        self.intervened += found.duration
        if self.longest is None or found.duration > self.longest.duration:
            self.longest = found
        return [Event("ended", found.ends, found)]

    def _closed(self, t: float) -> list[Event]:
        """What the next sample, at `t`, ends: an input is held until it comes."""
        if self.current is None:
            return []
        if not self._passed:
            self.current.ends = t
        return self.end() if t - self.current.ends > self.gap else []

    def _count(self, record: DecisionRecord) -> None:
        self.samples += 1
        self.statuses[record.status] += 1
        self.overruled += record.overruled
        if record.lost:
            self.lost[record.lost] += 1
        if record.value < self.worst or math.isnan(self.worst):
            self.worst, self.worst_at = record.value, record.t

    def summary(self) -> dict[str, Any]:
        """For JSON: times in seconds, shares of all samples; what is not known is left out."""
        total = max(self.samples, 1)
        said: dict[str, Any] = {
            "samples": self.samples,
            "sessions": self.sessions,
            "duration": self.duration,
            "longest_silence": self.silence,
            "share": {s: self.statuses[s] / total for s in GRAVITY if self.statuses[s]},
            "lost": {what: n / total for what, n in sorted(self.lost.items())},
            "interventions": self.count,
            "intervened": self.intervened,
        }
        if not math.isnan(self.worst):
            said["worst_value"] = {"value": self.worst, "t": self.worst_at}
        if self.longest is not None:
            said["longest_intervention"] = self.longest.plain()
        return said


def changes_of(record: DecisionRecord) -> dict[str, float]:
    """By how much each input differs from the command; without those that are not known."""
    found = {n: v - record.command.get(n, math.nan) for n, v in record.input.items()}
    return {n: v for n, v in found.items() if math.isfinite(v) and v != 0.0}


def _joined(known: tuple[str, ...], more: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*known, *more)))


def _last_if_unknown(value: float) -> float:
    return math.inf if math.isnan(value) else value
