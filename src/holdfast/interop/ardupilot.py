"""The JSON physics interface of ArduPilot's simulator (SITL), both ends, over UDP.

Any planar system is the physics, in lockstep; at the autopilot's end a law of one's own drives any
physics backend. Servo outputs [us] say which channel drives what actuator, and how far.

The autopilot sends little-endian binary servo packets, the physics answers with a line of JSON
between two line ends; see `ServoPacket` and `motion_line`. The layouts are those of ArduPilot's
`libraries/SITL/SIM_JSON.h` and `examples/JSON/readme.md`.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from holdfast.analysis.online.controller import Given, Plant, numbers
from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.host.interruption import ended_by_signals
from holdfast.interop.numeric_system import Numeric
from holdfast.interop.planar_motion import Motion, PlanarMotion, Triple
from holdfast.interop.udp import LONGEST, Address, Closing, bound
from holdfast.maths.definitions.system import System

MAGIC = {16: 18458, 32: 29569}
"""Number of channels -> the first number of a packet."""
HEADER = struct.Struct("<HHI")
FIELDS = ("timestamp", "imu", "position", "velocity", "attitude", "quaternion")
LARGEST = 0xFFFF


@dataclass(frozen=True)
class ServoPacket:
    """uint16 magic, uint16 frame_rate [Hz], uint32 frame_count, uint16 pwm[16 or 32] [us].

    frame_rate [Hz]: of the frames. frame_count: of this one. pwm [us]: the pulse of each of 16 or
    32 channels.
    """

    frame_rate: int
    frame_count: int
    pwm: tuple[int, ...]

    def pack(self) -> bytes:
        """The packet. Raises `SimulationError` for other channels and numbers out of range."""
        channels = len(self.pwm)
        try:
            head = HEADER.pack(MAGIC[channels], self.frame_rate, self.frame_count)
            return head + struct.pack(f"<{channels}H", *self.pwm)
        except (KeyError, struct.error):
            raise SimulationError(
                f"{self!r:.100} is no servo packet",
                expected="16 or 32 channels, each from 0 to 65535, and counts of its size",
            ) from None

    @staticmethod
    def read(data: bytes) -> ServoPacket:
        """The packet of these bytes. Raises `SimulationError` for bytes that are none."""
        for channels, magic in MAGIC.items():
            if len(data) == HEADER.size + 2 * channels:
                number, rate, count = HEADER.unpack_from(data)
                if number == magic:
                    pwm = struct.unpack_from(f"<{channels}H", data, HEADER.size)
                    return ServoPacket(rate, count, pwm)
        raise SimulationError(
            f"{len(data)} bytes ({data[:8].hex(' ')} ...) are no servo packet",
            expected="40 bytes with the magic number 18458, or 72 with 29569",
        )


def motion_line(motion: Motion) -> bytes:
    """The answer of the physics: a line of JSON, with a line end before and behind it.

    motion: what is told.

    timestamp [s]; imu: gyro [rad/s], accel_body [m/s^2]; position [m]; attitude [rad]; velocity
    [m/s]; then what `Motion.others` holds. Numbers are written so that they are read back to the
    bit. There are no spaces, because ArduPilot's reader takes none before an array.

    Raises `SimulationError` for numbers that are not finite, and where the others name one of
    these.
    """
    if taken := [name for name in motion.others if name in FIELDS]:
        raise SimulationError(f"'{taken[0]}' is a field of the motion itself")
    said = {
        "timestamp": motion.t,
        "imu": {"gyro": motion.gyro, "accel_body": motion.accel},
        "position": motion.position,
        "attitude": motion.attitude,
        "velocity": motion.velocity,
        **motion.others,
    }
    try:
        text = json.dumps(said, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SimulationError(f"the motion at {motion.t} s cannot be written ({error})") from None
    return f"\n{text}\n".encode()


def read_motion(data: bytes) -> Motion:
    """The motion of an answer: of its last whole line, as ArduPilot takes it.

    data: the bytes of an answer.

    With both an attitude and a quaternion the quaternion counts.

    Raises `SimulationError` for an answer that lacks a field or holds something else than finite
    numbers in it.
    """
    try:
        lines = [line for line in data.decode().split("\n") if line.strip(" \r\0")]
        said = json.loads(lines[-1].strip(" \r\0"))
        imu = said["imu"]
        if "quaternion" in said:
            attitude = _euler(*_numbers(said["quaternion"], 4))
        else:
            attitude = _triple(said["attitude"])
        return Motion(
            t=_numbers([said["timestamp"]], 1)[0],
            position=_triple(said["position"]),
            velocity=_triple(said["velocity"]),
            attitude=attitude,
            gyro=_triple(imu["gyro"]),
            accel=_triple(imu["accel_body"]),
            others=_others(said),
        )
    except (ValueError, LookupError, TypeError, ArithmeticError, RecursionError):
        shown = data.decode(errors="replace").strip()
        shown = shown if len(shown) < 80 else f"{shown[:77]}..."
        raise SimulationError(
            f"{shown!r} is no answer of a physics backend",
            expected="a line of JSON with timestamp, imu, position, velocity, and attitude or "
            "quaternion",
        ) from None


def _others(said: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in said.items() if name not in FIELDS}


def _numbers(said: Any, count: int) -> list[float]:
    if not isinstance(said, list) or len(said) != count:
        raise TypeError
    if any(isinstance(n, bool) or not isinstance(n, int | float) for n in said):
        raise TypeError
    numbers = [float(n) for n in said]
    if not all(map(math.isfinite, numbers)):
        raise ValueError
    return numbers


def _triple(said: Any) -> Triple:
    one, two, three = _numbers(said, 3)
    return one, two, three


def _euler(w: float, x: float, y: float, z: float) -> Triple:
    """Roll, pitch and yaw of a quaternion, of any length."""
    n = w * w + x * x + y * y + z * z
    sine = 2 * (w * y - z * x) / n
    return (
        math.atan2(2 * (w * x + y * z), w * w - x * x - y * y + z * z),
        math.asin(max(-1.0, min(1.0, sine))),
        math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z),
    )


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
        """The system's inputs for the pulses [us] of the channels, shape (inputs,)."""
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


