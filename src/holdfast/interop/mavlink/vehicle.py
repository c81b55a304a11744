"""A simulated vehicle that speaks MAVLink: states out, commands in."""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from holdfast.analysis.online.controller import Plant
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.host.interruption import ended_by_signals
from holdfast.interop.closing import Closing
from holdfast.interop.mavlink.commands import Commands
from holdfast.interop.mavlink.frames import Codec, Message, dialect
from holdfast.interop.planar_motion import PlanarMotion
from holdfast.interop.udp import Port
from holdfast.maths.definitions.system import System

AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""


class SimulatedVehicle(Closing):
    """A `Plant` that publishes LOCAL_POSITION_NED, ATTITUDE and HEARTBEAT, and obeys commands.

    Commands are those of one kind (`commands`), to its system, of any controller. A command is
    held for `patience` [s]; without a newer one the inputs are 0, as an autopilot's failsafe would
    have them.

    system: with a pose, see `PlanarMotion`. start: its states. connection: "udpout:HOST:PORT" or
    "udpin:HOST:PORT". number: its system. rate [Hz]: of the two messages of states.
    on_states: is told the time and the states after every sample. pose, twist, bearing: see
    `PlanarMotion`.

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
        """The states now."""
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
