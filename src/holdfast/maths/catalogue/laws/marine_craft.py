"""Laws of marine craft: go to a pose or a target, dock, and hold a pose or a position.

An underactuated craft follows a dipolar field by surge and yaw rate. A fully actuated one chooses
its velocities; weathervaning leaves the heading free, as the baseline for the laws of chapter 3.
"""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked, renamed
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.marine_vehicle import surge_inertia, sway_inertia
from holdfast.maths.control.gain_conditions import held_gain, surge_gain_limit
from holdfast.maths.control.surge_and_turn import measured_current, surge_and_turn
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import angle, least, length, select, sgn, wrap
from holdfast.maths.reference_fields.dipole import GUARD, UNSEEN, dipolar_field, field_angle


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
    over ground. disturbance_measured: whether the law measures the current at every instant, as
    Lemma 3 needs; without, it assumes still water. The vehicle then ends within
    `lyapunov.ultimate_bound` of the goal, heading along the current or against it.

    Gains: k1 [m/s] the top speed, mu [1/m], k2 [1/s], lam (lambda > 1). Condition for
    convergence of the heading: k1 mu below `lyapunov.surge_gain_limit` (E6).

    Raises `DefinitionError` for a system without the states and inputs of such a craft.
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

    The viable law at the edges of the view, and the one that keeps the goal set G = { |(x, y)| =
    distance, psi = phi_t }. The thesis prints the goal point with the opposite sign, which puts it
    behind the wall (E3). In a current the law is (5.41), u and r relative to the water. Outputs:
    surge u [m/s], yaw rate r [rad/s]. as_printed: whether to take the sign of the thesis.

    Raises `DefinitionError` for a system without the states and inputs of such a craft.
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
        empirical="the bound of the speed is one of a distance in metres",
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


VELOCITIES = ("u", "v", "r")


@checked
def hold_pose(
    system: System,
    *,
    goal_x: float = 0.0,
    goal_y: float = 0.0,
    goal_psi: float = 0.0,
    current_x: float = 0.0,
    current_y: float = 0.0,
    k1: float = 0.2,
    k2: float = 0.4,
    approach_speed: float = 0.2,
    approach_turn: float = 0.2,
) -> Law:
    """Bring a craft with a sway force to a pose, and hold it there: dynamic positioning.

        w = -k1 d / sqrt(1 + |k1 d|^2 / approach_speed^2) - V,     d = (x, y) - goal
        (u, v) = R(psi)^T w,   r = -k2 e / sqrt(1 + (k2 e / approach_turn)^2),
        e = wrap(psi - goal_psi)

    The distance falls at min(k1 |d|, approach_speed) or a little less, the heading error likewise,
    wherever the craft starts. V = (current_x, current_y) [m/s] is the current that the law
    believes in. k1, k2 in 1/s, approach_speed in m/s, approach_turn in rad/s. Outputs: surge u,
    sway v [m/s], yaw rate r [rad/s], which `track_velocity` follows.

    Raises `DefinitionError` for a craft without three inputs: its sway force cannot be chosen.
    """
    if len(system.inputs) < len(VELOCITIES) or not set(VELOCITIES) <= set(system.state_names):
        raise DefinitionError(
            f"law 'hold_pose' needs surge, sway and yaw to be chosen, system '{system.name}' "
            f"has the inputs {', '.join(system.input_names)}",
            expected="a fully actuated craft, such as 'marine_craft' with a bow thruster",
            remedy="for an underactuated one, a law that `holdfast explain` names",
        )
    felt = system.current_along("x", "y") or ()
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    k1_, k2_, speed, turn = (symbol(n) for n in ("k1", "k2", "approach_speed", "approach_turn"))
    away = (x - symbol("goal_x"), y - symbol("goal_y"))
    slow = sp.sqrt(1 + k1_**2 * (away[0] ** 2 + away[1] ** 2) / speed**2)
    wx, wy = (
        -k1_ * d / slow - symbol(current)
        for d, current in zip(away, ("current_x", "current_y"), strict=True)
    )
    error = k2_ * wrap(psi - symbol("goal_psi"))
    sin, cos = sp.sin(psi), sp.cos(psi)
    return Law(
        name="hold_pose",
        reads=system.quantities(("x", "y", "psi"), "hold_pose"),
        outputs={
            "u": cos * wx + sin * wy,
            "v": cos * wy - sin * wx,
            "r": -error / sp.sqrt(1 + (error / turn) ** 2),
        },
        parameters=(
            Parameter("goal_x", "m", "x of the pose", value=goal_x),
            Parameter("goal_y", "m", "y of the pose", value=goal_y),
            Parameter("goal_psi", "rad", "heading of the pose", value=goal_psi),
            Parameter("current_x", "m/s", "current the law believes in", value=current_x),
            Parameter("current_y", "m/s", "current the law believes in", value=current_y),
            Parameter("k1", "1/s", "gain of the distance", value=k1, above=0),
            Parameter("k2", "1/s", "heading gain", value=k2, above=0),
            Parameter("approach_speed", "m/s", "largest speed", value=approach_speed, above=0),
            Parameter("approach_turn", "rad/s", "largest yaw rate", value=approach_turn, above=0),
        ),
        believed={q.name: symbol(f"current_{n}") for n, q in zip("xy", felt, strict=False)},
        description="bring a fully actuated craft to a pose and hold it: dynamic positioning",
        source="a bounded proportional law for positions; Fossen 2021, chapter 15, has others",
    )


