"""A fixed thruster: a force along one direction, between two limits."""

from __future__ import annotations

import math

import sympy as sp

from holdfast.maths.definitions.actuator import Actuator, ActuatorKind
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.quantity import Quantity

EXACT = 15
"""Multiples of this angle [deg] have a sine and a cosine without rounding."""


def thruster(
    name: str, x: sp.Expr, y: sp.Expr, direction: float, ahead: sp.Expr, astern: sp.Expr
) -> Actuator:
    """At (x, y) [m], pushing along `direction` [rad] with a force from -astern to ahead [N].

    direction counter-clockwise from ahead. One newton gives (cos a, sin a, x sin a - y cos a).
    """
    degrees = math.degrees(direction)
    near = EXACT * round(degrees / EXACT)
    exact = abs(degrees - near) < 1e-9 * max(1.0, abs(near))
    angle = sp.pi * sp.Rational(near, 180) if exact else sp.Float(direction)
    cos, sin = sp.cos(angle), sp.sin(angle)
    return Actuator(
        (Quantity(name, "N", f"force of {name}"),),
        ((cos, sin, x * sin - y * cos),),
        Box((-astern,), (ahead,)),
    )


THRUSTER = ActuatorKind(
    "thruster",
    {
        "x": ("m", "place ahead of the origin", -math.inf),
        "y": ("m", "place to port of the origin", -math.inf),
        "direction": ("rad", "where it pushes, counter-clockwise from ahead", -math.inf),
        "ahead": ("N", "largest force along its direction", 0.0),
        "astern": ("N", "largest force against its direction", 0.0),
        "lag": ("s", "time constant of its force", 0.0),
        "slew": ("N/s", "fastest change of its force", 0.0),
    },
    optional=("lag", "slew"),
    fixed=("x", "y", "direction"),
    build=thruster,
)
