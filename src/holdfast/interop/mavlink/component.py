"""A safety filter as a MAVLink component between a controller and a vehicle.

It reads the states of a planar vehicle from the messages of its autopilot, and says of itself
heartbeats, texts of interventions, and values. A simulated vehicle speaks MAVLink too: states out,
commands in.
"""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from holdfast.analysis.online.controller import Plant
from holdfast.analysis.online.decision import DecisionRecord, Status
from holdfast.analysis.online.relay import Relay
from holdfast.analysis.online.safety_filter import SafetyFilter
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.host.interruption import ended_by_signals
from holdfast.interop.mavlink.commands import Commands
from holdfast.interop.mavlink.frames import Codec, Message, dialect, is_signed, is_v1
from holdfast.interop.mavlink.lookout import KINDS, PLACES, Lookout, Watch
from holdfast.interop.planar_motion import Motion, PlanarMotion, Triple
from holdfast.interop.udp import Closing, Port
from holdfast.maths.definitions.system import System

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


LOCAL_NED, BODY_FRD = 1, 12
BACK = 1.0
"""A time that fell by more [s] is that of a vehicle that started again."""


class Measurements:
    """The newest states, from LOCAL_POSITION_NED and ATTITUDE, or from ODOMETRY.

    A message that is not newer than the last one of its kind is not taken, and counted in `stale`;
    if it is older by more than a second the vehicle has started again, counted in `restarts`. An
    ODOMETRY in other frames than MAV_FRAME_LOCAL_NED and MAV_FRAME_BODY_FRD is counted in `other`;
    of its attitude the heading is taken, as of a level vehicle.
    """

    def __init__(self, planar: PlanarMotion) -> None:
        self.planar = planar
        self.stale = self.restarts = self.other = 0
        self._times: dict[str, float] = {}
        self._position: tuple[float, Triple, Triple] | None = None
        self._attitude: tuple[float, Triple, Triple] | None = None

    def take(self, message: Message, now: float) -> tuple[dict[str, float], float] | None:
        """The states after a message received at `now` [s], and the time of their oldest part."""
        kind = message.get_type()
        if kind == "LOCAL_POSITION_NED":
            if self._newer(kind, message.time_boot_ms * 1e-3):
                position = (message.x, message.y, message.z)
                self._position = now, position, (message.vx, message.vy, message.vz)
                return self._both(message.time_boot_ms * 1e-3)
        elif kind == "ATTITUDE":
            if self._newer(kind, message.time_boot_ms * 1e-3):
                turning = (message.rollspeed, message.pitchspeed, message.yawspeed)
                self._attitude = now, (message.roll, message.pitch, message.yaw), turning
                return self._both(message.time_boot_ms * 1e-3)
        elif kind == "ODOMETRY":
            return self._odometry(message, now)
        return None

    def _newer(self, kind: str, t: float) -> bool:
        last = self._times.get(kind, -math.inf)
        if t < last - BACK:
            self.restarts += 1
            self._times.clear()
            self._position = self._attitude = None
        elif t <= last:
            self.stale += 1
            return False
        self._times[kind] = t
        return True

    def _both(self, t: float) -> tuple[dict[str, float], float] | None:
        if self._position is None or self._attitude is None:
            return None
        (one, position, velocity), (two, attitude, gyro) = self._position, self._attitude
        motion = Motion(t, position, velocity, attitude, gyro)
        return self.planar.states(motion), min(one, two)

    def _odometry(self, message: Message, now: float) -> tuple[dict[str, float], float] | None:
        if (message.frame_id, message.child_frame_id) != (LOCAL_NED, BODY_FRD):
            self.other += 1
            return None
        if not self._newer("ODOMETRY", message.time_usec * 1e-6):
            return None
        w, x, y, z = message.q
        yaw = math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
        cos, sin = math.cos(yaw), math.sin(yaw)
        velocity = (message.vx * cos - message.vy * sin, message.vx * sin + message.vy * cos, 0.0)
        motion = Motion(
            t=message.time_usec * 1e-6,
            position=(message.x, message.y, message.z),
            velocity=velocity,
            attitude=(0.0, 0.0, yaw),
            gyro=(0.0, 0.0, message.yawspeed),
        )
        return self.planar.states(motion), now


AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1: gimbals and cameras may send an ATTITUDE of their own."""
ONBOARD_COMPUTER = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER."""
OTHER_COMMANDS = frozenset(
    {
        "MANUAL_CONTROL",
        "RC_CHANNELS_OVERRIDE",
        "SET_ACTUATOR_CONTROL_TARGET",
        "SET_ATTITUDE_TARGET",
        "SET_POSITION_TARGET_GLOBAL_INT",
        "SET_POSITION_TARGET_LOCAL_NED",
    }
)
"""Messages that move a vehicle; those that the filter does not read pass, and it says so."""
EARLY = 1e-6
"""A sample may be so early [s]: the clock is a number that is rounded."""
LINK = 71
"""The link of our signatures, so that their times are not mixed with those of the controller."""


@dataclass
class Counts:
    """What a component received, in both directions together.

    passed: messages sent on unchanged. commands: those that the filter took. sent: filtered
    commands. broken: frames with a wrong checksum. garbage: bytes of no whole frame. unsigned:
    frames without the signature that the key asks for. strangers: datagrams of a third address.
    other_system: states of another vehicle or component, and
    commands to one, which pass. stale: states older
    than the last. refused: commands that the filter cannot read (another kind of setpoint, a
    signature without a key), which do not pass. unfiltered: other messages that may move the
    vehicle, which do. unsent: datagrams without a receiver. restarts: of the vehicle. obstacles:
    messages that say where some are; unplaced: those of which the component cannot say where.
    """

    passed: int = 0
    commands: int = 0
    sent: int = 0
    broken: int = 0
    garbage: int = 0
    unsigned: int = 0
    strangers: int = 0
    other_system: int = 0
    stale: int = 0
    refused: int = 0
    unfiltered: int = 0
    unsent: int = 0
    restarts: int = 0
    obstacles: int = 0
    unplaced: int = 0

    def __str__(self) -> str:
        counts = [(f.name, getattr(self, f.name)) for f in fields(self)]
        return ", ".join(f"{n} {name}" for name, n in counts if n) or "nothing received"


