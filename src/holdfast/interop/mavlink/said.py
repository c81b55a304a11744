"""What a component says of itself: heartbeats, texts of interventions, values."""

from __future__ import annotations

import math
from collections.abc import Iterator

from holdfast.analysis.online.decision import DecisionRecord, Status
from holdfast.interop.mavlink.frames import Message, dialect

CHUNK = 50
"""The length of a STATUSTEXT [bytes]; a longer text has several."""
TEXTS, VALUES = 1.0, 0.2
"""The least time between two texts of one severity, and between two values [s]."""
SEVERITY = {
    Status.CHANGED.value: dialect.MAV_SEVERITY_WARNING,
    Status.PASSED.value: dialect.MAV_SEVERITY_INFO,
}
"""Of the statuses; all others promise nothing, and are errors."""


class Said:
    """STATUSTEXT and NAMED_VALUE_FLOAT of decisions, as often as a radio bears."""

    def __init__(self) -> None:
        self._texts: dict[int, float] = {}
        self._valued = -math.inf
        self._number = 0
        self._kind = ""
        self._began = math.nan

    def of(self, record: DecisionRecord, now: float) -> Iterator[Message]:
        """What is said of a decision at `now` [s]."""
        if math.isnan(self._began):
            self._began = now
        kind = f"{record.lost}/{record.status}" if record.intervened else ""
        if record.why and record.intervened:
            severity = SEVERITY.get(record.status, dialect.MAV_SEVERITY_ERROR)
            if record.lost:
                severity = dialect.MAV_SEVERITY_ERROR
            yield from self._text(f"holdfast: {record.why}", severity, now)
        elif self._kind and not kind:
            yield from self._text("holdfast: the command passes", dialect.MAV_SEVERITY_INFO, now)
        self._kind = kind
        if now - self._valued >= VALUES:
            self._valued = now
            boot = round(1000 * (now - self._began)) & 0xFFFFFFFF
            for name, value in ((b"hf_value", record.value), (b"hf_slack", record.slack)):
                yield dialect.MAVLink_named_value_float_message(boot, name, value)

    def warning(self, text: str, now: float) -> Iterator[Message]:
        """A text that is no decision's."""
        yield from self._text(f"holdfast: {text}", dialect.MAV_SEVERITY_NOTICE, now)

    def _text(self, text: str, severity: int, now: float) -> Iterator[Message]:
        if now - self._texts.get(severity, -math.inf) < TEXTS:
            return
        self._texts[severity] = now
        data = text.encode("ascii", errors="replace")
        parts = [data[at : at + CHUNK] for at in range(0, len(data), CHUNK)]
        self._number = self._number % 0xFFFF + 1
        number = self._number if len(parts) > 1 else 0
        if len(parts[-1]) == CHUNK and number:
            parts.append(b"")  # the end is a chunk that is not full
        for place, part in enumerate(parts):
            yield dialect.MAVLink_statustext_message(severity, part, number, place)


def heartbeat() -> Message:
    """HEARTBEAT of an onboard computer."""
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_ONBOARD_CONTROLLER,
        dialect.MAV_AUTOPILOT_INVALID,
        0,
        0,
        dialect.MAV_STATE_ACTIVE,
        3,
    )
