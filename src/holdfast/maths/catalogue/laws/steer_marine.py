"""Steer a marine vehicle to a pose along a dipolar field, by surge and yaw rate."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked, renamed
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.marine_vehicle import surge_inertia, sway_inertia
from holdfast.maths.control.gain_conditions import held_gain, surge_gain_limit
from holdfast.maths.control.surge_and_turn import measured_current
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import length, sgn, wrap
from holdfast.maths.reference_fields.dipole import GUARD, dipolar_field, field_angle


@renamed(measured="disturbance_measured")
@checked
def steer_marine(
    system: System,
    *,
    goal_x: float = -0.5,
    goal_y: float = 0.0,
    k1: float = 0.16,
    mu: float = 1.5,
    k2: float = 1.0,
    lam: float = 3.0,
    disturbance_measured: bool = False,
) -> Law:
    """Steer a marine vehicle to (goal_x, goal_y) with heading 0 along a dipolar field.

        u = -k1 sgn(r1 . h) tanh(mu |r1|)                     (5.18a)
        r = -k2 wrap(psi - phi) + grad(phi) . (xdot, ydot)    (5.18b)

    r1 = (x - goal_x, y - goal_y), h = (cos psi, sin psi), phi the direction of the dipolar
    field F(r1) (5.17). In grad(phi) . (xdot, ydot) the surge is the commanded one (5.18a)
    and the sway the measured one (E8). Outputs: surge u [m/s], yaw rate r [rad/s].

    In a current the same law is (5.31): u and v are relative to the water, and xdot, ydot those
    over ground. With `disturbance_measured` the law measures the current at every
    instant, as Lemma 3 needs; without, it assumes still water. The vehicle then ends within
    `lyapunov.ultimate_bound` of the goal, heading along the current or against it.

    Gains: k1 [m/s] the top speed, mu [1/m], k2 [1/s], lam (lambda > 1). Condition for
    convergence of the heading: k1 mu below `lyapunov.surge_gain_limit` (E6).
    """
    if not isinstance(disturbance_measured, bool):
        raise DefinitionError(
            f"disturbance_measured of steer_marine is {disturbance_measured!r}",
            expected="true or false",
        )
    sensed = measured_current("steer_marine", system) if disturbance_measured else ()
    vx, vy = (q.symbol for q in sensed) if sensed else (sp.S.Zero, sp.S.Zero)
    x, y, psi, v = (symbol(n) for n in ("x", "y", "psi", "v"))
    s = {n: symbol(n) for n in ("goal_x", "goal_y", "k1", "mu", "k2", "lam")}
    x1, y1 = x - s["goal_x"], y - s["goal_y"]
    cos, sin = sp.cos(psi), sp.sin(psi)
    phi = field_angle(dipolar_field((x1, y1), s["lam"], (1, 0)))
    surge = -s["k1"] * sgn(x1 * cos + y1 * sin) * sp.tanh(s["mu"] * length(x1, y1, GUARD**2))
    position_rate = {"x": surge * cos - v * sin + vx, "y": surge * sin + v * cos + vy}
    turn = phi.diff(x) * position_rate["x"] + phi.diff(y) * position_rate["y"]
    needed = ("mass", "Xudot", "Yvdot", "Yv")
    plant = tuple(p for p in system.parameters if p.name in needed)
    system.quantities(needed, "steer_marine")
    return Law(
        name="steer_marine",
        reads=(*system.quantities(("x", "y", "psi", "v"), "steer_marine"), *sensed),
        outputs={"u": surge, "r": -s["k2"] * wrap(psi - phi) + turn},
        parameters=(
            Parameter("goal_x", "m", "goal position", value=goal_x),
            Parameter("goal_y", "m", "goal position", value=goal_y),
            Parameter("k1", "m/s", "top surge speed", value=k1, above=0, gain=True),
            Parameter(
                "mu", "1/m", "steepness of the speed near the goal", value=mu, above=0, gain=True
            ),
            Parameter("k2", "1/s", "heading gain", value=k2, above=0, gain=True),
            Parameter("lam", "1", "exponent lambda of the dipolar field", value=lam, above=1),
            *plant,
        ),
        conditions=(
            GainCondition(
                value=s["k1"] * s["mu"],
                limit=surge_gain_limit(symbol("Yv"), surge_inertia(), sway_inertia(), s["lam"]),
                consequence="the sway outpaces the approach and the heading does not converge",
                source="correction E6 of thesis Theorem 1",
            ),
            *held_gain("k2"),
        ),
        description="go to a pose along a dipolar field, by surge and yaw rate",
        source="thesis (5.17), (5.18), (5.31), corrections E6-E8",
    )
