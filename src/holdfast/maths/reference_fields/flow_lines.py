"""Flow lines in closed form: curves of the dipolar family, its exact flow, first integrals.

    rho = R |sin a|^k,   a = angle(x, p),   k = lambda - 1        thesis 2.1, (4.5), (4.6)

in every plane span{p, x0}, for any dimension. The exponent k is derived from the components
of a field, so that it serves the electric dipole (k = 2) as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.reference_fields.field import Field
from holdfast.maths.reference_fields.meridian_planes import (
    Vector,
    axially_symmetric,
    dot,
    frame,
    meridian,
)

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
    """The flow line through a start x0, at the parameters' values; the same units as x0.

    A start on the axis of p gives one of the two half-lines, any other a loop; a start in
    decimals gives numbers of 20 digits in place of exact ones. Raises
    `DefinitionError` for x0 = 0, a wrong dimension, or a field whose lines are not loops.
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

    `start` in m, `time` in s, p then in 1/(m s). A start on the axis with p . x0 > 0 reaches
    infinity at t = 1/(|p| |x0|), one with p . x0 < 0 has come from there at minus that time.
    Raises `DefinitionError` at and beyond these times, for x0 = 0, and for any other field.
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
