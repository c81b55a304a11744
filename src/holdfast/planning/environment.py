"""The free space of robots as convex cells, the passages between them, and their order on a route.

Cells are read from a GeoJSON file, or given.

Every cell of a route has a field, which is verified on every face.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import shapely
import shapely.ops

from holdfast.errors import DefinitionError, ScenarioError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.host.files import read_small_text
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.definitions.value import Value
from holdfast.maths.formations.footprint import (
    Edge,
    Field,
    blended,
    direction_of,
    edges,
    exit_field,
    goal_field,
    polygon,
)

Point = tuple[float, float]


def shown(point: Sequence[float] | Array) -> str:
    """A point as text for messages, of the shape (2,)."""
    x, y = (round(float(v), 3) + 0.0 for v in point)  # no -0
    return f"({x:g}, {y:g})"


CLOSE = 1e-6
"""Lengths [m] below this count as zero: faces this close lie on the same line."""


@dataclass(frozen=True)
class Cell:
    """A convex polygon, its corners counterclockwise [m]."""

    name: str
    corners: tuple[Point, ...]

    @cached_property
    def faces(self) -> tuple[Edge, ...]:
        """The sides, each from a corner to the next."""
        return edges(self.corners)

    @cached_property
    def shape(self) -> shapely.Polygon:
        return shapely.Polygon(self.corners)

    def side(self, number: int) -> tuple[Array, Array]:
        """The ends of a face, each of the shape (2,)."""
        ends = np.array([self.corners[number], self.corners[(number + 1) % len(self.corners)]])
        return ends[0], ends[1]

    @cached_property
    def _planes(self) -> tuple[Array, Array]:
        """Outward normals and offsets of the faces."""
        normals = np.array([[f.ahead, f.left] for f in self.faces], dtype=float)
        return normals, np.array([f.offset for f in self.faces], dtype=float) + CLOSE

    def contains(self, point: Sequence[float] | Array) -> bool:
        """Whether a point is in the cell or on its border: shape (2,)."""
        normals, offsets = self._planes
        return bool((normals @ np.asarray(point, dtype=float) <= offsets).all())


@dataclass(frozen=True)
class Passage:
    """The part of a border that robots' centres can cross: a segment of a face of each cell.

    `face` belongs to the first cell, (a, b) are the ends, `normal` points into the next cell.
    """

    face: int
    a: Point
    b: Point
    normal: Point

    @property
    def middle(self) -> Point:
        return ((self.a[0] + self.b[0]) / 2, (self.a[1] + self.b[1]) / 2)

    @property
    def width(self) -> float:
        return math.dist(self.a, self.b)


@dataclass(frozen=True, eq=False)
class Environment(Value):
    """Cells as given, and for the centres of robots of `robot_radius`: `inner`, with `passages`.

    passages: (cell, next cell) -> their common segment; `closed` explains why two touching cells
    have none that a robot can pass. free: the union of all cells; walls are its border.
    """

    cells: tuple[Cell, ...]
    robot_radius: float
    inner: tuple[Cell, ...]
    passages: Mapping[tuple[int, int], Passage]
    closed: tuple[str, ...]
    free: shapely.Geometry

    @cached_property
    def walls(self) -> tuple[tuple[Point, Point], ...]:
        """The border of the free space, as segments."""
        return _segments(shapely.simplify(self.free.buffer(-CLOSE, join_style="mitre"), 2 * CLOSE))

    @cached_property
    def _roomy(self) -> tuple[shapely.Geometry, shapely.Geometry]:
        """The free space of the robots' centres, and its border."""
        inner = shapely.union_all([c.shape.buffer(CLOSE, join_style="mitre") for c in self.inner])
        border = inner.boundary
        shapely.prepare(inner)
        shapely.prepare(border)
        return inner, border

    def room(self, places: Array) -> Array:
        """The clearance of robots at places (..., 2) to the walls; negative inside a wall. The
        clearances have the shape (...,) in m."""
        inner, border = self._roomy
        x, y = places[..., 0], places[..., 1]
        gap = shapely.distance(shapely.points(x, y), border)
        signed: Array = np.where(shapely.contains_xy(inner, x, y), gap, -gap)
        return signed

    def in_sight(self, one: Sequence[float], other: Sequence[float]) -> bool:
        """Whether the line between two places crosses no wall."""
        return bool(self.free.covers(shapely.LineString([one, other])))

    def cells_at(self, point: Sequence[float]) -> set[int]:
        """All cells that contain a robot's centre at that point: two on a common segment."""
        return {i for i, c in enumerate(self.inner) if c.contains(point)}