LATE = 16
"""A frame at most so many behind the last one is a late duplicate, not a new start."""
INSISTS = 4
"""A late frame that comes so often in turn is of an autopilot that has started again."""
TICK = 0.1
"""Seconds of silence after which `serve` looks whether it is to end."""
PORT = 9002
"""Where ArduPilot expects the physics."""


@dataclass
class Counts:
    """What the physics received.

    steps: frames that moved the vehicle. repeated: frames that were answered again. late: older
    ones, which were not. missed: frames between two that arrived. restarts: starts of the
    autopilot after the first. refused: datagrams that are no servo packet, or ask for 0 Hz.
    """

    steps: int = 0
    repeated: int = 0
    late: int = 0
    missed: int = 0
    restarts: int = 0
    refused: int = 0

    def __str__(self) -> str:
        return ", ".join(f"{getattr(self, f.name)} {f.name}" for f in fields(self))


class Physics:
    """The answers of a vehicle to servo packets, without a socket: one step for every frame.

    A frame moves the vehicle by 1 / frame_rate, with its pulses held, as `Plant` does. The answer
    is the motion after it. The frame with the count of the last one is answered again, to the bit,
    and does not move the vehicle. One that is a little older is a late duplicate and is not
    answered, for its sender has gone on. A count that fell further, or fell and comes from another
    address, is a new start of the autopilot, and the vehicle begins at `start`. Where counts are
    missing the vehicle makes one step all the same, and they are counted.

    system: with a pose. pose, twist, bearing: as of `PlanarMotion`. substeps: Runge-Kutta steps of
    a frame. start: its states, by default 0. servos: actuator -> channel, or `Servo`; by default
    those of a skid-steered boat, port 1 and starboard 3, over their limits. disturbance: constant
    values by name, else 0. also: more fields of the answer (rangefinders, wind), of the time and
    the states.

    Raises `SimulationError` and `DefinitionError` for a system that does not fit, and in `answer`
    where the vehicle diverges.
    """

    @checked
    def __init__(
        self,
        system: System,
        start: Sequence[float] | Array | None = None,
        *,
        servos: Mapping[str, int | Servo] | None = None,
        disturbance: Mapping[str, float] | None = None,
        pose: tuple[str, str, str] = ("x", "y", "psi"),
        twist: tuple[str, str, str] = ("u", "v", "r"),
        bearing: float = 0.0,
        substeps: int = 2,
        also: Callable[[float, Array], Mapping[str, Any]] | None = None,
    ) -> None:
        self.system, self.substeps, self.also = system, substeps, also
        self.planar = PlanarMotion(system, pose=pose, twist=twist, bearing=bearing)
        self.outputs = ServoOutputs(system, servos)
        begin: Given = np.zeros(len(system.states)) if start is None else start
        self._start = numbers(begin, system.state_names, "start")
        pushes = dict.fromkeys(system.disturbance_names, 0.0) | dict(disturbance or {})
        self._pushed = numbers(pushes, system.disturbance_names, "disturbance")
        for what, row in (("start", self._start), ("disturbance", self._pushed)):
            if not np.isfinite(row).all():
                raise SimulationError(f"the {what} is {row.tolist()}", expected="finite numbers")
        self._plants: dict[int, Plant] = {}
        self.counts = Counts()
        self._sender: Address | None = None
        self._reset()

    @property
    def state(self) -> Array:
        """The states now, shape (states,)."""
        return self._state.copy()

    def _reset(self) -> None:
        self._state, self._t, self._count, self._rate = self._start, 0.0, -1, 0
        self._input: Array | None = None
        self._answer = b""
        self._asked = -1, 0

    def answer(self, data: bytes, sender: Address | None = None) -> bytes | None:
        """The answer to a datagram, or None for one that gets none."""
        try:
            packet = ServoPacket.read(data)
        except SimulationError:
            self.counts.refused += 1
            return None
        if packet.frame_rate == 0 or len(packet.pwm) < self.outputs.last:
            self.counts.refused += 1
            return None
        behind = self._count - packet.frame_count
        if behind == 0 and sender == self._sender:
            self.counts.repeated += 1
            return self._answer
        if behind >= 0:
            if behind <= LATE and sender == self._sender and not self._insists(packet.frame_count):
                self.counts.late += 1
                return None
            self.counts.restarts += 1
            self._reset()
        elif self._count >= 0:
            self.counts.missed += -behind - 1
        self._count, self._sender = packet.frame_count, sender
        self._answer = motion_line(self._moved(packet))
        self.counts.steps += 1
        return self._answer

    def _insists(self, count: int) -> bool:
        """Whether a late frame was sent again and again: by one that waits for its answer."""
        last, times = self._asked
        self._asked = count, times + 1 if count == last else 1
        return self._asked[1] >= INSISTS

    def _moved(self, packet: ServoPacket) -> Motion:
        plant = self._plant(packet.frame_rate)
        input = self.outputs.inputs(packet.pwm)
        jump = (0.0, 0.0)
        if self.planar.follows_at_once and self._input is not None:
            jump = self._jump(self._input, input, plant.sample_time)
        self._state = plant.step(input, self._pushed)
        self._input, t = input, self._t + plant.t
        motion = self.planar.motion(t, self._state, input, self._pushed, jump)
        if self.also is None:
            return motion
        more = self.also(t, self.state)
        if not isinstance(more, Mapping):
            raise SimulationError(f"also gives {more!r:.60}", expected="fields by name")
        return replace(motion, others=more)

    def _jump(self, before: Array, after: Array, length: float) -> tuple[float, float]:
        """The change of the velocity with the input, as an acceleration over the step."""
        old = self.planar.speed(self._state, before, self._pushed)
        new = self.planar.speed(self._state, after, self._pushed)
        return (new[0] - old[0]) / length, (new[1] - old[1]) / length

    def _plant(self, rate: int) -> Plant:
        """The plant of a frame rate; the time of the frames before it goes on."""
        if rate == self._rate:
            return self._plants[rate]
        if self._rate:
            self._t += self._plants[self._rate].t
        if rate not in self._plants:
            self._plants[rate] = Plant(
                self.system, self._state, sample_time=1.0 / rate, substeps=self.substeps
            )
        self._plants[rate].reset(self._state)
        self._rate = rate
        return self._plants[rate]


