"""A log of messages: MCAP files and ROS 2 bags, their fields as columns TOPIC:FIELD."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from holdfast.errors import HoldfastError, SimulationError
from holdfast.execution.arrays import Wholes
from holdfast.interop.logs.table import Column, Recording, with_unit
from holdfast.interop.ros_messages import ODOMETRY, Interface, heading_of
from holdfast.maths.definitions.system import System

HEADING = "heading"
"""The last part of a field: the angle about z of the quaternion before it."""

NANO = 1e-9
_DEEPEST, _WIDEST = 8, 16

LARGEST = 1 << 16
"""Bytes of a message; larger ones are images and clouds of points, and are left out."""

APART = 1.0
"""Seconds between the clock of headers and that of the log that no delay explains."""

_LAST = (1 << 63) - 1
Read = tuple[int, Any]
"""The log's time [ns] and a message."""


class Messages(Recording):
    """The topics of an MCAP file or of a ROS 2 bag (a folder).

    Messages are those of ROS 2 (CDR) or JSON objects. Their time is that of their header, where
    they have one that is not 0, else that of the log. Where all headers have another clock than
    the log, as in a simulation, the clock is that of the topic with the most of them, and times of
    the log are brought to it by the pairs of times that this topic has. Raises
    `SimulationError` for a file that is none, or without a message that can be read.
    """

    def __init__(self, path: Path, system: System) -> None:
        self.name = path.name
        self._system = system
        self._topics, skipped = _topics(path)
        if not self._topics:
            what = f": {', '.join(skipped)}" if skipped else ""
            raise SimulationError(f"{path} has no message that can be read{what}"[:300])
        self._fields: dict[str, tuple[str, ...]] = {}
        self._clock = self._other_clock()
        self._origin = min(when for _, rows in self._topics.values() for when, _ in rows)
        if self._clock:
            self._origin = int(self._clock[2].min())
        self._usual = self._defaults()
        self.notes = tuple(f"topic {t} cannot be read" for t in skipped)

    def columns(self) -> tuple[str, ...]:
        return tuple(
            f"{topic}:{field}"
            for topic, (_, rows) in self._topics.items()
            for field in _numeric(rows[0][1])
        )

    def usual(self, wanted: str) -> str:
        return self._usual.get(wanted, "")

    def column(self, name: str) -> Column:
        bare, unit = with_unit(name)
        topic, _, field = bare.rpartition(":")
        if topic not in self._topics or not field:
            raise self.unknown(name)
        _, rows = self._topics[topic]
        value = np.array([_value(message, field) for _, message in rows], dtype=np.float64)
        if np.isnan(value).all():
            raise self.unknown(name)
        time, note = self._times(rows)
        return Column((time - self._origin).astype(np.float64) * NANO, value, unit, note)

    def _times(self, rows: list[Read]) -> tuple[Wholes, tuple[str, ...]]:
        """The times of messages [ns] and what was assumed of them."""
        when = np.array([t for t, _ in rows], dtype=np.int64)
        stamps = np.array([_stamp(message) for _, message in rows], dtype=np.int64)
        if self._clock is None:
            if stamps.all() and _apart(stamps, when) < APART:
                return stamps, ()
            return when, ("times are those of the log, not of a header",)
        topic, log, clock = self._clock
        off = (clock - log).astype(np.float64)
        moved = when + np.interp(when, log, off).astype(np.int64)
        if stamps.all() and _apart(stamps, moved) < APART:
            return stamps, ()
        return moved, (f"times are those of the log, brought to the clock of {topic}",)

    def _other_clock(self) -> tuple[str, Wholes, Wholes] | None:
        """The topic with the most headers of another clock than the log's, and its two times.

        None if the headers of a topic have the clock of the log: another topic is then the odd one.
        """
        longest: tuple[str, Wholes, Wholes] | None = None
        for topic, (_, rows) in self._topics.items():
            stamps = np.array([_stamp(message) for _, message in rows], dtype=np.int64)
            when = np.array([t for t, _ in rows], dtype=np.int64)
            if not stamps.all():
                continue
            if _apart(stamps, when) < APART:
                return None
            if np.ptp(stamps) > 0 and (longest is None or len(longest[1]) < len(when)):
                order = np.argsort(when, kind="stable")
                longest = topic, when[order], stamps[order]
        return longest

    def _defaults(self) -> dict[str, str]:
        """Where states and inputs are, if one topic alone has a message for them."""
        places: dict[str, str] = {}
        for name in (*self._system.state_names, *self._system.input_names):
            at = [t for t, (_, rows) in self._topics.items() if _flat(rows[0][1], name)]
            if len(at) == 1:
                places[name] = f"{at[0]}:{name}"
        try:
            interface = Interface(self._system, frame="")
        except HoldfastError:
            return places
        poses = self._of_kind(ODOMETRY)
        if len(poses) == 1:
            fields = (
                "pose.pose.position.x", "pose.pose.position.y", f"pose.pose.orientation.{HEADING}",
                "twist.twist.linear.x", "twist.twist.linear.y", "twist.twist.angular.z",
            )  # fmt: skip
            for state, field in zip((*interface.pose, *interface.twist), fields, strict=True):
                if state is not None:
                    places.setdefault(state, f"{poses[0]}:{field}")
        plain = f"geometry_msgs/msg/{interface.base}"
        commands = [*self._of_kind(plain), *self._of_kind(f"{plain}Stamped")]
        if len(commands) == 1:
            stamped = self._topics[commands[0]][0].endswith("Stamped")
            inside = f"{interface.base.lower()}." if stamped else ""
            for name, field in interface.fields.items():
                places.setdefault(name, f"{commands[0]}:{inside}{field}")
        return places

    def _of_kind(self, kind: str) -> list[str]:
        return [topic for topic, (its, _) in self._topics.items() if its == kind]


