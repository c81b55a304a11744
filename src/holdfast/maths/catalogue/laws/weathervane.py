"""Hold station with a free heading (weathervaning): the baseline for the laws of chapter 3."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.control.surge_and_turn import surge_and_turn
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import angle, least, length, wrap
from holdfast.maths.reference_fields.dipole import UNSEEN


@checked
def weathervane(
    system: System,
    *,
    current_x: float = -0.1,
    current_y: float = 0.2,
    k1: float = 0.5,
    k2: float = 2.0,
    speed_limit: float | None = None,
    turn_limit: float | None = None,
) -> Law:
    """Hold the position at the origin in a known current V, with a free heading.

        w = -k1 r - V, at most speed_limit         the required velocity through the water
        u = w . h,   r = -k2 wrap(psi - phi) + d/dt phi,   phi the direction of w

    The vehicle comes to rest at the origin with its bow into the current: an equilibrium of
    (3.1), so no switching is needed, but psi = 0 is not reached. The speed is reduced where w turns
    faster than 0.8 turn_limit. The limits are those of `hold_station`. k1, k2 in 1/s; `current_x`,
    `current_y` [m/s] are the current the law believes in.
    """
    vehicle = surge_and_turn("weathervane", system, speed_limit, turn_limit)
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    current = (symbol("current_x"), symbol("current_y"))
    needed = [-symbol("k1") * r - v for r, v in zip((x, y), current, strict=True)]
    phi = angle(needed[1], needed[0], UNSEEN)
    size = length(needed[0], needed[1], UNSEEN)
    wanted = least(size, symbol("speed_limit")) * sp.cos(psi - phi)
    surge, turn = vehicle.along(phi, wanted, current)
    return Law(
        name="weathervane",
        reads=vehicle.reads,
        outputs={
            "u": surge,
            "r": vehicle.within_turn(-symbol("k2") * wrap(psi - phi) + turn),
        },
        parameters=(
            Parameter("current_x", "m/s", "current the law believes in", value=current_x),
            Parameter("current_y", "m/s", "current the law believes in", value=current_y),
            Parameter("k1", "1/s", "gain of the distance", value=k1, above=0, gain=True),
            Parameter("k2", "1/s", "heading gain", value=k2, above=0, gain=True),
            *vehicle.limits,
        ),
        conditions=(
            GainCondition(
                value=sp.sqrt(current[0] ** 2 + current[1] ** 2),
                limit=symbol("speed_limit"),
                consequence="the vehicle is not fast enough to stand against the current",
                source="equilibrium of (3.1)",
            ),
            *held_gain("k2"),
        ),
        believed={q.name: v for q, v in zip(vehicle.current, current, strict=True)},
        description="hold station in a known current, bow into it: the heading is left free",
        source="weathervaning, the usual alternative to the laws of thesis chapter 3",
    )
