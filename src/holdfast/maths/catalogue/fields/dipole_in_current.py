"""The dipole-like field of a vehicle in a current, with its axis along the current."""

from __future__ import annotations

from dataclasses import replace

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.fields.dipole_like import dipole_like
from holdfast.maths.reference_fields.field import Field


@checked
def dipole_in_current(*, lam: float = 3.0, current_x: float = 1.0, current_y: float = 1.0) -> Field:
    """Dipole-like field that a vehicle in the current v = (current_x, current_y) can follow.

        F(r) = lambda (p . r) r - p (1 - exp(-|r|^2)),   p = v sgn(v_x)              (3.4)

    Its lines arrive at the origin along the current, the only headings at which (3.2) lets the
    vehicle rest; the sign keeps the bow on the side of the target, p_x >= 0. As v_x passes zero p
    turns by pi; at v_x = 0 it is v itself. current_x, current_y [m/s]: v.

    Raises `DefinitionError` for v = 0, lambda < 1.
    """
    if current_x == 0 and current_y == 0:
        raise DefinitionError(
            "dipole_in_current: the current is zero", remedy="use dipole_like without a current"
        )
    side = 1.0 if current_x >= 0 else -1.0
    field = dipole_like(lam=lam, moment=(side * current_x, side * current_y))
    return replace(
        field,
        name="dipole_in_current",
        description="dipole-like field along a current: where a drifting vehicle can come to rest",
        source="thesis (3.4), Fig. 3.3(b)",
    )
