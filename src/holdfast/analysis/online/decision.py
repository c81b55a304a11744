"""What a safety filter answers at a sample, what it did as a line of JSON, and when it intervened.

The lines are for logs, monitors and other processes. Interventions are intervals of a stream of
decisions, with the reason of each, and their summary.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from enum import Enum
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.simulation.control_sample import Rows


class Status(Enum):
    """What a safety filter did with a command."""

    PASSED = "passed"
    """The command meets all conditions and is given back unchanged."""
    CHANGED = "changed"
    """The input is the admissible one nearest to the command."""
    INFEASIBLE = "infeasible"
    """No input meets all conditions; the input misses them by the least amount, `slack`."""
    OUTSIDE_GRID = "outside the grid"
    """The state is outside the grid of the kernel or in no certified cell, or the time of the
    kernel has run out: nothing is promised."""
    NOT_A_NUMBER = "not a number"
    """A measurement, the command or a condition at the state is NaN or infinite; the input is the
    filter's `fallback`."""


class Explains(Protocol):
    """Whoever knows more of a decision: the filter that made it."""

    def value_at(self, decision: Decision) -> float: ...

    def reason(self, decision: Decision) -> str: ...

    def gave_way(self, decision: Decision) -> tuple[str, ...]: ...


class Told(NamedTuple):
    """What was said of a decision, without the filter that made it."""

    value: float
    why: str
    names: tuple[str, ...]

    def value_at(self, decision: Decision) -> float:
        return self.value

    def reason(self, decision: Decision) -> str:
        return self.why

    def gave_way(self, decision: Decision) -> tuple[str, ...]:
        return self.names


class Obstructs(Protocol):
    """An obstacle: its name, and its `count` bodies as records of `execution/obstacle_pairs.py`.

    state: of another vehicle its place, its heading and its further states; else empty. radius [m]:
    of its first body.
    """

    @property
    def name(self) -> str: ...

    @property
    def records(self) -> bytes: ...

    @property
    def count(self) -> int: ...

    @property
    def velocity(self) -> tuple[float, float]: ...

    @property
    def state(self) -> tuple[float, ...]: ...

    @property
    def radius(self) -> float: ...

    @property
    def age(self) -> float: ...

    def aged(self, seconds: float) -> Obstructs:
        """The same, known so much later [s]."""


