"""Go to an inspection pose in front of a target by legs that keep the target in view."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.catalogue.systems.marine_vehicle import surge_inertia, sway_inertia
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.control.view_legs import AHEAD, BACK, leg_parameters, view_legs
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import (
    clip,
    greatest,
    least,
    magnitude,
    wrap,
)

GAINS = ("k1", "mu", "kv")
HULL = ("mass", "Xudot", "Yvdot", "Yv")
"""Parameters of a hull that slips sideways."""


@checked
def inspect_target(
    system: System,
    *,
    distance: float = 0.5,
    k1: float = 0.2,
    mu: float = 0.9,
    kv: float = 2.0,
    exponent: float = 1.5,
    half_angle: float = 0.5235987755982988,
    target_half_width: float = 0.10,
    range_min: float = 0.35,
    range_max: float = 2.0,
    leg_margin: float = 0.045,
    far_margin: float = 0.25,
    turn_first: float = 0.25,
    creep: float = 0.25,
    swing: float = 0.1,
    settle: float = 0.03,
) -> Switching:
    """Go to the pose (-distance, 0, 0) before a target at the origin that must stay in view.

    In the log-polar coordinates s = ln(R / distance), beta = atan2(-y, -x) (the bearing of the
    target) a vehicle whose heading is beta + delta moves along d beta / d s = tan(delta), ahead
    or back, whatever its speed. The view allows |delta| <= leg(R) = alpha - half the angle of the
    target - leg_margin, so that a single leg home suffices where |beta| <= tan(leg) |s|:

        ahead: delta = clip(atan(n beta s / (s^2 + 0.02^2)), +-leg), u = k1 tanh(mu (R - R0))
        back:  delta = -leg clip(beta / 0.1, +-1),                   u = -k1
        r = -kv wrap(psi - beta - delta),    R0 = distance (1 - max(|beta| - settle, 0))

    n = `exponent` > 1: the way home ends as beta ~ s^n, tangent to the goal's heading, as the
    lines of the dipolar field with lambda = n / (n - 1) do. A leg ahead goes as far as it can. If
    it ends before the target (s < 0.1, or 5 cm before the least range) with the bearing off by
    more than `settle` [rad] plus the change that the rest of the leg allows, the vehicle backs up
    until one leg home suffices, or to within `far_margin` [m] of the largest range `range_max`, but
    at least to 10 cm beyond the least range: the two guards never hold at once. `swing` [rad] is
    the bearing lost in turning from one leg to the other. If the heading is off by more than
    `turn_first` [rad], the vehicle slows down, to no less than the share `creep` of its speed; it
    does not slow down where a range limit keeps it from turning.

    The law does not keep the view by itself: add a safety filter (`safeguard`). Only this geometry
    is proved; the arrival is measured (docs/rescue.md). Conditions, checked by `simulate` and
    `tune`:

        k1 mu < surge_gain_limit, lambda = n / (n - 1)           the sway of a marine vehicle
        kv (Ts + delay) <= 1/2                                   `held_gain`
        (1 - ln 2) k1 half_angle / (kv distance) <= swing        the turn between two legs

    The first limit is that of the vehicle and of every model of it that may be true (0.351 1/s for
    the VideoRay, 0.234 1/s with 20 % more inertia and 20 % less drag). In the third, a heading that
    goes from one leg to the other as exp(-kv t) loses this much bearing at most before it points
    along the new leg, at the top speed and no nearer than the pose.
    Outputs: surge u [m/s], yaw rate r [rad/s].

    Raises `DefinitionError` for exponent <= 1, a target that fills the view at `distance`, or a
    pose outside the range limits.
    """
    values = {
        "distance": (distance, "m", "distance of the pose from the target"),
        "k1": (k1, "m/s", "top surge speed"),
        "mu": (mu, "1/m", "steepness of the speed near the goal"),
        "kv": (kv, "1/s", "heading gain"),
        "exponent": (exponent, "1", "exponent n of the way home"),
        "half_angle": (half_angle, "rad", "half angle of view alpha"),
        "target_half_width": (target_half_width, "m", "half-width yT"),
        "range_min": (range_min, "m", "least laser range Lmin"),
        "range_max": (range_max, "m", "largest laser range Lmax"),
        "leg_margin": (leg_margin, "rad", "distance of the legs from the edge of the view"),
        "far_margin": (far_margin, "m", "margin of backing up to the largest range"),
        "turn_first": (turn_first, "rad", "heading error above which the vehicle slows down"),
        "creep": (creep, "1", "least share of the speed"),
        "swing": (swing, "rad", "bearing lost in turning to the other leg"),
        "settle": (settle, "rad", "acceptable bearing error at the pose"),
    }
    parameters = leg_parameters(values, GAINS, nearest=range_min, farthest=range_max - far_margin)
    s = {name: symbol(name) for name in values}
    hull = tuple(p for p in system.parameters if p.name in HULL)
    conditions = (*_sway(s, len(hull)), *held_gain("kv"), _turn(s))
    x, psi = symbol("x"), symbol("psi")
    view, start = view_legs(), s["distance"]
    radius, bearing, depth, leg = view.radius, view.bearing, view.depth, view.leg
    side = clip(bearing / sp.Rational(1, 10), -sp.S.One, sp.S.One)
    near = sp.Rational(1, 50) ** 2
    home = clip(sp.atan(s["exponent"] * bearing * depth / (depth**2 + near)), -leg, leg)

    # an unacceptable bearing error keeps the vehicle moving
    beyond = greatest(magnitude(bearing) - s["settle"], sp.S.Zero)

    def law(name: str, offset: sp.Expr, speed: sp.Expr) -> Law:
        error = wrap(psi - bearing - offset)
        share = sp.Rational(3, 2) - magnitude(error) / s["turn_first"]
        share = clip(greatest(share, view.pressed[name]), s["creep"], sp.S.One)
        surge = s["k1"] * speed * share
        reads = system.quantities(("x", "y", "psi"), "inspect_target")
        outputs = {"u": surge, "r": -s["kv"] * error}
        return Law(name, reads, outputs, (*parameters, *hull), conditions=conditions)

    reach = sp.tan(view.usual) * magnitude(depth)
    suffices = greatest(reach - s["swing"], s["settle"] / 2) - magnitude(bearing)
    too_little = magnitude(bearing) - sp.Rational(13, 10) * reach - s["settle"]
    too_far = s["far_margin"] - x - s["range_max"] * sp.cos(psi)
    too_near = sp.Rational(1, 20) + x + s["range_min"] * sp.cos(psi)
    # Beyond 79.5 degrees the two range limits are so close that both guards would hold at once:
    # a leg back ends only 5 cm beyond where the leg ahead would end.
    clear = -sp.Rational(1, 20) - too_near
    at_end = sp.Rational(1, 10)
    far_enough = least(least(too_far, clear), depth - 2 * at_end)
    return Switching(
        name="inspect_target",
        modes={
            AHEAD: law(AHEAD, home, sp.tanh(s["mu"] * (radius - start + start * beyond))),
            BACK: law(BACK, -side * leg, -sp.S.One),
        },
        transitions=(
            Transition(AHEAD, BACK, least(too_little, greatest(at_end - depth, too_near))),
            Transition(BACK, AHEAD, greatest(suffices, far_enough)),
        ),
        initial=AHEAD,
        description="go to an inspection pose by legs that keep the target in view",
        source="own; kinematics of thesis (5.14) in log-polar coordinates about the target",
    )


def _sway(s: dict[str, sp.Symbol], hull: int) -> tuple[GainCondition, ...]:
    """k1 mu below `surge_gain_limit` at lambda = n / (n - 1), where the system has a hull."""
    if hull < len(HULL):
        return ()
    drag, along, across = -symbol("Yv"), surge_inertia(), sway_inertia()
    weight = (2 - s["exponent"]) * across + s["exponent"] * along
    return (
        GainCondition(
            value=s["k1"] * s["mu"],
            limit=drag / greatest(across, weight),
            consequence="the sway outpaces the approach and the heading does not converge",
            source="correction E6 of thesis Theorem 1, on the way home beta ~ s^n",
        ),
    )


def _turn(s: dict[str, sp.Symbol]) -> GainCondition:
    """The bearing that a turn from leg to leg loses is within `swing`."""
    return GainCondition(
        value=(1 - sp.log(2)) * s["k1"] * s["half_angle"] / (s["kv"] * s["distance"]),
        limit=s["swing"],
        consequence="a turn between two legs loses more bearing than the guards allow for",
        source="derived: a turn at the top speed, no nearer than the pose",
        closed=True,
    )
