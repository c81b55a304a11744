"""Rest in a current with a target in view: on the ray through the target along the current."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.control.surge_and_turn import measured_current
from holdfast.maths.control.view_legs import AHEAD, BACK, leg_parameters, view_legs
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import (
    angle,
    clip,
    greatest,
    least,
    length,
    magnitude,
    sgn,
    wrap,
)
from holdfast.maths.reference_fields.dipole import GUARD

HOME = "home"
GAINS = ("k1", "mu", "kv", "kb", "leg_speed")
STILL = sp.Rational(1, 100)
"""Current [m/s] up to which the goal is straight before the target."""


@checked
def rest_in_current(
    system: System,
    *,
    distance: float = 1.2,
    k1: float = 0.2,
    mu: float = 0.9,
    kv: float = 8.0,
    kb: float = 0.12,
    leg_speed: float = 0.8,
    exponent: float = 1.5,
    half_angle: float = 0.5235987755982988,
    target_half_width: float = 0.10,
    range_min: float = 0.35,
    range_max: float = 2.0,
    leg_margin: float = 0.02,
    far_margin: float = 0.1,
    near_margin: float = 0.3,
    clearance: float = 0.1,
    turn_first: float = 0.15,
    swing: float = 0.1,
    settle: float = 0.015,
    far_share: float = 1.0,
    lead: float = 0.0,
    bearing_max: float = 1.35,
    hold_in: float = 0.008,
    hold_out: float = 0.003,
) -> Switching:
    """Rest in a measured current, `distance` from a target at the origin that stays in view.

    A vehicle without a sway actuator rests only along the current (Vx, Vy) = V (cos theta, sin
    theta): stern to it, psi* = theta, or bow to it, psi* = theta + pi. The wall x = 0 is seen for
    cos psi* > 0, which one of them fulfils unless the current is along the wall. The target is
    straight ahead at (-R cos psi*, -R sin psi*, psi*): an equilibrium for every R in view.
    With the bearing beta = atan2(-y, -x) of the target and psi = beta + delta,

        R'    = -(u cos delta - v sin delta + Vr),   Vr = Vx cos beta + Vy sin beta
        beta' = -(u sin delta + v cos delta + Vt)/R,  Vt = Vy cos beta - Vx sin beta

    so that at a constant range the current itself carries the vehicle to e = wrap(beta - psi*) = 0,
    if A = sgn(e) Vt + |Vr| tan(leg) > 0, leg(R) = half_angle - half the angle of the target -
    leg_margin: from everywhere with the bow, from |e| < leg with the stern to the current. Modes:

        home:   R' = -k1 tanh(mu (R - distance)),  beta' = -kb e - the way home of inspect_target
        ahead:  u = leg_speed / cos delta,  delta =  leg clip(20 e, +-1)
        back:   u = -leg_speed / cos delta, delta = -leg clip(20 e, +-1)
        r = lead beta' - kv wrap(psi - beta - delta),    beta' at the speed u without sway

    Home gives way to a leg if A <= hold_out and the way home is too short to mend e; it returns as
    A >= hold_in or one leg suffices. A leg back ends `far_margin` [m] before the largest range, one
    ahead `near_margin` before the least, both at the heading that the next leg turns to. With
    `far_share` below 1 a leg back goes on: only that share of the offset of the next leg counts,
    which begins less steep, as the range allows. Legs have to be long for a craft that turns
    slowly, and its heading lags a bearing that moves: `lead` = 1 makes up for it, 0 leaves the term
    out. A leg waits, at its range, until its heading is right to `turn_first` [rad]; `swing` [rad]
    is the bearing lost in turning. Below 1 cm/s of current the goal is straight before the target;
    between there and 2 cm/s it turns. The goal's bearing is within `bearing_max`: in a current
    nearer to the wall the vehicle stays in view by legs without coming to rest.

    The law does not keep the view by itself: add a safety filter that measures the current
    (`safeguard`, measured). What arrives is measured (docs/currents.md). Lengths in m, angles in
    rad. Outputs: surge u [m/s] through the water, yaw rate r [rad/s].

    Raises `DefinitionError` for a system without a current, exponent <= 1, a target that
    fills the view at `distance`, and a distance outside the range limits.
    """
    values = {
        "distance": (distance, "m", "distance of the goal from the target"),
        "k1": (k1, "m/s", "top speed over ground of the way home"),
        "mu": (mu, "1/m", "steepness of the speed near the goal"),
        "kv": (kv, "1/s", "heading gain"),
        "kb": (kb, "1/s", "bearing gain"),
        "leg_speed": (leg_speed, "m/s", "speed of a leg through the water"),
        "exponent": (exponent, "1", "exponent n of the way home"),
        "half_angle": (half_angle, "rad", "half angle of view alpha"),
        "target_half_width": (target_half_width, "m", "half-width yT"),
        "range_min": (range_min, "m", "least laser range Lmin"),
        "range_max": (range_max, "m", "largest laser range Lmax"),
        "leg_margin": (leg_margin, "rad", "distance of the legs from the edge of the view"),
        "far_margin": (far_margin, "m", "margin of backing up to the largest range"),
        "near_margin": (near_margin, "m", "margin of going ahead to the least range"),
        "clearance": (clearance, "m", "least depth of a leg back"),
        "turn_first": (turn_first, "rad", "heading error above which a leg waits"),
        "swing": (swing, "rad", "bearing lost in turning to the other leg"),
        "settle": (settle, "rad", "acceptable bearing error at the goal"),
        "far_share": (far_share, "1", "share of the next offset at the largest range"),
        "lead": (lead, "1", "share of the bearing's rate that the heading leads with"),
        "bearing_max": (bearing_max, "rad", "largest bearing of the goal"),
        "hold_in": (hold_in, "m/s", "least drift to the goal at which a leg ends"),
        "hold_out": (hold_out, "m/s", "least drift to the goal without a leg"),
    }
    current = measured_current("rest_in_current", system)
    parameters = leg_parameters(
        values, GAINS, nearest=range_min + near_margin, farthest=range_max - far_margin
    )
    s = {name: symbol(name) for name in values}
    x, psi, vx, vy = symbol("x"), symbol("psi"), *(q.symbol for q in current)
    zero, one = sp.S.Zero, sp.S.One
    view, start = view_legs(), s["distance"]
    radius, bearing, depth, leg = view.radius, view.bearing, view.depth, view.leg
    slope = sp.tan(leg)

    cos, sin = sp.cos(bearing), sp.sin(bearing)
    inward, across = vx * cos + vy * sin, vy * cos - vx * sin
    error = wrap(bearing - _goal_bearing(vx, vy, s["bearing_max"]))
    drift = sgn(error) * across + magnitude(inward) * slope
    reads = (*system.quantities(("x", "y", "psi"), "rest_in_current"), *current)
    fastest = system.largest_current
    used = fastest.free_symbols if fastest is not None else set()
    largest = tuple(p for p in system.parameters if p.symbol in used)
    conditions = (*held_gain("kv"), *((_way(fastest),) if fastest is not None else ()))

    def law(name: str, offset: sp.Expr, radial: sp.Expr) -> Law:
        """Go towards the target at `radial` over ground, the heading `offset` from its bearing."""
        facing = greatest(sp.cos(wrap(psi - bearing)), sp.Rational(7, 10))
        surge = (radial - inward) / facing
        turn = -s["kv"] * wrap(psi - bearing - offset)
        if lead:
            turn -= s["lead"] * (surge * sp.sin(psi - bearing) + across) / (radius + GUARD**2)
        outputs = {"u": surge, "r": turn}
        return Law(
            name,
            reads,
            outputs,
            (*parameters, *largest),
            conditions=conditions,
            signals={"bearing_error": error, "drift": drift},
        )

    def along(name: str, offset: sp.Expr, through: sp.Expr) -> Law:
        """A leg at the speed `through` the water as soon as its heading is right."""
        off = magnitude(wrap(psi - bearing - offset))
        share = greatest(sp.Rational(3, 2) - off / s["turn_first"], view.pressed[name])
        return law(name, offset, (through + inward) * clip(share, zero, one))

    few = sp.Rational(1, 50) ** 2
    homeward = s["exponent"] * error * depth / (depth**2 + few)
    radial = s["k1"] * sp.tanh(s["mu"] * (radius - start))
    in_water = radial - inward
    over = s["kb"] * radius * error + radial * clip(homeward, -slope, slope) - across
    slow = sp.Rational(3, 100) ** 2  # m/s, at which the heading swings from one side to the other
    home = sp.atan(clip(over * in_water / (in_water**2 + slow), -slope, slope))
    toward = clip(20 * error, -one, one)

    lost = greatest(-drift, zero) / s["leg_speed"]
    reach = greatest(sp.tan(view.usual) - lost, zero) * magnitude(depth)
    suffices = greatest(
        greatest(reach - s["swing"], s["settle"] / 2) - magnitude(error), drift - s["hold_in"]
    )
    stuck = least(
        magnitude(error) - sp.Rational(13, 10) * reach - s["settle"], s["hold_out"] - drift
    )
    steepest = least(sp.cos(psi), sp.cos(bearing + s["far_share"] * toward * leg))
    flattest = greatest(sp.cos(psi), sp.cos(bearing - toward * leg))
    too_near = s["near_margin"] + x + s["range_min"] * flattest
    too_far = least(
        s["far_margin"] - x - s["range_max"] * steepest, -s["clearance"] - too_near
    )  # never both at once
    return Switching(
        name="rest_in_current",
        modes={
            HOME: law(HOME, home, radial),
            AHEAD: along(AHEAD, toward * leg, s["leg_speed"]),
            BACK: along(BACK, -toward * leg, -s["leg_speed"]),
        },
        transitions=(
            Transition(HOME, BACK, least(stuck, -depth)),
            Transition(HOME, AHEAD, least(stuck, depth)),
            Transition(BACK, HOME, suffices),
            Transition(AHEAD, HOME, suffices),
            Transition(BACK, AHEAD, too_far),
            Transition(AHEAD, BACK, too_near),
        ),
        initial=HOME,
        description="rest in a measured current, the target in view: on the ray along the current",
        source="own; equilibria of thesis (5.30) in the camera set (5.23)",
    )


def _way(current: sp.Expr) -> GainCondition:
    """A leg is faster through the water than the largest current."""
    return GainCondition(
        value=current,
        limit=symbol("leg_speed"),
        consequence="a leg against the current makes no way",
        source="a leg over ground is that through the water and the current",
    )


def _goal_bearing(vx: sp.Expr, vy: sp.Expr, most: sp.Expr) -> sp.Expr:
    """psi* = theta or theta + pi, where cos psi* > 0; 0 in still water."""
    away = sgn(vx)
    share = clip(length(vx, vy, GUARD**2) / STILL - 1, sp.S.Zero, sp.S.One)
    along = angle(away * vy * share, away * vx * share + (1 - share) * STILL, GUARD**2)
    return clip(along, -most, most)
