"""Decisions of a filter as MCAP, for Foxglove and everything else that reads it.

    /holdfast/decision       every decision, as the object of `DecisionRecord.line`
    /holdfast/intervention   every intervention, when it has ended
    /holdfast/log            foxglove.Log: the sentences

The encoding is JSON, with a JSON schema. A number that is not known is left out. The time of a
message is that of the decision, in nanoseconds of the clock of its receiver.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import Writer

from holdfast.analysis.online.decision import GRAVITY, DecisionRecord, Event, Status
from holdfast.errors import OutputError

NANO = 1_000_000_000
CHUNK = 1 << 16
"""Bytes of the newest messages that a process which is killed loses: about 100 decisions."""
INFO, WARNING, ERROR = 2, 3, 4
"""Levels of foxglove.Log."""


def _object(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


NUMBER, TEXT, FLAG = {"type": "number"}, {"type": "string"}, {"type": "boolean"}
TEXTS = {"type": "array", "items": TEXT}
WHOLE = {"type": "integer", "minimum": 0}
DECISION = {
    "t": NUMBER, "status": TEXT, "lost": TEXT, "overruled": FLAG, "slack": NUMBER, "value": NUMBER,
    "gave_way": TEXTS, "why": TEXT,
}  # fmt: skip
INTERVENTION = {
    "begins": NUMBER, "ends": NUMBER, "duration": NUMBER, "status": TEXT, "lost": TEXTS,
    "constraints": TEXTS, "changes": {"type": "object", "additionalProperties": NUMBER},
    "value": NUMBER, "slack": NUMBER, "why": TEXT, "samples": WHOLE,
}  # fmt: skip
LOG = {
    "timestamp": _object({"sec": WHOLE, "nsec": WHOLE}), "level": WHOLE, "message": TEXT,
    "name": TEXT, "file": TEXT, "line": WHOLE,
}  # fmt: skip


class DecisionLog:
    """A file of decisions that grows; a context manager, because its index is written at the end.

    Of a process that is killed the file lacks the index and the last `CHUNK` bytes. What is there
    is read by `mcap.stream_reader.StreamReader`, and made whole by `mcap recover`.

    Raises `OutputError` for a file that exists or cannot be written, and for times that MCAP has
    not: below 0, or after the year 2554.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self._file = open(self.path, "xb")  # noqa: SIM115
        except FileExistsError:
            raise OutputError(f"{path} exists already", remedy="choose another file") from None
        except OSError as error:
            raise self._refusal(error) from None
        self._writer = Writer(self._file, chunk_size=CHUNK)
        self._writer.start(profile="", library="holdfast")
        self._channels: dict[str, int] = {}

    def __enter__(self) -> DecisionLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with self._file:
                self._writer.finish()  # type: ignore[no-untyped-call]
        except OSError as error:
            if problem is None:
                raise self._refusal(error) from None

    def decided(self, record: DecisionRecord) -> None:
        """Write a decision."""
        if "decision" not in self._channels:
            named = {
                n: _object(dict.fromkeys(getattr(record, n), NUMBER))
                for n in ("state", "command", "input", "actuators")
            }
            self._begin("decision", "holdfast.Decision", DECISION | named)
        self._write("decision", record.t, _known(asdict(record)))

    def happened(self, event: Event, sentence: str) -> None:
        """Write a sentence on an intervention; one that has ended too, at the time of its end."""
        over = event.what == "ended"
        gravity = GRAVITY.index(event.intervention.status)
        worse = gravity > GRAVITY.index(Status.CHANGED.value) or event.intervention.lost
        self.say(event.t, sentence, INFO if over else ERROR if worse else WARNING)
        if over:
            if "intervention" not in self._channels:
                self._begin("intervention", "holdfast.Intervention", INTERVENTION)
            self._write("intervention", event.t, _known(event.intervention.plain()))

    def say(self, t: float, sentence: str, level: int) -> None:
        """Write a sentence."""
        if "log" not in self._channels:
            self._begin("log", "foxglove.Log", LOG)
        stamp = self._nanoseconds(t)
        said = {
            "timestamp": {"sec": stamp // NANO, "nsec": stamp % NANO}, "level": level,
            "message": sentence, "name": "holdfast", "file": "", "line": 0,
        }  # fmt: skip
        self._write("log", t, said)

    def _begin(self, topic: str, name: str, properties: Mapping[str, Any]) -> None:
        text = json.dumps({"title": name, **_object(properties)}).encode()
        schema = self._writer.register_schema(name, "jsonschema", text)
        self._channels[topic] = self._writer.register_channel(f"/holdfast/{topic}", "json", schema)

    def _write(self, topic: str, t: float, said: Mapping[str, Any]) -> None:
        stamp, data = self._nanoseconds(t), json.dumps(said).encode()
        try:
            self._writer.add_message(self._channels[topic], stamp, data, stamp)
            self._file.flush()  # a chunk that is complete is in the file
        except OSError as error:
            raise self._refusal(error) from None

    def _nanoseconds(self, t: float) -> int:
        stamp = round(t * NANO) if math.isfinite(t) else -1
        if not 0 <= stamp < 1 << 64:
            raise OutputError(f"MCAP has no time of {t:g} s", expected="0 to 18,446,744,073 s")
        return stamp

    def _refusal(self, error: OSError) -> OutputError:
        return OutputError(f"{self.path} cannot be written ({error.strerror})")


def _known(said: Any) -> Any:
    """The same without numbers that are not finite."""
    if isinstance(said, Mapping):
        finite = {k: v for k, v in said.items() if not isinstance(v, float) or math.isfinite(v)}
        return {k: _known(v) for k, v in finite.items()}
    return list(said) if isinstance(said, tuple) else said
