"""Any planar system as the physics of ArduPilot's simulator, in lockstep."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from holdfast.analysis.online.controller import Given, Plant, numbers
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.host.interruption import ended_by_signals
from holdfast.interop.ardupilot.packets import ServoPacket, motion_line
from holdfast.interop.ardupilot.servos import Servo, ServoOutputs
from holdfast.interop.planar_motion import Motion, PlanarMotion
from holdfast.interop.udp import LONGEST, Address, bound
from holdfast.maths.definitions.system import System

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

    system: with a pose, see `PlanarMotion`, whose arguments pose, twist and bearing are. start: its
    states, by default 0. servos: actuator -> channel, or `Servo`; by default those of a
    skid-steered boat, port 1 and starboard 3, over their limits. disturbance: constant values by
    name, else 0. also: more fields of the answer (rangefinders, wind), of the time and the states.

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
        """The states now."""
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

    say: is told, as a sentence, of a first frame, of new starts, and of what was missed or refused.
    ready: is told the port when it is bound (0 is any free one). frames: end after so many steps.
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
