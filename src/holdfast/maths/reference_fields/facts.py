"""Known facts of a field as sentences: its zeros, their sectors, its flow lines, its defects."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.reference_fields.critical_points import CriticalPoint, Sector
from holdfast.maths.reference_fields.field import Field
from holdfast.maths.reference_fields.flow_lines import first_integral, loop_exponent
from holdfast.maths.reference_fields.meridian_planes import plane_by_plane
from holdfast.maths.reference_fields.zeros import critical_points

_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")


@checked
def field_facts(field: Field) -> list[str]:
    """Sentences for a reader, each derived from the components, then the field's notes.

    In N > 2 dimensions the critical point is described in the planes through p. Raises
    `DefinitionError` where zeros are not isolated.
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
