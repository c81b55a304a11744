"""The dipole-like field of chapter 2: a rose near the origin, not globally."""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.reference_fields.dipole import dipole_like_field
from holdfast.maths.reference_fields.field import Field, coordinate_names, exact_moment


@checked
def dipole_like(
    *, lam: float = 3.0, moment: Sequence[float] = (1.0, 0.0), exponential: bool = True
) -> Field:
    """Dipole-like field of any dimension N: elliptic sectors at the origin, yet no global rose.

        F(q) = lambda (p . q) q - p (1 - exp(-|q|^2))         (2.7), (2.8)

    lam: lambda >= 1 (below 1 there are other zeros). moment: p. exponential: without it, F1 =
    lambda (p . q) q - p of figure 2.3(a), the lines are those of two charges, with nodes at
    +-p/(|p| sqrt(lambda)). Coordinates without unit, because the thesis compares |q|^2 with 1.

    Raises `DefinitionError` for lambda < 1 or p = 0.
    """
    if not lam >= 1:
        raise DefinitionError(
            f"dipole-like field: lambda = {lam:g}",
            expected="lambda >= 1, else it has zeros away from the origin",
        )
    if not isinstance(exponential, bool):
        raise DefinitionError(
            f"exponential of dipole_like is {exponential!r}", expected="true or false"
        )
    p = exact_moment(moment)
    names = coordinate_names(len(p))
    q = [symbol(n) for n in names]
    defects = (
        "not every line returns: integrated both ways from 300 random points of [-2, 2]^2 "
        "(lam = 3, p = (1, 0)), 225 lie on lines with one end at infinity; without the "
        "exponential the lines are x_along^2 - C x_across^2 = 1/lam, hyperbolae for C > 0",
        "d|q|^2/dt has the sign of p . q: the origin is reached forward in time only where "
        "p . q < 0, backward where p . q > 0; a controller must choose its sense of travel "
        "by that sign (4.14), not travel with u1 > 0 always",
    )
    return Field(
        name="dipole_like" if exponential else "dipole_like_without_exponential",
        coordinates=tuple(Quantity(n, "1", "generalized coordinate") for n in names),
        components=dipole_like_field(q, symbol("lam"), p, exponential=exponential),
        moment=p,
        parameters=(
            Parameter("lam", "1", "lambda: growth of the field far away", value=lam, above=0),
        ),
        description=(
            "dipole-like field: a rose at the origin only, some lines go to infinity"
            if exponential
            else "dipole-like field without its exponential: the lines of two charges"
        ),
        source="thesis (2.7), (2.8), erratum of 'all flow lines converge'",
        notes=defects if exponential else (),
    )
