"""Move straight ahead or straight back, away from a range limit."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.expressions.functions import magnitude


@checked
def back_off(law: Law, *, creep: float = 0.02, as_printed: bool = False) -> Law:
    """Straight back: u = -(|u_convergent| + creep), r = 0; the viable law at the near limit.

    The thesis keeps u of (5.18a) there, which drives the vehicle across the limit whenever the goal
    lies behind it (E4); as_printed: whether to reproduce that. creep [m/s]: keeps it moving when
    the convergent surge is zero.
    """
    return _straight(law, "back_off", -1, creep, as_printed, "back from the near range limit")


@checked
def move_ahead(law: Law, *, creep: float = 0.02, as_printed: bool = False) -> Law:
    """Straight ahead: u = |u_convergent| + creep, r = 0; the viable law at the far limit.

    as_printed: whether u is that of (5.18a), as in `back_off`. creep [m/s]: as there.
    """
    return _straight(law, "move_ahead", 1, creep, as_printed, "ahead from the far range limit")


def _straight(
    law: Law, name: str, direction: int, creep: float, as_printed: bool, where: str
) -> Law:
    if not isinstance(as_printed, bool):
        raise DefinitionError(f"as_printed of {name} is {as_printed!r}", expected="true or false")
    wanted = law.output("u", name)
    speed = wanted if as_printed else direction * (magnitude(wanted) + symbol("creep"))
    return Law(
        name=name,
        reads=law.reads,
        outputs={"u": speed, "r": sp.S.Zero},
        parameters=(
            *law.parameters,
            Parameter("creep", "m/s", "speed added to the convergent one", value=creep, above=0.0),
        ),
        believed=law.believed,
        description="straight on, at the convergent surge" if as_printed else f"straight {where}",
        source="thesis section 5.4.3, " + ("as printed" if as_printed else "correction E4"),
    )
