"""The steering angle of a car within its limit."""

from __future__ import annotations

import math

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.expressions.functions import magnitude, wrap


@checked
def steering_angle(*, steering_limit: float = math.radians(35.0)) -> Region:
    """|delta| <= steering_limit [rad], the angle wrapped: the steering angle of `car`.

    Raises `DefinitionError` for a limit not between 0 and pi/2, beyond which the model of a car
    has no meaning.
    """
    if not 0 < steering_limit < math.pi / 2:
        raise DefinitionError(
            f"steering_limit is {steering_limit:g}", expected="an angle between 0 and pi/2 rad"
        )
    delta = symbol("delta")
    return Region(
        name="steering_angle",
        reads=(Quantity("delta", "rad", angle=True),),
        inequalities=(
            Inequality(
                "steering",
                magnitude(wrap(delta)) - symbol("steering_limit"),
                "rad",
                "steering angle within its limit",
            ),
        ),
        parameters=(
            Parameter(
                "steering_limit", "rad", "largest steering angle", value=steering_limit, above=0.0
            ),
        ),
        description="the steering angle of a car within its limit",
        source="the stops of a steering gear; a region for cars",
    )
