"""All zeros of a field: exact if algebra or monotonicity decides, else by a stated search."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.reference_fields.critical_points import CriticalPoint, classify
from holdfast.maths.reference_fields.field import Field
from holdfast.maths.reference_fields.meridian_planes import (
    Vector,
    axially_symmetric,
    frame,
    meridian,
)

GRID = 15
"""Newton's method starts from GRID x GRID points of the box."""

_W = sp.Symbol("w", positive=True)


@dataclass(frozen=True)
class Zeros:
    """The real zeros of a field.

    `exact`: no other zeros exist. `method` names how they were found, and for a search the box. A
    critical point whose kind is not decided has None in `critical_points`.
    """

    points: tuple[Vector, ...]
    exact: bool
    method: str
    critical_points: tuple[CriticalPoint | None, ...] = ()

    @property
    def unique(self) -> bool:
        """Whether the field is known to vanish at one point only, of the whole space."""
        return self.exact and len(self.points) == 1


_MERGED = 1e-5
"""Zeros closer than this fraction of the box count as one."""


def _span(box: Sequence[tuple[float, float]]) -> float:
    return max(b - a for a, b in box)


@checked
def critical_points(
    field: Field, box: Sequence[tuple[float, float]] = ((-2.0, 2.0), (-2.0, 2.0))
) -> Zeros:
    """The zeros of a field, classified where it is planar.

    Polynomials: resultants, all real zeros. Fields whose part across p vanishes on lines only:
    monotony along those lines, all real zeros. Otherwise Newton's method from a grid over
    `box`, which excludes no other zero. In N > 2 dimensions the field must be axially
    symmetric. Raises `DefinitionError` where zeros are not isolated.
    """
    if field.dimension > 2:
        return _symmetric_zeros(field, box)
    planar = meridian(field) if field.moment else field
    at_values = [c.xreplace(planar.values) for c in planar.components]
    found: list[Vector] | None
    exact, method = True, "exact, by resultants of the polynomial components"
    if all(c.is_polynomial(*planar.symbols) for c in at_values):
        found = _by_resultants(field.name, at_values, planar.symbols)
    else:
        found = _on_lines(at_values, planar.symbols)
        method = "exact, by monotony along the lines where one component vanishes"
    if found is None:
        found = [tuple(sp.Float(v) for v in point) for point in _by_newton(field, box)]
        intervals = " x ".join(f"[{a:g}, {b:g}]" for a, b in box)
        exact = False
        method = (
            f"Newton's method from {GRID**2} points of {intervals}; others are not excluded, and "
            f"zeros closer than {_MERGED * _span(box):.2g} count as one"
        )
    elif field.moment:
        p, e = frame(field)
        found = [
            tuple(sp.radsimp(sp.expand(c * a + s * b)) for a, b in zip(p, e, strict=True))
            for c, s in found
        ]
    found.sort(key=lambda point: [float(sp.N(c)) for c in point])
    return Zeros(tuple(found), exact, method, tuple(_classified(field, z) for z in found))


def _classified(field: Field, point: Vector) -> CriticalPoint | None:
    try:
        return classify(field, point)
    except DefinitionError:
        return None


def _symmetric_zeros(field: Field, box: Sequence[tuple[float, float]]) -> Zeros:
    if not axially_symmetric(field):
        raise DefinitionError(
            f"field '{field.name}' has dimension {field.dimension} and is not axially symmetric",
            expected="a planar field, or one that is the same in every plane through p",
        )
    inside = critical_points(meridian(field), box)
    if any(abs(sp.N(across)) > 1e-9 for _, across in inside.points):
        raise DefinitionError(
            f"field '{field.name}' vanishes on spheres about its axis", expected="isolated zeros"
        )
    p = frame(field)[0]
    points = tuple(tuple(along * c for c in p) for along, _ in inside.points)
    return Zeros(
        points,
        inside.exact,
        inside.method + ", in one plane through p for all (axial symmetry)",
    )


