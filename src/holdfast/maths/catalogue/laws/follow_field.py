"""Follow the reference field of a system, by the law derived from its constraint alone."""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.system import System
from holdfast.maths.nonholonomic.structure import alignment, law_outputs, structure


@checked
def follow_field(
    system: System,
    *,
    k1: float = 1.0,
    k: float = 4.0,
    lam: float = 3.0,
    freeze: float = 1e-4,
    moment: Sequence[float] | None = None,
) -> Law:
    """Follow the reference field, by the law derived from A(q) alone.

        s = atan2(g x F, g . F),   u = -k1 sgn(g . x) |x| / |g| along g,   sdot = -k s

    for a system with two leafwise states x, one transverse state t and no drift; g spans the
    motions on the leaf. For |x| < `freeze`, where the direction of F is not defined, u = 0 and t
    goes to zero with the gain k. Local where g cannot point every way (as in a chained form).
    moment: p, where the system leaves a choice. k1, k in 1/s, lam > 1.

    Raises `DefinitionError` for any other system, and names the missing property.
    """
    constraint = structure(system, moment)
    pieces = alignment(constraint)
    if isinstance(pieces, str):
        raise DefinitionError(f"no field-following law for system '{system.name}': {pieces}")
    unit = constraint.leaf[0].unit
    return Law(
        name="follow_field",
        reads=constraint.coordinates,
        outputs=law_outputs(system, constraint, pieces),
        parameters=(
            Parameter("k1", "1/s", "gain of the distance", value=k1, above=0),
            Parameter("k", "1/s", "decay rate of the misalignment", value=k, above=0),
            Parameter("lam", "1", "exponent lambda of the dipolar field", value=lam, above=1),
            Parameter("freeze", unit, "distance of the final turn", value=freeze, above=0),
            *system.parameters,
        ),
        description="follow the dipolar field, by the law derived from the constraint alone",
        source="thesis chapter 4, guidelines for control design; (4.13), (4.14) for the unicycle",
    )
