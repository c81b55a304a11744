"""Classification of a planar field's zero: its sectors, index and kind (thesis 4.1.1).

Near a zero the field is its leading homogeneous part of degree m. With e(a) = (cos a, sin a),

    drho/dt = rho^m R(a) + ...,   da/dt = rho^(m-1) A(a) + ...

The zeros of A are the directions along which lines arrive or leave. Blown up to a circle, each
of them is a node or a saddle, by the sign of R there and of A on either side; two neighbours
bound one sector. Bendixson: index = 1 + (elliptic - hyperbolic) / 2.

A field of any dimension is restricted to the planes through its moment p. Where the field is
axially symmetric, every plane span{p, e} is invariant and carries the same
picture, so a critical point in N > 2 dimensions is classified plane by plane. An index test
is not sufficient: the degree of the dipolar field on the sphere of N = 3 is 0.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Quantity, whole_number
from holdfast.maths.reference_fields.field import Field

MAX_ORDER = 12
"""The highest degree searched for a leading part."""

_ANALYTIC = (sp.exp, sp.sin, sp.cos, sp.tan, sp.sinh, sp.cosh, sp.tanh, sp.atan, sp.asinh)
_T = sp.Symbol("t", real=True)
_S = sp.Symbol("s", positive=True)


class _UndecidedError(Exception):
    """A sign that depends on the value of a parameter."""


@dataclass(frozen=True)
class Sector:
    """The lines between two directions: 'elliptic' (both ends at the point), 'hyperbolic'
    (none), or 'parabolic' (one). `start` and `end` are angles in rad, end > start."""

    kind: str
    start: sp.Expr
    end: sp.Expr


@dataclass(frozen=True)
class CriticalPoint:
    """A zero of a planar field.

    `kind` is 'rose' (elliptic sectors only), 'node' (parabolic only), 'cross point'
    (hyperbolic only), 'centre or focus' (no line has a direction at the point), or 'mixed'.
    `degree` is that of the leading part; `validity` says for which parameters this holds.
    """

    point: tuple[sp.Expr, ...]
    index: int
    sectors: tuple[Sector, ...]
    kind: str
    degree: int
    validity: str = ""

    def count(self, kind: str) -> int:
        """The number of sectors of this kind."""
        return sum(sector.kind == kind for sector in self.sectors)


@checked
def classify(field: Field, point: Sequence[sp.Expr | float] | None = None) -> CriticalPoint:
    """Sectors, index and kind of a planar field at one of its zeros, the origin by default.

    point: where it is zero.

    First for every value of the parameters above their limits, then, where a sign depends on it, at
    their values. A point given in decimals is classified by its Jacobian.

    Raises `DefinitionError` where the field is not planar, not smooth, not zero there, or where its
    leading part does not decide.

    >>> hf.classify(hf.fields.dipolar()).kind
    'rose'
    """
    if field.dimension != 2:
        raise DefinitionError(
            f"field '{field.name}' has dimension {field.dimension}; sectors and index are planar",
            remedy="classify it plane by plane",
        )
    at = tuple(sp.sympify(c) for c in (point if point is not None else (0, 0)))
    if len(at) != 2:
        raise DefinitionError(f"a point with {len(at)} coordinates", expected="2")
    limits = [f"{p.name} > {p.above:g}" for p in field.parameters if p.symbol in field.any_values]
    used = sp.Tuple(*field.components).free_symbols
    limits = [t for t, p in zip(limits, field.any_values, strict=True) if p in used]
    if limits and not any(c.has(sp.Float) for c in at):
        try:
            return _classified(field, at, field.any_values, "for every " + ", ".join(limits))
        except (_UndecidedError, DefinitionError):
            pass  # a sign that is undetermined in general may be determined at the values
    chosen = [f"{p.name} = {p.value:g}" for p in field.parameters if p.symbol in used]
    validity = "at " + ", ".join(chosen) if chosen else ""
    try:
        return _classified(field, at, field.values, validity)
    except _UndecidedError:
        raise _refusal(field, "an undetermined sign") from None


@checked
def winding_number(
    field: Field, radius: float, centre: Sequence[float] = (0.0, 0.0), samples: int = 128
) -> int:
    """The winding number of the field along a circle, counted numerically.

    radius, centre: of the circle, in the unit of the coordinates. samples: on the circle at first;
    it is sampled finer and finer until the field turns by less than pi/4 from one sample to the
    next.

    Raises `DefinitionError` where the field is not planar or vanishes on the circle.

    >>> hf.winding_number(hf.fields.dipolar(), 1.0)
    2
    """
    if field.dimension != 2:
        raise DefinitionError(
            f"field '{field.name}' has dimension {field.dimension}; only planar fields wind",
            remedy="an index test says nothing about it: see plane_by_plane",
        )
    if not (radius > 0 and math.isfinite(radius)):
        raise DefinitionError(f"radius {radius:g}", expected="a positive number")
    if len(centre) != 2 or samples < 1:
        raise DefinitionError(
            f"{samples} samples around a centre with {len(centre)} coordinates",
            expected="at least 1, and 2",
        )
    function = field.function

    def direction(a: float) -> float:
        x, y = function(centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a))
        if not math.hypot(x, y) > 1e-300:
            raise DefinitionError(
                f"field '{field.name}' vanishes on the circle of radius {radius:g}",
                remedy="take another radius",
            )
        return math.atan2(y, x)

    def turn(a: float, da: float, b: float, db: float, depth: int) -> float:
        change = math.remainder(db - da, 2 * math.pi)
        if abs(change) < math.pi / 4 and depth > 0:  # each first interval is halved once
            return change
        if depth > 40:
            raise DefinitionError(
                f"field '{field.name}' turns abruptly on the circle of radius {radius:g}: "
                "it vanishes there or nearly so",
                remedy="take another radius",
            )
        m = 0.5 * (a + b)
        dm = direction(m)
        return turn(a, da, m, dm, depth + 1) + turn(m, dm, b, db, depth + 1)

    angles = [2 * math.pi * i / samples for i in range(samples + 1)]
    directions = [direction(a) for a in angles[:-1]]
    directions.append(directions[0])
    total = math.fsum(
        turn(angles[i], directions[i], angles[i + 1], directions[i + 1], 0) for i in range(samples)
    )
    return round(total / (2 * math.pi))


def _refusal(field: Field, why: str) -> DefinitionError:
    return DefinitionError(
        f"the leading part of field '{field.name}' does not decide its critical point: {why}",
        remedy="use the winding number for the index, or a field with a decisive leading part",
    )


def _classified(
    field: Field, point: tuple[sp.Expr, ...], values: Mapping[sp.Symbol, sp.Expr], validity: str
) -> CriticalPoint:
    local = _at(field, point, values)
    x, y = field.symbols
    inexact = any(c.has(sp.Float) for c in point)
    degree, (p, q) = _linear_part(field, local) if inexact else _leading(field, local)
    angular, radial = sp.expand(x * q - y * p), sp.expand(x * p + y * q)

    def along(expression: sp.Expr, direction: tuple[sp.Expr, sp.Expr]) -> sp.Expr:
        return expression.subs({x: direction[0], y: direction[1]}, simultaneous=True)

    if angular == 0:
        if _slopes(field, radial, (x, y)):
            raise _refusal(field, "every direction is characteristic, and one without motion")
        return CriticalPoint(
            point, 1, (Sector("parabolic", sp.S.Zero, 2 * sp.pi),), "node", degree, validity
        )
    directions = sorted(
        ((_angle(v), v) for v in _slopes(field, angular, (x, y))), key=lambda pair: sp.N(pair[0])
    )
    if not directions:
        return CriticalPoint(point, 1, (), "centre or focus", degree, validity)
    outward = [
        _sign(along(radial, v)) or _outward_beyond(field, local, angular, v) for _, v in directions
    ]
    sectors = []
    for i, (start, _) in enumerate(directions):
        j = (i + 1) % len(directions)
        end = directions[j][0] + (2 * sp.pi if j == 0 else 0)
        middle = sp.nsimplify(sp.N((start + end) / 2, 20), rational=True)
        turning = _sign(along(angular, (sp.cos(middle), sp.sin(middle))))
        source, sink = (outward[i], outward[j]) if turning > 0 else (outward[j], outward[i])
        kind = "parabolic" if source == sink else "elliptic" if source > 0 else "hyperbolic"
        sectors.append(Sector(kind, start, end))
    kinds = {s.kind for s in sectors}
    surplus = sum({"elliptic": 1, "hyperbolic": -1}.get(s.kind, 0) for s in sectors)
    names = {"elliptic": "rose", "parabolic": "node", "hyperbolic": "cross point"}
    name = names[kinds.pop()] if len(kinds) == 1 else "mixed"
    return CriticalPoint(point, 1 + surplus // 2, tuple(sectors), name, degree, validity)


def _at(
    field: Field, point: tuple[sp.Expr, ...], values: Mapping[sp.Symbol, sp.Expr]
) -> tuple[sp.Expr, ...]:
    """The components about the point, after a check that they are analytic there."""
    shift = {s: c + s for s, c in zip(field.symbols, point, strict=True)}
    here = dict(zip(field.symbols, point, strict=True))
    for component in field.components:
        foreign = [f for f in component.atoms(sp.Function) if not isinstance(f, _ANALYTIC)]
        roots = [
            f
            for f in component.atoms(sp.Pow)
            if not (f.exp.is_integer and f.exp.is_positive)
            and f.base.subs(here).subs(values).is_zero is not False
            and f.base.free_symbols & set(field.symbols)
        ]
        if foreign or roots:
            raise DefinitionError(
                f"field '{field.name}' is not smooth at the point: {(foreign + roots)[0]}",
                expected="components with a Taylor series",
                remedy="put a positive scalar that is singular there into the field's factor",
            )
    return tuple(c.subs(shift, simultaneous=True).xreplace(dict(values)) for c in field.components)


def _taylor(expression: sp.Expr, symbols: tuple[sp.Symbol, ...], order: int) -> list[sp.Expr]:
    """The homogeneous parts of degree 0 ... order."""
    ray = expression.subs({s: _S * s for s in symbols}, simultaneous=True)
    parts = []
    for k in range(order + 1):
        part = sp.expand(ray.subs(_S, 0)) / sp.factorial(k)
        parts.append(part if part == 0 else sp.expand(sp.simplify(part)))
        ray = ray.diff(_S)
    return parts


def _leading(field: Field, local: tuple[sp.Expr, ...]) -> tuple[int, tuple[sp.Expr, sp.Expr]]:
    for order in (2, MAX_ORDER):  # usually found at the first order
        parts = [_taylor(c, field.symbols, order) for c in local]
        for degree, pair in enumerate(zip(*parts, strict=True)):
            if any(c != 0 for c in pair):
                if degree == 0:
                    raise DefinitionError(f"field '{field.name}' is not zero at the point")
                return degree, (pair[0], pair[1])
    raise _refusal(field, f"it has no part of degree {MAX_ORDER} or less")


def _linear_part(field: Field, local: tuple[sp.Expr, ...]) -> tuple[int, tuple[sp.Expr, sp.Expr]]:
    """The linear part at a point known in decimals; refused if its determinant is small."""
    x, y = field.symbols
    origin = {x: 0, y: 0}
    entries = [[float(sp.N(c.diff(s).subs(origin))) for s in (x, y)] for c in local]
    size = max(1e-300, *(abs(e) for row in entries for e in row))
    bends = [c.diff(s, r) for c in local for s in (x, y) for r in (x, y)]
    bend = max(abs(float(sp.N(b.subs(origin)))) for b in bends)
    values = [float(sp.N(c.subs(origin))) for c in local]
    if max(map(abs, values)) > 1e-8 * (size + bend):
        raise DefinitionError(f"field '{field.name}' is not zero at the point")
    (a, b), (c, d) = [[sp.Rational(round(e / size * 10**9), 10**9) for e in r] for r in entries]
    if abs(a * d - b * c) < sp.Rational(1, 10**6) or size < 1e-3 * bend:
        raise _refusal(field, "at a point known in decimals its Jacobian is singular")
    return 1, (a * x + b * y, c * x + d * y)


def _slopes(
    field: Field, form: sp.Expr, symbols: tuple[sp.Symbol, sp.Symbol]
) -> list[tuple[sp.Expr, sp.Expr]]:
    """The directions in which a homogeneous form vanishes, each together with its opposite."""
    x, y = symbols
    total = sp.Poly(form, x, y).total_degree()
    poly = sp.Poly(sp.expand(form.subs({x: 1, y: _T}, simultaneous=True)), _T)
    directions = [(sp.S.Zero, sp.S.One)] if poly.degree() < total else []
    if poly.degree() > 0:
        coefficients = [sp.factor(sp.radsimp(sp.cancel(c / poly.LC()))) for c in poly.all_coeffs()]
        monic = sp.Poly(coefficients, _T, extension=True)
        if monic.free_symbols_in_domain:
            raise _UndecidedError
        try:
            roots = dict(monic.sqf_part().real_roots(multiple=False))
        except (NotImplementedError, sp.polys.polyerrors.PolynomialError):
            raise _refusal(field, "its directions are not algebraic numbers") from None
        directions += [(sp.S.One, root) for root in roots]
    return directions + [(-a, -b) for a, b in directions]


def _angle(direction: tuple[sp.Expr, sp.Expr]) -> sp.Expr:
    """The angle of a direction in [0, 2 pi)."""
    a = sp.pi / 2 if direction[0] == 0 else sp.atan(direction[1] / direction[0])
    if direction[0] < 0 or (direction[0] == 0 and direction[1] < 0):
        a += sp.pi
    return a + 2 * sp.pi if sp.N(a) < 0 else a


def _sign(value: sp.Expr) -> int:
    if value.is_number:
        number = sp.N(value, 50)
        return 0 if abs(number) < sp.Float("1e-30") else 1 if number > 0 else -1
    value = sp.factor(value)
    for sign, true in ((0, value.is_zero), (1, value.is_positive), (-1, value.is_negative)):
        if true:
            return sign
    raise _UndecidedError


def _outward_beyond(
    field: Field,
    local: tuple[sp.Expr, ...],
    angular: sp.Expr,
    direction: tuple[sp.Expr, sp.Expr],
) -> int:
    """The sign of the motion along a direction where R vanishes, from the next orders.

    It decides where the ray is invariant and A has a simple zero: the ray is then the centre
    manifold of the blown-up equilibrium.
    """
    x, y = field.symbols
    a, b = direction
    ray = [c.subs({x: a * _S, y: b * _S}, simultaneous=True) for c in local]
    slope = (a * angular.diff(y) - b * angular.diff(x)).subs({x: a, y: b}, simultaneous=True)
    if sp.simplify(a * ray[1] - b * ray[0]) != 0 or _sign(slope) == 0:
        raise _refusal(field, f"no radial motion along the direction ({a}, {b})")
    for part in _taylor(sp.simplify(a * ray[0] + b * ray[1]), (_S,), MAX_ORDER):
        if part != 0:
            return _sign(part.subs(_S, 1))
    raise _refusal(field, f"no motion at all along the direction ({a}, {b})")


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
        exact = [sp.nsimplify(c, rational=sp.sympify(c).has(sp.Float)) for c in direction]
        if len(exact) != field.dimension:
            raise DefinitionError(
                f"direction of dimension {len(exact)}", expected=f"{field.dimension}"
            )
        share = dot(exact, p) / length**2
        e = [sp.radsimp(sp.expand(g - share * b)) for g, b in zip(exact, p, strict=True)]
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
    """The critical point at the origin, classified in planes through p.

    count: of planes.

    The first plane is a standard one, the others are drawn at random from integer directions.

    Raises `DefinitionError` where a plane through p is not invariant, so that no planar picture
    exists.

    >>> hf.plane_by_plane(hf.fields.electric_dipole(), count=2).points[1].kind
    'rose'
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
