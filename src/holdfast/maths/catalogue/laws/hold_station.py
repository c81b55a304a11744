"""Hold station in a known or bounded current: laws and the supervisors that switch them.

Limits of ball, gains and sample time for station keeping in a bounded current (chapter 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import sympy as sp

from holdfast.arguments import checked, renamed
from holdfast.errors import DefinitionError
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.control.surge_and_turn import surge_and_turn
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import TIME, Parameter, symbol
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import (
    angle,
    clip,
    greatest,
    least,
    length,
    select,
    sgn,
    wrap,
)
from holdfast.maths.reference_fields.dipole import UNSEEN, dipole_like_field, field_angle


@dataclass(frozen=True)
class StationKeepingLimits:
    """Proved requirements of `hold_station`, and its measured accuracy.

    least_k1: for the radius r0, (3.7) holds for every direction of the current and every
    |r| >= r0 exactly when k1 is above this [1/s]. least_r0: for the gain k1, the smallest such
    radius [m]; 0 if any radius is enough. longest_sample_time: k2 times it is 0.5 [s]. excess: the
    approximate distance by which the vehicle leaves the ball, 0.03 / k2 [m]: measured in the
    current of the thesis with r1 = r0, up to five times that in other directions (the thesis says
    'arbitrarily small').
    """

    least_k1: float
    least_r0: float
    longest_sample_time: float
    excess: float


@checked
def station_keeping_limits(
    speed_bound: float, lam: float = 3.0, *, k1: float = 1.5, r0: float = 0.1, k2: float = 5.0
) -> StationKeepingLimits:
    """The limits of `hold_station` for a current whose speed is bounded.

        k1 > sup_(r >= r0) |v| (lam r^2 - 2 w) / (r (lam r^2 - w)),   w = 1 - exp(-r^2)

    the supremum of (3.7) over all directions of the current; (3.6) holds always for lam >= 2.
    Sufficient, not necessary: smaller k1 were seen to enter the ball too.

    speed_bound [m/s]: of the current. lam: lambda. k1, k2 [1/s]: gains of the law. r0 [m]: the
    radius of the ball.

    Raises `DefinitionError` for a speed, gain or radius that is not positive, or lam < 2.

    >>> round(hf.station_keeping_limits(0.3).least_k1, 3)
    1.511
    """
    for name, value in (("speed_bound", speed_bound), ("k1", k1), ("r0", r0), ("k2", k2)):
        if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
            raise DefinitionError(f"{name} is {value!r}", expected="a number above 0")
    if not (math.isfinite(lam) and lam >= 2):
        raise DefinitionError(f"lam is {lam}", expected="2 or more")
    return StationKeepingLimits(
        least_k1=speed_bound * _worst_beyond(r0, lam),
        least_r0=_least_radius(k1 / speed_bound, lam),
        longest_sample_time=0.5 / k2,
        excess=0.03 / k2,
    )


def _need(r: float, lam: float) -> float:
    """k1 / |v| required by (3.7) at the distance r, over all directions [1/m]."""
    w = -math.expm1(-(r**2))
    return (lam * r**2 - 2 * w) / (r * (lam * r**2 - w))


@lru_cache(maxsize=4096)
def _worst_beyond(r0: float, lam: float) -> float:
    """The supremum of the need over r >= r0; it has at most one maximum and falls as 1/r."""
    low, high = math.log(r0), math.log(max(r0, 1.0)) + 5.0
    grid = [low + (high - low) * i / 400 for i in range(401)]
    best = max(range(401), key=lambda i: _need(math.exp(grid[i]), lam))
    a, b = grid[max(best - 1, 0)], grid[min(best + 1, 400)]
    for _ in range(100):  # ternary search within one cell either side
        c, d = a + (b - a) / 3, b - (b - a) / 3
        if _need(math.exp(c), lam) < _need(math.exp(d), lam):
            a = c
        else:
            b = d
    return max(_need(math.exp(a), lam), _need(r0, lam))


def _least_radius(gain: float, lam: float) -> float:
    smallest = 1e-6
    if _worst_beyond(smallest, lam) < gain:
        return 0.0
    low, high = math.log(smallest), math.log(1e6)
    for _ in range(80):
        middle = (low + high) / 2
        if _worst_beyond(math.exp(middle), lam) < gain:
            high = middle
        else:
            low = middle
    return math.exp(high)


METRES = "the field of the thesis has exp(-|r|^2) of a distance in metres"
"""Why units of the law that follows it are not checked."""

APPROACH, PUSH, TURN = "approach", "push", "turn"

ALIGNED = math.acos(0.8)
"""Largest heading error [rad] from the pushing direction at which a vehicle may turn home."""


@renamed(measured="disturbance_measured")
@checked
def hold_station(
    system: System,
    *,
    disturbance_measured: bool = False,
    current_x: float = -0.1,
    current_y: float = 0.2,
    r0: float = 0.1,
    r1: float = 0.13,
    r2: float | None = None,
    k1: float = 1.5,
    k2: float = 5.0,
    k3: float = 1.5,
    k4: float = 5.0,
    k5: float = 5.0,
    k6: float = 4.0,
    lam: float = 3.0,
    speed_limit: float | None = None,
    turn_limit: float | None = None,
) -> Switching:
    """Keep a unicycle-like vehicle within a ball of the origin in a known current v.

        approach: u = -k1 sgn(r . h) |r| - sgn(vx) |v|,  r = -k2 wrap(psi - phi) + d/dt phi  (3.5)
        push:     u = -k3 sgn(vx) |v|,                   r = -k4 wrap(psi - phi_p)           (3.8)
        turn:     u = 0,                                 r = -k5 wrap(psi)                   (3.9)

    h = (cos psi, sin psi); phi is the direction of the field F = lambda (p . r) r -
    p (1 - exp(-|r|^2)) (3.4) with p = v sgn(vx), phi_p that of p; d/dt phi is taken with the
    current. The second term of (3.5a) is identically this feedforward.

    Inside |r| <= r0 the vehicle turns home while the current brings it nearer (r . v < 0) and
    pushes against the current otherwise; outside |r| > r1 >= r0 it approaches again. The
    thesis has r1 = r0, which leaves no hysteresis, and no rule for leaving the ball downstream
    while pushing; here the vehicle then approaches again. The excursion from the ball is about
    0.03/k2 m in the current of the thesis, and up to five times that in others.

    A vehicle with inertia is carried out of the ball while it turns into the current, and the flow
    lines that lead back from there ask for a whole turn. With an r2 the vehicle pushes on until |r|
    > r2, slows down while it points the wrong way, and leans towards the line of the current
    through the station:

        push:     u = -k3 sgn(vx) |v| max(0, cos e),     r = -k4 e
                  e = wrap(psi - phi_p - sgn(vx) clip(k6 d, +-0.9 acos(1/k3)))

    with the distance d [m] from that line. r2 [m]: as above; None for a vehicle without inertia. k6
    [1/m]: the gain of d. It then turns home only where |d| <= r1, and straight from `approach` only
    with a heading within `ALIGNED` of phi_p.

    Both inputs stay within `speed_limit` [m/s] and `turn_limit` [rad/s], which are the system's
    where it has them, else must be given; while approaching, the vehicle goes slower where the
    field turns faster than 0.8 turn_limit. For the full marine vehicle u and r are velocities
    to track, and d/dt phi is that of the ground track, sway included.

    disturbance_measured: whether the law reads the current at every instant, which may vary slowly;
    without, it believes in (`current_x`, `current_y`).

    Raises `DefinitionError` for r1 < r0, r2 < r1, k3 <= 1 (the current would win) or a current that
    is believed to be zero.
    """
    vehicle = surge_and_turn("hold_station", system, speed_limit, turn_limit)
    if not r1 >= r0:
        raise DefinitionError(f"r1 = {r1:g} is below r0 = {r0:g}", expected="r1 >= r0")
    if r2 is not None and not r2 >= r1:
        raise DefinitionError(f"r2 = {r2:g} is below r1 = {r1:g}", expected="r2 >= r1")
    _check_push(k3)
    if not isinstance(disturbance_measured, bool):
        raise DefinitionError(
            f"hold_station: disturbance_measured is {disturbance_measured!r}",
            expected="true or false",
        )
    if not disturbance_measured and math.hypot(current_x, current_y) == 0:
        raise DefinitionError(
            "hold_station: the current is zero", remedy="use steer_unicycle without a current"
        )
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    s = {n: symbol(n) for n in ("current_x", "current_y", "r0", "r1", "lam")}
    k = {n: symbol(n) for n in ("k1", "k2", "k3", "k4", "k5")}
    sensed = vehicle.current if disturbance_measured else ()
    vx, vy = current = tuple(q.symbol for q in sensed) or (s["current_x"], s["current_y"])
    speed, side = sp.sqrt(vx**2 + vy**2), sgn(vx)
    none = sp.Float(1e-9) - speed  # without a current, the nominal field
    p = (select(none, sp.S.One, side * vx), select(none, sp.S.Zero, side * vy))
    rho = length(x, y, UNSEEN)
    phi = field_angle(dipole_like_field((x, y), s["lam"], p), UNSEEN)
    ahead = sgn(x * sp.cos(psi) + y * sp.sin(psi))
    wanted = vehicle.within_speed(-k["k1"] * ahead * rho - side * speed)
    surge, turn = vehicle.along(phi, wanted, current)
    constant = (
        Parameter("current_x", "m/s", "current the law believes in", value=current_x),
        Parameter("current_y", "m/s", "current the law believes in", value=current_y),
    )
    parameters = (
        *(() if disturbance_measured else constant),
        Parameter("r0", "m", "radius of the ball to enter", value=r0, above=0.0),
        Parameter("r1", "m", "radius beyond which it approaches again", value=r1, above=0.0),
        Parameter("k1", "1/s", "gain of the distance", value=k1, above=0, gain=True),
        Parameter("k2", "1/s", "heading gain while approaching", value=k2, above=0, gain=True),
        Parameter(
            "k3", "1", "speed while pushing, relative to the current", value=k3, above=1, gain=True
        ),
        Parameter("k4", "1/s", "heading gain while pushing", value=k4, above=0, gain=True),
        Parameter("k5", "1/s", "heading gain while turning home", value=k5, above=0, gain=True),
        Parameter("lam", "1", "exponent lambda of the field", value=lam, above=1),
        *vehicle.limits,
    )
    if r2 is not None:
        parameters += (
            Parameter("r2", "m", "radius beyond which pushing ends", value=r2, above=0.0),
            Parameter(
                "k6",
                "1/m",
                "gain of the distance from the current's line",
                value=k6,
                above=0,
                gain=True,
            ),
        )
    conditions = held_gain("k2", "k4", "k5")
    if not disturbance_measured:
        need = station_keeping_limits(1.0, lam, r0=r0).least_k1  # per m/s of current
        limits = station_keeping_limits(math.hypot(current_x, current_y), lam, k1=k1, r0=r0)
        entering = GainCondition(
            value=sp.Float(need) * speed,
            limit=k["k1"],
            consequence=f"entering the ball is not proved; with k1 = {k1:g} it is from "
            f"r0 = {limits.least_r0:.4g} m on",
            source="(3.7), supremum over all directions",
        )
        conditions = (entering, _outruns(k["k3"] * speed), *conditions)

    def law(mode: str, u: sp.Expr, r: sp.Expr) -> Law:
        outputs = {"u": vehicle.within_speed(u), "r": vehicle.within_turn(r)}
        believed = {q.name: v for q, v in zip(vehicle.current, current, strict=True)}
        reads = (*vehicle.reads, *sensed)
        return Law(
            mode,
            reads,
            outputs,
            parameters,
            conditions=conditions,
            believed=believed,
            empirical=METRES if mode == APPROACH else "",
        )

    upstream = angle(p[1], p[0], UNSEEN)
    outward = x * vx + y * vy  # r . v
    inside, outside = s["r0"] - rho, rho - s["r1"]
    inward = -outward - sp.Float(math.ulp(0.0))
    off, push = psi - upstream, -k["k3"] * side * speed
    turn_home, push_on = least(inside, greatest(inward, -TIME)), least(inside, outward)
    pushed_out, lost = least(outside, inward), least(outside, outward)
    if r2 is not None:
        aside = y * sp.cos(upstream) - x * sp.sin(upstream)
        most = sp.Rational(9, 10) * sp.acos(1 / k["k3"])
        off = psi - upstream - side * clip(symbol("k6") * aside, -most, most)
        push = push * greatest(sp.cos(off), sp.S.Zero)
        aligned = sp.cos(psi - upstream) - math.cos(ALIGNED)
        turn_home, push_on = least(turn_home, aligned), inside
        pushed_out = least(pushed_out, s["r1"] - greatest(aside, -aside))
        lost = rho - symbol("r2")
    return Switching(
        name="hold_station",
        modes={
            APPROACH: law(APPROACH, surge, -k["k2"] * wrap(psi - phi) + turn),
            PUSH: law(PUSH, push, -k["k4"] * wrap(off)),
            TURN: law(TURN, sp.S.Zero, -k["k5"] * wrap(psi)),
        },
        transitions=(
            Transition(APPROACH, TURN, turn_home),
            Transition(APPROACH, PUSH, push_on),
            Transition(PUSH, TURN, pushed_out),
            Transition(PUSH, APPROACH, lost),
            Transition(TURN, APPROACH, least(outside, outward)),
        ),
        initial=APPROACH,
        description="hold station in a known current, by switching between three laws",
        source="thesis (3.4), (3.5), (3.8), (3.9) and the logic of section 3.2, completed",
    )


def _check_push(k3: float) -> None:
    if not k3 > 1:
        raise DefinitionError(
            f"k3 = {k3:g}: pushing does not overcome the current", expected="k3 > 1"
        )


def _outruns(push: sp.Expr) -> GainCondition:
    """The speed required for pushing is within the limit."""
    return GainCondition(
        value=push,
        limit=symbol("speed_limit"),
        consequence="the vehicle is not fast enough to push against the current",
        source="k3 > 1 of (3.8), within the speed limit",
        closed=True,
    )


AHEAD, ASTERN = "hold_ahead", "hold_astern"


@checked
def hold_station_unknown(
    system: System,
    *,
    current_bound: float = 0.25,
    r0: float = 0.1,
    r1: float = 0.15,
    k1: float = 1.5,
    k2: float = 5.0,
    k3: float = 1.5,
    k4: float = 5.0,
    lam: float = 3.0,
    speed_limit: float | None = None,
    turn_limit: float | None = None,
) -> Switching:
    """Keep a unicycle-like vehicle within a ball of the origin, knowing a bound of the current.

        approach: u = -sgn(r . h) (k1 |r| + current_bound),  r = -k2 wrap(psi - phi) + d/dt phi
        hold:     u = -sgn(x_in) k3 current_bound,           r = -k4 psi

    phi is the direction of the nominal field F = lambda x r - (1, 0) (1 - exp(-|r|^2)) (3.3),
    its rate taken without the current; x_in the side on which |r| <= r0 was entered. It
    approaches again outside |r| >= r1. With r1 = r0, as in the thesis, the law has no hysteresis
    and slides on the boundary; the other readings of sgn(r . v) keep the vehicle away from the
    ball (3.11 does not follow from its proof).

    Speeds are limited and scaled as in `hold_station`. Lengths in m, `current_bound` in m/s,
    k1, k2, k4 in 1/s. Raises `DefinitionError` for r1 <= r0 or k3 <= 1.
    """
    vehicle = surge_and_turn("hold_station_unknown", system, speed_limit, turn_limit)
    if not r1 > r0:
        raise DefinitionError(
            f"r1 = {r1:g} is not above r0 = {r0:g}: the law would slide on the boundary",
            expected="r1 > r0",
        )
    _check_push(k3)
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    s = {n: symbol(n) for n in ("current_bound", "r0", "r1", "lam")}
    k = {n: symbol(n) for n in ("k1", "k2", "k3", "k4")}
    rho = length(x, y, UNSEEN)
    phi = field_angle(dipole_like_field((x, y), s["lam"], (sp.S.One, sp.S.Zero)), UNSEEN)
    ahead = sgn(x * sp.cos(psi) + y * sp.sin(psi))
    wanted = vehicle.within_speed(-ahead * (k["k1"] * rho + s["current_bound"]))
    surge, turn = vehicle.along(phi, wanted, (sp.S.Zero, sp.S.Zero))
    parameters = (
        Parameter("current_bound", "m/s", "largest current", value=current_bound, above=0.0),
        Parameter("r0", "m", "radius of the ball to enter", value=r0, above=0.0),
        Parameter("r1", "m", "radius beyond which it approaches again", value=r1, above=0.0),
        Parameter("k1", "1/s", "gain of the distance", value=k1, above=0, gain=True),
        Parameter("k2", "1/s", "heading gain while approaching", value=k2, above=0, gain=True),
        Parameter(
            "k3", "1", "ratio of the speed while holding to the bound", value=k3, above=1, gain=True
        ),
        Parameter("k4", "1/s", "heading gain while holding", value=k4, above=0, gain=True),
        Parameter("lam", "1", "exponent lambda of the field", value=lam, above=1),
        *vehicle.limits,
    )

    conditions = (_outruns(k["k3"] * s["current_bound"]), *held_gain("k2", "k4"))

    def law(mode: str, u: sp.Expr, r: sp.Expr) -> Law:
        outputs = {"u": vehicle.within_speed(u), "r": vehicle.within_turn(r)}
        return Law(
            mode,
            vehicle.reads,
            outputs,
            parameters,
            conditions=conditions,
            empirical=METRES if mode == APPROACH else "",
        )

    hold = k["k3"] * s["current_bound"]
    inside, outside = s["r0"] - rho, rho - s["r1"]
    return Switching(
        name="hold_station_unknown",
        modes={
            APPROACH: law(APPROACH, surge, -k["k2"] * wrap(psi - phi) + turn),
            AHEAD: law(AHEAD, hold, -k["k4"] * wrap(psi)),
            ASTERN: law(ASTERN, -hold, -k["k4"] * wrap(psi)),
        },
        transitions=(
            Transition(APPROACH, ASTERN, least(inside, x)),
            Transition(APPROACH, AHEAD, inside),
            Transition(AHEAD, APPROACH, outside),
            Transition(ASTERN, APPROACH, outside),
        ),
        initial=APPROACH,
        description="hold station in a current with a known bound",
        source="thesis (3.3), section 3.3.4, in the reading that works, with an exit radius",
    )