def _by_resultants(
    name: str, components: Sequence[sp.Expr], symbols: tuple[sp.Symbol, ...]
) -> list[Vector] | None:
    """Candidates are the roots of both resultants; each pair is tried at 60 digits."""
    x, y = symbols
    f, g = components
    common = sp.gcd(f, g)
    if common.free_symbols & {x, y}:
        raise DefinitionError(
            f"the components of field '{name}' share the factor {common}",
            expected="isolated zeros",
            remedy="move a common positive factor into `factor`",
        )
    candidates = []
    for kept, gone in ((x, y), (y, x)):
        eliminant = sp.Poly(sp.expand(sp.resultant(f, g, gone)), kept)
        if eliminant.is_zero:  # a common factor that the gcd over irrational numbers missed
            return None
        if eliminant.degree() < 1:
            return []
        monic = sp.Poly([sp.radsimp(c / eliminant.LC()) for c in eliminant.all_coeffs()], kept)
        if not (monic.domain.is_QQ or monic.domain.is_ZZ):
            return None
        candidates.append(list(dict(monic.sqf_part().real_roots(multiple=False))))
    zeros = []
    for a, b in itertools.product(*candidates):
        at = {x: sp.N(a, 60), y: sp.N(b, 60)}
        if all(abs(sp.N(c.subs(at), 50)) < sp.Float("1e-40") for c in (f, g)):
            zeros.append((a, b))
    return zeros


def _on_lines(components: Sequence[sp.Expr], symbols: tuple[sp.Symbol, ...]) -> list[Vector] | None:
    """Zeros where one component is a product of the coordinates: the other along each axis."""
    x, y = symbols
    across = next((c for c in components if c.is_polynomial(x, y)), None)
    if across is None:
        return None
    other = components[1] if across is components[0] else components[0]
    factors = [f for f, _ in sp.factor_list(across, x, y)[1]]
    if not set(factors) <= {x, y}:
        return None
    for gone in factors:
        kept = y if gone == x else x
        if not _only_at_zero(other.subs(gone, 0), kept):
            return None
    return [(sp.S.Zero, sp.S.Zero)]


def _only_at_zero(g: sp.Expr, v: sp.Symbol) -> bool:
    """Whether g(v), even in v, is 0 at v = 0 only: strictly monotone in w = v^2 > 0."""
    if sp.simplify(g - g.subs(v, -v)) != 0 or sp.simplify(g.subs(v, 0)) != 0:
        return False
    h = sp.simplify(g.subs(v, sp.sqrt(_W)))
    for rising in (h, -h):
        slope = sp.expand(rising.diff(_W))
        start = slope.subs(_W, 0)
        convex = slope.diff(_W).is_positive and start.is_nonnegative
        if slope.is_positive or convex:
            return True
    return False


def _by_newton(field: Field, box: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Damped Newton's method from a grid; the distinct zeros inside the box."""
    function = field.function
    slopes = [c.xreplace(field.values).diff(s) for c in field.components for s in field.symbols]
    jacobian = sp.lambdify(field.symbols, slopes, "math", cse=True)
    (x0, x1), (y0, y1) = box
    size = max(x1 - x0, y1 - y0)
    zeros: list[tuple[float, float]] = []
    for i, j in itertools.product(range(GRID), repeat=2):
        start = (x0 + (x1 - x0) * (i + 0.5) / GRID, y0 + (y1 - y0) * (j + 0.5) / GRID)
        try:
            zero = _newton(function, jacobian, start, size)
        except (ArithmeticError, ValueError):  # the path left where the field is defined
            continue
        if zero is None or not (x0 <= zero[0] <= x1 and y0 <= zero[1] <= y1):
            continue
        if all(math.dist(zero, other) > _MERGED * size for other in zeros):
            zeros.append(zero)
    return zeros


def _newton(
    function: Callable[..., list[float]],
    jacobian: Callable[..., list[float]],
    point: tuple[float, float],
    size: float,
) -> tuple[float, float] | None:
    """The zero reached from `point`, or None: steps below 1e-12 of the box, field no larger."""
    x, y = point
    f, g = function(x, y)
    for _ in range(200):
        a, b, c, d = jacobian(x, y)
        scale = a * a + b * b + c * c + d * d
        if scale == 0.0:
            return (x, y) if f == g == 0.0 else None
        # (J'J + m) step = -J'F, with m small against J'J: exact steps where J is regular
        m = 1e-14 * scale
        p, q, r = a * a + c * c + m, a * b + c * d, b * b + d * d + m
        u, v = a * f + c * g, b * f + d * g
        determinant = p * r - q * q
        dx, dy = (q * v - r * u) / determinant, (q * u - p * v) / determinant
        step = math.hypot(dx, dy)
        if step < 1e-12 * size:
            small = math.hypot(f, g) <= 1e-9 * math.sqrt(scale) * size
            return (x + dx, y + dy) if small else None
        shrink = min(1.0, 0.5 * size / step)
        x, y = x + shrink * dx, y + shrink * dy
        f, g = function(x, y)
    return None
