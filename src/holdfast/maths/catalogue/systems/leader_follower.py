"""A wheeled robot that follows another, in the leader's frame."""

from __future__ import annotations

from dataclasses import replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.catalogue.systems.driftless import unicycle
from holdfast.maths.definitions.compose_systems import renamed, seen_from
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.system import Measurement, System
from holdfast.maths.expressions.functions import angle, length
from holdfast.maths.reference_fields.dipole import UNSEEN


@checked
def leader_follower(
    *,
    speed_limit: float = 2.0,
    turn_limit: float = 4.0,
    leader_speed: float = 0.25,
    leader_turn: float = 0.5,
) -> System:
    """The follower's pose (x, y, beta) in the leader's frame, derived from two unicycles.

        x' = uF cos(beta) - uL + y wL,   y' = uF sin(beta) - x wL,   beta' = wF - wL     (6.7)

    Inputs: the follower's speed uF [m/s] in [-speed_limit, speed_limit] and turn rate wF [rad/s]
    likewise. Disturbances: the leader's inputs, |uL| <= leader_speed and |wL| <= leader_turn, which
    the follower does not know. It measures `range` [m], the distance between the robots, and
    `bearing` [rad], the direction of the leader from its own heading, positive to the left:

        range = |(x, y)|,   bearing = atan2(-y, -x) - beta
    """
    leader = _robot("L", leader_speed, leader_turn)
    leader = renamed(leader, {"speed_limitL": "leader_speed", "turn_limitL": "leader_turn"})
    follower = _robot("F", speed_limit, turn_limit)
    follower = renamed(follower, {"speed_limitF": "speed_limit", "turn_limitF": "turn_limit"})
    system = seen_from(
        leader,
        ("xL", "yL", "thetaL"),
        follower,
        ("xF", "yF", "thetaF"),
        pose=("x", "y", "beta"),
    )
    x, y, beta = (symbol(n) for n in ("x", "y", "beta"))
    return replace(
        system,
        name="leader_follower",
        measurements=sight(
            -x * sp.cos(beta) - y * sp.sin(beta), x * sp.sin(beta) - y * sp.cos(beta)
        ),
        description="wheeled robot that follows another, seen from the leader",
        source="thesis (6.7), derived from two unicycles (6.1)",
    )


def sight(ahead: sp.Expr, left: sp.Expr, of: str = "") -> tuple[Measurement, Measurement]:
    """Range and bearing of a point (ahead, left) in a robot's own frame."""
    return (
        Measurement(
            f"range{of}", "m", "distance to the leader", expression=length(ahead, left, UNSEEN)
        ),
        Measurement(
            f"bearing{of}", "rad", "direction of the leader", expression=angle(left, ahead, UNSEEN)
        ),
    )


def _robot(of: str, speed: float, turn: float) -> System:
    """A unicycle whose names end in `of`, with the letters of the thesis."""
    letters = {"x": "x", "y": "y", "psi": "theta", "v": "u", "r": "w"}
    letters |= {"speed_limit": "speed_limit", "turn_limit": "turn_limit"}
    robot = renamed(unicycle(speed, turn), {old: f"{new}{of}" for old, new in letters.items()})
    who = "of the leader" if of == "L" else "of the follower"
    return replace(
        robot,
        inputs=tuple(replace(q, description=f"{q.description} {who}") for q in robot.inputs),
        parameters=tuple(
            Parameter(p.name, p.unit, f"{p.description} {who}", value=p.value, above=p.above)
            for p in robot.parameters
        ),
    )
