"""Targets in view among obstacles: a region, for any vehicle with a position.

A target is in view if the line of sight to it, the segment from the vehicle to the target, keeps a
clearance from every convex part of every polygon, and if the target is within the angle and the
range of the camera.

    clearance - d_j(a, b) <= 0                   a: the vehicle, b: the target
    |bearing of b - heading - pan| - half_angle <= 0
    range_min - |b - a| <= 0,    |b - a| - range_max <= 0

d_j is the distance of two convex sets; where they meet, it is minus the least displacement that
separates them. While they are apart, it is the least of the distances of the corners to the
segment, and of the ends of the segment to the polygon. Each of these has exact derivatives, off a
side and off a corner, so that an inequality is the greatest of smooth pieces: a safety filter has a
condition for each of them.

At least k of n targets are in view where the k-th least of their worst inequalities v_i is at most
0. This is a disjunction: the set is a union, and its boundary has corners that point inwards. The
inequalities are asked of the k targets whose v_i are least at the state, and of no others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Annotated

import shapely
import sympy as sp

from holdfast.arguments import Unit, Written, checked
from holdfast.errors import DefinitionError, check_name
from holdfast.maths.control.barrier_conditions import MOST_PIECES
from holdfast.maths.definitions.quantity import Parameter, expression_of, whole_number
from holdfast.maths.definitions.region import Circle, Cone, Inequality, Region, Shape
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import angle, greatest, length, select, wrap
from holdfast.maths.formations.walls import (
    Place,
    corner_to_sight,
    passing_distance,
    separation,
    signed_distance,
)
from holdfast.maths.reference_fields.dipole import GUARD, UNSEEN
from holdfast.planning.obstacles import (
    Corners,
    convex_parts,
    drawn_sides,
    numbered,
    polygon_of,
    room_niches,
    sides_of,
)

Metres = Annotated[float, Unit("m")]
Radians = Annotated[float, Unit("rad")]

DRAWN = 0.01
"""The radius of a target in figures, as a share of the scene."""


@dataclass
class _View:
    """One target: its inequalities, each with its smooth pieces, and their values."""

    inequalities: list[tuple[Inequality, list[sp.Expr]]] = field(default_factory=list)
    values: list[sp.Expr] = field(default_factory=list)

    def add(
        self, name: str, pieces: list[sp.Expr], unit: str, scale: float, description: str,
        value: sp.Expr | None = None,
    ) -> None:  # fmt: skip
        """value: the greatest of the pieces, where it has a shorter form without derivatives."""
        inequality = Inequality(name, reduce(greatest, pieces), unit, description, scale)
        self.inequalities.append((inequality, pieces))
        value = inequality.expression if value is None else value
        self.values.append(value / sp.Float(scale))


@checked
def targets_in_view(
    system: System,
    targets: Mapping[str, tuple[Written, Written]],
    polygons: Mapping[str, Corners] | None = None,
    *,
    room: Corners | None = None,
    at_least: int | None = None,
    clearance: Metres = 0.0,
    half_angle: Radians | None = None,
    range_min: Metres | None = None,
    range_max: Metres | None = None,
    heading: str = "psi",
    pan: str | None = None,
    pan_limit: Radians | None = None,
    position: tuple[str, str] = ("x", "y"),
) -> Region:
    """The region in which the vehicle sees its targets past all polygons.

        clearance - d_j(a, b) <= 0,   |bearing - heading - pan| <= half_angle,
        range_min <= |b - a| <= range_max

    system: the vehicle, in whose unit of length all is. targets: name -> (x, y), numbers, or
    expressions of the states, such as the position of a leader. polygons: name -> corners of an
    obstacle to sight, as for `obstacles`, convex or not. room: what it lacks to its convex hull
    hides targets too. at_least: how many targets have to be in view, by default all. clearance [m]:
    the least distance from the line of sight to the polygons. half_angle [rad]: of the camera.
    range_min [m]: its least range. range_max [m]: its range; None for no limit. heading: the state
    that is the direction of the camera. pan: a state that is added to it, for a camera that turns
    (`panning`). pan_limit [rad]: the largest |pan|. position: the states that are the place.

    The vehicle itself keeps the clearance as well. A target that moves is not asked how near it
    comes to a side: that is not for the vehicle to decide.

    Raises `DefinitionError` for an unknown state, polygons that `obstacles` refuses, a target that
    is inside a polygon or nearer to it than the clearance, more targets in view than there are, and
    limits that no target can meet.

    >>> lamps, pier = {"lamp": (4.0, 0.0)}, {"pier": [(2, 1), (3, 1), (3, 2), (2, 2)]}
    >>> hf.targets_in_view(robot, lamps, pier, clearance=0.1).inequality_names
    ('lamp_past_pier',)
    """
    states = {q.name: q for q in system.states}
    for name in (
        *position,
        *((heading,) if half_angle is not None else ()),
        *((pan,) if pan else ()),
    ):
        check_name(
            name, states, DefinitionError, f"'{name}' is not a state of system '{system.name}'"
        )
    _check_limits(clearance, half_angle, range_min, range_max, pan, pan_limit)
    if not targets:
        raise DefinitionError("there is no target", expected="one or more")
    count = whole_number(
        len(targets) if at_least is None else at_least, "at_least", 1, len(targets)
    )
    shapes = {name: polygon_of(name, corners) for name, corners in (polygons or {}).items()}
    hiding = shapes
    if room is not None:
        shapes = {**shapes, "room": polygon_of("room", room)}
        hiding = {**hiding, **room_niches(shapes["room"])}
    if not hiding and half_angle is None and range_min is None and range_max is None:
        raise DefinitionError(
            "nothing limits the view", remedy="give polygons, half_angle or a range"
        )
    places = {name: _place(name, at, system) for name, at in targets.items()}
    fixed = {n: at for n, at in places.items() if not at[0].free_symbols | at[1].free_symbols}
    for name, at in fixed.items():
        _check_apart(name, at, hiding, clearance)
    size = range_max or _size(
        [*shapes.values(), *(shapely.Point(*map(float, p)) for p in fixed.values())]
    )

    parameters: list[Parameter] = []

    def parameter(name: str, unit: str, value: float, description: str) -> sp.Expr:
        if all(p.name != name for p in parameters):
            parameters.append(Parameter(name, unit, description, value=float(value)))
        return next(p.symbol for p in parameters if p.name == name)

    vehicle: Place = (states[position[0]].symbol, states[position[1]].symbol)
    direction = sp.S.Zero
    if half_angle is not None:
        direction = states[heading].symbol + (states[pan].symbol if pan else 0)
    views = []
    for name, target in places.items():
        view = _View()
        away = tuple(b - a for a, b in zip(vehicle, target, strict=True))
        for of, polygon in hiding.items():
            parts = convex_parts(polygon)
            for label, part in zip(numbered(of, len(parts)), parts, strict=True):
                clear = parameter("sight_clearance", "m", clearance, "distance of a line of sight")
                pieces, value = _past(vehicle, target, part, of, clear, size)
                text = f"line of sight to {name}, past {of}"
                view.add(f"{name}_past_{label}", pieces, "m", size, text, value)
        if half_angle is not None:
            alpha = parameter("view_half_angle", "rad", half_angle, "half angle of the view")
            off = wrap(angle(away[1], away[0], GUARD**2) - direction)
            view.add(f"{name}_left", [off - alpha], "rad", half_angle, f"left edge of {name}")
            view.add(f"{name}_right", [-off - alpha], "rad", half_angle, f"right edge of {name}")
        distance = length(*away, UNSEEN)
        if range_min is not None:
            near = parameter("view_range_min", "m", range_min, "least range of the view")
            view.add(f"{name}_near", [near - distance], "m", range_min, f"{name} is not too near")
        if range_max is not None:
            far = parameter("view_range_max", "m", range_max, "range of the view")
            view.add(f"{name}_far", [distance - far], "m", range_max, f"{name} is within range")
        views.append(view)
    inequalities = _of_the_best(views, count)
    if pan_limit is not None and pan:
        most, turned = parameter("pan_limit", "rad", pan_limit, "largest pan"), states[pan].symbol
        inequalities += [
            Inequality("pan_left", turned - most, "rad", "camera within its limit, left"),
            Inequality("pan_right", -turned - most, "rad", "camera within its limit, right"),
        ]
    read = set().union(*(c.expression.free_symbols for c in inequalities))
    scene: list[Shape] = []
    for name, shape in shapes.items():
        scene += drawn_sides("room" if name == "room" else "obstacle", shape)
    scene += [Circle("target", at, sp.Float(DRAWN * size)) for at in fixed.values()]
    if half_angle is not None:
        reach = sp.Float(size if range_max is None else range_max)
        scene.append(Cone("view", vehicle, direction, sp.Float(half_angle), reach))
    every = "all targets" if count == len(views) else f"at least {count} of {len(views)} targets"
    return Region(
        "targets in view", tuple(q for q in system.states if q.symbol in read),
        tuple(inequalities), parameters=tuple(parameters), scene=tuple(scene),
        description=f"{every} in view, past all polygons",
        source="thesis chapter 6, for any vehicle; obstacles that are not convex",
    )  # fmt: skip


def _past(
    vehicle: Place, target: Place, part: shapely.Polygon, name: str, clearance: sp.Expr, size: float
) -> tuple[list[sp.Expr], sp.Expr]:
    """The smooth pieces of the clearance less d_j, and the greatest of them.

    Where the polygon is in the way, one of them is the greatest.
    """
    sides = [sp.Float(c) for c in sides_of(part)]
    corners = [(sides[k], sides[k + 1]) for k in range(0, len(sides), 4)]
    if len(corners) >= MOST_PIECES:
        raise DefinitionError(
            f"polygon '{name}' has a convex part of {len(corners)} corners",
            expected=f"at most {MOST_PIECES - 1}",
            remedy="leave out corners, or divide it",
        )
    gap = separation(vehicle, target, sides)
    pieces = [select(gap, clearance - signed_distance(vehicle, sides), clearance - gap)]
    pieces += [
        select(gap, clearance - corner_to_sight(vehicle, target, corner), -sp.Float(size))
        for corner in corners
    ]
    return pieces, clearance - passing_distance(vehicle, target, sides)


def _of_the_best(views: Sequence[_View], count: int) -> list[Inequality]:
    """The inequalities of the `count` targets that are best in view; those of others are met."""
    if count == len(views):
        return [
            Inequality(c.name, c.expression, c.unit, c.description)
            for view in views
            for c, _ in view.inequalities
        ]
    worst = [reduce(greatest, view.values) for view in views]
    chosen = []
    for i, view in enumerate(views):
        better = [
            select(worst[i] - other, sp.S.One, sp.S.Zero) if j < i
            else 1 - select(other - worst[i], sp.S.One, sp.S.Zero)
            for j, other in enumerate(worst) if j != i
        ]  # fmt: skip
        seen = count - sp.Rational(1, 2) - sp.Add(*better)
        for c, pieces in view.inequalities:
            assert c.scale is not None
            each = [select(seen, piece, -sp.Float(c.scale)) for piece in pieces]
            expression = reduce(greatest, each)
            chosen.append(Inequality(c.name, expression, c.unit, c.description, c.scale))
    return chosen


def _place(name: str, at: Sequence[object], system: System) -> Place:
    if len(at) != 2:
        raise DefinitionError(f"target '{name}' has {len(at)} coordinates", expected="(x, y)")
    place = expression_of(at[0]), expression_of(at[1])
    allowed = {q.symbol for q in system.states}
    for coordinate in place:
        if outside := coordinate.free_symbols - allowed:
            raise DefinitionError(
                f"target '{name}' is at '{min(map(str, outside))}', which is not a state of system "
                f"'{system.name}'",
                expected="numbers, or expressions of states",
            )
        if not coordinate.free_symbols and not coordinate.is_finite:
            raise DefinitionError(f"a coordinate of target '{name}' is not finite")
    return place


def _check_apart(
    name: str, at: Place, hiding: Mapping[str, shapely.Polygon], clearance: float
) -> None:
    point = shapely.Point(*map(float, at))
    for of, polygon in hiding.items():
        distance = float(shapely.distance(point, polygon))
        if distance == 0 or distance < clearance:
            near = f"{distance:.3g} m from polygon '{of}', less than the clearance {clearance:g} m"
            raise DefinitionError(
                f"target '{name}' is " + (near if distance else f"inside polygon '{of}', or on it"),
                expected="a target that can be seen",
                remedy="move the target" + (", or make the clearance less" if distance else ""),
            )


def _check_limits(
    clearance: float, half_angle: float | None, near: float | None, far: float | None,
    pan: str | None, pan_limit: float | None,
) -> None:  # fmt: skip
    if not 0 <= clearance < math.inf:
        raise DefinitionError(f"clearance is {clearance}", expected="a number of m, 0 or more")
    limits = {"half_angle": half_angle, "range_min": near, "range_max": far, "pan_limit": pan_limit}
    for name, value in limits.items():
        if value is not None and not 0 < value < math.inf:
            raise DefinitionError(f"{name} is {value}", expected="a number above 0, or None")
    if half_angle is not None and half_angle >= math.pi:
        raise DefinitionError(
            f"half_angle is {half_angle:g} rad",
            expected="less than pi",
            remedy="None sees all round",
        )
    if near is not None and far is not None and near >= far:
        raise DefinitionError(f"range_min {near:g} m is not below range_max {far:g} m")
    if pan and half_angle is None:
        raise DefinitionError(
            f"pan '{pan}' without half_angle", expected="both: a camera that turns"
        )
    if pan_limit is not None and not pan:
        raise DefinitionError("pan_limit without pan", expected="both, or neither")


def _size(shapes: Sequence[shapely.Geometry]) -> float:
    """The diagonal of a box around all."""
    x0, y0, x1, y1 = shapely.total_bounds(list(shapes)) if shapes else (0.0, 0.0, 0.0, 0.0)
    return math.hypot(x1 - x0, y1 - y0) or 1.0
