"""Steer a unicycle to the origin along a dipolar field: two laws of the thesis."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.unicycle import unicycle
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import System, check_rates
from holdfast.maths.expressions.functions import least, length, magnitude, select, sgn, wrap
from holdfast.maths.reference_fields.dipole import UNSEEN, dipolar_field, field_angle

DISTANCE = "a speed that is held and late overshoots the origin"


@checked
def steer_unicycle(
    system: System, *, k1: float = 1.0, k: float = 4.0, lam: float = 3.0, freeze: float = 1e-4
) -> Law:
    """Steer a unicycle to the origin with heading 0 along a dipolar field.

        v = -k1 sgn(x cos(psi) + y sin(psi)) rho sigma                            (4.14)
        r = -k wrap(psi - phi) + d/dt phi,   phi the direction of F               (4.13)
        sigma = min(1, 0.8 turn_limit / |d/dt phi|)

    rho = |(x, y)|, at most speed_limit / k1. The factor sigma slows the vehicle where the
    field turns faster than the vehicle can: without it a bounded turn rate makes the line
    x cos(psi) + y sin(psi) = 0 attractive and many starts do not converge. For rho < `freeze`
    [m], where phi is not defined, v = 0 and r = -k psi. Gains k1, k [1/s], lam > 1.
    """
    x, y, psi = _pose("steer_unicycle", system)
    s = {n: symbol(n) for n in ("k1", "k", "lam", "freeze", "speed_limit", "turn_limit")}
    rho = length(x, y, UNSEEN)
    forward = -_towards(x, y, psi) * least(s["k1"] * rho, s["speed_limit"])
    field = dipolar_field((x, y), s["lam"], (1, 0))
    phi = field_angle(field, UNSEEN)
    turn = forward * (phi.diff(x) * sp.cos(psi) + phi.diff(y) * sp.sin(psi))
    slower = least(1, sp.Rational(4, 5) * s["turn_limit"] / (magnitude(turn) + sp.Float(1e-12)))
    outside = rho - s["freeze"]
    return Law(
        name="steer_unicycle",
        reads=system.states,
        outputs={
            "v": select(outside, slower * forward, sp.S.Zero),
            "r": select(outside, -s["k"] * wrap(psi - phi) + slower * turn, -s["k"] * wrap(psi)),
        },
        parameters=(
            Parameter("k1", "1/s", "gain of the distance", value=k1, above=0, gain=True),
            Parameter("k", "1/s", "heading gain", value=k, above=0, gain=True),
            Parameter("lam", "1", "exponent lambda of the dipolar field", value=lam, above=1),
            Parameter("freeze", "m", "distance of the final turn", value=freeze, above=0),
            *system.quantities(("speed_limit", "turn_limit"), "steer_unicycle"),  # type: ignore[arg-type]
        ),
        conditions=held_gain("k1", consequence=DISTANCE) + held_gain("k"),
        description="go to the origin with heading 0 along a dipolar field, within input limits",
        source="thesis (4.13), (4.14), with speed scaling",
    )


@checked
def align_unicycle(
    system: System,
    *,
    k: float = 2.0,
    epsilon: float = 0.05,
    freeze: float = 1e-4,
    output: str = "angle",
    travel: str = "toward",
) -> Law:
    """Steer a unicycle along the field (2.14) at the speed tanh(rho).

        F = (2 cos^2 phi - sin^2 phi, 3 sin phi cos phi),  phi = atan2(y, x)     (2.14)

    `output` = "h": hdot = -k h for h = <a, F> (2.15), with the sign of the second term
    corrected to plus; where |dh/dpsi| <= `epsilon`, r = k wrap(psi_F - psi) (2.16). h = 0 also
    means the opposite heading, and the vehicle may arrive with it. "angle": r = -k wrap(psi -
    psi_F) + d/dt psi_F, which is free of both. `travel` = "forward" is the thesis's v =
    tanh(rho), with which some starts leave on lines that lead far away; "toward" takes the
    sense of (4.14). For rho < `freeze` [m], v = 0 and r = -k psi. k in 1/s.
    """
    for what, value, choices in (
        ("output", output, ("h", "angle")),
        ("travel", travel, ("toward", "forward")),
    ):
        if value not in choices:
            raise DefinitionError(
                f"{what} of align_unicycle is {value!r}", expected=" or ".join(map(repr, choices))
            )
    x, y, psi = _pose("align_unicycle", system)
    s = {n: symbol(n) for n in ("k", "epsilon", "freeze")}
    rho = length(x, y, UNSEEN)
    speed = sp.tanh(rho)
    forward = speed if travel == "forward" else -_towards(x, y, psi) * speed
    squared = x**2 + y**2 + UNSEEN
    field = ((2 * x**2 - y**2) / squared, 3 * x * y / squared)
    heading = field_angle(field, UNSEEN)
    error = wrap(psi - heading)

    def rate(e: sp.Expr) -> sp.Expr:
        return forward * (e.diff(x) * sp.cos(psi) + e.diff(y) * sp.sin(psi))

    turn = -s["k"] * error + rate(heading)
    if output == "h":
        h = -sp.sin(psi) * field[0] + sp.cos(psi) * field[1]
        slope = h.diff(psi)
        regular = magnitude(slope) - s["epsilon"]
        aligned = (-s["k"] * h - rate(h)) / select(regular, slope, sp.S.One)
        turn = select(regular, aligned, -s["k"] * error)
    outside = rho - s["freeze"]
    return Law(
        name="align_unicycle",
        reads=system.states,
        outputs={
            "v": select(outside, forward, sp.S.Zero),
            "r": select(outside, turn, -s["k"] * wrap(psi)),
        },
        parameters=(
            Parameter("k", "1/s", "decay rate of the misalignment", value=k, above=0, gain=True),
            Parameter("epsilon", "1", "least |dh/dpsi| to divide by", value=epsilon, above=0),
            Parameter("freeze", "m", "distance of the final turn", value=freeze, above=0),
        ),
        conditions=held_gain("k"),
        description="go to the origin along the field of a point dipole, at bounded speed",
        source="thesis (2.14)-(2.16), corrected, and (4.14)",
    )


def _pose(law: str, system: System) -> tuple[sp.Symbol, sp.Symbol, sp.Symbol]:
    check_rates(law, system, unicycle)
    return symbol("x"), symbol("y"), symbol("psi")


def _towards(x: sp.Expr, y: sp.Expr, psi: sp.Expr) -> sp.Expr:
    return sgn(x * sp.cos(psi) + y * sp.sin(psi))