def environment(cells: Mapping[str, object], robot_radius: float) -> Environment:
    """The free space { name: corners } for robots of that radius.

    Cells are convex polygons with corners in order, (x, y) in m, that touch without overlapping.
    A face that lies along another cell opens to it where they touch. The rest is wall, and robots'
    centres stay a radius away from walls. Of two faces that touch, one has to be open over its
    entire length. Raises `DefinitionError`, naming the cell and the face, for cells that are not
    convex, overlap or are narrower than a robot, and for faces that touch otherwise.
    """
    if isinstance(robot_radius, bool) or not 0 < robot_radius < math.inf:
        raise DefinitionError(f"robot_radius is {robot_radius!r}", expected="above 0")
    if not cells:
        raise DefinitionError("the environment has no cells", expected="at least one")
    all_cells = tuple(Cell(n, polygon(v, f"cell '{n}'")) for n, v in cells.items())
    for one, other in combinations(all_cells, 2):
        shared = one.shape.intersection(other.shape)
        if shared.area > CLOSE:
            raise DefinitionError(
                f"cells '{one.name}' and '{other.name}' overlap by {shared.area:.3g} m^2 at "
                f"{shown(shared.centroid.coords[0])}",
                expected="cells that touch without overlapping",
            )
    touching = _touching(all_cells)
    offsets = _offsets(all_cells, touching, robot_radius)
    free = shapely.union_all([c.shape.buffer(CLOSE, join_style="mitre") for c in all_cells])
    inner = tuple(_inner(c, offsets[i], robot_radius, free) for i, c in enumerate(all_cells))
    passages, closed = _passages(all_cells, inner, touching)
    return Environment(all_cells, robot_radius, inner, passages, tuple(closed), free)


# -- from cells to the free space of the robots' centres -----------------------------------------


@dataclass(frozen=True)
class _Contact:
    """Faces (cell, number) of two cells on one line, and the ends of their common segment."""

    one: tuple[int, int]
    other: tuple[int, int]
    a: Array
    b: Array


def _touching(cells: tuple[Cell, ...]) -> list[_Contact]:
    contacts = []
    for (i, one), (j, other) in combinations(enumerate(cells), 2):
        for k, face in enumerate(one.faces):
            for m, opposite in enumerate(other.faces):
                if shared := _shared(one.side(k), face, other.side(m), opposite):
                    contacts.append(_Contact((i, k), (j, m), *shared))
    return contacts


def _shared(
    side: tuple[Array, Array], face: Edge, across: tuple[Array, Array], opposite: Edge
) -> tuple[Array, Array] | None:
    """The common segment of two opposite faces on a line."""
    normal = np.array([face.ahead, face.left], dtype=float)
    other = np.array([opposite.ahead, opposite.left], dtype=float)
    beside = max(abs(float(normal @ end) - float(face.offset)) for end in across)
    if normal @ other > -1 + 1e-9 or beside > CLOSE:
        return None
    along = (side[1] - side[0]) / np.linalg.norm(side[1] - side[0])
    low, high = sorted(float(along @ (e - side[0])) for e in across)
    low, high = max(low, 0.0), min(high, float(np.linalg.norm(side[1] - side[0])))
    return (side[0] + low * along, side[0] + high * along) if high - low > CLOSE else None


