"""Move straight ahead or straight back, away from a range limit."""

from __future__ import annotations

import sympy as sp

from holdfast.maths.functions import magnitude
from holdfast.maths.law import Law
from holdfast.maths.quantity import Parameter, symbol


def back_off(law: Law, *, creep: float = 0.02) -> Law:
    """Straight back: u = -(|u_convergent| + creep), r = 0; the viable law at the near limit.

    The thesis keeps u of (5.18a) there, which drives the vehicle across the limit whenever
    the goal lies behind it (E4). `creep` [m/s] keeps it moving when the convergent surge is
    zero.
    """
    return _straight(law, "back_off", -1, creep, "straight back from the near range limit")


def move_ahead(law: Law, *, creep: float = 0.02) -> Law:
    """Straight ahead: u = |u_convergent| + creep, r = 0; the viable law at the far limit."""
    return _straight(law, "move_ahead", 1, creep, "straight ahead from the far range limit")


def _straight(law: Law, name: str, direction: int, creep: float, description: str) -> Law:
    speed = magnitude(law.outputs["u"]) + symbol("creep")
    return Law(
        name=name,
        reads=law.reads,
        outputs={"u": direction * speed, "r": sp.S.Zero},
        parameters=(
            *law.parameters,
            Parameter("creep", "m/s", "speed beyond the convergent one", value=creep, above=0.0),
        ),
        description=description,
        source="thesis section 5.4.3, correction E4",
    )
