"""A safety filter as a MAVLink component, and a simulated vehicle for it, over UDP."""

from holdfast.interop.mavlink.commands import BodyVelocity, ManualControl, commands_of
from holdfast.interop.mavlink.component import Counts, SafetyComponent, SimulatedVehicle, serve
from holdfast.interop.mavlink.frames import Codec
from holdfast.interop.mavlink.lookout import Lookout

__all__ = [
    "BodyVelocity",
    "Codec",
    "Counts",
    "Lookout",
    "ManualControl",
    "SafetyComponent",
    "SimulatedVehicle",
    "commands_of",
    "serve",
]
