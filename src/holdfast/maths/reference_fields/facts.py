"""Known facts of a field as sentences: its zeros, their sectors, its flow lines, its defects.

All zeros of a field are found: exactly if algebra or monotonicity decides, else by a stated search.
Flow lines have a closed form: curves of the dipolar family, its exact flow, first integrals.

    rho = R |sin a|^k,   a = angle(x, p),   k = lambda - 1        thesis 2.1, (4.5), (4.6)

in every plane span{p, x0}, for any dimension. The exponent k is derived from the components
of a field, so that it serves the electric dipole (k = 2) as well.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.reference_fields.critical_points import (
    CriticalPoint,
    Sector,
    Vector,
    axially_symmetric,
    classify,
    dot,
    frame,
    meridian,
    plane_by_plane,
)
from holdfast.maths.reference_fields.field import Field

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


@checked
def critical_points(
    field: Field, box: Sequence[tuple[float, float]] = ((-2.0, 2.0), (-2.0, 2.0))
) -> Zeros:
    """The zeros of a field, classified where it is planar.

    box: (lowest, highest) of each coordinate, in its unit.

    Polynomials: resultants, all real zeros. Fields whose part across p vanishes on lines only:
    monotony along those lines, all real zeros. Otherwise Newton's method from a grid over `box`,
    which excludes no other zero. In N > 2 dimensions the field must be axially symmetric.

    Raises `DefinitionError` where zeros are not isolated.

    >>> [point.kind for point in hf.critical_points(hf.fields.dipolar()).critical_points]
    ['rose']
    """
    if field.dimension > 2:
        return _symmetric_zeros(field, box)
    planar = meridian(field) if field.moment else field
    at_values = [c.xreplace(planar.values) for c in planar.components]
    zeros: list[Vector] | None
    exact, method = True, "exact, by resultants of the polynomial components"
    if all(c.is_polynomial(*planar.symbols) for c in at_values):
        zeros = _by_resultants(field.name, at_values, planar.symbols)
    else:
        zeros = _on_lines(at_values, planar.symbols)
        method = "exact, by monotony along the lines where one component vanishes"
    if zeros is None:
        zeros = [tuple(sp.Float(v) for v in point) for point in _by_newton(field, box)]
        intervals = " x ".join(f"[{a:g}, {b:g}]" for a, b in box)
        exact = False
        method = (
            f"Newton's method from {GRID**2} points of {intervals}; others are not excluded, and "
            f"zeros closer than {_MERGED * max(b - a for a, b in box):.2g} count as one"
        )
    elif field.moment:
        p, e = frame(field)
        zeros = [
            tuple(sp.radsimp(sp.expand(c * a + s * b)) for a, b in zip(p, e, strict=True))
            for c, s in zeros
        ]
    zeros.sort(key=lambda point: [float(sp.N(c)) for c in point])
    return Zeros(tuple(zeros), exact, method, tuple(_classified(field, z) for z in zeros))


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
    for variable, gone in ((x, y), (y, x)):
        eliminant = sp.Poly(sp.expand(sp.resultant(f, g, gone)), variable)
        if eliminant.is_zero:  # a common factor that the gcd over irrational numbers missed
            return None
        if eliminant.degree() < 1:
            return []
        monic = sp.Poly([sp.radsimp(c / eliminant.LC()) for c in eliminant.all_coeffs()], variable)
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
        variable = y if gone == x else x
        if not _only_at_zero(other.subs(gone, 0), variable):
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


ANGLE = sp.Symbol("a", real=True)
"""The angle of a position from the moment p, in rad."""

DISTANCE = sp.Symbol("s", positive=True)
"""The distance from the origin along a half-line."""


@dataclass(frozen=True)
class FlowLine:
    """The points curve(parameter) for lower < parameter < upper.

    `kind` is 'loop' (from the origin back to it, `parameter` is the angle from p) or
    'half-line' (the axis, `parameter` is the distance). `forward` says whether the field leads
    along it with a growing parameter. `size` is R = rho / |sin a|^k, infinite for a half-line.
    """

    kind: str
    curve: Vector
    parameter: sp.Symbol
    lower: sp.Expr
    upper: sp.Expr
    size: sp.Expr
    forward: bool


def loop_exponent(field: Field) -> sp.Expr | None:
    """k of the flow lines rho = R |sin a|^k, or None for other curves.

    d rho / (rho d a) = R(a)/A(a) must be k cot(a) in every plane through p, for k > 0; k is an
    expression of the parameters.
    """
    if not axially_symmetric(field):
        return None
    plane = meridian(field)
    c, s = plane.symbols
    radial = c * plane.components[0] + s * plane.components[1]
    angular = c * plane.components[1] - s * plane.components[0]
    if sp.simplify(angular) == 0:
        return None
    exponent = sp.simplify(radial * s / (angular * c))
    if exponent.free_symbols & {c, s} or not exponent.xreplace(field.values).is_positive:
        return None
    return exponent


@checked
def flow_line(field: Field, start: Sequence[sp.Expr | float]) -> FlowLine:
    """The flow line through a start x0, at the values of the parameters.

    start: x0, in the unit of the coordinates.

    A start on the axis of p gives one of the two half-lines, any other a loop; a start in decimals
    gives numbers of 20 digits in place of exact ones.

    Raises `DefinitionError` for x0 = 0, a wrong dimension, or a field whose lines are not loops.

    >>> hf.flow_line(hf.fields.dipolar(), [1, 1]).curve
    (2*sqrt(2)*sin(a)**2*cos(a), 2*sqrt(2)*sin(a)**3)
    """
    exponent = loop_exponent(field)
    if exponent is None:
        raise DefinitionError(
            f"the flow lines of field '{field.name}' are not rho = R |sin a|^k",
            expected="a dipolar field, or a positive multiple of one",
            remedy="integrate the field numerically",
        )
    k = exponent.xreplace(field.values)
    x0 = _point(start, field.dimension)
    p = frame(field)[0]
    plane = meridian(field)
    c, s = plane.symbols
    radial, across = (f.xreplace(field.values) for f in plane.components)
    along = sp.radsimp(sp.expand(dot(p, x0)))
    rest = [sp.radsimp(sp.expand(x - along * b)) for x, b in zip(x0, p, strict=True)]
    if _small(rest, x0):
        side = 1 if sp.N(along) > 0 else -1
        return FlowLine(
            kind="half-line",
            curve=tuple(side * DISTANCE * b for b in p),
            parameter=DISTANCE,
            lower=sp.S.Zero,
            upper=sp.oo,
            size=sp.oo,
            forward=bool(side * radial.subs({c: side, s: 0}) > 0),
        )
    e = frame(field, x0)[1]
    x_across = sp.radsimp(sp.expand(dot(e, x0)))
    rho = sp.sqrt(sp.expand(dot(x0, x0)))
    size = rho / (x_across / rho) ** k
    if any(sp.sympify(c).has(sp.Float) for c in start):  # exact roots of long decimals are useless
        size, p, e = sp.N(size, 20), tuple(sp.N(c, 20) for c in p), tuple(sp.N(c, 20) for c in e)
    distance = size * sp.sin(ANGLE) ** k  # sin a > 0 between the two ends
    return FlowLine(
        kind="loop",
        curve=tuple(
            distance * (sp.cos(ANGLE) * a + sp.sin(ANGLE) * b) for a, b in zip(p, e, strict=True)
        ),
        parameter=ANGLE,
        lower=sp.S.Zero,
        upper=sp.pi,
        size=size,
        forward=bool((c * across - s * radial).subs({c: 0, s: 1}) > 0),
    )


@checked
def exact_flow(field: Field, start: Sequence[sp.Expr | float], time: sp.Expr | float) -> Vector:
    """x(t) of xdot = F(x), x(0) = x0, for the dipolar field of lambda = 2, by inversion.

        y = x/|x|^2,   y(t) = y(0) - p t

    start [m]: x0. time [s]: t; p is then in 1/(m s).

    A start on the axis with p . x0 > 0 reaches infinity at t = 1/(|p| |x0|), one with p . x0 < 0
    has come from there at minus that time.

    Raises `DefinitionError` at and beyond these times, for x0 = 0, and for any other field.

    >>> hf.exact_flow(hf.fields.dipolar(lam=2.0), [1.0, 0.5], 0.2)
    (1.15384615384615, 0.769230769230769)
    """
    plane = meridian(field)
    c, s = plane.symbols
    p = plane.moment[0]
    image = (p * (c**2 - s**2), 2 * p * c * s)  # F of lambda = 2 in span{p, x}
    actual = [f.xreplace(field.values) for f in plane.components]
    if not (
        field.factor == 1
        and axially_symmetric(field)
        and all(sp.simplify(f - g) == 0 for f, g in zip(actual, image, strict=True))
    ):
        raise DefinitionError(
            f"field '{field.name}' is not the dipolar field of lambda = 2",
            expected="lambda = 2, where inversion makes the flow uniform",
            remedy="use flow_line for the curve without its time",
        )
    x0, t = _point(start, field.dimension), sp.sympify(time)
    squared = dot(x0, x0)
    y = [x / squared - q * t for x, q in zip(x0, field.moment, strict=True)]
    along = dot(x0, field.moment)
    across = [x - along / p**2 * q for x, q in zip(x0, field.moment, strict=True)]
    if _small(across, x0):
        escape = along / (squared * p**2)  # y vanishes there
        if sp.N(t / escape) >= 1:
            raise DefinitionError(
                f"a start on the axis is at infinity at t = {float(sp.N(escape)):g} s",
                expected=f"a time short of that, not {float(sp.N(t)):g} s",
            )
    length = dot(y, y)
    return tuple(component / length for component in y)


def first_integral(field: Field) -> sp.Expr:
    """An expression that is constant along every flow line, of the coordinates and parameters.

    Loops: |x_across|^k / |x|^(k+1) = 1/R, zero on the axis. Dipole-like field without its
    exponential (2.7): (x_along^2 - 1/lambda) / |x_across|^2 = C. Raises `DefinitionError` for
    other fields.
    """
    x = field.symbols
    if field.moment:
        p2 = dot(field.moment, field.moment)
        along2 = dot(field.moment, x) ** 2 / p2
        squared = sp.Add(*(c**2 for c in x))
        across2 = sp.expand(squared - along2)
        exponent = loop_exponent(field)
        if exponent is not None:
            return across2 ** (exponent / 2) / squared ** ((exponent + 1) / 2)
        growth = _growth(field)
        if growth is not None:
            return (along2 - 1 / growth) / across2
    raise DefinitionError(f"no first integral of field '{field.name}' is known in closed form")


def _growth(field: Field) -> sp.Expr | None:
    """lambda of F = lambda (p . q) q - p, in any plane through p; None for another field."""
    if not axially_symmetric(field):
        return None
    plane = meridian(field)
    (c, s), p = plane.symbols, plane.moment[0]
    growth = sp.simplify(plane.components[1] / (p * c * s))
    if growth.free_symbols & {c, s} or growth == 0:
        return None
    return growth if sp.simplify(plane.components[0] - p * (growth * c**2 - 1)) == 0 else None


def _point(start: Sequence[object], dimension: int) -> Vector:
    point = tuple(sp.nsimplify(c, rational=sp.sympify(c).has(sp.Float)) for c in start)
    if len(point) != dimension:
        raise DefinitionError(
            f"start of dimension {len(point)}", expected=f"{dimension}, as the field"
        )
    if all(c == 0 for c in point):
        raise DefinitionError(
            "the start is the origin, where the field vanishes", expected="a point off the origin"
        )
    return point


def _small(part: Sequence[sp.Expr], whole: Sequence[sp.Expr]) -> bool:
    """Whether a part of a vector is its rounding error only."""
    return bool(sp.N(dot(part, part), 30) <= sp.N(dot(whole, whole), 30) * sp.Float("1e-30"))


_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")


@checked
def field_facts(field: Field) -> list[str]:
    """Sentences for a reader, each derived from the components, then the field's notes.

    In N > 2 dimensions the critical point is described in the planes through p. Raises
    `DefinitionError` where zeros are not isolated.

    >>> hf.field_facts(hf.fields.dipolar())[2]
    'the origin: rose, two elliptic sectors, index 2, for every lam > 1'
    """
    names = ", ".join(q.name for q in field.coordinates)
    facts = [f"dimension {field.dimension}: ({names})"]
    if field.moment:
        facts[0] += f", moment p = ({', '.join(map(str, field.moment))})"
    facts += _zeros(field)
    if field.dimension > 2:
        facts += _planes(field)
    return [*facts, *_lines(field), *field.notes]


def critical_point_name(point: CriticalPoint) -> str:
    """Kind, sectors and index: 'rose, two elliptic sectors, index 2'."""
    parts = [point.kind]
    for kind in ("elliptic", "hyperbolic", "parabolic"):
        count = point.count(kind)
        if count:
            word = _WORDS[count] if count < len(_WORDS) else str(count)
            parts.append(f"{word} {kind} sector{'s' if count > 1 else ''}")
    return ", ".join([*parts, f"index {point.index}"])


def _zeros(field: Field) -> list[str]:
    zeros = critical_points(field)
    count = len(zeros.points)
    if count == 0:
        return [f"no zero was found ({zeros.method})"]
    if zeros.unique and all(c == 0 for c in zeros.points[0]):
        facts = [f"vanishes at the origin only ({zeros.method})"]
    else:
        shown = "; ".join("(" + ", ".join(map(_shown, z)) + ")" for z in zeros.points)
        facts = [f"{count} zero{'s' if count > 1 else ''}: {shown} ({zeros.method})"]
    for point, critical in zip(zeros.points, zeros.critical_points, strict=False):
        where = "the origin" if all(c == 0 for c in point) else f"({', '.join(map(_shown, point))})"
        if critical is None:
            facts.append(f"{where}: its leading part does not decide its kind")
            continue
        validity = f", {critical.validity}" if critical.validity else ""
        facts.append(f"{where}: {critical_point_name(critical)}{validity}")
        facts += [_sector(s) for s in critical.sectors]
        e, h = critical.count("elliptic"), critical.count("hyperbolic")
        if critical.sectors:
            facts.append(f"index by Bendixson: 1 + (e - h)/2 = 1 + ({e} - {h})/2")
    return facts


def _power(exponent: sp.Expr) -> str:
    return f"{exponent}" if exponent.is_integer and exponent.is_number else f"({exponent})"


def _planes(field: Field) -> list[str]:
    planes = plane_by_plane(field, 3 if field.dimension == 3 else 1)
    point = planes.points[0]
    tried = len(planes.points)
    count = f"{tried} plane{'s' if tried > 1 else ''} tried"
    facts = [
        "each plane through p is invariant"
        + (f" and shows the same picture, by algebra ({count})" if planes.exact else f" ({count})")
    ]
    validity = f", {point.validity}" if point.validity else ""
    if planes.alike:
        facts.append(f"in each plane through p: {critical_point_name(point)}{validity}")
    else:
        facts += [
            f"in the plane of p and {e}: {critical_point_name(c)}"
            for e, c in zip(planes.directions, planes.points, strict=True)
        ]
    if field.dimension % 2 and _even(field):
        facts.append(
            f"F(-x) = F(x), so its degree on the sphere of N = {field.dimension} is 0: an index "
            "test says nothing, the planes do"
        )
    return facts


def _even(field: Field) -> bool:
    mirrored = {s: -s for s in field.symbols}
    return all(sp.expand(c.subs(mirrored, simultaneous=True) - c) == 0 for c in field.components)


def _lines(field: Field) -> list[str]:
    k = loop_exponent(field)
    if k is not None:
        value = k.xreplace(field.values)
        facts = [
            f"flow lines rho = R |sin a|^{_power(k)}, a the angle from p; closed loops but for the "
            "two half-lines of the axis",
            "tangent of a loop at the origin: +p where it leaves and where it comes back",
        ]
        if value > 1:
            bend = "infinite"
        elif value == 1:
            bend = "finite (the loops are circles), and so is the rate of turn"
        else:
            bend = "zero"
        facts.append(
            f"curvature at the origin: {bend} (x_across ~ x_along^{_power(1 + 1 / value)})"
        )
        if value == 1:
            facts.append("exact flow by inversion: y = x/|x|^2, y(t) = y(0) - p t")
        facts.append(f"constant along a line: {first_integral(field)} = 1/R")
        return facts
    try:
        return [f"constant along a flow line: {first_integral(field)}"]
    except DefinitionError:
        return []


def _sector(sector: Sector) -> str:
    return f"  {sector.kind} from {_shown(sector.start)} to {_shown(sector.end)} rad"


def _shown(value: sp.Expr) -> str:
    if value.is_number and abs(sp.N(value)) < 1e-12:
        return "0"
    text = sp.sstr(value)
    return text if len(text) < 24 and not value.has(sp.Float) else f"{float(sp.N(value)):.6g}"
