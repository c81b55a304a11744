"""Two opposite charges: the physical electric dipole, whose limit is the point dipole."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.catalogue.fields.electric_dipole import VACUUM_PERMITTIVITY
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.reference_fields.field import Field


@checked
def charge_pair(
    *, charge: float = 1e-9, half_distance: float = 0.4, eps0: float = VACUUM_PERMITTIVITY
) -> Field:
    """Electric field of +Q at (a, 0) and -Q at (-a, 0), in a plane through both, in V/m.

        E(r) = Q / (4 pi eps0) [ (r - a) / |r - a|^3 - (r + a) / |r + a|^3 ]

    The physical dipole of thesis Fig. 2.1, moment p = 2 a Q; for a -> 0 at constant p it is
    the point dipole. The charges are nodes, one a source and one a sink. `charge` Q in C,
    `half_distance` a in m, `eps0` in F/m.
    """
    x, y, q, a, eps = (symbol(n) for n in ("x", "y", "charge", "half_distance", "eps0"))
    source, sink = ((x - s * a) ** 2 + y**2 for s in (1, -1))
    near, far = sp.sqrt(source), sp.sqrt(sink)
    scale = q / (4 * sp.pi * eps)
    return Field(
        name="charge_pair",
        coordinates=tuple(Quantity(n, "m", "position") for n in ("x", "y")),
        components=(
            (x - a) * far**3 - (x + a) * near**3,
            y * far**3 - y * near**3,
        ),
        moment=(sp.S.One, sp.S.Zero),
        parameters=(
            Parameter("charge", "C", "charge of the source", value=charge, above=0.0),
            Parameter("half_distance", "m", "half the distance", value=half_distance, above=0.0),
            Parameter("eps0", "F/m", "permittivity", value=eps0, above=0),
        ),
        factor=scale / (near * far) ** 3,
        potential=scale * (1 / near - 1 / far),
        unit="V/m",
        description="two opposite charges, the physical electric dipole",
        source="thesis section 2.2.1, Fig. 2.1",
    )
