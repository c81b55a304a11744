"""Unicycle: the wheeled robot that cannot move sideways."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.system import PfaffianRow, System


@checked
def unicycle(speed_limit: float = 1.0, turn_limit: float = 2.0) -> System:
    """Unicycle: xdot = v cos(psi), ydot = v sin(psi), psidot = r; thesis (2.10).

    The Pfaffian row is -sin(psi) xdot + cos(psi) ydot = 0: no sideways motion. Inputs are
    the speed v [m/s] in [-speed_limit, speed_limit] and the turn rate r [rad/s] likewise.
    """
    psi, v, r = symbol("psi"), symbol("v"), symbol("r")
    fast, turn = symbol("speed_limit"), symbol("turn_limit")
    return System(
        name="unicycle",
        states=(
            Quantity("x", "m", "position"),
            Quantity("y", "m", "position"),
            Quantity("psi", "rad", "heading", angle=True),
        ),
        inputs=(Quantity("v", "m/s", "speed"), Quantity("r", "rad/s", "turn rate")),
        rates={"x": v * sp.cos(psi), "y": v * sp.sin(psi), "psi": r},
        parameters=(
            Parameter("speed_limit", "m/s", "largest speed", value=speed_limit, above=0.0),
            Parameter("turn_limit", "rad/s", "largest turn rate", value=turn_limit, above=0.0),
        ),
        input_bounds=Box((-fast, -turn), (fast, turn)),
        pfaffian=(PfaffianRow({"x": -sp.sin(psi), "y": sp.cos(psi)}),),
        description="wheeled robot that cannot move sideways",
        source="thesis (2.10)",
    )
