"""Dock an underactuated marine vehicle at the origin along the field lambda = 2: two laws."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.marine_vehicle import surge_inertia, sway_inertia
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import least, length, select, sgn, wrap
from holdfast.maths.reference_fields.dipole import UNSEEN, dipolar_field, field_angle


@checked
def dock_marine(system: System, *, k1: float = 0.2, k2: float = 2.0, freeze: float = 0.01) -> Law:
    """Dock a marine vehicle at the origin with heading 0, exponentially.

        u_d = -k1 sgn(x) rho cos(psi - phi) / sqrt(1 + rho^2),    phi = 2 atan2(y, x)
        r_d = -k2 wrap(psi - phi) + d/dt phi                                     (4.34)

    The bounded form of (4.38), which converges only as 1/t. d/dt phi is taken along the
    measured surge and sway. For rho < `freeze` [m], where d/dt phi is of the order of
    v / rho, r_d = -k2 psi. Outputs: surge u [m/s], yaw rate r [rad/s].

    Converges only for k1 < min(|Yv| / m22, |Yv| / (2 m11)); beyond it the hull side-slips
    into the origin in finite time. Raises `DefinitionError` for gains outside.
    """
    x, y, psi, phi, turn, parameters = _approach("dock_marine", system, k1, k2, freeze)
    rho = length(x, y, UNSEEN)
    k = symbol("k1")
    drag = -symbol("Yv")
    condition = GainCondition(
        value=k,
        limit=least(drag / sway_inertia(), drag / (2 * surge_inertia())),
        consequence="the sway outpaces the approach and the hull side-slips into the origin",
        source="linearised closed loop; opposite to thesis appendix 4.6",
    )
    if message := condition.violation({p.symbol: p.value for p in parameters}):
        raise DefinitionError(message)
    surge = -k * sgn(x) * rho * sp.cos(psi - phi) / sp.sqrt(1 + rho**2)
    return Law(
        name="dock_marine",
        reads=system.quantities(("x", "y", "psi", "u", "v"), "dock_marine"),
        outputs={
            "u": surge,
            "r": select(rho - symbol("freeze"), turn, -symbol("k2") * wrap(psi)),
        },
        parameters=parameters,
        conditions=(condition, *held_gain("k2")),
        description="dock at the origin with heading 0, exponentially, by surge and yaw rate",
        source="thesis (4.33), (4.34), (4.38) made bounded, with its gain condition",
    )


@checked
def project_marine(
    system: System, *, k1: float = 0.2, k2: float = 2.0, freeze: float = 1e-6
) -> Law:
    """Dock a marine vehicle by the projection of the field on the heading, as the thesis does.

        u_d = -k1 sgn(x) <F, (cos psi, sin psi)> = -k1 sgn(x) rho^2 cos(psi - phi)   (4.38)
        r_d = -k2 wrap(psi - phi) + d/dt phi                                        (4.34)

    with F = (x^2 - y^2, 2 x y) (4.33). The distance falls as 1 / (k1 t) only: 1.7 cm after
    60 s at k1 = 1. A large k1 does not help: the hull then side-slips into the origin (thesis
    appendix 4.6 asks for large k1; the opposite holds). Use `dock_marine` instead.
    k1 in 1/(m s), k2 in 1/s, `freeze` as in `dock_marine`.
    """
    x, y, psi, _, turn, parameters = _approach(
        "project_marine", system, k1, k2, freeze, unit="1/(m s)"
    )
    field = dipolar_field((x, y), sp.Integer(2), (1, 0))
    along = field[0] * sp.cos(psi) + field[1] * sp.sin(psi)
    rho = length(x, y, UNSEEN)
    return Law(
        name="project_marine",
        reads=system.quantities(("x", "y", "psi", "u", "v"), "project_marine"),
        outputs={
            "u": -symbol("k1") * sgn(x) * along,
            "r": select(rho - symbol("freeze"), turn, -symbol("k2") * wrap(psi)),
        },
        parameters=parameters,
        conditions=held_gain("k2"),
        description="dock at the origin by the projection of the field on the heading (slow)",
        source="thesis (4.33), (4.34), (4.38)",
    )


def _approach(
    law: str, system: System, k1: float, k2: float, freeze: float, unit: str = "1/s"
) -> tuple[sp.Symbol, sp.Symbol, sp.Symbol, sp.Expr, sp.Expr, tuple[Parameter, ...]]:
    x, y, psi, u, v = (symbol(n) for n in ("x", "y", "psi", "u", "v"))
    field = dipolar_field((x, y), sp.Integer(2), (1, 0))
    phi = field_angle(field, UNSEEN)
    rates = (u * sp.cos(psi) - v * sp.sin(psi), u * sp.sin(psi) + v * sp.cos(psi))
    turn = -symbol("k2") * wrap(psi - phi) + phi.diff(x) * rates[0] + phi.diff(y) * rates[1]
    needed = ("mass", "Xudot", "Yvdot", "Yv")
    system.quantities(needed, law)
    return (
        x,
        y,
        psi,
        phi,
        turn,
        (
            Parameter("k1", unit, "gain of the distance", value=k1, above=0, gain=True),
            Parameter("k2", "1/s", "heading gain", value=k2, above=0, gain=True),
            Parameter("freeze", "m", "distance of the final turn", value=freeze, above=0),
            *(p for p in system.parameters if p.name in needed),
        ),
    )