def _offsets(cells: tuple[Cell, ...], touching: list[_Contact], radius: float) -> list[list[float]]:
    """The outward shift of each face for the robots' centres.

    A face that contains wall moves in by the radius; a face that opens to it moves out to meet it.
    """
    open_length: dict[tuple[int, int], float] = {}
    for contact in touching:
        size = float(np.linalg.norm(contact.b - contact.a))
        for key in (contact.one, contact.other):
            open_length[key] = open_length.get(key, 0.0) + size

    def is_open(key: tuple[int, int]) -> bool:
        a, b = cells[key[0]].side(key[1])
        return open_length.get(key, 0.0) > float(np.linalg.norm(b - a)) - 2 * CLOSE

    wanted: dict[tuple[int, int], set[float]] = {}
    for contact in touching:
        one, other = is_open(contact.one), is_open(contact.other)
        if not one and not other:
            names = cells[contact.one[0]].name, cells[contact.other[0]].name
            raise DefinitionError(
                f"cells '{names[0]}' and '{names[1]}' share a part of a face of each, from "
                f"{shown(contact.a)} to {shown(contact.b)}",
                remedy="split one of the cells there, so that it opens over all of a face",
            )
        for key, mine, theirs in (
            (contact.one, one, other),
            (contact.other, other, one),
        ):
            if mine:
                wanted.setdefault(key, set()).add(0.0 if theirs else radius)
    for (i, k), values in wanted.items():
        if len(values) > 1:
            a, b = cells[i].side(k)
            raise DefinitionError(
                f"the face of cell '{cells[i].name}' from {shown(a)} to {shown(b)} borders on "
                "cells that end there and on one that does not",
                remedy="split the cell there",
            )
    return [
        [next(iter(wanted.get((i, k), {-radius}))) for k in range(len(c.faces))]
        for i, c in enumerate(cells)
    ]


def _inner(cell: Cell, offsets: list[float], radius: float, free: shapely.Geometry) -> Cell:
    """The part of a cell for robots' centres: its faces moved by the offsets, less the parts still
    too near to a wall, cut off perpendicular to the shortest way there."""
    size = 4 * max(math.dist(a, b) for a in cell.corners for b in cell.corners)
    shape: shapely.Geometry = cell.shape.buffer(size, join_style="mitre")
    for face, offset in zip(cell.faces, offsets, strict=True):
        normal = np.array([face.ahead, face.left], dtype=float)
        shape = _cut(shape, normal, float(face.offset) + offset, size)
    border = free.boundary
    for _ in range(100):
        if shape.is_empty or shape.geom_type != "Polygon" or shape.area < CLOSE:
            break
        here, wall = (np.array(p.coords[0]) for p in shapely.ops.nearest_points(shape, border))
        gap = float(np.linalg.norm(wall - here))
        if gap > radius - 2 * CLOSE:
            corners = list(shapely.simplify(shapely.normalize(shape), CLOSE).exterior.coords)[:-1]
            return Cell(cell.name, polygon(corners, f"cell '{cell.name}'"))
        towards = (wall - here) / gap if gap > 2 * CLOSE else _outwards(shape, wall)
        shape = _cut(shape, towards, float(towards @ wall) - radius, size)
    raise DefinitionError(
        f"cell '{cell.name}' is narrower than a robot", expected=f"more than {2 * radius:g} m"
    )


def _cut(shape: shapely.Geometry, normal: Array, offset: float, size: float) -> shapely.Geometry:
    """The part of the shape with normal . p <= offset."""
    if shape.is_empty:
        return shape
    along = np.array([-normal[1], normal[0]])
    middle = np.array(shape.centroid.coords[0])
    foot = middle + (offset - normal @ middle) * normal
    ends = [foot - 4 * size * along, foot + 4 * size * along]
    return shape.intersection(
        shapely.Polygon([*ends, *(e - 8 * size * normal for e in reversed(ends))])
    )


def _outwards(shape: shapely.Polygon, corner: Array) -> Array:
    """The direction in the middle between the normals of the sides at a corner of a polygon."""
    corners = np.array(shapely.orient_polygons(shape).exterior.coords)[:-1]
    k = int(np.argmin(np.linalg.norm(corners - corner, axis=1)))
    ways = corners[k] - corners[k - 1], corners[(k + 1) % len(corners)] - corners[k]
    total = sum(np.array([w[1], -w[0]]) / np.linalg.norm(w) for w in ways)
    return np.asarray(total / np.linalg.norm(total))


