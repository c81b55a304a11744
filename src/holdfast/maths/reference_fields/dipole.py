"""Dipolar reference fields and their direction (thesis (4.5), (4.6), (5.17)).

    F(r) = lambda (p . r) r - p |r|^2

Every flow line joins the origin to itself with the direction p at both ends when lambda > 1,
so a vehicle that follows F arrives at the origin with the heading of p.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import angle

GUARD = sp.Float(1e-3)
"""Radius in metres inside which the gradient of the field's direction is damped (E7).

The direction of F turns by a full turn around the origin, so its gradient grows as 1/rho;
closer than this the gradient fades to zero instead. Results do not depend on the value
between 1e-6 and 0.03 m."""


UNSEEN = sp.Float(1e-60)
"""A guard that only avoids division by zero, for laws that do not use the value there."""


def dipolar_field(
    position: Sequence[sp.Expr], exponent: sp.Expr, moment: Sequence[float]
) -> tuple[sp.Expr, ...]:
    """F(r) = lambda (p . r) r - p |r|^2 for a position error r of any dimension.

    `exponent` is lambda (> 1), `moment` is p. Raises `DefinitionError` for p = 0, a
    dimension mismatch, or a numeric lambda <= 1, for which the flow lines do not form a rose.
    """
    if len(position) != len(moment):
        raise DefinitionError(
            f"dipolar field: position of dimension {len(position)}, moment of {len(moment)}",
            expected="equal dimensions",
        )
    if all(p == 0 for p in moment):
        raise DefinitionError("dipolar field: the moment p is zero", expected="a direction")
    if exponent.is_number and exponent <= 1:
        raise DefinitionError(
            f"dipolar field: lambda = {exponent}",
            expected="lambda > 1, else its flow lines do not converge to the origin",
        )
    p = [sp.nsimplify(value) for value in moment]
    along = sp.Add(*(a * b for a, b in zip(p, position, strict=True)))
    squared = sp.Add(*(a**2 for a in position))
    return tuple(exponent * along * r - q * squared for r, q in zip(position, p, strict=True))


def dipole_like_field(
    position: Sequence[sp.Expr],
    exponent: sp.Expr,
    moment: Sequence[sp.Expr],
    *,
    exponential: bool = True,
) -> tuple[sp.Expr, ...]:
    """F(r) = lambda (p . r) r - p (1 - exp(-|r|^2)), (2.7); without the last term F1 of it."""
    along = sp.Add(*(a * b for a, b in zip(moment, position, strict=True)))
    squared = sp.Add(*(a**2 for a in position))
    decay = 1 - sp.exp(-squared) if exponential else sp.S.One
    return tuple(exponent * along * r - p * decay for r, p in zip(position, moment, strict=True))


def field_angle(field: Sequence[sp.Expr], guard: sp.Expr = GUARD**4) -> sp.Expr:
    """phi = atan2(F_y, F_x) of a planar field, with its gradient guarded at the zero of F.

    |F|^2 is of order rho^4 near the zero, hence the guard GUARD^4; a law that does not use phi
    there takes `UNSEEN`.
    """
    return angle(field[1], field[0], guard)
