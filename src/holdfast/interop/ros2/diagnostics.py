"""What a filter does, as diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from holdfast.analysis.online.decision import DecisionRecord, Status
from holdfast.interop.ros2.node import Node, Subscription
from holdfast.interop.ros_messages import header, made

OK, WARN, ERROR, STALE = range(4)
"""The levels of diagnostic_msgs/DiagnosticStatus."""
EVERY = 0.5
"""Seconds between two messages on what does not change."""

_LEVELS = {Status.PASSED.value: OK, Status.CHANGED.value: WARN}


class Diagnostics:
    """Publishes on `/diagnostics` at every change of a status, and every `EVERY` seconds.

    The level is OK where the command is passed, WARN where it is changed or lost or a message was
    refused since, ERROR where nothing is promised, STALE when the node is closed.
    """

    def __init__(self, node: Node, hardware: str, topics: Mapping[str, Subscription]) -> None:
        self._name, self._hardware, self._topics = node.name.name, hardware, topics
        self._publisher = node.publisher("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        self._said, self._due, self._refused, self._why = "", 0.0, 0, ""

    def tell(self, record: DecisionRecord, now: float, stamp: int, skipped: int) -> None:
        """A decision, at `now` [s]; stamp in ns since 1970."""
        kind = f"{record.lost}/{record.status}"
        self._why = record.why or (self._why if kind == self._said else "")
        if kind == self._said and now < self._due:
            return
        self._said, self._due = kind, now + EVERY
        refused = sum(t.refused for t in self._topics.values())
        level = max(_LEVELS.get(record.status, ERROR), WARN if record.lost else OK)
        if refused > self._refused:
            level, self._refused = max(level, WARN), refused
        values: dict[str, Any] = {
            "status": record.status,
            "lost": record.lost,
            "value": record.value,
            "slack": record.slack,
            "why": self._why,
            "gave way": ", ".join(record.gave_way),
            **{f"command {n}": v for n, v in record.command.items()},
            **{f"input {n}": v for n, v in record.input.items()},
            "samples skipped": skipped,
        }
        for name, topic in self._topics.items():
            values[f"{name} received"] = topic.received
            values[f"{name} refused"] = topic.refused
            values[f"{name} refused because"] = topic.why
        self._send(level, self._why or record.status, values, stamp)

    def farewell(self, stamp: int) -> None:
        """That the node is closed."""
        self._send(STALE, "closed; the last command was the fallback", {}, stamp, last=True)

    def _send(
        self, level: int, said: str, values: Mapping[str, Any], stamp: int, *, last: bool = False
    ) -> None:
        status = made(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level,
            name=f"{self._name}: decisions",
            message=said,
            hardware_id=self._hardware,
            values=[
                made("diagnostic_msgs/msg/KeyValue", key=key, value=_text(value))
                for key, value in values.items()
            ],
        )
        report = made(
            "diagnostic_msgs/msg/DiagnosticArray", header=header(stamp, ""), status=[status]
        )
        self._publisher.send(report, last=last)


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
