"""A field of any dimension, restricted to the planes through its moment p.

Where the field is axially symmetric, every plane span{p, e} is invariant and carries the same
picture, so a critical point in N > 2 dimensions is classified plane by plane. An index test
is not sufficient: the degree of the dipolar field on the sphere of N = 3 is 0.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Quantity, whole_number
from holdfast.maths.reference_fields.critical_points import CriticalPoint, classify
from holdfast.maths.reference_fields.field import Field

Vector = tuple[sp.Expr, ...]


@dataclass(frozen=True)
class PlaneByPlane:
    """The critical point at the origin in several planes span{p, direction}.

    `exact`: the field is axially symmetric, by algebra; then any plane represents all.
    """

    directions: tuple[Vector, ...]
    points: tuple[CriticalPoint, ...]
    exact: bool

    @property
    def alike(self) -> bool:
        """Whether all planes show the same sectors and index."""
        pictures = {(c.kind, c.index, tuple(s.kind for s in c.sectors)) for c in self.points}
        return len(pictures) == 1


def dot(a: Sequence[sp.Expr], b: Sequence[sp.Expr]) -> sp.Expr:
    """a . b"""
    return sp.Add(*(x * y for x, y in zip(a, b, strict=True)))


def frame(field: Field, direction: Sequence[object] | None = None) -> tuple[Vector, Vector]:
    """Unit vectors along p and across it, towards `direction` (any perpendicular by default).

    Raises `DefinitionError` where the field has no moment or the direction is parallel to it.
    """
    if not field.moment:
        raise DefinitionError(
            f"field '{field.name}' has no moment", expected="an axis p that planes pass through"
        )
    p = field.moment
    length = sp.sqrt(sp.expand(dot(p, p)))
    if direction is None:
        e = [sp.S.Zero] * len(p)
        if p[0] == p[1] == 0:
            e[0] = sp.S.One
        else:  # a quarter turn in the plane of the first two coordinates
            e[0], e[1] = -p[1], p[0]
    else:
        given = [sp.nsimplify(c, rational=sp.sympify(c).has(sp.Float)) for c in direction]
        if len(given) != field.dimension:
            raise DefinitionError(
                f"direction of dimension {len(given)}", expected=f"{field.dimension}"
            )
        share = dot(given, p) / length**2
        e = [sp.radsimp(sp.expand(g - share * b)) for g, b in zip(given, p, strict=True)]
        if all(c == 0 for c in e):
            raise DefinitionError("the direction is parallel to the moment, or zero")
    across = sp.sqrt(sp.expand(dot(e, e)))
    return tuple(sp.radsimp(c / length) for c in p), tuple(sp.radsimp(c / across) for c in e)


def meridian(field: Field, direction: Sequence[object] | None = None) -> Field:
    """The planar field of coordinates `along` p and `across`, in one plane through p.

    The part of the field normal to the plane is dropped: `invariance_residuals` tells whether
    there is any. Raises `DefinitionError` as `frame`.
    """
    p, e = frame(field, direction)
    coordinates = (
        Quantity("along", field.coordinates[0].unit, "along p"),
        Quantity("across", field.coordinates[0].unit, "across p"),
    )
    c, s = (q.symbol for q in coordinates)
    at = {x: c * a + s * b for x, a, b in zip(field.symbols, p, e, strict=True)}
    inside = [f.subs(at, simultaneous=True) for f in field.components]
    components = tuple(sp.expand(dot(inside, v), power_exp=False) for v in (p, e))
    return replace(
        field,
        name=f"{field.name} in a plane through p",
        coordinates=coordinates,
        components=components,
        moment=(sp.sqrt(sp.expand(dot(field.moment, field.moment))), sp.S.Zero),
        factor=sp.simplify(field.factor.subs(at, simultaneous=True)),
        potential=None
        if field.potential is None
        else sp.simplify(field.potential.subs(at, simultaneous=True)),
    )


def invariance_residuals(field: Field) -> tuple[sp.Expr, ...]:
    """The 3 x 3 minors of (p, x, F): all are zero iff every plane through p is invariant."""
    rows = sp.Matrix([field.moment, field.symbols, field.components])
    return tuple(
        sp.simplify(sp.expand(rows[:, list(columns)].det()))
        for columns in itertools.combinations(range(field.dimension), 3)
    )


def symmetry_residuals(field: Field) -> tuple[sp.Expr, ...]:
    """DF(x) B x - B F(x) for the rotations B about p: all are zero iff F is axially symmetric."""
    normals = sp.Matrix([field.moment]).nullspace()
    x, f = sp.Matrix(field.symbols), sp.Matrix(field.components)
    jacobian = f.jacobian(x)
    return tuple(
        sp.simplify(sp.expand(entry))
        for u, w in itertools.combinations(normals, 2)
        for entry in jacobian * (u * w.T - w * u.T) * x - (u * w.T - w * u.T) * f
    )


def axially_symmetric(field: Field) -> bool:
    """Whether, by algebra, all planes through p are invariant and show the same picture.

    In the plane: whether the mirror image about p is the same picture.
    """
    if not field.moment:
        return False
    if field.dimension == 2:
        plane = meridian(field)
        s = plane.symbols[1]
        (a, b) = plane.components
        return bool(sp.expand(a.subs(s, -s) - a) == 0 and sp.expand(b.subs(s, -s) + b) == 0)
    return all(r == 0 for r in invariance_residuals(field)) and all(
        r == 0 for r in symmetry_residuals(field)
    )


MOST_PLANES = 1000


@checked
def plane_by_plane(field: Field, count: int = 3, seed: int = 0) -> PlaneByPlane:
    """The critical point at the origin, classified in `count` planes through p.

    The first plane is a standard one, the others are drawn at random from integer directions.
    Raises `DefinitionError` where a plane through p is not invariant, so that no planar
    picture exists.
    """
    whole_number(count, "the number of planes", 1, MOST_PLANES)
    if field.dimension > 2:
        residual = next((r for r in invariance_residuals(field) if r != 0), None)
        if residual is not None:
            raise DefinitionError(
                f"field '{field.name}' leaves the planes through p: {residual} is not zero",
                expected="a field in span{p, x}",
            )
    generator = random.Random(seed)
    directions = [frame(field)[1]]
    while len(directions) < count:
        drawn = [sp.Integer(generator.randint(-9, 9)) for _ in field.coordinates]
        try:
            directions.append(frame(field, drawn)[1])
        except DefinitionError:  # drawn along p
            continue
    return PlaneByPlane(
        tuple(directions),
        tuple(classify(meridian(field, e)) for e in directions),
        axially_symmetric(field),
    )