def _topics(path: Path) -> tuple[dict[str, tuple[str, list[Read]]], list[str]]:
    """topic -> (type, messages), and the topics that cannot be read."""
    topics: dict[str, tuple[str, list[Read]]] = {}
    skipped: set[str] = set()
    try:
        for topic, kind, when, message in _bag(path) if path.is_dir() else _mcap(path):
            if message is None:
                skipped.add(topic)
            else:
                topics.setdefault(topic, (kind, []))[1].append((min(when, _LAST), message))
    except HoldfastError:
        raise
    except Exception as error:
        # whatever a damaged file makes the libraries do
        raise SimulationError(
            f"{path} cannot be read ({type(error).__name__}: {error})"[:200],
            expected="an MCAP file, or the folder of a ROS 2 bag",
        ) from None
    return topics, sorted(skipped - set(topics))


def _bag(path: Path) -> Iterator[tuple[str, str, int, Any]]:
    """The messages of a bag; those of unknown types are None."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, when, raw in reader.messages():
            message = None
            if len(raw) <= LARGEST:
                with suppress(Exception):  # whatever the bytes make the generated reader do
                    message = reader.deserialize(raw, connection.msgtype)
            yield connection.topic, connection.msgtype, when, message


def _mcap(path: Path) -> Iterator[tuple[str, str, int, Any]]:
    """The messages of an MCAP file; those that are neither CDR nor JSON are None."""
    readers: dict[int, Callable[[bytes], Any] | None] = {}
    with open(path, "rb") as file:
        try:
            for schema, channel, message in make_reader(file).iter_messages():
                if channel.id not in readers:
                    readers[channel.id] = None
                    with suppress(Exception):  # a definition that is none
                        readers[channel.id] = _reader_of(schema, channel)
                read, content = readers[channel.id], None
                kind = schema.name if schema else ""
                if read is not None and len(message.data) <= LARGEST:
                    with suppress(Exception):  # whatever the bytes make the reader do
                        content = read(message.data)
                yield channel.topic, kind, message.log_time, content
        except McapError as error:
            raise SimulationError(
                f"{path} is not an MCAP file, or is damaged ({error})"[:200],
                remedy="`mcap recover` makes a file whole whose writer was killed",
            ) from None


def _reader_of(schema: Any, channel: Any) -> Callable[[bytes], Any] | None:
    if channel.message_encoding == "json":
        return lambda data: json.loads(data)
    if channel.message_encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
        return None
    store = get_typestore(Stores.ROS2_JAZZY)
    if schema.name not in store.types:
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
    return lambda data: store.deserialize_cdr(data, schema.name)


def _part(message: Any, key: str) -> Any:
    """A field of a message, an entry of an object, or an element of a list."""
    if key == HEADING and all(hasattr(message, n) for n in "xyzw"):
        return heading_of(message)
    if isinstance(message, dict):
        return message.get(key)
    if key.isdecimal():
        return message[int(key)] if int(key) < len(message) else None
    return getattr(message, key, None)


def _value(message: Any, field: str) -> float:
    """The number of a field; NaN if there is none."""
    try:
        for key in field.split("."):
            message = _part(message, key)
        return float(message) if message is not None else np.nan
    except (TypeError, ValueError, AttributeError, ArithmeticError, LookupError):
        return np.nan


def _flat(message: Any, name: str) -> bool:
    """Whether a JSON object has a number of that name."""
    return isinstance(message, dict) and not np.isnan(_value(message, name))


def _stamp(message: Any) -> int:
    """The time of the header [ns since 1970], 0 if there is none."""
    with suppress(TypeError, ValueError, ArithmeticError, LookupError, AttributeError):
        stamp = _part(_part(message, "header"), "stamp")
        seconds = int(_part(stamp, "sec") or 0)
        rest = int(_part(stamp, "nanosec") or _part(stamp, "nsec") or 0)
        nanoseconds = seconds * 1_000_000_000 + rest
        return nanoseconds if 0 < nanoseconds <= _LAST else 0
    return 0


def _apart(stamps: Wholes, when: Wholes) -> float:
    """Seconds between two clocks, the usual."""
    return abs(float(np.median((stamps - when).astype(np.float64)))) * NANO


def _numeric(message: Any, prefix: str = "", depth: int = 0) -> Iterator[str]:
    """The fields of a message that are numbers."""
    if isinstance(message, bool | str | bytes) or depth > _DEEPEST:
        return
    if isinstance(message, int | float | np.integer | np.floating):
        yield prefix
        return
    dot = f"{prefix}." if prefix else ""
    parts: Iterable[tuple[str, Any]]
    if isinstance(message, dict):
        parts = message.items()
    elif hasattr(message, "__msgtype__"):
        if all(hasattr(message, n) for n in "xyzw"):
            yield f"{dot}{HEADING}"
        parts = ((n, getattr(message, n)) for n in message.__dataclass_fields__ if n[0] != "_")
    elif isinstance(message, list | tuple | np.ndarray):
        parts = ((str(k), m) for k, m in enumerate(message[:_WIDEST]))
    else:
        return
    for key, part in parts:
        yield from _numeric(part, f"{dot}{key}", depth + 1)
