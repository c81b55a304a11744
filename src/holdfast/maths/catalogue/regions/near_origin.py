"""A box around the origin, the goal of a steering law."""

from __future__ import annotations

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import UNWRITTEN, Parameter, symbol
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import magnitude, wrap

TOLERANCES = {
    "m": ("near", "position tolerance"),
    "rad": ("near_angle", "angle tolerance"),
}
OTHER = ("near_rest", "tolerance of any other state")


@checked
def near_origin(
    system: System, *, near: float = 0.01, near_angle: float = 0.02, near_rest: float = 0.01
) -> Region:
    """Every state of `system` near zero.

    |q_i| <= near [m], near_angle [rad] (angles wrapped) or near_rest (any other unit)
    """
    values = {"near": near, "near_angle": near_angle, "near_rest": near_rest}
    inequalities, used = [], {}
    for q in system.states:
        name, meaning = TOLERANCES.get(q.unit, OTHER)
        unit = q.unit if q.unit in TOLERANCES else UNWRITTEN  # it stands for several
        used[name] = Parameter(name, unit, meaning, value=values[name], above=0.0)
        size = magnitude(wrap(q.symbol)) if q.angle else magnitude(q.symbol)
        inequalities.append(
            Inequality(f"{q.name}_near_0", size - symbol(name), q.unit, f"{q.name} near zero")
        )
    return Region(
        name="near_origin",
        reads=system.states,
        inequalities=tuple(inequalities),
        parameters=tuple(used.values()),
        description="every state near zero",
        source="the origin of thesis chapters 2 and 4",
    )
