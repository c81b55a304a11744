"""Sensor footprints, convex polygons in the robot's own frame, and fields in convex cells.

The field of a cell exits through one face (thesis section 6.5.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.expressions.functions import angle, clip, length
from holdfast.maths.reference_fields.dipole import UNSEEN


@dataclass(frozen=True)
class Edge:
    """ahead * X + left * Y <= offset, (ahead, left) being the outward normal of length one."""

    ahead: sp.Expr
    left: sp.Expr
    offset: sp.Expr


Polygon = tuple[tuple[float, float], ...]


def triangle(reach: sp.Expr, half_angle: sp.Expr) -> tuple[tuple[sp.Expr, sp.Expr], ...]:
    """The view of a camera whose sides are `reach` long, `half_angle` from straight ahead."""
    ahead, left = reach * sp.cos(half_angle), reach * sp.sin(half_angle)
    return (sp.S.Zero, sp.S.Zero), (ahead, -left), (ahead, left)


def polygon(vertices: object = None, what: str = "the footprint") -> Polygon:
    """The vertices of a convex polygon, counterclockwise; None: the triangle of 2.5 m, 35 degrees.

    Raises `DefinitionError` for fewer than three vertices, vertices that are not pairs of numbers,
    and a polygon that is not convex.
    """
    if vertices is None:
        usual = triangle(sp.Float(2.5), sp.rad(35))
        return tuple((float(a), float(b)) for a, b in usual)
    points = _points(vertices, what)
    count = len(points)
    ways = [_minus(points[(i + 1) % count], points[i]) for i in range(count)]
    turns = [a[0] * b[1] - a[1] * b[0] for a, b in zip((ways[-1], *ways[:-1]), ways, strict=True)]
    side = math.copysign(1.0, sum(turns))
    for point, turn in zip(points, turns, strict=True):
        if not turn * side > 0:
            raise DefinitionError(
                f"{what} is not convex at ({point[0]:g}, {point[1]:g})",
                expected="a convex polygon, its vertices in order, none between two others",
            )
    headings = [math.atan2(b, a) for a, b in ways]
    around = sum(math.remainder(headings[i] - headings[i - 1], math.tau) for i in range(count))
    if abs(around) > 1.5 * math.tau:
        raise DefinitionError(f"{what} winds around twice", expected="vertices in order")
    return tuple(points if side > 0 else reversed(points))


def edges(corners: Polygon) -> tuple[Edge, ...]:
    """The sides of a polygon that `polygon` returned."""
    sides = []
    for one, other in zip(corners, corners[1:] + corners[:1], strict=True):
        along, aside = _minus(other, one)
        size = math.hypot(along, aside)
        normal = aside / size, -along / size
        offset = normal[0] * one[0] + normal[1] * one[1]
        sides.append(Edge(*(sp.Float(value) for value in (*normal, offset))))
    return tuple(sides)


def _minus(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    return a[0] - b[0], a[1] - b[1]


def side_parameters(corners: Polygon) -> tuple[tuple[Edge, ...], tuple[Parameter, ...]]:
    """The sides as symbols, and their values: polygons of equal side count share one program."""
    symbols, values = [], []
    for number, side in enumerate(edges(corners), start=1):
        named = [
            Parameter(f"side{number}_{name}", unit, what, value=float(getattr(side, name)))
            for name, unit, what in (
                ("ahead", "1", "normal of a side of the footprint"),
                ("left", "1", "normal of a side of the footprint"),
                ("offset", "m", "distance of a side from the sensor"),
            )
        ]
        symbols.append(Edge(*(p.symbol for p in named)))
        values += named
    return tuple(symbols), tuple(values)


def body_coordinates() -> tuple[sp.Expr, sp.Expr]:
    """The leader's position in the frame of a follower at (x, y, beta) of the leader's frame."""
    x, y, beta = (symbol(n) for n in ("x", "y", "beta"))
    return -x * sp.cos(beta) - y * sp.sin(beta), x * sp.sin(beta) - y * sp.cos(beta)


def _listed(value: Any) -> list[Any]:
    """The entries of a list, a tuple or an array; none for anything else."""
    value = getattr(value, "tolist", lambda: value)()
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else []


def _points(vertices: object, what: str) -> list[tuple[float, float]]:
    points = []
    for vertex in _listed(vertices):
        numbers = _listed(vertex)
        if len(numbers) != 2 or not all(
            isinstance(n, int | float) and math.isfinite(n) for n in numbers
        ):
            raise DefinitionError(
                f"vertex {vertex!r} of {what}", expected="two finite numbers in m"
            )
        points.append((float(numbers[0]), float(numbers[1])))
    if len(points) < 3:
        raise DefinitionError(
            f"{what} has {len(points)} vertices", expected="at least 3 pairs of numbers"
        )
    return points


Field = tuple[sp.Expr, sp.Expr]

WEIGHT = sp.Float(8)
"""Weight of a face's term, relative to the unit field, at the face itself."""


def exit_field(
    x: sp.Expr,
    y: sp.Expr,
    middle: tuple[sp.Expr, sp.Expr],
    direction: sp.Expr,
    shift: sp.Expr,
    exponent: sp.Expr,
) -> Field:
    """The dipolar field (6.10) that exits a cell through a passage.

    middle: midpoint of the passage; direction: of its outward normal and of the moment p. The zero
    of the field lies `shift` beyond the passage: at the midpoint itself, as in the thesis, the
    field points back into the cell all along the passage. On the line of the passage, at a distance
    eta from its middle, the outward component is (lambda - 1) shift^2 - eta^2.
    """
    along, left = _aligned(x - middle[0], y - middle[1], direction)
    along -= shift
    ahead = (exponent - 1) * along**2 - left**2
    aside = exponent * along * left
    cos, sin = sp.cos(direction), sp.sin(direction)
    return cos * ahead - sin * aside, sin * ahead + cos * aside


def goal_field(x: sp.Expr, y: sp.Expr, goal: tuple[sp.Expr, sp.Expr]) -> Field:
    """A field that points straight to a point of the cell from everywhere."""
    return goal[0] - x, goal[1] - y


def blended(
    field: Field,
    x: sp.Expr,
    y: sp.Expr,
    faces: Sequence[Edge],
    senses: Sequence[int],
    depth: float,
) -> Field:
    """The unit field plus, near every face, a term away from a wall or out through the exit.

        F / |F| + sum_i 8 sense_i smoothstep(1 - d_i / depth) n_i

    d_i: distance to face i [m]; n_i: its outward normal; senses: -1 for a wall, +1 for an exit, 0
    for a face that is both. For cells of any convex shape: where two faces meet, the weight has to
    be above 1 / (1 + n_i . n_j).
    """
    size = length(*field, UNSEEN)
    total = [component / size for component in field]
    for face, sense in zip(faces, senses, strict=True):
        inside = face.offset - face.ahead * x - face.left * y
        near = clip(1 - inside / sp.Float(depth), sp.S.Zero, sp.S.One)
        push = sense * WEIGHT * near**2 * (3 - 2 * near)
        total = [t + push * n for t, n in zip(total, (face.ahead, face.left), strict=True)]
    return total[0], total[1]


def direction_of(field: Field) -> sp.Expr:
    """The angle of a field without a zero in the region of use."""
    return angle(field[1], field[0], UNSEEN)


def _aligned(ahead: sp.Expr, aside: sp.Expr, direction: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    cos, sin = sp.cos(direction), sp.sin(direction)
    return cos * ahead + sin * aside, cos * aside - sin * ahead
