"""The two ends of a MAVLink component: a controller, and a vehicle that says what a test lets it."""

import math

from pymavlink.dialects.v20 import ardupilotmega as common

from holdfast.interop.mavlink import Codec
from holdfast.interop.udp import Port

GROUND = (255, 190)


class Ground:
    """A controller: a socket, and what it heard."""

    def __init__(self, port, key=None):
        self.port, self.codec, self.heard = Port(f"udpout:127.0.0.1:{port}"), Codec(key), []
        self.frames = []

    def send(self, message, *, sender=GROUND, v1=False):
        frame = self.codec.frame(message, *sender, v1=v1)
        self.port.send(frame)
        return frame

    def hear(self):
        new = [m for d in self.port.receive(0.0) for m in self.codec.messages(d)]
        self.heard += [m for m, _ in new]
        self.frames += [f for _, f in new]
        return [m for m, _ in new]


class Boat(Ground):
    """A vehicle that says only what a test lets it say."""

    def states(self, state, t, system=1):
        x, y, psi, u, v, r = state
        north, east = u * math.cos(psi) - v * math.sin(psi), u * math.sin(psi) + v * math.cos(psi)
        boot = round(1000 * t)
        self.send(
            common.MAVLink_local_position_ned_message(boot, x, -y, 0, north, -east, 0),
            sender=(system, 1),
        )
        self.send(common.MAVLink_attitude_message(boot, 0, 0, -psi, 0, 0, -r), sender=(system, 1))
