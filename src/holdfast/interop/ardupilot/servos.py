"""Servo outputs [us] to actuators: which channel drives what, and how far."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.analysis.online.controller import Given, numbers
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.interop.numeric_system import Numeric
from holdfast.maths.definitions.system import System

SKID = {"port": 1, "starboard": 3}
"""Actuators -> channels of ArduPilot's skid-steered Rover: throttle left and throttle right."""
MOST = 32
NEUTRAL = 1500


@dataclass(frozen=True)
class Servo:
    """A channel and what its pulse means: linear from the shortest to the neutral to the longest.

    channel: from 1, that of SERVO1_FUNCTION. pulse [us]: shortest, neutral, longest. at: the
    actuator's values there, by default its least value, 0 and its largest. Longer and shorter
    pulses count as the ends, and no pulse (0) as the neutral one. A thruster that runs astern with
    long pulses, or a turn rate (counter-clockwise) of a steering channel (right), has its values
    exchanged: at=(1.5, 0, -1.5).
    """

    channel: int
    pulse: tuple[int, int, int] = (1000, 1500, 2000)
    at: tuple[float, float, float] | None = None

    def value(self, us: int) -> float:
        """The actuator's value for a pulse."""
        assert self.at is not None
        (low, neutral, high), (least, middle, most) = self.pulse, self.at
        if us == 0 or us == neutral:
            return middle
        us = min(max(us, low), high)
        if us < neutral:
            return middle + (least - middle) * (neutral - us) / (neutral - low)
        return middle + (most - middle) * (us - neutral) / (high - neutral)

    def us(self, value: float) -> int:
        """The pulse for an actuator's value, to the nearest microsecond, within the ends."""
        assert self.at is not None
        (low, neutral, high), (least, middle, most) = self.pulse, self.at
        for end, there in ((high, most), (low, least)):
            share = (value - middle) / (there - middle) if there != middle else 0.0
            if share > 0:
                return round(neutral + (end - neutral) * min(share, 1.0))
        return neutral


class ServoOutputs:
    """The servos of a system's actuators, checked: pulses to actuators, and back.

    given: actuator -> channel, or `Servo`; None for port on 1 and starboard on 3, as a skid-steered
    Rover has them. servos: one for every actuator, in their order.

    Raises `SimulationError` for actuators without a channel, channels twice, pulses out of order
    and values beyond the actuator's limits; `DefinitionError` for a system without such limits.
    """

    def __init__(self, system: System, given: Mapping[str, int | Servo] | None = None) -> None:
        self.numeric = Numeric(system)
        self.servos = _servos(self.numeric, given)
        self.last = max(servo.channel for servo in self.servos.values())

    def inputs(self, pwm: Sequence[int]) -> Array:
        """The system's inputs for the pulses [us] of the channels."""
        values = [servo.value(pwm[servo.channel - 1]) for servo in self.servos.values()]
        return self.numeric.inputs(np.array(values))

    def pulses(self, actuators: Given) -> list[int]:
        """The pulses [us] of the first channels for actuators, such as `Decision.actuators`.

        Channels that drive nothing are neutral. Rounded to the nearest microsecond.
        Raises `SimulationError` for other actuators, and for numbers that are not finite.
        """
        values = numbers(actuators, tuple(self.servos), "actuators")
        if not np.isfinite(values).all():
            raise SimulationError(f"the actuators are {values.tolist()}", expected="finite numbers")
        widths = [NEUTRAL] * self.last
        for servo, value in zip(self.servos.values(), values.tolist(), strict=True):
            widths[servo.channel - 1] = servo.us(value)
        return widths


def _servos(numeric: Numeric, wanted: Mapping[str, int | Servo] | None) -> dict[str, Servo]:
    system = numeric.system
    low, high = numeric.limits()
    if wanted is None:
        if set(numeric.actuators) != set(SKID):
            raise SimulationError(
                f"system '{system.name}' has the actuators {', '.join(numeric.actuators)}",
                expected="servos=, the channel of each of them; known are port and starboard",
            )
        wanted = SKID
    for name in wanted:
        if name not in numeric.actuators:
            raise SimulationError(
                f"system '{system.name}' has no actuator '{name}'",
                remedy=suggestion(str(name), numeric.actuators),
            )
    servos: dict[str, Servo] = {}
    for name, least, most in zip(numeric.actuators, low.tolist(), high.tolist(), strict=True):
        if name not in wanted:
            raise SimulationError(f"the actuator '{name}' has no channel", expected="one in servos")
        servos[name] = _checked(name, wanted[name], least, most)
    channels = [servo.channel for servo in servos.values()]
    if twice := {c for c in channels if channels.count(c) > 1}:
        raise SimulationError(f"channel {min(twice)} drives two actuators")
    return servos


def _checked(name: str, wanted: int | Servo, least: float, most: float) -> Servo:
    servo = wanted if isinstance(wanted, Servo) else Servo(wanted)
    owner = f"the servo of '{name}'"
    if isinstance(servo.channel, bool) or servo.channel not in range(1, MOST + 1):
        raise SimulationError(f"{owner} has the channel {servo.channel!r}", expected="1 to 32")
    shortest, neutral, longest = servo.pulse
    if not 0 < shortest < neutral < longest <= 0xFFFF:
        raise SimulationError(
            f"{owner} has the pulses {servo.pulse}", expected="shortest < neutral < longest"
        )
    if servo.at is None:
        if not least <= 0.0 <= most:
            raise SimulationError(
                f"'{name}' is between {least:g} and {most:g}, and never 0",
                expected="Servo(channel, at=(...)), with its value at the neutral pulse",
            )
        return Servo(servo.channel, servo.pulse, (least, 0.0, most))
    if not all(least <= value <= most for value in servo.at):
        raise SimulationError(
            f"{owner} has the values {servo.at}", expected=f"values from {least:g} to {most:g}"
        )
    return servo
