"""A leader and its followers in the world frame; each sees only the robot before it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import sympy as sp

from holdfast.maths.catalogue.systems.driftless import unicycle
from holdfast.maths.catalogue.systems.leader_follower import sight
from holdfast.maths.definitions.compose_systems import renamed, side_by_side
from holdfast.maths.definitions.quantity import symbol, whole_number
from holdfast.maths.definitions.system import Measurement, System


def robot_names(followers: int) -> tuple[str, ...]:
    """ "L", "1", "2", ...: the suffixes of the names of the robots' quantities."""
    return ("L", *(str(k) for k in range(1, followers + 1)))


def chain(followers: int = 1, *, speed_limit: float = 2.0, turn_limit: float = 4.0) -> System:
    """A leader and its followers, unicycles in the world: xL, yL, thetaL, x1, y1, theta1, ...

    Inputs uL, wL, u1, w1, ... [m/s, rad/s], all within the same limits.

    followers: how many.

    Follower k measures `range{k}` and `bearing{k}` of the robot before it.
    """
    whole_number(followers, "number of followers", 1, 20)
    names = robot_names(followers)
    letters = {"x": "x", "y": "y", "psi": "theta", "v": "u", "r": "w"}
    robots = [
        renamed(
            unicycle(speed_limit, turn_limit), {old: f"{new}{of}" for old, new in letters.items()}
        )
        for of in names
    ]
    measured: list[Measurement] = []
    for before, of in pairwise(names):
        measured += sight(*in_view(of, before), of)
    return replace(
        side_by_side(*robots, name="chain"),
        measurements=tuple(measured),
        description="wheeled robots in a row; each sees the one before it",
        source="thesis (6.1), section 6.6",
    )


def place(of: str) -> tuple[sp.Symbol, sp.Symbol]:
    """The position of a robot."""
    return symbol(f"x{of}"), symbol(f"y{of}")


def in_view(of: str, other: str) -> tuple[sp.Expr, sp.Expr]:
    """The position of another robot, ahead and to the left of this one."""
    (x, y), (other_x, other_y) = place(of), place(other)
    theta, dx, dy = symbol(f"theta{of}"), other_x - x, other_y - y
    return sp.cos(theta) * dx + sp.sin(theta) * dy, sp.cos(theta) * dy - sp.sin(theta) * dx
