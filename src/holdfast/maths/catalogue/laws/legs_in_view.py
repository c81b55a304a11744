"""Go to a pose before a target, or rest in a current with it in view, by legs that keep it in view.

Legs lead towards the target and away from it along the edges of the view, in log-polar coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.marine_vehicle import surge_inertia, sway_inertia
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.control.surge_and_turn import measured_current
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import Parameter, symbol
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

AHEAD, BACK = "ahead", "back"
POSITIVE = (
    "distance", "k1", "mu", "kv", "kb", "leg_speed", "half_angle", "range_max", "turn_first",
)  # fmt: skip
"""Numbers of the laws by legs that have to be above 0."""


@dataclass(frozen=True)
class ViewLegs:
    """A target at the origin as the vehicle at (x, y, psi) sees it.

    radius: R [m]; bearing: beta = atan2(-y, -x); depth: ln(R / distance). leg: the largest offset
    of the heading from the bearing that keeps the target in view, half_angle - half the angle of
    the target - leg_margin; usual: the same in the middle of the way home, which represents all of
    it. pressed: leg -> from 0 to 1 and beyond where a range limit keeps the vehicle from turning,
    so that only speed frees it.
    """

    radius: sp.Expr
    bearing: sp.Expr
    depth: sp.Expr
    leg: sp.Expr
    usual: sp.Expr
    pressed: Mapping[str, sp.Expr]


def view_legs() -> ViewLegs:
    """In the parameters distance, half_angle, target_half_width, leg_margin, range_min, range_max.

    The ends of the target are at (0, +-target_half_width), on the wall x = 0.
    """
    x, y, psi = (symbol(name) for name in ("x", "y", "psi"))
    width, start, margin = (symbol(n) for n in ("target_half_width", "distance", "leg_margin"))
    guard = GUARD**2
    radius, bearing = length(x, y, guard), angle(-y, -x, guard)
    ends = (angle(-width - y, -x, guard), angle(width - y, -x, guard))
    half = greatest(*(magnitude(wrap(bearing - end)) for end in ends))
    middle = sp.atan(width / sp.sqrt(radius * start))
    return ViewLegs(
        radius=radius,
        bearing=bearing,
        depth=sp.log((radius + GUARD**2) / start),
        leg=greatest(symbol("half_angle") - half - margin, sp.S.Zero),
        usual=greatest(symbol("half_angle") - middle - margin, sp.S.Zero),
        pressed={
            AHEAD: 1 - (x + symbol("range_max") * sp.cos(psi)) / sp.Rational(3, 10),
            BACK: 1 + (x + symbol("range_min") * sp.cos(psi)) / sp.Rational(1, 10),
        },
    )


def leg_parameters(
    values: Mapping[str, tuple[float, str, str]],
    gains: Collection[str],
    *,
    nearest: float,
    farthest: float,
) -> tuple[Parameter, ...]:
    """The parameters of a law by legs, name -> (value, unit, meaning).

    Raises `DefinitionError` for exponent <= 1, a target that fills the view at `distance`, and a
    distance that is not between `nearest` and `farthest`.
    """
    number = {name: value for name, (value, _, _) in values.items()}
    exponent, distance = number["exponent"], number["distance"]
    if not exponent > 1:
        raise DefinitionError(f"exponent is {exponent:g}", expected="above 1")
    half = math.atan2(number["target_half_width"], distance)
    if not number["half_angle"] - half > number["leg_margin"]:
        raise DefinitionError(
            f"the target leaves no room in the view at {distance:g} m",
            expected="half_angle above that of the target and leg_margin",
        )
    if not nearest < distance < farthest:
        raise DefinitionError(
            f"the pose at {distance:g} m is out of range",
            expected=f"between {nearest:g} m and {farthest:g} m",
        )
    return tuple(
        Parameter(
            name,
            unit,
            text,
            value=value,
            above=0 if name in POSITIVE else -math.inf,
            gain=name in gains,
        )
        for name, (value, unit, text) in values.items()
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


HOME = "home"
REST_GAINS = (*GAINS, "kb", "leg_speed")
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
        values, REST_GAINS, nearest=range_min + near_margin, farthest=range_max - far_margin
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
