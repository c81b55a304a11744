"""Unicycle in a current: the kinematics of a marine vehicle."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.bounds import Ball, Box
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.system import PfaffianRow, System


@checked
def drifting_unicycle(
    speed_limit: float = 10.0, turn_limit: float = 50.0, current_limit: float = 0.5
) -> System:
    """Unicycle in a uniform current (Vx, Vy): thesis (3.1).

        x' = u cos(psi) + Vx,   y' = u sin(psi) + Vy,   psi' = r

    The Pfaffian row -sin(psi) x' + cos(psi) y' = Vy cos(psi) - Vx sin(psi), (3.2), is
    acatastatic: the vehicle can rest only where it heads along the current (or against it) with
    u = -(Vx cos(psi) + Vy sin(psi)). Inputs: the speed u [m/s] through the water and the turn
    rate r [rad/s], bounded by `speed_limit` and `turn_limit`; the current is at most
    `current_limit` [m/s].
    """
    psi, u, r, vx, vy = (symbol(n) for n in ("psi", "u", "r", "Vx", "Vy"))
    fast, turn = symbol("speed_limit"), symbol("turn_limit")
    sin, cos = sp.sin(psi), sp.cos(psi)
    return System(
        name="drifting_unicycle",
        states=(
            Quantity("x", "m", "position"),
            Quantity("y", "m", "position"),
            Quantity("psi", "rad", "heading", angle=True),
        ),
        inputs=(
            Quantity("u", "m/s", "speed through the water"),
            Quantity("r", "rad/s", "turn rate"),
        ),
        disturbances=(
            Quantity("Vx", "m/s", "current along x", role="current"),
            Quantity("Vy", "m/s", "current along y", role="current"),
        ),
        rates={"x": u * cos + vx, "y": u * sin + vy, "psi": r},
        parameters=(
            Parameter("speed_limit", "m/s", "largest speed", value=speed_limit, above=0.0),
            Parameter("turn_limit", "rad/s", "largest turn rate", value=turn_limit, above=0.0),
            Parameter("current_limit", "m/s", "largest current", value=current_limit, above=0.0),
        ),
        input_bounds=Box((-fast, -turn), (fast, turn)),
        disturbance_bounds=Ball(symbol("current_limit"), 2),
        pfaffian=(PfaffianRow({"x": -sin, "y": cos}, vy * cos - vx * sin),),
        description="unicycle-like marine vehicle in a current, kinematics only",
        source="thesis (3.1), (3.2)",
    )