def _passages(
    cells: tuple[Cell, ...], inner: tuple[Cell, ...], touching: list[_Contact]
) -> tuple[dict[tuple[int, int], Passage], list[str]]:
    passages: dict[tuple[int, int], Passage] = {}
    closed = []
    for i, j in sorted({(c.one[0], c.other[0]) for c in touching}):
        shared = [
            (k, m, ends)
            for k, face in enumerate(inner[i].faces)
            for m, opposite in enumerate(inner[j].faces)
            if (ends := _shared(inner[i].side(k), face, inner[j].side(m), opposite))
        ]
        if not shared:
            closed.append(f"between '{cells[i].name}' and '{cells[j].name}' no robot passes")
            continue
        k, m, (a, b) = max(shared, key=lambda s: float(np.linalg.norm(s[2][1] - s[2][0])))
        for one, other, face in ((i, j, k), (j, i, m)):
            edge = inner[one].faces[face]
            passages[one, other] = Passage(
                face,
                (float(a[0]), float(a[1])),
                (float(b[0]), float(b[1])),
                (float(edge.ahead), float(edge.left)),
            )
    return passages, closed


def _segments(shape: shapely.Geometry) -> tuple[tuple[Point, Point], ...]:
    polygons = getattr(shape, "geoms", [shape])
    rings = [r for p in polygons for r in (p.exterior, *p.interiors)]
    segments: list[tuple[Point, Point]] = []
    for ring in rings:
        points = [(float(x), float(y)) for x, y in ring.coords]
        segments += pairwise(points)
    return tuple(segments)


MOST = 100 * 2**20
"""The largest size of a map in bytes."""


def geojson_cells(path: str | Path) -> dict[str, list[Point]]:
    """{ name: corners } of the polygons of a GeoJSON file, named by their `name`, or id, or number.

    Coordinates are metres in a plane. The polygons of a MultiPolygon are NAME_1 and on. Raises
    `DefinitionError` for a file that cannot be read, is not GeoJSON, or has anything but polygons
    without holes.
    """
    try:
        data = json.loads(read_small_text(path, MOST))
    except ScenarioError as error:
        raise DefinitionError(error.cause, expected=error.expected) from None
    except (ValueError, RecursionError):
        raise DefinitionError(f"{path} is not a JSON file") from None
    features = data.get("features") if isinstance(data, dict) else None
    if not isinstance(features, list) or not features:
        raise DefinitionError(
            f"{path} is not a GeoJSON file of cells",
            expected='{"type": "FeatureCollection", "features": [...]}',
        )
    by_name: dict[str, list[Point]] = {}
    for number, feature in enumerate(features, start=1):
        for name, corners in _geojson_parts(feature, number, path):
            if name in by_name:
                raise DefinitionError(f"{path}: two cells are called '{name}'")
            by_name[name] = corners
    return by_name


def _geojson_parts(feature: Any, number: int, path: str | Path) -> list[tuple[str, list[Point]]]:
    if not isinstance(feature, dict):
        raise DefinitionError(f"{path}: feature {number} is {feature!r}")
    about = feature.get("properties")
    named = about.get("name") if isinstance(about, dict) else None
    name = str(named or feature.get("id", f"cell_{number}"))
    shape = feature.get("geometry")
    shape = shape if isinstance(shape, dict) else {}
    kind = shape.get("type")
    parts = {"Polygon": [shape.get("coordinates")], "MultiPolygon": shape.get("coordinates")}
    polygons = parts.get(kind) if isinstance(kind, str) else None
    if not isinstance(polygons, list) or not polygons:
        polygons = [None]
    named = []
    for count, rings in enumerate(polygons, start=1):
        if not isinstance(rings, list) or len(rings) != 1 or not isinstance(rings[0], list):
            raise DefinitionError(
                f"{path}: '{name}' is a {kind or 'feature without geometry'}",
                expected="a Polygon or MultiPolygon without holes",
            )
        ring = rings[0]
        if len(ring) > 1 and ring[0] == ring[-1]:
            ring = ring[:-1]
        label = name if len(polygons) == 1 else f"{name}_{count}"
        named.append((label, [tuple(c[:2]) if isinstance(c, list) else c for c in ring]))
    return named


ALMOST = 0.8


@dataclass(frozen=True)
class Leg:
    """A cell for the robots' centres, and its exit passage; None in the cell of the goal."""

    cell: Cell
    exit: Passage | None


