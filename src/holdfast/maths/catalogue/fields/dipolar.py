"""The dipolar family: every flow line leaves the origin along p and comes back along p."""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.reference_fields.dipole import dipolar_field
from holdfast.maths.reference_fields.field import Field, coordinate_names, exact_moment


@checked
def dipolar(*, lam: float = 3.0, moment: Sequence[float] = (1.0, 0.0)) -> Field:
    """Dipolar field of any dimension N; its origin is a rose of two elliptic sectors.

        F(x) = lambda (p . x) x - p |x|^2                     (4.5), (4.6)

    Flow lines rho = R |sin a|^(lambda - 1), a the angle from p, in each plane through p. lam:
    lambda, above 1 (below 1 the sectors are hyperbolic and no line reaches the origin but on the
    axis). moment: p, of N >= 2 numbers and any length but zero. Positions are in m.

    Raises `DefinitionError` for lambda <= 1 or p = 0.
    """
    p = exact_moment(moment)
    names = coordinate_names(len(p))
    return Field(
        name="dipolar",
        coordinates=tuple(Quantity(n, "m", "position") for n in names),
        components=dipolar_field([symbol(n) for n in names], symbol("lam"), p),
        moment=p,
        parameters=(
            Parameter("lam", "1", "lambda: the lines are |sin a|^(lam-1)", value=lam, above=1),
        ),
        unit="m^2",
        description="dipolar field: every line joins the origin to itself along p",
        source="thesis (4.5), (4.6), (4.10), (4.16)",
    )
