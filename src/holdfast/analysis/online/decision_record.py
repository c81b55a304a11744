"""What a filter did at a sample, as a line of JSON: for logs, monitors and other processes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from holdfast.analysis.online.decision import Status
from holdfast.errors import SimulationError

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
