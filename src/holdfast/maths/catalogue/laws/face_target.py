"""Face a target at the origin and go to a circle around it."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import angle, length, sgn, wrap
from holdfast.maths.reference_fields.dipole import GUARD


@checked
def face_target(
    system: System,
    *,
    distance: float = 0.5,
    k1: float = 0.16,
    mu: float = 1.5,
    kv: float = 1.5,
    as_printed: bool = False,
) -> Law:
    """Face a target at the origin and go straight to the circle of radius `distance`.

        u = -k1 sgn(r1 . h) tanh(mu |r1|),  r1 = (x, y) + distance (cos phi_t, sin phi_t)   (5.28)
        r = -kv wrap(psi - phi_t),          phi_t = atan2(-y, -x)

    The viable law at the edges of the view, and the one that keeps the goal set
    G = { |(x, y)| = distance, psi = phi_t }. The thesis prints the goal point with the opposite
    sign, which puts it behind the wall (E3); `as_printed` reproduces that. In a current the
    law is (5.41), u and r relative to the water. Outputs: surge u [m/s], yaw rate r [rad/s].
    """
    if not isinstance(as_printed, bool):
        raise DefinitionError(
            f"as_printed of face_target is {as_printed!r}", expected="true or false"
        )
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    s = {n: symbol(n) for n in ("distance", "k1", "mu", "kv")}
    bearing = angle(-y, -x, GUARD**2)
    away = -s["distance"] if as_printed else s["distance"]
    x1, y1 = x + away * sp.cos(bearing), y + away * sp.sin(bearing)
    ahead = sgn(x1 * sp.cos(psi) + y1 * sp.sin(psi))
    return Law(
        name="face_target",
        reads=system.quantities(("x", "y", "psi"), "face_target"),
        outputs={
            "u": -s["k1"] * ahead * sp.tanh(s["mu"] * length(x1, y1, GUARD**2)),
            "r": -s["kv"] * wrap(psi - bearing),
        },
        parameters=(
            Parameter("distance", "m", "distance to the target", value=distance, above=0.0),
            Parameter("k1", "m/s", "top surge speed", value=k1, above=0, gain=True),
            Parameter(
                "mu", "1/m", "steepness of the speed near the goal", value=mu, above=0, gain=True
            ),
            Parameter("kv", "1/s", "heading gain", value=kv, above=0, gain=True),
        ),
        conditions=held_gain("kv"),
        description="face the target and go to a circle around it",
        source="thesis (5.28), (5.41) "
        + ("as printed" if as_printed else "with the sign of E3, section 5.4.3"),
    )
