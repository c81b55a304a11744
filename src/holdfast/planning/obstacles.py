"""Polygons as obstacles of any vehicle with a position: a region by exact distances.

Lines through many points are drawn by few of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, check_name
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.region import Inequality, Region, Segment
from holdfast.maths.definitions.system import System
from holdfast.maths.formations.walls import signed_distance

NOTHING = 1e-9
"""A share of an area that is a rounding error."""

Corners = Sequence[Sequence[float]]


@checked
def obstacles(
    system: System,
    polygons: Mapping[str, Corners],
    *,
    room: Corners | None = None,
    clearance: float = 0.0,
    position: tuple[str, str] = ("x", "y"),
) -> Region:
    """The region outside every polygon, and within the room, by at least the clearance.

        clearance - d_j(x, y) <= 0,    n_k . ((x, y) - a_k) + clearance <= 0

    Here d_j [m] is the signed distance to a convex polygon, negative inside it; its derivatives are
    those of the nearest side or corner. n_k is the outward normal of side k of the room. system:
    the vehicle, in whose unit of length all is. polygons: name -> corners (x, y) [m], in order, not
    closed; one that is not convex becomes several convex ones, NAME_1 and on, so that in a notch
    all sides are kept away from. room: the corners of a polygon to stay in; what it lacks to its
    convex hull are obstacles too. clearance [m]: a radius of the vehicle, the parameters
    clearance_NAME. position: the states that are the place.

    Raises `DefinitionError` for an unknown state, fewer than three corners, corners that are not
    finite, sides that cross or have no length, and a clearance below 0.

    >>> pier = {"pier": [(1, -1), (2, -1), (2, 1), (1, 1)]}
    >>> harbour = hf.obstacles(robot, pier, clearance=0.3)
    >>> harbour.inequality_names
    ('pier',)
    """
    states = {q.name: q for q in system.states}
    for name in position:
        check_name(
            name, states, DefinitionError, f"'{name}' is not a state of system '{system.name}'"
        )
    if not (math.isfinite(clearance) and clearance >= 0):
        raise DefinitionError(f"clearance is {clearance}", expected="a number of m, 0 or more")
    if not polygons and room is None:
        raise DefinitionError("there is neither a polygon nor a room")
    if room is not None and "room" in polygons:
        raise DefinitionError("a polygon is named 'room' beside room=", remedy="rename it")
    at = states[position[0]].symbol, states[position[1]].symbol
    parameters, inequalities, scene = [], [], []

    def clearance_of(name: str) -> sp.Expr:
        parameters.append(
            Parameter(f"clearance_{name}", "m", f"distance from {name}", value=float(clearance))
        )
        return parameters[-1].symbol

    def clear_of(name: str, parts: Sequence[shapely.Polygon], distance: sp.Expr) -> None:
        for label, part in zip(numbered(name, len(parts)), parts, strict=True):
            away = signed_distance(at, sides_of(part))
            inequalities.append(Inequality(label, distance - away, "m", f"distance to {name}"))

    for name, corners in polygons.items():
        polygon = polygon_of(name, corners)
        clear_of(name, convex_parts(polygon), clearance_of(name))
        scene += drawn_sides("obstacle", polygon)
    if room is not None:
        polygon, distance = polygon_of("room", room), clearance_of("room")
        hull = polygon.convex_hull
        sides = sides_of(shapely.orient_polygons(hull))
        rows = [sides[k : k + 4] for k in range(0, len(sides), 4)]
        for label, (ax, ay, bx, by) in zip(numbered("room", len(rows)), rows, strict=True):
            size = math.hypot(bx - ax, by - ay)
            out = ((at[0] - ax) * (by - ay) - (at[1] - ay) * (bx - ax)) / size
            inequalities.append(Inequality(label, out + distance, "m", "distance to a side"))
        for name, niche in room_niches(polygon).items():
            clear_of(name, convex_parts(niche), distance)
        scene += drawn_sides("room", polygon)
    return Region(
        "clear of obstacles" if room is None else "room", tuple(states[n] for n in position),
        tuple(inequalities), parameters=tuple(parameters), scene=tuple(scene),
    )  # fmt: skip


def room_niches(room: shapely.Polygon) -> dict[str, shapely.Polygon]:
    """What a room lacks to its convex hull: room_niche_1 and on."""
    hull = room.convex_hull
    parts = shapely.get_parts(hull.difference(room))
    niches = (n for n in parts if n.area > NOTHING * hull.area)
    return {f"room_niche_{number}": niche for number, niche in enumerate(niches, 1)}


def convex_parts(polygon: shapely.Polygon) -> list[shapely.Polygon]:
    """Convex polygons that cover it: neighbouring triangles, joined while they stay convex."""
    if _is_convex(polygon):
        return [shapely.orient_polygons(polygon)]
    parts = list(shapely.get_parts(shapely.constrained_delaunay_triangles(polygon)))
    k = 0
    while k < len(parts):
        for other in parts[k + 1 :]:
            both = shapely.union(parts[k], other)
            if both.geom_type == "Polygon" and _is_convex(both):
                parts.remove(other)
                parts[k] = both
                break
        else:
            k += 1
    return [shapely.orient_polygons(shapely.simplify(part, 0.0)) for part in parts]


def _is_convex(polygon: shapely.Polygon) -> bool:
    return bool(polygon.convex_hull.area - polygon.area <= NOTHING * polygon.area)


def numbered(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}_{k}" for k in range(1, count + 1)]


def sides_of(polygon: shapely.Polygon) -> list[float]:
    """The ends x0, y0, x1, y1 of every side, counterclockwise."""
    points = [(float(x), float(y)) for x, y in polygon.exterior.coords]
    return [c for a, b in pairwise(points) for c in (*a, *b)]


def polygon_of(name: str, corners: Corners) -> shapely.Polygon:
    """The polygon with these corners; `DefinitionError` where it is none."""
    points = [tuple(float(c) for c in corner) for corner in corners]
    if len(points) < 3 or any(len(p) != 2 for p in points):
        raise DefinitionError(
            f"polygon '{name}' has {len(points)} corners", expected="three or more of (x, y)"
        )
    if not all(math.isfinite(c) for p in points for c in p):
        raise DefinitionError(f"a corner of polygon '{name}' is not finite")
    if shapely.MultiPoint(points).convex_hull.area <= 0 and len(set(points)) == len(points):
        raise DefinitionError(f"polygon '{name}' has no area")
    if len(set(points)) != len(points):
        raise DefinitionError(f"polygon '{name}' has a corner twice", expected="each corner once")
    shape = shapely.Polygon(points)
    if not shape.is_valid or shape.area <= 0:
        reason = shapely.is_valid_reason(shape).lower()
        raise DefinitionError(
            f"polygon '{name}': {reason}", expected="corners in order, sides that do not cross"
        )
    return shapely.orient_polygons(shape)


def drawn_sides(role: str, polygon: shapely.Polygon) -> list[Segment]:
    """The sides of a polygon, to be drawn."""
    ends = sides_of(polygon)
    numbers = [sp.Float(c) for c in ends]
    return [
        Segment(role, (numbers[i], numbers[i + 1]), (numbers[i + 2], numbers[i + 3]))
        for i in range(0, len(ends), 4)
    ]


def kept_points(line: Array, within: float) -> Any:
    """The numbers of the points by which a line, shape (n, 2), is drawn, in order.

    No point of the line is farther than `within` from the line through these (Douglas and Peucker).
    """
    if len(line) < 3:
        return np.arange(len(line))
    numbered = shapely.linestrings(np.column_stack([line, np.arange(len(line))]))
    drawn = shapely.simplify(numbered, within, preserve_topology=False)
    return shapely.get_coordinates(drawn, include_z=True)[:, 2].astype(int)