class SafetyComponent(Closing):
    """A filter that reads states and commands, and sends the filtered command in their place.

    The states of the vehicle are read from LOCAL_POSITION_NED and ATTITUDE, or ODOMETRY, of its
    autopilot; the command from one kind of message (`commands`). Every `keep.sample_time` the
    newest of both are decided on as `Relay` does, and the decision is sent to the vehicle as a
    message of the same kind and version, from the system and component that commanded. A command
    that arrives half a sample or more after the last decision is decided on at once, and the
    samples go on from there, unless the filter remembers (observers, rates of inputs): that one
    keeps its samples. A command that the filter passes is sent as it was. All other messages pass
    unchanged, both ways.

    Nothing is sent before the first command, and nothing when the last one is older than `hold`
    [s]: then the vehicle's own failsafe has to act, which the messages would put off.

    The component has the system number of the vehicle. It sends HEARTBEAT once a second, both ways,
    and to the controller STATUSTEXT where it intervenes and the value and the slack as
    NAMED_VALUE_FLOAT ("hf_value", "hf_slack").

    A filter with obstacles reads OBSTACLE_DISTANCE and OBSTACLE_DISTANCE_3D of any component of the
    vehicle's system, and AIS_VESSEL and ADSB_VEHICLE. These are placed by GLOBAL_POSITION_INT or
    GPS_GLOBAL_ORIGIN of the autopilot. All of these pass on. Without distances for the patience the
    input is the fallback, and nothing is promised.

    keep: the filter. component: its own number. hold [s]: how old the last command may be.
    commands: `ManualControl` or `BodyVelocity`. controller, vehicle: connections, "udpin:HOST:PORT"
    or "udpout:HOST:PORT". system, autopilot: the numbers of the vehicle and of its component that
    knows the states. patience [s]: of the relay. key: the secret that signs the connection. pose,
    twist, bearing: see `PlanarMotion`. lookout: what counts as an obstacle, see `Lookout`.

    Raises `SimulationError` and `DefinitionError` for a system that does not fit, for a port in
    use, and for invalid arguments.
    """

    @checked
    def __init__(
        self,
        keep: SafetyFilter,
        commands: Commands,
        *,
        controller: str = "udpin:127.0.0.1:14550",
        vehicle: str = "udpin:127.0.0.1:14560",
        system: int = 1,
        autopilot: int = AUTOPILOT,
        component: int = ONBOARD_COMPUTER,
        patience: float = 0.25,
        hold: float = 10.0,
        key: bytes | None = None,
        pose: tuple[str, str, str] = ("x", "y", "psi"),
        twist: tuple[str, str, str] = ("u", "v", "r"),
        bearing: float = 0.0,
        lookout: Lookout | None = None,
    ) -> None:
        if not (hold > patience and hold < math.inf):
            raise SimulationError(f"hold is {hold} s", expected="more than the patience")
        if system not in range(1, 256) or component not in range(1, 256):
            raise SimulationError(
                f"system {system}, component {component}", expected="numbers from 1 to 255"
            )
        self.relay, self.commands, self.hold = Relay(keep, patience=patience), commands, float(hold)
        if keep.measured_disturbances:
            raise SimulationError(
                f"the filter measures {', '.join(keep.measured_disturbances)}",
                expected="a filter of states alone: no message holds disturbances",
            )
        self.system, self.autopilot, self.component = system, autopilot, component
        planar = PlanarMotion(keep.system, pose=pose, twist=twist, bearing=bearing)
        self._measurements = Measurements(planar)
        if lookout is not None and keep.clearing is None:
            raise SimulationError(
                "a lookout is given, and the filter keeps clear of no obstacles",
                remedy="make it with obstacles=20",
            )
        self._watch = None
        if keep.clearing is not None:
            self._watch = Watch(planar, lookout or Lookout(), self.relay.patience)
        self._from_controller, self._from_vehicle = Codec(key, link=LINK), Codec(key, link=LINK)
        self._said = Said()
        self._counts = Counts()
        self._like: Message | None = None
        self._read: dict[str, float] = {}
        self._sender, self._v1, self._commanded = (0, 0), False, -math.inf
        self._due = self._decided = self._beat = -math.inf
        self._waiting = False
        self._prompt = getattr(keep.law, "memory", None) is None
        self.controller = Port(controller)
        try:
            self.vehicle = Port(vehicle)
        except SimulationError:
            self.controller.close()
            raise

    def close(self) -> None:
        """Close both sockets."""
        self.controller.close()
        self.vehicle.close()

    @property
    def counts(self) -> Counts:
        """What was received and sent so far."""
        counts, codecs = self._counts, (self._from_controller, self._from_vehicle)
        ports, measured = (self.controller, self.vehicle), self._measurements
        counts.broken = sum(c.broken for c in codecs)
        counts.garbage = sum(c.garbage for c in codecs)
        counts.unsigned = sum(c.unsigned for c in codecs)
        counts.strangers = sum(p.strangers for p in ports)
        counts.unsent = sum(p.unsent for p in ports)
        counts.stale, counts.restarts = measured.stale, measured.restarts
        if self._watch is not None:
            counts.obstacles, counts.unplaced = self._watch.taken, self._watch.refused
        return counts

    def turn(self, now: float) -> DecisionRecord | None:
        """Read what waits at `now` [s], and decide if a sample is due; its decision."""
        for datagram in self.vehicle.receive(now):
            for message, frame in self._from_vehicle.messages(datagram):
                self._state(message, now)
                self._look(message, now)
                self._pass(frame, self.controller)
        for datagram in self.controller.receive(now):
            for message, frame in self._from_controller.messages(datagram):
                self._look(message, now)
                if not self._command(message, frame, now):
                    self._pass(frame, self.vehicle)
        if now - self._beat >= 1.0:
            self._beat = now
            self._tell(heartbeat(), self.controller)
            self._tell(heartbeat(), self.vehicle)
        if self.due(now) > EARLY:
            return None
        sample = self.relay.keep.sample_time
        on_time = -EARLY <= now - self._due < sample
        self._due = (self._due if on_time else now) + sample
        self._decided, self._waiting = now, False
        return self._decide(now)

    def due(self, now: float) -> float:
        """The seconds until the next decision."""
        due = self._due
        if self._waiting and self._prompt:
            due = min(due, self._decided + self.relay.keep.sample_time / 2)
        return max(due - now, 0.0)

    # -- from the vehicle, from the controller ---------------------------------------------------

    def _pass(self, frame: bytes, port: Port) -> None:
        self._counts.passed += 1
        port.send(frame)

    def _state(self, message: Message, now: float) -> None:
        if (message.get_srcSystem(), message.get_srcComponent()) != (self.system, self.autopilot):
            self._counts.other_system += message.get_type() in ("LOCAL_POSITION_NED", "ODOMETRY")
            return
        restarts = self._measurements.restarts
        measurement = self._measurements.take(message, now)
        if self._measurements.restarts > restarts:
            self.relay.reset()
            if self._watch is not None:
                self._watch.forget()
            if self._like is not None:  # its age is what it was
                self.relay.commanded(self._read, self._commanded)
        if measurement is not None:
            states, received = measurement
            self.relay.measured({n: states[n] for n in self.relay.states}, received)
            if self._watch is not None:
                self._watch.measured(states)

    def _look(self, message: Message, now: float) -> None:
        """Take what a message of the vehicle's system says of obstacles."""
        kind = message.get_type()
        if self._watch is None or not (kind in KINDS or kind in PLACES):
            return
        if message.get_srcSystem() != self.system:
            self._counts.other_system += kind in KINDS
        elif kind in KINDS:
            refused = self._watch.refused
            self._watch.take(message, now)
            if self._watch.refused > refused:
                self._warn(f"not counted: {self._watch.why}", now)
        elif message.get_srcComponent() == self.autopilot:
            self._watch.placed(message)

    def _command(self, message: Message, frame: bytes, now: float) -> bool:
        """Whether a message is a command that does not pass as it is."""
        kind = message.get_type()
        if kind != self.commands.kind:
            if kind in OTHER_COMMANDS:
                self._counts.unfiltered += 1
                self._warn(f"{kind} passes unfiltered", now)
            return False
        if self.commands.target(message) not in (0, self.system):
            self._counts.other_system += 1
            return False
        signed = is_signed(frame) and self._from_controller.key is None
        input = None if signed else self.commands.command(message)
        if input is None:
            self._counts.refused += 1
            why = "it is signed, and no key was given" if signed else "it sets something else"
            self._warn(f"{kind} is not sent on: {why}", now)
            return True
        self._counts.commands += 1
        self._like, self._read, self._v1 = message, input, is_v1(frame)
        self._sender = message.get_srcSystem(), message.get_srcComponent()
        self._commanded, self._waiting = now, True
        self.relay.commanded(input, now)
        return True

    # -- to them ---------------------------------------------------------------------------------

    def _decide(self, now: float) -> DecisionRecord:
        if self._watch is not None and (around := self._watch.around(now)) is not None:
            self.relay.surrounded(*around)
        record = self.relay.decide(now)
        if self._like is not None and now - self._commanded <= self.hold:
            made = self._like
            if record.lost:  # what else the last command asked for is over
                made = self.commands.of(record.input, self.system)
            elif record.input != self._read:
                made = self.commands.message(self._like, record.input)
            self.vehicle.send(self._from_vehicle.frame(made, *self._sender, v1=self._v1))
            self._counts.sent += 1
        for message in self._said.of(record, now):
            self._tell(message, self.controller)
        return record

    def _warn(self, text: str, now: float) -> None:
        for message in self._said.warning(text, now):
            self._tell(message, self.controller)

    def _tell(self, message: Message, port: Port) -> None:
        codec = self._from_controller if port is self.controller else self._from_vehicle
        if port.peer is not None:
            port.send(codec.frame(message, self.system, self.component))


