"""Exact distances of points and lines of sight to any number of walls.

Walls are segments; `ends` are the four coordinates x0, y0, x1, y1 of each, one after the other.
The nearest point on the walls is a separate function that is frozen when
differentiated: the gradient of a distance is that of the distance to this fixed point.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.maths.expressions.functions import RealFunction, length, select
from holdfast.maths.reference_fields.dipole import UNSEEN


class nearest_on_walls(RealFunction):
    """nearest_on_walls(k, x, y, *ends): coordinate k of the nearest point of the walls."""

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.S.Zero


class nearest_face(RealFunction):
    """nearest_face(k, x, y, *ends): the corner or side of polygons that is nearest.

    k = 0: 1 on a side, -1 at a corner; 1: 1 outside the polygons, -1 inside one; 2, 3: the corner,
    or the beginning of the side; 4, 5: the unit normal of the side, on its right.
    """

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.S.Zero


class nearest_to_sight(RealFunction):
    """nearest_to_sight(k, ax, ay, bx, by, *ends): where the line from a to b is nearest to a wall.

    k = 0: the share s of the way from a to b; 1, 2: the point of the wall; 3: +1, or -1 where a
    wall crosses the line. Then it is the shortest way by which the wall would get out of it.
    """

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        return sp.S.Zero


Place = tuple[sp.Expr, sp.Expr]


def wall_distance(at: Place, ends: Sequence[sp.Expr]) -> sp.Expr:
    """The distance of a point to the walls, at least 0."""
    x, y = at
    return length(
        x - nearest_on_walls(0, x, y, *ends), y - nearest_on_walls(1, x, y, *ends), UNSEEN
    )


def signed_distance(at: Place, ends: Sequence[sp.Expr]) -> sp.Expr:
    """The distance of a point to polygons, counterclockwise; negative inside one.

    Off a side it is linear, off a corner the distance to a point: both derivatives are exact.
    """
    x, y = at
    kind, side, px, py, nx, ny = (nearest_face(k, x, y, *ends) for k in range(6))
    return select(kind, (x - px) * nx + (y - py) * ny, side * length(x - px, y - py, UNSEEN))


def sight_distance(one: Place, other: Place, ends: Sequence[sp.Expr]) -> sp.Expr:
    """The distance of the line between two points to the walls; negative where one crosses it."""
    share, x, y, side = (nearest_to_sight(k, *one, *other, *ends) for k in range(4))
    nearest = [a + share * (b - a) for a, b in zip(one, other, strict=True)]
    return side * length(nearest[0] - x, nearest[1] - y, UNSEEN)
