"""Underactuated marine vehicle: surge force and yaw moment, no sway actuator."""

from __future__ import annotations

import math

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.catalogue.actuators.thruster import thruster
from holdfast.maths.catalogue.systems.planar_craft import planar_craft
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.vehicle_file import overridden, takes, vehicle_for

_ANY, _POSITIVE = -math.inf, 0.0

PARAMETERS: dict[str, tuple[str, str, float]] = {
    "mass": ("kg", "rigid-body mass m", _POSITIVE),
    "Iz": ("kg m^2", "yaw moment of inertia", _POSITIVE),
    "Xudot": ("kg", "surge added mass (negative)", _ANY),
    "Yvdot": ("kg", "sway added mass (negative)", _ANY),
    "Nrdot": ("kg m^2", "yaw added inertia (negative)", _ANY),
    "Xu": ("N s/m", "linear surge drag (negative)", _ANY),
    "Yv": ("N s/m", "linear sway drag (negative)", _ANY),
    "Nr": ("N m s", "linear yaw drag (negative)", _ANY),
    "Xuu": ("N s^2/m^2", "quadratic surge drag (negative)", _ANY),
    "Yvv": ("N s^2/m^2", "quadratic sway drag (negative)", _ANY),
    "Nrr": ("N m s^2", "quadratic yaw drag (negative)", _ANY),
    "thrust_limit": ("N", "largest force of one thruster, astern too unless given", _POSITIVE),
    "thrust_astern": ("N", "largest force of one thruster astern", _POSITIVE),
    "thruster_arm": ("m", "distance of each thruster from the centre line", _POSITIVE),
    "current_limit": ("m/s", "largest speed of the current", _ANY),
}
"""Name -> (unit, meaning, exclusive lower limit) of every parameter, in SI units."""

ASTERN = "thrust_astern"


@takes(PARAMETERS, optional=(ASTERN,))
@checked
def marine_vehicle(
    vehicle: str = "videoray_pro_iii", as_printed: bool = False, **overrides: float
) -> System:
    """Underactuated marine vehicle on the horizontal plane, in a uniform current.

        xdot = u cos(psi) - v sin(psi) + Vx        m11 udot =  m22 v r + Xu u + Xuu |u| u + tau_u
        ydot = u sin(psi) + v cos(psi) + Vy        m22 vdot = -m11 u r + Yv v + Yvv |v| v
        psidot = r             m33 rdot = (m11 - m22) u v + Nr r + Nrr |r| r + tau_r

    with m11 = mass - Xudot, m22 = mass - Yvdot, m33 = Iz - Nrdot; u, v are relative to the
    water. Thesis (5.14), and (5.30) with the current (Vx, Vy) in the earth frame, taken from
    a ball of radius `current_limit` and zero unless a scenario gives one. The Pfaffian
    row is (5.15): -sin(psi) xdot + cos(psi) ydot = v + current across the hull.

    Inputs: surge force tau_u [N] and yaw moment tau_r [N m] of two thrusters in
    [-thrust_astern, thrust_limit], `thruster_arm` off the centre line: tau_u = Fp + Fs,
    tau_r = arm (Fs - Fp). z is up and psi counter-clockwise, so that more port thrust turns
    the vehicle to starboard (negative yaw).

    as_printed: whether, as in the thesis's (7.2), Xudot r times the current across the hull is
    added to m11 udot, and -Yvdot r times the current along it to m22 vdot. These terms appear if
    the added mass acts on the absolute acceleration, and cancel if it acts on the relative one.

    vehicle: a shipped vehicle, or the path of a vehicle file. overrides: numbers by name, in SI
    units, in place of those of the file (`PARAMETERS`). A thruster without `thrust_astern` gives
    thrust_limit both ways.

    Raises `ScenarioError` for an unknown vehicle or name.
    """
    numbers = dict(vehicle_for(vehicle, PARAMETERS, optional=(ASTERN,)).parameters)
    if ASTERN in overrides and ASTERN not in numbers:
        unit, meaning, above = PARAMETERS[ASTERN]
        numbers[ASTERN] = Parameter(ASTERN, unit, meaning, value=1.0, above=above)
    parameters = overridden(numbers, overrides, "marine_vehicle")
    p = {n: symbol(n) for n in PARAMETERS}
    arm, limit = p["thruster_arm"], p["thrust_limit"]
    astern = p[ASTERN] if ASTERN in parameters else limit
    return planar_craft(
        "marine_vehicle",
        (parameters[n] for n in PARAMETERS if n in parameters),
        (
            thruster("port", sp.S.Zero, arm, 0.0, limit, astern),
            thruster("starboard", sp.S.Zero, -arm, 0.0, limit, astern),
        ),
        description="underactuated marine vehicle, two aft thrusters, in a current",
        source="thesis (7.2) as printed" if as_printed else "thesis (5.14), (5.15), (5.30)",
        extra=_printed_terms() if as_printed else None,
    )


def _printed_terms() -> dict[str, sp.Expr]:
    """What (7.2) has beside (5.30): added mass that acts on the absolute acceleration."""
    psi, r, vx, vy = (symbol(n) for n in ("psi", "r", "Vx", "Vy"))
    sin, cos = sp.sin(psi), sp.cos(psi)
    return {
        "u": symbol("Xudot") * (vy * cos - vx * sin) * r,
        "v": -symbol("Yvdot") * (vx * cos + vy * sin) * r,
    }


def surge_inertia() -> sp.Expr:
    """m11 = mass - Xudot [kg]."""
    return symbol("mass") - symbol("Xudot")


def sway_inertia() -> sp.Expr:
    """m22 = mass - Yvdot [kg]."""
    return symbol("mass") - symbol("Yvdot")
