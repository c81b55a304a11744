"""The angles between a tractor and its trailers: no trailer jack-knifes."""

from __future__ import annotations

import math
from itertools import pairwise

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import magnitude, wrap


@checked
def hitch_angles(system: System, *, hitch_limit: float = math.radians(60.0)) -> Region:
    """Every angle between a body of a tractor with trailers and the next one within a limit.

        |psi_(i-1) - psi_i| <= hitch_limit [rad],   i = 1 ... N   (angles wrapped)

    Raises `DefinitionError` for a system without the headings psi0 and psi1, and for a limit not
    between 0 and pi.
    """
    headings: list[Quantity] = []
    while any(q.name == f"psi{len(headings)}" and q.angle for q in system.states):
        headings.append(next(q for q in system.states if q.name == f"psi{len(headings)}"))
    if len(headings) < 2:
        raise DefinitionError(
            f"region 'hitch_angles' is not made for system '{system.name}'",
            expected="the headings psi0 of a tractor and psi1 of its trailer",
        )
    if not 0 < hitch_limit < math.pi:
        raise DefinitionError(
            f"hitch_limit is {hitch_limit:g}", expected="an angle between 0 and pi rad"
        )
    return Region(
        name="hitch_angles",
        reads=tuple(headings),
        inequalities=tuple(
            Inequality(
                f"hitch_{i}",
                magnitude(wrap(ahead.symbol - behind.symbol)) - symbol("hitch_limit"),
                "rad",
                f"angle at the hitch of trailer {i}",
            )
            for i, (ahead, behind) in enumerate(pairwise(headings), start=1)
        ),
        parameters=(
            Parameter("hitch_limit", "rad", "largest hitch angle", value=hitch_limit, above=0.0),
        ),
        description="no hitch angle beyond a limit: no trailer jack-knifes",
        source="the angle of each hitch; a region for tractors with trailers",
    )
