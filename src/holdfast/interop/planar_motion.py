"""Planar systems in the axes of autopilots: north, east, down; forward, right, down."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.definitions.system import System

GRAVITY = 9.80665
"""Standard gravity, as ArduPilot takes it [m/s^2]."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Motion:
    """What an autopilot is told of a vehicle's motion.

    t [s]: when. position [m]: north, east, down. velocity [m/s]: over ground, north, east, down.
    attitude [rad]: roll, pitch, yaw, the last clockwise from north. gyro [rad/s], accel [m/s^2]:
    forward, right, down, as a gyroscope and an accelerometer show them (specific force: at rest 0,
    0, -9.80665). others: what else a message said.
    """

    t: float
    position: Triple
    velocity: Triple
    attitude: Triple
    gyro: Triple
    accel: Triple = (0.0, 0.0, -GRAVITY)
    others: Mapping[str, Any] = field(default_factory=dict)


class PlanarMotion:
    """The motion of a planar system in an autopilot's axes, and back.

    holdfast's axes are those of REP 103: z up, the heading psi counter-clockwise from x, surge
    ahead and sway to port. With the compass bearing b of the x axis:

        north = x cos b + y sin b        yaw      = b - psi
        east  = x sin b - y cos b        yaw rate = -psidot

    and the same for velocities and accelerations. The specific force in the body (forward, right,
    down) is

        f = (a_n cos yaw + a_e sin yaw,  -a_n sin yaw + a_e cos yaw,  -9.80665)

    where a is the derivative of (xdot, ydot) along the rates, with the inputs held. For a system
    whose velocity follows its inputs at once, `motion` adds the change of velocity at the
    beginning of the step over its length, so that the integral of f is the velocity.

    pose: the states that are x, y [m] and the heading [rad]. twist: the states that are surge and
    sway [m/s] and yaw rate [rad/s], those that the system has. bearing [rad]: b; 0 has x point
    north and y west, pi/2 has x point east and y north.

    Raises `DefinitionError` for a system without these states, with others besides them, or with
    rates that depend on the time.
    """

    @checked
    def __init__(
        self,
        system: System,
        *,
        pose: tuple[str, str, str] = ("x", "y", "psi"),
        twist: tuple[str, str, str] = ("u", "v", "r"),
        bearing: float = 0.0,
    ) -> None:
        owner = f"system '{system.name}'"
        if missing := [name for name in pose if name not in system.state_names]:
            raise DefinitionError(
                f"{owner} has no state '{missing[0]}'", expected="pose=(x, y, heading)"
            )
        if others := [name for name in system.state_names if name not in (*pose, *twist)]:
            raise DefinitionError(
                f"{owner} has the state '{others[0]}', which is neither of the pose nor of the "
                "twist",
                expected="pose=(x, y, heading), twist=(surge, sway, yaw rate)",
            )
        if any(TIME in rate.free_symbols for rate in system.rates.values()):
            raise DefinitionError(f"the rates of {owner} depend on the time")
        if not math.isfinite(bearing):
            raise DefinitionError(f"bearing is {bearing}", expected="radians")
        self.system, self.pose, self.twist, self.bearing = system, pose, twist, float(bearing)
        self._turn = math.cos(bearing), math.sin(bearing)
        self._places = [system.state_names.index(name) for name in pose]
        speeds = [system.rates[name] for name in pose]
        gained = [system.derivative(system.rates[name]) for name in pose[:2]]
        moving = [*system.states, *system.inputs, *system.disturbances]
        self._moving = Evaluator([*speeds, *gained], [q.symbol for q in moving], system.parameters)
        inputs = {u.symbol for u in system.inputs}
        self.follows_at_once = any(inputs & speed.free_symbols for speed in speeds[:2])

    def motion(
        self,
        t: float,
        state: Array,
        input: Array,
        pushed: Array,
        jump: tuple[float, float] = (0, 0),
    ) -> Motion:
        """The motion at a state, with the input that is held and the disturbances.

        jump [m/s^2]: added to the acceleration along x and y.

        state: shape (states,). input: shape (inputs,). pushed: shape (disturbances,).
        """
        row = np.concatenate([state, input, pushed])[np.newaxis]
        vx, vy, turn, ax, ay = self._moving.values(row)[0].tolist()
        x, y, psi = state[self._places].tolist()
        north, east = self.to_ground(x, y)
        v_north, v_east = self.to_ground(vx, vy)
        a_north, a_east = self.to_ground(ax + jump[0], ay + jump[1])
        yaw = self.bearing - psi
        cos, sin = math.cos(yaw), math.sin(yaw)
        return Motion(
            t=t,
            position=(north, east, 0.0),
            velocity=(v_north, v_east, 0.0),
            attitude=(0.0, 0.0, yaw),
            gyro=(0.0, 0.0, -turn),
            accel=(a_north * cos + a_east * sin, a_east * cos - a_north * sin, -GRAVITY),
        )

    def speed(self, state: Array, input: Array, pushed: Array) -> tuple[float, float]:
        """The velocity along x and y [m/s]. state: shape (states,). input: shape (inputs,). pushed:
        shape (disturbances,)."""
        row = np.concatenate([state, input, pushed])[np.newaxis]
        velocity = self._moving.values(row)[0]
        return float(velocity[0]), float(velocity[1])

    def states(self, motion: Motion) -> dict[str, float]:
        """The states of the system, by name, of a motion that an autopilot or a simulator tells.

        Surge and sway are the velocity over ground in the vehicle's axes, and so those of a marine
        vehicle only in still water. The yaw rate is that of the heading, also where the vehicle
        rolls and pitches. All are NaN where the attitude is not finite.
        """
        roll, pitch, yaw = motion.attitude
        if not all(map(math.isfinite, motion.attitude)):
            return dict.fromkeys(self.system.state_names, math.nan)
        x, y = self.from_ground(*motion.position[:2])
        north, east = motion.velocity[:2]
        _, q, r = motion.gyro
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = (q * math.sin(roll) + r * math.cos(roll)) / math.cos(pitch)
        by_name = dict(
            zip(self.pose, (x, y, math.remainder(self.bearing - yaw, 2 * math.pi)), strict=True)
        )
        moving = (north * cos + east * sin, north * sin - east * cos, -turn)
        by_name |= dict(zip(self.twist, moving, strict=True))
        return {name: by_name[name] for name in self.system.state_names}

    def to_ground(self, x: float, y: float) -> tuple[float, float]:
        """North and east of a vector along x and y."""
        cos, sin = self._turn
        return x * cos + y * sin, x * sin - y * cos

    def from_ground(self, north: float, east: float) -> tuple[float, float]:
        """The inverse of `to_ground`, which is the same reflection."""
        return self.to_ground(north, east)