class Near(NamedTuple):
    """What was near at a sample: of every pair the gap [m] and the number of the body, in turn.

    found: how many pairs there were, of which the nearest have places; -1 - k for a body k that is
    not finite or cannot be. obstacles: or discs without names, as of `disc_records`. evaded [m/s]:
    the speed of obstacles that turning evades. unkept: the vehicles of which the kernel is not
    kept.
    """

    gaps: Array
    found: int
    obstacles: tuple[Obstructs, ...] | Array
    evaded: float
    unkept: tuple[int, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """A name for every body."""
        if isinstance(self.obstacles, np.ndarray):
            return tuple(f"obstacle {k}" for k in range(1, len(self.obstacles) + 1))
        named = enumerate(self.obstacles, 1)
        return tuple(o.name or f"obstacle {k}" for k, o in named for _ in range(o.count))

    @property
    def impossible(self) -> bool:
        """Whether the faulty body is a disc of finite numbers, which `hf.Obstacle` would refuse."""
        discs = self.obstacles
        if not isinstance(discs, np.ndarray) or self.found >= 0:
            return False
        return bool(np.isfinite(discs[-1 - self.found]).all())

    def of(self, pair: int) -> str:
        """The name of the obstacle of a pair."""
        return self.names[int(self.gaps[2 * pair + 1])]

    @property
    def clearances(self) -> dict[str, float]:
        """Obstacle -> its gap [m], for those that have a place."""
        nearest: dict[str, float] = {}
        names = self.names
        for gap, number in self.gaps.reshape(-1, 2).tolist():
            if number >= 0:
                name = names[int(number)]
                nearest[name] = min(gap, nearest.get(name, math.inf))
        return nearest

    @property
    def too_fast(self) -> tuple[str, ...]:
        """The obstacles that are faster than turning evades."""
        if isinstance(self.obstacles, np.ndarray):
            speeds = np.linalg.norm(self.obstacles[:, 3:5], axis=1).tolist()
        else:
            speeds = [math.hypot(*o.velocity) for o in self.obstacles for _ in range(o.count)]
        pairs = zip(self.names, speeds, strict=True)
        return tuple(dict.fromkeys(n for n, speed in pairs if speed > self.evaded))

    @property
    def left_out(self) -> tuple[str, ...]:
        """The obstacles that have no place, since others are nearer."""
        if self.found < 0:
            return ()
        places = {int(number) for number in self.gaps[1::2]}
        with_place = {name for k, name in enumerate(self.names) if k in places}
        return tuple(n for n in dict.fromkeys(self.names) if n not in with_place)


class Decision:
    """The answer of a safety filter at one sample.

    input: what to apply, in the order and units of the system's inputs. actuators: the limited
    values of its actuators for it. nominal: the command as the filter took it. overruled: whether a
    condition changed it; the bounds of the inputs alone may change it too. slack: by how much the
    conditions are missed, 0 where an input is admissible. value: V at the state of a kernel; of a
    region -max_j c_j, positive inside, and NaN where an observer estimates states; of a certificate
    for how long it keeps the state [s]. status: see
    `Status`. why: one sentence, made when it is read.
    """

    __slots__ = ("_by", "_row", "_rows", "near", "overruled", "seen", "status", "t")

    def __init__(
        self,
        row: Array,
        rows: Rows,
        status: Status,
        overruled: bool,
        t: float,
        seen: Array,
        by: Explains,
        near: Near | None = None,
    ) -> None:
        """row: the numbers of a decision one after the other, shape (numbers,), where `rows` says.
        seen: what was measured, shape (measured,)."""
        row.flags.writeable = False
        self._row, self._rows, self.status, self.overruled = row, rows, status, overruled
        self.t, self.seen, self._by, self.near = t, seen, by, near

    @property
    def input(self) -> Array:
        """The input, shape (inputs,)."""
        return self._row[self._rows.command]

    @property
    def actuators(self) -> Array:
        """What the actuators are to give, shape (actuators,)."""
        return self._row[self._rows.actuators]

    @property
    def nominal(self) -> Array:
        """What the other controller commands, shape (inputs,)."""
        return self._row[self._rows.nominal]

    @property
    def slack(self) -> float:
        return float(self._row[self._rows.slack])

    @property
    def looked_up(self) -> float:
        """V at the state, where the filter is of a kernel."""
        return float(self._row[self._rows.value])

    @property
    def value(self) -> float:
        return self._by.value_at(self)

    @property
    def why(self) -> str:
        return self._by.reason(self)

    @property
    def gave_way(self) -> tuple[str, ...]:
        """The inequalities whose conditions the input misses; "value" is the kernel's."""
        return self._by.gave_way(self) if self.status is Status.INFEASIBLE else ()

    @property
    def clearances(self) -> Mapping[str, float]:
        """Obstacle -> how far it is away, beside radii and clearance [m]; below 0 inside."""
        return self.near.clearances if self.near else {}

    @property
    def too_fast(self) -> tuple[str, ...]:
        """Obstacles that come faster than turning moves the hull aside: braking is left."""
        return self.near.too_fast if self.near else ()

    @property
    def left_out(self) -> tuple[str, ...]:
        """Obstacles that the filter did not count with, since so many others are nearer."""
        return self.near.left_out if self.near else ()

    @property
    def conditions(self) -> Array:
        """Of every condition sum_i n_i u_i <= b: the n_i and b in turn; then the scales. The shape
        is (conditions * (inputs + 1) + inputs,): one row for all, as the program leaves it."""
        return self._row[self._rows.conditions]

    def __deepcopy__(self, memo: object) -> Decision:
        """Itself: nothing of it changes, and environments copy what they tell."""
        return self

    def __eq__(self, other: object) -> bool:
        """Whether both say the same of the same; NaN is equal to itself."""
        if not isinstance(other, Decision):
            return NotImplemented
        arrays = (self._row, other._row), (self.seen, other.seen), (self.t, other.t)
        same = all(np.array_equal(a, b, equal_nan=True) for a, b in arrays)
        facts = self.status, self.overruled, self._rows
        return same and facts == (other.status, other.overruled, other._rows)

    def __hash__(self) -> int:
        return hash((None if math.isnan(self.t) else self.t, self.status, self.overruled))

    def __reduce__(self) -> tuple[object, ...]:
        """What it says, and not the filter."""
        stand_in = Told(self.value, self.why, self.gave_way)
        fields = self._row, self._rows, self.status, self.overruled, self.t, self.seen, stand_in
        return Decision, (*fields, self.near)

    def __repr__(self) -> str:
        return f"<Decision at {self.t:g} s: {self.status.value}, input {self.input.tolist()}>"


class Decisions(NamedTuple):
    """The answers for many vehicles at one sample: a row, or an entry, for each of them."""

    input: Array
    actuators: Array
    nominal: Array
    overruled: Truths
    slack: Array
    value: Array
    status: tuple[Status, ...]


NO_MEASUREMENT = "no measurement"
STATUSES = (*(s.value for s in Status), NO_MEASUREMENT)


@dataclass(frozen=True)
class DecisionRecord:
    """A decision with all names, which does not need the filter.

    t [s]: of the receiver's clock. status: that of the decision (`Status`), or "no measurement".
    lost: "command", "measurement" or "list of obstacles" where none came in time, else empty.
    state, command, input, actuators: by name, in the units of the system. overruled, slack, value,
    gave_way: as in
    `Decision`. why: one sentence where the filter intervened, not at every sample of one
    intervention; else empty.
    """

    t: float
    status: str
    lost: str
    state: Mapping[str, float]
    command: Mapping[str, float]
    input: Mapping[str, float]
    actuators: Mapping[str, float]
    overruled: bool
    slack: float
    value: float
    gave_way: tuple[str, ...]
    why: str

    @property
    def intervened(self) -> bool:
        """Whether the vehicle was given something else than the command, or nothing is promised."""
        return bool(self.lost) or self.status != Status.PASSED.value

    def line(self) -> str:
        """One line of JSON, without its end; NaN and infinities are null."""
        return json.dumps({f.name: _plain(getattr(self, f.name)) for f in fields(self)})

    @staticmethod
    def read(line: str | bytes) -> DecisionRecord:
        """The record of a line. Raises `SimulationError` for a line that is none."""
        try:
            said = json.loads(line)
            if not isinstance(said, dict) or said["status"] not in STATUSES:
                raise ValueError
            return DecisionRecord(
                t=_number(said["t"]),
                status=said["status"],
                lost=_text(said["lost"]),
                overruled=bool(said["overruled"]),
                slack=_number(said["slack"]),
                value=_number(said["value"]),
                gave_way=tuple(map(_text, said["gave_way"])),
                why=_text(said["why"]),
                **{n: _numbers(said[n]) for n in ("state", "command", "input", "actuators")},
            )
        except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError, RecursionError):
            shown = line.decode(errors="replace") if isinstance(line, bytes) else line
            shown = shown.strip()
            shown = shown if len(shown) < 80 else f"{shown[:77]}..."
            raise SimulationError(
                f"{shown!r} is no decision", expected="a line that DecisionRecord.line wrote"
            ) from None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _numbers(said: Mapping[str, Any]) -> dict[str, float]:
    return {_text(name): _number(value) for name, value in said.items()}


def _number(said: Any) -> float:
    if isinstance(said, bool) or not isinstance(said, int | float | None):
        raise TypeError
    return math.nan if said is None else float(said)


def _text(said: Any) -> str:
    if not isinstance(said, str):
        raise TypeError
    return said


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
        before = self.lost
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
        graver = graver or self.lost != before
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
        ended, self.current = self.current, None
        if ended is None:
            return []
        self.intervened += ended.duration
        if self.longest is None or ended.duration > self.longest.duration:
            self.longest = ended
        return [Event("ended", ended.ends, ended)]

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
    changes = {n: v - record.command.get(n, math.nan) for n, v in record.input.items()}
    return {n: v for n, v in changes.items() if math.isfinite(v) and v != 0.0}


def _joined(names: tuple[str, ...], more: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*names, *more)))


def _last_if_unknown(value: float) -> float:
    return math.inf if math.isnan(value) else value
