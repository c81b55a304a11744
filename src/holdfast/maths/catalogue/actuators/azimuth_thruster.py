"""An azimuth thruster: a force of any direction and of bounded size."""

from __future__ import annotations

import math

import sympy as sp

from holdfast.maths.definitions.actuator import Actuator, ActuatorKind
from holdfast.maths.definitions.bounds import Ball
from holdfast.maths.definitions.quantity import Quantity


def azimuth_thruster(name: str, x: sp.Expr, y: sp.Expr, limit: sp.Expr) -> Actuator:
    """At (x, y) [m], with the force (NAME_x, NAME_y) ahead and to port, |force| <= limit [N].

    Its thrust is the size of the force, its angle the direction, which turns at once. One newton
    ahead gives (1, 0, -y), one to port (0, 1, x).
    """
    return Actuator(
        (
            Quantity(f"{name}_x", "N", f"force of {name} ahead"),
            Quantity(f"{name}_y", "N", f"force of {name} to port"),
        ),
        ((sp.S.One, sp.S.Zero, -y), (sp.S.Zero, sp.S.One, x)),
        Ball(limit, 2),
    )


AZIMUTH_THRUSTER = ActuatorKind(
    "azimuth thruster",
    {
        "x": ("m", "place ahead of the origin", -math.inf),
        "y": ("m", "place to port of the origin", -math.inf),
        "limit": ("N", "largest force, in every direction", 0.0),
    },
    optional=(),
    fixed=("x", "y"),
    build=azimuth_thruster,
)