def serve(
    physics: Physics,
    *,
    host: str = "127.0.0.1",
    port: int = PORT,
    say: Callable[[str], None] | None = None,
    ready: Callable[[int], None] | None = None,
    frames: int | None = None,
) -> Counts:
    """Answer the packets that arrive at a port, until Ctrl-C or SIGTERM; what was received.

    physics: what answers. host, port: where it listens. say: is told, as a sentence, of a first
    frame, of new starts, and of what was missed or refused. ready: is told the port when it is
    bound (0 is any free one). frames: end after so many steps.

    Raises `SimulationError` for a port in use, and where the vehicle diverges.
    """
    tell, last = say or _silent, -float("inf")
    ended = threading.Event()
    with bound(host, port) as wire, ended_by_signals(ended.set):
        wire.settimeout(TICK)
        if ready is not None:
            ready(wire.getsockname()[1])
        while not ended.is_set() and (frames is None or physics.counts.steps < frames):
            before = Counts(**vars(physics.counts))
            try:
                data, sender = wire.recvfrom(LONGEST)
            except (TimeoutError, ConnectionError):  # silence, or an answer had no receiver
                continue
            reply = physics.answer(data, sender)
            if reply is not None:
                with suppress(OSError):  # the network is down: it asks again
                    wire.sendto(reply, sender)
            if news := _news(before, physics.counts, sender):
                now = time.monotonic()
                if now - last >= 1.0 or "start" in news:
                    tell(news)
                    last = now
    return physics.counts


