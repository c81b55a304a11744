"""The electric point dipole, the model of the reference fields."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.reference_fields.dipole import dipolar_field
from holdfast.maths.reference_fields.field import Field, coordinate_names, exact_moment

VACUUM_PERMITTIVITY = 8.8541878128e-12
"""eps0 in F/m (CODATA 2018)."""


@checked
def electric_dipole(
    *, moment: Sequence[float] = (1.0, 0.0, 0.0), eps0: float = VACUUM_PERMITTIVITY
) -> Field:
    """Electric field of a point dipole away from the dipole itself, in V/m.

        E(r) = [3 (p . r/|r|) r/|r| - p] / (4 pi eps0 |r|^3)  (2.6)
        E_r = 2 p cos a / (4 pi eps0 r^3),  E_a = p sin a / (4 pi eps0 r^3)     (2.5)

    minus the gradient of V = p . r / (4 pi eps0 |r|^3) (2.4). It is the dipolar field of lambda = 3
    times 1/(4 pi eps0 |r|^5), so its lines are r = R sin^2 a, a the angle from p. moment [C m]: p,
    of three numbers, or of two for a plane through p. The Dirac term of (2.6) acts at r = 0 only
    and is left out.

    Raises `DefinitionError` for another dimension or p = 0.
    """
    p = exact_moment(moment)
    if len(p) not in (2, 3):
        raise DefinitionError(
            f"electric dipole of dimension {len(p)}",
            expected="a moment of 3 numbers, or of 2 in a plane through it",
        )
    names = coordinate_names(len(p))
    r = [symbol(n) for n in names]
    distance = sp.sqrt(sp.Add(*(a**2 for a in r)))
    along = sp.Add(*(a * b for a, b in zip(p, r, strict=True)))
    return Field(
        name="electric_dipole",
        coordinates=tuple(Quantity(n, "m", "position") for n in names),
        components=dipolar_field(r, sp.Integer(3), p),
        moment=p,
        parameters=(Parameter("eps0", "F/m", "permittivity", value=eps0, above=0),),
        factor=1 / (4 * sp.pi * symbol("eps0") * distance**5),
        potential=along / (4 * sp.pi * symbol("eps0") * distance**3),
        unit="V/m",
        description="electric field of a point dipole, moment in C m",
        source="thesis (2.4)-(2.6)",
        notes=(
            "E itself is unbounded at the origin; the field that vanishes there is E without its "
            "positive factor, which has the same lines",
        ),
    )
