"""A rudder: a force across the hull that grows with its angle and with the square of the speed."""

from __future__ import annotations

import math

import sympy as sp

from holdfast.maths.definitions.actuator import Actuator, ActuatorKind
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.expressions.functions import magnitude


def rudder(name: str, x: sp.Expr, lift: sp.Expr, limit: sp.Expr) -> Actuator:
    """At x [m] ahead of the origin, with an angle NAME within +-limit [rad].

        tau_v = lift |u| u NAME,   tau_r = x tau_v,       lift in N s^2/(m^2 rad)

    of the surge u through the water: in the coefficients of a manoeuvring model lift is Y_uudelta
    and x lift is N_uudelta. A positive angle pushes to port, so that a craft with its rudder astern
    turns to starboard. There is no force without speed. The drag of the angle is left out.
    """
    surge = symbol("u")
    force = lift * magnitude(surge) * surge
    return Actuator(
        (Quantity(name, "rad", f"angle of {name}"),),
        ((sp.S.Zero, force, x * force),),
        Box((-limit,), (limit,)),
    )


RUDDER = ActuatorKind(
    "rudder",
    {
        "x": ("m", "place of its force ahead of the origin", -math.inf),
        "lift": ("N s^2/m^2", "force to port by angle and square of the speed", 0.0),
        "limit": ("rad", "largest angle", 0.0),
        "lag": ("s", "time constant of its angle", 0.0),
        "slew": ("rad/s", "fastest change of its angle", 0.0),
    },
    optional=("lag", "slew"),
    fixed=("x",),
    build=rudder,
)
