"""A safety filter as a MAVLink component, and a simulated vehicle for it, over UDP."""

from holdfast.interop.mavlink.commands import BodyVelocity, ManualControl, commands_of
from holdfast.interop.mavlink.component import Counts, SafetyComponent, serve
from holdfast.interop.mavlink.frames import Codec
from holdfast.interop.mavlink.vehicle import SimulatedVehicle

__all__ = [
    "BodyVelocity",
    "Codec",
    "Counts",
    "ManualControl",
    "SafetyComponent",
    "SimulatedVehicle",
    "commands_of",
    "serve",
]
