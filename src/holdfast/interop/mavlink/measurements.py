"""The states of a planar vehicle from the messages of its autopilot."""

from __future__ import annotations

import math

from holdfast.interop.mavlink.frames import Message
from holdfast.interop.planar_motion import Motion, PlanarMotion, Triple

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
