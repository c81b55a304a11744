"""What the two ends of ArduPilot's JSON interface send each other.

The autopilot sends little-endian binary servo packets, the physics answers with a line of JSON
between two line ends; see `ServoPacket` and `motion_line`. The layouts are those of ArduPilot's
`libraries/SITL/SIM_JSON.h` and `examples/JSON/readme.md`.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from holdfast.errors import SimulationError
from holdfast.interop.planar_motion import Motion, Triple

MAGIC = {16: 18458, 32: 29569}
"""Number of channels -> the first number of a packet."""
HEADER = struct.Struct("<HHI")
FIELDS = ("timestamp", "imu", "position", "velocity", "attitude", "quaternion")
LARGEST = 0xFFFF


@dataclass(frozen=True)
class ServoPacket:
    """uint16 magic, uint16 frame_rate [Hz], uint32 frame_count, uint16 pwm[16 or 32] [us]."""

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

    timestamp [s]; imu: gyro [rad/s], accel_body [m/s^2]; position [m]; attitude [rad]; velocity
    [m/s]; then what `Motion.others` holds. Numbers are written so that they are read back to the
    bit. There are no spaces, because ArduPilot's reader takes none before an array. Raises
    `SimulationError` for numbers that are not finite, and where the others name one of these.
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

    With both an attitude and a quaternion the quaternion counts. Raises `SimulationError` for an
    answer that lacks a field or holds something else than finite numbers in it.
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