@dataclass(frozen=True)
class Route:
    """The legs in order; `goal` lies in the last."""

    environment: Environment
    legs: tuple[Leg, ...]
    goal: Point

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(leg.cell.name for leg in self.legs)


def plan_route(environment: Environment, start: Sequence[float], goal: Sequence[float]) -> Route:
    """The shortest way over the cells, by the middles of the passages.

    start, goal: (x, y) [m] of the centre of a robot. Raises `DefinitionError` if one of them is
    outside the robots' free space, or if no way leads from one to the other.
    """
    places = [_place(environment, p, what) for p, what in ((start, "start"), (goal, "goal"))]
    graph = nx.DiGraph()
    # edges connect passages of one cell, weighted by length; a passage joins two cells
    for (i, j), passage in environment.passages.items():
        for (a, b), onwards in environment.passages.items():
            if a == j and b != i:
                far = math.dist(passage.middle, onwards.middle)
                graph.add_edge((i, j), (a, b), length=far)
        if i in places[0]:
            graph.add_edge("start", (i, j), length=math.dist(start, passage.middle))
        if j in places[1]:
            graph.add_edge((i, j), "goal", length=math.dist(goal, passage.middle))
    if places[0] & places[1]:
        graph.add_edge("start", "goal", length=math.dist(start, goal))
    try:
        nodes = nx.shortest_path(graph, "start", "goal", weight="length")[1:-1]
    except (nx.NetworkXNoPath, nx.NodeNotFound):
        names = [environment.cells[min(p)].name for p in places]
        why = f" ({'; '.join(environment.closed)})" if environment.closed else ""
        raise DefinitionError(
            f"no way leads from cell '{names[0]}' to cell '{names[1]}'{why}"
        ) from None
    last = nodes[-1][1] if nodes else min(places[0] & places[1])
    legs = [_leg(environment.inner[i], environment.passages[i, j]) for i, j in nodes]
    legs.append(Leg(environment.inner[last], None))
    return Route(environment, tuple(legs), (float(goal[0]), float(goal[1])))


def _leg(cell: Cell, exit: Passage) -> Leg:
    """The cell, cut back to the passage if that is nearly all of its face.

    The field then has to change its sense on a face only if the wall beside a door is long.
    """
    a, b = cell.side(exit.face)
    if exit.width < ALMOST * math.dist(a, b):
        return Leg(cell, exit)
    ends = sorted((exit.a, exit.b), key=lambda end: math.dist(end, a))
    corners = list(cell.corners)
    corners[exit.face], corners[(exit.face + 1) % len(corners)] = ends
    return Leg(Cell(cell.name, tuple(corners)), exit)


def _place(environment: Environment, point: Sequence[float], what: str) -> set[int]:
    numbers = environment.cells_at(point)
    if numbers:
        return numbers
    if any(cell.contains(point) for cell in environment.cells):
        raise DefinitionError(
            f"at the {what} {shown(point)} a robot would touch a wall",
            expected=f"at least {environment.robot_radius:g} m from all walls",
        )
    raise DefinitionError(f"the {what} {shown(point)} is outside the free space")


X, Y = symbol("xL"), symbol("yL")

SAMPLES = 401
"""Number of points on every face at which the field is checked."""

DEPTH = 0.1
"""Depth of the faces' influence in a blended cell, as a share of the root of its area."""


@dataclass(frozen=True, eq=False)
class Fields(Value):
    """One field for every leg of a route, in xL and yL, with the values of its parameters."""

    route: Route
    fields: tuple[Field, ...]
    parameters: tuple[Parameter, ...]

    @cached_property
    def _headings(self) -> Evaluator:
        return Evaluator([direction_of(f) for f in self.fields], [X, Y], self.parameters)

    def headings(self, number: int, places: Array) -> Array:
        """The direction of the field of a leg at places of shape (n, 2), numbers from 0."""
        angles: Array = self._headings.values(places)[:, number]
        return angles


