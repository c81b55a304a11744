"""Exact distances of points and lines of sight to any number of walls, and to polygons.

Walls are segments, and so are the sides of polygons; `ends` are the four coordinates x0, y0, x1, y1
of each, one after the other. The nearest point on the walls is a separate function that is frozen
when differentiated: the gradient of a distance is that of the distance to this fixed point.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.maths.expressions.functions import Frozen, greatest, least, length, magnitude, select
from holdfast.maths.reference_fields.dipole import UNSEEN


class nearest_on_walls(Frozen):
    """nearest_on_walls(k, x, y, *ends): coordinate k of the nearest point of the walls."""


class nearest_face(Frozen):
    """nearest_face(k, x, y, *ends): the corner or side of polygons that is nearest.

    k = 0: 1 on a side, -1 at a corner; 1: 1 outside the polygons, -1 inside one; 2, 3: the corner,
    or the beginning of the side; 4, 5: the unit normal of the side, on its right.
    """


class nearest_to_sight(Frozen):
    """nearest_to_sight(k, ax, ay, bx, by, *ends): where the line from a to b is nearest to a wall.

    k = 0: the share s of the way from a to b; 1, 2: the point of the wall; 3: +1, or -1 where a
    wall crosses the line. Then it is the shortest way by which the wall would get out of it.
    """


class separating_sides(Frozen):
    """separating_sides(k, ax, ay, bx, by, *ends): what separates the line from a to b from a convex
    polygon, counterclockwise.

    k = 0: the end of the line that is nearer to the best separating side of the polygon, 0 for a, 1
    for b; 1, 2: the beginning of that side; 3, 4: its outward unit normal; 6, 7: the corner
    farthest to the right of the line; 9, 10: farthest to its left. 5, 8: twice the areas to which
    the line spans these two, the second with the sign changed.
    """


class passing(Frozen):
    """passing(k, ax, ay, bx, by, *ends): how far the line from a to b passes a convex polygon.

    k = 0: the largest distance of both ends from the outside of a side; 1, 2: twice the least area
    to a corner, if all are to the left, or to the right; 3, 4: the squares of the least distances
    of a corner to the line, and of a to the polygon.
    """


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


def separation(one: Place, other: Place, ends: Sequence[sp.Expr]) -> sp.Expr:
    """The largest gap between the line and a convex polygon along a normal of either of them.

    Negative exactly where they meet: it is then minus the least displacement that separates them.
    Otherwise it is at most their distance. Every part of it is smooth, with exact derivatives.
    """
    end, x, y, nx, ny, _, lx, ly, _, rx, ry = (
        separating_sides(k, *one, *other, *ends) for k in range(11)
    )
    at = [a + end * (b - a) for a, b in zip(one, other, strict=True)]
    side = (at[0] - x) * nx + (at[1] - y) * ny
    return greatest(greatest(_offset(one, other, (lx, ly)), -_offset(one, other, (rx, ry))), side)


def corner_to_sight(one: Place, other: Place, corner: Place) -> sp.Expr:
    """The distance of a corner to the line between two points, off its ends and off its middle."""
    (ax, ay), (bx, by), (x, y) = one, other, corner
    along = (x - ax) * (bx - ax) + (y - ay) * (by - ay)
    beyond = (x - bx) * (bx - ax) + (y - by) * (by - ay)
    return select(
        -along,
        length(x - ax, y - ay, UNSEEN),
        select(beyond, length(x - bx, y - by, UNSEEN), magnitude(_offset(one, other, corner))),
    )


def passing_distance(one: Place, other: Place, ends: Sequence[sp.Expr]) -> sp.Expr:
    """The distance of the line to a convex polygon, but for its end at the other point; where they
    meet, `separation`. It is a number when it is differentiated.
    """
    side, left, right, corner, end = (passing(k, *one, *other, *ends) for k in range(5))
    (ax, ay), (bx, by) = one, other
    gap = greatest(greatest(left, right) / sp.sqrt((bx - ax) ** 2 + (by - ay) ** 2 + UNSEEN), side)
    return select(gap, sp.sqrt(least(corner, end)), gap)


def _offset(one: Place, other: Place, point: Place) -> sp.Expr:
    """How far a point is to the left of the line from one point to the other."""
    (ax, ay), (bx, by), (x, y) = one, other, point
    dx, dy = bx - ax, by - ay
    return (dx * (y - ay) - dy * (x - ax)) / sp.sqrt(dx**2 + dy**2 + UNSEEN)