@checked
def weathervane(
    system: System,
    *,
    current_x: float = -0.1,
    current_y: float = 0.2,
    k1: float = 0.5,
    k2: float = 2.0,
    speed_limit: float | None = None,
    turn_limit: float | None = None,
) -> Law:
    """Hold the position at the origin in a known current V, with a free heading.

        w = -k1 r - V, at most speed_limit         the required velocity through the water
        u = w . h,   r = -k2 wrap(psi - phi) + d/dt phi,   phi the direction of w

    The vehicle comes to rest at the origin with its bow into the current: an equilibrium of
    (3.1), so no switching is needed, but psi = 0 is not reached. The speed is reduced where w turns
    faster than 0.8 turn_limit. The limits are those of `hold_station`. k1, k2 in 1/s; `current_x`,
    `current_y` [m/s] are the current the law believes in.
    """
    vehicle = surge_and_turn("weathervane", system, speed_limit, turn_limit)
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    current = (symbol("current_x"), symbol("current_y"))
    needed = [-symbol("k1") * r - v for r, v in zip((x, y), current, strict=True)]
    phi = angle(needed[1], needed[0], UNSEEN)
    size = length(needed[0], needed[1], UNSEEN)
    wanted = least(size, symbol("speed_limit")) * sp.cos(psi - phi)
    surge, turn = vehicle.along(phi, wanted, current)
    return Law(
        name="weathervane",
        reads=vehicle.reads,
        outputs={
            "u": surge,
            "r": vehicle.within_turn(-symbol("k2") * wrap(psi - phi) + turn),
        },
        parameters=(
            Parameter("current_x", "m/s", "current the law believes in", value=current_x),
            Parameter("current_y", "m/s", "current the law believes in", value=current_y),
            Parameter("k1", "1/s", "gain of the distance", value=k1, above=0, gain=True),
            Parameter("k2", "1/s", "heading gain", value=k2, above=0, gain=True),
            *vehicle.limits,
        ),
        conditions=(
            GainCondition(
                value=sp.sqrt(current[0] ** 2 + current[1] ** 2),
                limit=symbol("speed_limit"),
                consequence="the vehicle is not fast enough to stand against the current",
                source="equilibrium of (3.1)",
            ),
            *held_gain("k2"),
        ),
        believed={q.name: v for q, v in zip(vehicle.current, current, strict=True)},
        description="hold station in a known current, bow into it: the heading is left free",
        source="weathervaning, the usual alternative to the laws of thesis chapter 3",
    )