def route_fields(route: Route, exponent: float = 3.0) -> Fields:
    """The field of every leg: dipolar to its exit, the last straight to the goal.

    exponent: lambda. If a dipolar field points out of a wall, or into the cell at its exit, it is
    blended with terms that point away from the faces. Raises `DefinitionError`, naming cell and
    face, if the blended field does so too.
    """
    parameters = _parameters(route, exponent)
    fields = [_field(number, leg) for number, leg in enumerate(route.legs, start=1)]
    for number in {leg for leg, _ in _wrong_faces(route, fields, parameters)}:
        leg = route.legs[number]
        depth = DEPTH * math.sqrt(leg.cell.shape.area)
        fields[number] = blended(fields[number], X, Y, leg.cell.faces, _senses(leg), depth)
    wrong = _wrong_faces(route, fields, parameters)
    if wrong:
        number, face = wrong[0]
        leg = route.legs[number]
        out = leg.exit is not None and leg.exit.face == face
        a, b = leg.cell.side(face)
        raise DefinitionError(
            f"the field of cell '{leg.cell.name}' does not point {'out' if out else 'inwards'} all "
            f"along its face from {shown(a)} to {shown(b)}",
            remedy="split the cell, so that its angles are smaller",
        )
    return Fields(route, tuple(fields), parameters)


def _parameters(route: Route, exponent: float) -> tuple[Parameter, ...]:
    """The parameters of the fields, by name."""
    parameters = [
        Parameter("lam", "1", "exponent lambda of the fields", value=exponent, above=1.0),
        Parameter("goal_x", "m", "goal of the leader", value=route.goal[0]),
        Parameter("goal_y", "m", "goal of the leader", value=route.goal[1]),
    ]
    for number, leg in enumerate(route.legs, start=1):
        if leg.exit is not None:
            direction = math.atan2(leg.exit.normal[1], leg.exit.normal[0])
            shift = leg.exit.width / 2 / math.sqrt(exponent - 1)  # all of the passage only
            parameters += [
                Parameter(f"exit{number}_x", "m", "middle of a passage", value=leg.exit.middle[0]),
                Parameter(f"exit{number}_y", "m", "middle of a passage", value=leg.exit.middle[1]),
                Parameter(f"exit{number}_direction", "rad", "of its normal", value=direction),
                Parameter(f"exit{number}_shift", "m", "zero of the field beyond it", value=shift),
            ]
    return tuple(parameters)


def _field(number: int, leg: Leg) -> Field:
    if leg.exit is None:
        return goal_field(X, Y, (symbol("goal_x"), symbol("goal_y")))
    x, y, direction, shift = (symbol(f"exit{number}_{n}") for n in ("x", "y", "direction", "shift"))
    return exit_field(X, Y, (x, y), direction, shift, symbol("lam"))


def _senses(leg: Leg) -> list[int]:
    """Of every face: -1 for a wall, +1 for the exit, 0 for a face that is partly the exit."""
    senses = [-1] * len(leg.cell.faces)
    if leg.exit is not None:
        a, b = leg.cell.side(leg.exit.face)
        whole = leg.exit.width > float(np.linalg.norm(b - a)) - 4 * CLOSE
        senses[leg.exit.face] = 1 if whole else 0
    return senses


def _wrong_faces(
    route: Route, fields: Sequence[Field], values: Sequence[Parameter]
) -> list[tuple[int, int]]:
    """The first (leg, face) where the field does not point inwards, or outwards at the exit.

    On a face that is partly the exit, the rest is a wall. The field of the goal's cell points
    straight to a point of a convex cell, and so out of no face.
    """
    check = Evaluator([e for field in fields for e in field], [X, Y], values)
    wrong = []
    for number, leg in enumerate(route.legs[:-1]):
        for k, face in enumerate(leg.cell.faces):
            a, b = leg.cell.side(k)
            share = (np.arange(SAMPLES) + 0.5)[:, None] / SAMPLES  # ends belong to two faces
            places = a + share * (b - a)
            field = check.values(places)[:, 2 * number : 2 * number + 2]
            outwards = field @ np.array([face.ahead, face.left], dtype=float)
            out = np.zeros(SAMPLES, dtype=bool)
            if leg.exit is not None and leg.exit.face == k:
                from_middle = np.linalg.norm(places - np.array(leg.exit.middle), axis=1)
                out = from_middle < leg.exit.width / 2
            if not np.where(out, outwards > 0, outwards < 0).all():
                wrong.append((number, k))
    return wrong
