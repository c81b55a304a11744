"""What a safety filter answers at a sample, and what it did as a line of JSON.

The lines are for logs, monitors and other processes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
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

    __slots__ = ("_by", "_row", "_rows", "overruled", "seen", "status", "t")

    def __init__(
        self,
        row: Array,
        rows: Rows,
        status: Status,
        overruled: bool,
        t: float,
        seen: Array,
        by: Explains,
    ) -> None:
        row.flags.writeable = False
        self._row, self._rows, self.status, self.overruled = row, rows, status, overruled
        self.t, self.seen, self._by = t, seen, by

    @property
    def input(self) -> Array:
        return self._row[self._rows.command]

    @property
    def actuators(self) -> Array:
        return self._row[self._rows.actuators]

    @property
    def nominal(self) -> Array:
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
    def conditions(self) -> Array:
        """Of every condition sum_i n_i u_i <= b: the n_i and b in turn; then the scales."""
        return self._row[self._rows.conditions]

    def __deepcopy__(self, memo: object) -> Decision:
        """Itself: nothing of it changes, and environments copy what they tell."""
        return self

    def __reduce__(self) -> tuple[object, ...]:
        """What it says, and not the filter."""
        told = Told(self.value, self.why, self.gave_way)
        kept = self._row, self._rows, self.status, self.overruled, self.t, self.seen, told
        return Decision, kept

    def __repr__(self) -> str:
        return f"<Decision at {self.t:g} s: {self.status.value}, input {self.input.tolist()}>"


class Decisions(NamedTuple):
    """The answers for many vehicles at one sample: a row, or an entry, for each of them."""

    input: Array
    actuators: Array
    nominal: Array
    overruled: npt.NDArray[np.bool_]
    slack: Array
    value: Array
    status: tuple[Status, ...]


NO_MEASUREMENT = "no measurement"
STATUSES = (*(s.value for s in Status), NO_MEASUREMENT)


@dataclass(frozen=True)
class DecisionRecord:
    """A decision with all names, which does not need the filter.

    t [s]: of the receiver's clock. status: that of the decision (`Status`), or "no measurement".
    lost: "command" or "measurement" where none came in time, else empty. state, command, input,
    actuators: by name, in the units of the system. overruled, slack, value, gave_way: as in
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
