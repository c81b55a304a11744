"""The JSON physics interface of ArduPilot's simulator (SITL), both ends, over UDP."""

from holdfast.interop.ardupilot.autopilot import Autopilot
from holdfast.interop.ardupilot.packets import ServoPacket, motion_line, read_motion
from holdfast.interop.ardupilot.physics import Counts, Physics, serve
from holdfast.interop.ardupilot.servos import Servo, ServoOutputs

__all__ = [
    "Autopilot",
    "Counts",
    "Physics",
    "Servo",
    "ServoOutputs",
    "ServoPacket",
    "motion_line",
    "read_motion",
    "serve",
]