def serve(
    component: SafetyComponent,
    *,
    on_decision: Callable[[DecisionRecord], None] | None = None,
    seconds: float = math.inf,
) -> Counts:
    """Run a component until Ctrl-C or SIGTERM, or for so many seconds; what it received.

    component: what is run. seconds [s]: how long; None for ever. on_decision: is told every
    decision, of which `DecisionRecord.line` is a line of JSON. The sockets are closed at the end.
    """
    ended = threading.Event()
    with component, ended_by_signals(ended.set):
        wires = [component.controller.socket, component.vehicle.socket]
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end and not ended.is_set():
            record = component.turn(now)
            if record is not None and on_decision is not None:
                on_decision(record)
            select.select(wires, [], [], min(component.due(time.monotonic()), end - now))
    return component.counts


class SimulatedVehicle(Closing):
    """A `Plant` that publishes LOCAL_POSITION_NED, ATTITUDE and HEARTBEAT, and obeys commands.

    Commands are those of one kind, to its system, of any controller. A command is held for a time;
    without a newer one the inputs are 0, as an autopilot's failsafe would have them.

    commands: `ManualControl` or `BodyVelocity`. patience [s]: how long a command is held. key: the
    secret that signs the connection. system: with a pose, see `PlanarMotion`. start: its states.
    connection: "udpout:HOST:PORT" or "udpin:HOST:PORT". number: its system. rate [Hz]: of the two
    messages of states. on_states: is told the time and the states after every sample. pose, twist,
    bearing: see `PlanarMotion`.

    Raises `SimulationError` and `DefinitionError` for a system that does not fit, for a port in
    use, and where the plant diverges.
    """

    @checked
    def __init__(
        self,
        system: System,
        start: Sequence[float] | Array,
        commands: Commands,
        *,
        connection: str = "udpout:127.0.0.1:14560",
        number: int = 1,
        sample_time: float = 0.02,
        rate: float = 50.0,
        patience: float = 1.0,
        key: bytes | None = None,
        pose: tuple[str, str, str] = ("x", "y", "psi"),
        twist: tuple[str, str, str] = ("u", "v", "r"),
        bearing: float = 0.0,
        on_states: Callable[[float, Array], None] | None = None,
    ) -> None:
        """start: shape (states,)."""
        if not (0 < rate <= 1000 and patience > 0):
            raise SimulationError(
                f"rate is {rate} Hz, patience {patience} s", expected="up to 1000 Hz, above 0 s"
            )
        self.plant = Plant(system, start, sample_time=sample_time)
        self.planar = PlanarMotion(system, pose=pose, twist=twist, bearing=bearing)
        self.commands, self.number, self.on_states = commands, number, on_states
        self.rate, self.patience = float(rate), float(patience)
        self._nothing = np.zeros(len(system.inputs))
        self._input, self._commanded = self._nothing, -math.inf
        self._pushed = np.zeros(len(system.disturbances))
        self._began = math.nan
        self._published, self._beats = 0, 0
        self._codec = Codec(key, link=1)
        self.port = Port(connection)

    def close(self) -> None:
        """Close the socket."""
        self.port.close()

    @property
    def state(self) -> Array:
        """The states now, shape (states,)."""
        return self.plant.state

    def turn(self, now: float) -> None:
        """Read commands, move to the time `now` [s], and publish what is due."""
        if math.isnan(self._began):
            self._began = now
        for datagram in self.port.receive(now):
            for message, _ in self._codec.messages(datagram):
                self._obey(message, now)
        while self.plant.t + self.plant.sample_time <= now - self._began + 1e-9:
            lost = now - self._commanded > self.patience
            self.plant.step(self._nothing if lost else self._input)
            if self.on_states is not None:
                self.on_states(self.plant.t, self.plant.state)
        since = now - self._began + 1e-9
        if since >= self._published / self.rate:
            self._published = math.floor(since * self.rate) + 1
            self._publish()
        if since >= self._beats:
            self._beats = math.floor(since) + 1
            self._send(_heartbeat())

    def _obey(self, message: Message, now: float) -> None:
        if message.get_type() != self.commands.kind:
            return
        if self.commands.target(message) not in (0, self.number):
            return
        inputs = self.commands.command(message)
        if inputs is not None:
            names = self.plant.system.input_names
            self._input = np.array([inputs[name] for name in names])
            self._commanded = now

    def _publish(self) -> None:
        t, boot = self.plant.t, round(1000 * self.plant.t)
        motion = self.planar.motion(t, self.plant.state, self._input, self._pushed)
        self._send(
            dialect.MAVLink_local_position_ned_message(boot, *motion.position, *motion.velocity)
        )
        roll, pitch, yaw = motion.attitude
        yaw = math.remainder(yaw, 2 * math.pi)
        self._send(dialect.MAVLink_attitude_message(boot, roll, pitch, yaw, *motion.gyro))

    def _send(self, message: Message) -> None:
        self.port.send(self._codec.frame(message, self.number, AUTOPILOT))

    def run(self, seconds: float = math.inf) -> None:
        """Go on in real time, until Ctrl-C or SIGTERM, or for so many seconds."""
        ended = threading.Event()
        with self, ended_by_signals(ended.set):
            end = time.monotonic() + seconds
            while (now := time.monotonic()) < end and not ended.is_set():
                self.turn(now)
                select.select([self.port.socket], [], [], self.plant.sample_time / 4)


def _heartbeat() -> Message:
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_SURFACE_BOAT,
        dialect.MAV_AUTOPILOT_GENERIC,
        dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | dialect.MAV_MODE_FLAG_SAFETY_ARMED,
        0,
        dialect.MAV_STATE_ACTIVE,
        3,
    )