def _news(before: Counts, after: Counts, sender: Address) -> str:
    where = f"{sender[0]}:{sender[1]}"
    if after.steps == 1 and before.steps == 0:
        return f"the autopilot at {where} has started"
    if after.restarts > before.restarts:
        return f"the autopilot at {where} has started again: the vehicle is at its start"
    if after.missed > before.missed:
        return f"{after.missed - before.missed} frames of {where} are missing"
    if after.refused > before.refused:
        return f"a datagram of {where} is no servo packet: {after.refused} refused so far"
    return ""


def _silent(news: str) -> None:
    pass


class Autopilot(Closing):
    """Sends servo packets and takes the answers, as ArduPilot's simulator does, in lockstep.

    host, port: where the physics listens. rate [Hz]: what the physics is asked to step by, 1 to
    65535. channels: 16 or 32. resend [s]: a packet that has no answer is sent again (ArduPilot:
    after 1 s). patience [s]: after that `frame` raises. Used in a `with`, or `close` it.

    restarts: how often the physics began anew: its time fell. ignored: answers that were there
    already. resent: packets that were sent again.

    Raises `SimulationError` for invalid arguments and for a host that is unknown.
    """

    @checked
    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = PORT,
        *,
        rate: int = 50,
        channels: int = 16,
        resend: float = 0.1,
        patience: float = 10.0,
    ) -> None:
        if channels not in MAGIC or rate not in range(1, 0x10000):
            raise SimulationError(
                f"rate is {rate} Hz, with {channels} channels",
                expected="1 to 65535 Hz, and 16 or 32 channels",
            )
        if not (0 < resend <= patience < math.inf):
            raise SimulationError(
                f"resend is {resend} s, patience {patience} s", expected="0 < resend <= patience"
            )
        if port not in range(1, 0x10000):
            raise SimulationError(f"port is {port}", expected="1 to 65535")
        self.rate, self.channels, self.resend, self.patience = rate, channels, resend, patience
        try:
            self.physics = (socket.gethostbyname(host), int(port))
        except OSError as error:
            raise SimulationError(f"{host!r} is no host ({error.strerror})") from None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._seen: deque[bytes] = deque(maxlen=LATE)
        self.count, self.t = 0, -math.inf
        self.restarts = self.ignored = self.resent = 0

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def frame(self, pwm: Sequence[int]) -> Motion:
        """Send the pulses [us] of the first channels, the others neutral; the motion after them.

        Raises `SimulationError` where no answer comes within the patience, for an answer that is
        none, and for pulses that are no whole numbers from 0 to 65535.
        """
        pulses = (*pwm, *[NEUTRAL] * (self.channels - len(pwm)))
        data = ServoPacket(self.rate, self.count, pulses).pack()
        ends, resent = time.monotonic() + self.patience, False
        while True:
            if (now := time.monotonic()) >= ends:
                raise SimulationError(
                    f"the physics at {self.physics[0]}:{self.physics[1]} is silent for "
                    f"{self.patience:g} s at frame {self.count}",
                    remedy="start it, or give more patience",
                )
            self.resent += resent
            self._socket.sendto(data, self.physics)
            motion = self._answer(min(now + self.resend, ends))
            if motion is not None:
                self.count += 1
                return motion
            resent = True

    def _answer(self, until: float) -> Motion | None:
        """The next answer that was not there yet; None if there is none until then."""
        while (left := until - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                data, sender = self._socket.recvfrom(LONGEST)
            except (TimeoutError, ConnectionError):
                continue
            if sender != self.physics or data in self._seen:
                self.ignored += 1
                continue
            motion = read_motion(data)
            self._seen.append(data)
            self.restarts += motion.t < self.t
            self.t = motion.t
            return motion
        return None
