"""Commands of a planar vehicle as MAVLink messages: to the inputs of a system, and back."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.interop.mavlink.frames import Message, dialect
from holdfast.interop.numeric_system import Numeric
from holdfast.maths.definitions.system import System

FULL = 1000
"""An axis of MANUAL_CONTROL at its end."""
AXES = {"x": 1.0, "y": -1.0, "z": 1.0, "r": -1.0}
"""The sign of holdfast's inputs along them: y is to the right, r clockwise."""
SETPOINTS = {"vx": 1.0, "vy": -1.0, "yaw_rate": -1.0}
IGNORED = 1479
"""The type_mask of a setpoint of velocity and yaw rate: position, acceleration, yaw are ignored."""
BODY_FRAMES = (8, 9, 12)
"""MAV_FRAME_BODY_NED, MAV_FRAME_BODY_OFFSET_NED, MAV_FRAME_BODY_FRD."""


class Commands(Protocol):
    """One kind of message that commands the inputs of a system."""

    kind: str
    """The name of the message."""

    def command(self, message: Message) -> dict[str, float] | None:
        """The inputs by name; None for a message of this kind that does not give all of them."""

    def message(self, like: Message, input: Mapping[str, float]) -> Message:
        """A message with these inputs, otherwise like another one."""

    def of(self, input: Mapping[str, float], target: int) -> Message:
        """A message with these inputs, for a system."""

    def target(self, message: Message) -> int:
        """The system that a message is for; 0 is every one."""


class ManualControl:
    """MANUAL_CONTROL: every input is an axis, from -1000 to 1000 in whole numbers.

    axes: input -> axis. A vehicle under water takes surge from x and yaw from r, the default;
    ArduPilot's Rover takes throttle from z and steering from y. full: the input at +1000, by
    default the largest that its bounds allow, negative for y and r, whose positive end is to
    the right. An axis out of its range, or 32767 (none), is no command.

    Raises `SimulationError` for inputs without an axis and other axes, `DefinitionError` for a
    system without a largest input.
    """

    kind = "MANUAL_CONTROL"

    @checked
    def __init__(
        self,
        system: System,
        axes: Mapping[str, str] | None = None,
        *,
        full: Mapping[str, float] | None = None,
    ) -> None:
        self.axes = _fields(system, {"tau_u": "x", "tau_r": "r"} if axes is None else axes, AXES)
        largest = _largest(system)
        scale = {n: AXES[axis] * largest[n] for n, axis in self.axes.items()} | dict(full or {})
        for name, value in scale.items():
            if name not in self.axes or not (math.isfinite(value) and value != 0):
                raise SimulationError(
                    f"full says {name!r}: {value}", expected="inputs, and what they are at +1000"
                )
        self.full = scale

    def command(self, message: Message) -> dict[str, float] | None:
        """The inputs by name; None where an axis is none."""
        read = {name: getattr(message, axis) for name, axis in self.axes.items()}
        if any(abs(value) > FULL for value in read.values()):
            return None
        return {name: value * self.full[name] / FULL for name, value in read.items()}

    def message(self, like: Message, input: Mapping[str, float]) -> Message:
        """A message with these inputs, to the nearest thousandth; buttons and all as in `like`."""
        made = copy.copy(like)
        for name, axis in self.axes.items():
            share = round(FULL * input[name] / self.full[name])
            setattr(made, axis, max(-FULL, min(FULL, share)))
        return made

    def of(self, input: Mapping[str, float], target: int) -> Message:
        """A message with these inputs, other axes and buttons 0."""
        empty = dialect.MAVLink_manual_control_message(target, 0, 0, 0, 0, 0)
        return self.message(empty, input)

    def target(self, message: Message) -> int:
        """The system that a message is for."""
        return int(message.target)


class BodyVelocity:
    """SET_POSITION_TARGET_LOCAL_NED with velocities and a yaw rate in the vehicle's frame.

    For systems whose inputs are velocities. setpoints: input -> vx, vy [m/s] or yaw_rate [rad/s];
    vy is to the right and yaw_rate clockwise, so that both change their sign. A message that says
    more (a position, an acceleration, a yaw), less, or in another frame is no command, and neither
    is one with a vy or vz that is not 0 and is no input.

    Raises `SimulationError` for inputs without a setpoint.
    """

    kind = "SET_POSITION_TARGET_LOCAL_NED"

    @checked
    def __init__(self, system: System, setpoints: Mapping[str, str] | None = None) -> None:
        fields = {"v": "vx", "r": "yaw_rate"} if setpoints is None else setpoints
        self.setpoints = _fields(system, fields, SETPOINTS)
        self._rest = [f for f in ("vx", "vy", "vz") if f not in self.setpoints.values()]

    def command(self, message: Message) -> dict[str, float] | None:
        """The inputs by name; None for a message that sets something else."""
        if message.coordinate_frame not in BODY_FRAMES or message.type_mask & 0xFFF != IGNORED:
            return None
        if any(getattr(message, name) != 0 for name in self._rest):
            return None
        return {n: SETPOINTS[f] * getattr(message, f) for n, f in self.setpoints.items()}

    def message(self, like: Message, input: Mapping[str, float]) -> Message:
        """A message with these inputs, otherwise like another one."""
        made = copy.copy(like)
        for name, field in self.setpoints.items():
            setattr(made, field, SETPOINTS[field] * input[name])
        return made

    def of(self, input: Mapping[str, float], target: int) -> Message:
        """A message with these inputs, in MAV_FRAME_BODY_NED."""
        nothing = [0.0] * 11
        empty = dialect.MAVLink_set_position_target_local_ned_message(
            0, target, 0, BODY_FRAMES[0], IGNORED, *nothing
        )
        return self.message(empty, input)

    def target(self, message: Message) -> int:
        """The system that a message is for."""
        return int(message.target_system)


def commands_of(system: System) -> Commands:
    """The kind of message for the inputs of a system, by their units: forces, or velocities.

    Raises `SimulationError` for inputs of other units, or names that need fields of their own.
    """
    units = {q.unit for q in system.inputs}
    if units <= {"N", "N m"}:
        return ManualControl(system)
    if units <= {"m/s", "rad/s"}:
        return BodyVelocity(system)
    raise SimulationError(
        f"inputs in {', '.join(sorted(units))} stand in no message",
        expected="forces and moments, or velocities",
    )


def _fields(
    system: System, fields: Mapping[str, str], allowed: Mapping[str, Any]
) -> dict[str, str]:
    """The fields of the inputs, in their order, checked."""
    for name, field in fields.items():
        if name not in system.input_names:
            raise SimulationError(
                f"system '{system.name}' has no input '{name}'",
                remedy=suggestion(str(name), system.input_names),
            )
        if field not in allowed:
            raise SimulationError(f"'{name}' is {field!r}", expected=", ".join(allowed))
    if missing := [name for name in system.input_names if name not in fields]:
        raise SimulationError(f"the input '{missing[0]}' has no field of the message")
    if len(set(fields.values())) < len(fields):
        raise SimulationError("two inputs have the same field of the message")
    return {name: fields[name] for name in system.input_names}


def _largest(system: System) -> dict[str, float]:
    """The largest absolute value of every input over its bounds."""
    numeric = Numeric(system)
    low, high = numeric.limits()
    corners = itertools.product(*zip(low, high, strict=True))
    largest = np.abs([numeric.inputs(np.array(corner)) for corner in corners]).max(axis=0)
    return dict(zip(system.input_names, largest.tolist(), strict=True))
