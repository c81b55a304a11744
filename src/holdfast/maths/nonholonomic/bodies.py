"""The bodies of a vehicle with trailers, which follow from its rates.

An axle with the heading theta is a point that never moves sideways. In a vehicle with trailers it
lies along the headings from the place (x, y),

    P = (x, y) + sum_k l_k (cos psi_k, sin psi_k)
    -sin(theta) x' + cos(theta) y' + sum_k l_k cos(theta - psi_k) psi_k' = 0

for every state and every input. These equations are linear in the lengths l_k: a heading has an
axle where one solution, of parameters alone, fits them all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import sympy as sp
from sympy.polys.matrices import DomainMatrix

from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.definitions.region import Footprint
from holdfast.maths.definitions.system import System

VEHICLE, TRAILER = "vehicle", "trailer"
"""The roles of the foremost body and of those behind it."""

Offsets = Mapping[sp.Symbol, sp.Expr]
"""Of an axle: heading -> the length l_k along it from the place of the vehicle."""

SKETCH = ((-0.3, 0.22), (0.4, 0.22), (0.4, 0.025), (1.0, 0.025))
NOSE = ((-0.3, 0.22), (0.4, 0.22), (0.65, 0.08))
"""The left side of a trailer with its drawbar, and of the vehicle, for a drawbar of length 1."""


def bodies(system: System, plane: Sequence[str] = ("x", "y")) -> tuple[Footprint, ...]:
    """The vehicle and its trailers, foremost first; none where fewer than two headings have axles.

    Axles and drawbars are those of the model. What it does not say is a sketch: the width, and how
    long a body is around its axle.
    """
    angles = [q.symbol for q in system.states if q.angle]
    if len(angles) < 2 or not set(plane) <= set(system.state_names):
        return ()
    axles = {theta: at for theta in angles if (at := offsets(system, theta, plane)) is not None}
    if len(axles) < 2:
        return ()
    numbers = {p.symbol: p.value for p in system.parameters}
    ahead = sorted(axles, key=lambda a: -sp.Add(*axles[a].values()).xreplace(numbers))
    lengths = []
    for front, rear in pairwise(ahead):
        apart = {psi: axles[front][psi] - axles[rear][psi] for psi in axles[front]}
        if any(apart[psi] != 0 for psi in apart if psi not in (front, rear)):
            return ()
        lengths.append(apart[rear])
    place = [next(q.symbol for q in system.states if q.name == n) for n in plane]
    return tuple(
        Footprint(
            TRAILER if k else VEHICLE,
            (
                place[0] + sp.Add(*(size * sp.cos(psi) for psi, size in axles[theta].items())),
                place[1] + sp.Add(*(size * sp.sin(psi) for psi, size in axles[theta].items())),
            ),
            theta,
            _outline(lengths[max(k - 1, 0)], SKETCH if k else NOSE),
        )
        for k, theta in enumerate(ahead)
    )


def _outline(
    length: sp.Expr, left: Sequence[tuple[float, float]]
) -> tuple[tuple[sp.Expr, sp.Expr], ...]:
    sides = [*left, *((a, -b) for a, b in reversed(left))]
    return tuple((sp.Float(a) * length, sp.Float(b) * length) for a, b in sides)


def offsets(system: System, theta: sp.Symbol, plane: Sequence[str]) -> Offsets | None:
    """The place of the axle with the heading theta; None where there is none, or more than one.

    The equations are taken at angles whose sine and cosine are rational, so that they are exact.
    """
    still = dict.fromkeys((q.symbol for q in system.disturbances), sp.S.Zero)
    rates = {
        n: sp.expand_trig(sp.nsimplify(e.xreplace(still), rational=True))
        for n, e in system.rates.items()
    }
    turning = [q for q in system.states if q.angle and rates[q.name] != 0]
    x, y = (rates[n] for n in plane)
    columns = [sp.expand_trig(sp.cos(theta - q.symbol)) * rates[q.name] for q in turning]
    entries = [*columns, sp.sin(theta) * x - sp.cos(theta) * y]
    rows = [[e.xreplace(point) for e in entries] for point in _points(system, 2 * len(entries))]
    allowed = {p.symbol for p in system.parameters}
    flat = [sp.together(e) for row in rows for e in row]
    if not all(e.free_symbols <= allowed and e.is_rational_function() for e in flat):
        return None
    matrix = DomainMatrix.from_Matrix(sp.Matrix(len(rows), len(entries), flat)).to_field()
    reduced, pivots = matrix.rref()
    if pivots != tuple(range(len(turning))):
        return None
    solved = reduced.to_Matrix().col(-1)
    sizes = {q.symbol: sp.cancel(solved[k]) for k, q in enumerate(turning)}
    return {q.symbol: sizes.get(q.symbol, sp.S.Zero) for q in system.states if q.angle}


def _points(system: System, count: int) -> list[dict[sp.Basic, sp.Expr]]:
    """Values of all states and inputs, the sines and cosines of the angles among them."""
    points = []
    for k in range(count):
        point: dict[sp.Basic, sp.Expr] = {TIME: sp.Rational(1, 3)}
        for j, q in enumerate((*system.states, *system.inputs)):
            value = sp.Rational(7 * k + 3 * j + 2, 5 * k + 11 * j + 13)
            if q.angle:  # the tangent of half the angle
                sine, cosine = 2 * value / (1 + value**2), (1 - value**2) / (1 + value**2)
                point |= {sp.sin(q.symbol): sine, sp.cos(q.symbol): cosine}
                point[sp.tan(q.symbol)] = sine / cosine
            point[q.symbol] = value
        points.append(point)
    return points
