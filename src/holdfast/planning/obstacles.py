"""Polygons as obstacles of any vehicle with a position: a region by exact distances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.scene import Segment
from holdfast.maths.definitions.system import System
from holdfast.maths.formations.walls import signed_distance

if TYPE_CHECKING:
    import shapely

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

        clearance - d_j(x, y) <= 0,    d_room(x, y) + clearance <= 0

    d_j [m] is the signed distance to polygon j, negative inside it; its derivatives are those of
    the nearest side or corner. polygons: name -> corners (x, y) [m], in order, not closed;
    they need not be convex. room: the corners of a polygon to stay in. clearance [m]: a radius of
    the vehicle; a parameter of the region. position: the states that are the place.

    Raises `DefinitionError` for an unknown state, fewer than three corners, corners that are not
    finite, sides that cross or have no length, and a clearance below 0.
    """
    states = {q.name: q for q in system.states}
    for name in position:
        if name not in states:
            raise DefinitionError(
                f"'{name}' is not a state of system '{system.name}'",
                remedy=suggestion(name, states),
            )
    if not (math.isfinite(clearance) and clearance >= 0):
        raise DefinitionError(f"clearance is {clearance}", expected="a number of m, 0 or more")
    if not polygons and room is None:
        raise DefinitionError("there is neither a polygon nor a room")
    kept = Parameter("clearance", "m", "distance from obstacles", value=float(clearance))
    at = states[position[0]].symbol, states[position[1]].symbol
    inequalities, scene = [], []
    for name, corners in polygons.items():
        ends = _sides(name, corners)
        inequalities.append(
            Inequality(name, kept.symbol - signed_distance(at, ends), "m", f"distance to {name}")
        )
        scene += _drawn(ends)
    if room is not None:
        ends = _sides("room", room)
        inequalities.append(
            Inequality("room", signed_distance(at, ends) + kept.symbol, "m", "distance to the room")
        )
        scene += _drawn(ends)
    return Region(
        "clear of obstacles" if room is None else "room", tuple(states[n] for n in position),
        tuple(inequalities), parameters=(kept,), scene=tuple(scene),
    )  # fmt: skip


def _sides(name: str, corners: Corners) -> list[float]:
    """The ends x0, y0, x1, y1 of every side, counterclockwise."""
    ring = _polygon(name, corners).exterior.coords
    points = [(float(x), float(y)) for x, y in ring]
    return [c for a, b in pairwise(points) for c in (*a, *b)]


def _polygon(name: str, corners: Corners) -> shapely.Polygon:
    import shapely

    points = [tuple(float(c) for c in corner) for corner in corners]
    if len(points) < 3 or any(len(p) != 2 for p in points):
        raise DefinitionError(
            f"polygon '{name}' has {len(points)} corners", expected="three or more of (x, y)"
        )
    if not all(math.isfinite(c) for p in points for c in p):
        raise DefinitionError(f"a corner of polygon '{name}' is not finite")
    if len(set(points)) != len(points):
        raise DefinitionError(f"polygon '{name}' has a corner twice", expected="each corner once")
    found = shapely.Polygon(points)
    if not found.is_valid or found.area <= 0:
        reason = shapely.is_valid_reason(found).lower()
        raise DefinitionError(
            f"polygon '{name}': {reason}", expected="corners in order, sides that do not cross"
        )
    return shapely.orient_polygons(found)


def _drawn(ends: Sequence[float]) -> list[Segment]:
    numbers = [sp.Float(c) for c in ends]
    return [
        Segment("wall", (numbers[i], numbers[i + 1]), (numbers[i + 2], numbers[i + 3]))
        for i in range(0, len(ends), 4)
    ]
