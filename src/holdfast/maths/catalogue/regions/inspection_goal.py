"""The inspection pose, or any pose that faces the target at the desired distance."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Circle, Inequality, Region
from holdfast.maths.expressions.functions import angle, greatest, least, length, magnitude, wrap
from holdfast.maths.reference_fields.dipole import GUARD


@checked
def inspection_goal(
    *,
    goal_x: float = -0.5,
    goal_y: float = 0.0,
    distance: float = 0.5,
    goal_radius: float = 0.03,
    goal_angle: float = 0.05,
) -> Region:
    """Near the pose (goal_x, goal_y, 0), or near the circle G around the target, facing it.

        max(|r1| / radius, |psi| / angle) <= 1
        or max(||(x, y)| - distance| / radius, |wrap(psi - phi_t)| / angle) <= 1

    G = { |(x, y)| = distance, psi = phi_t = atan2(-y, -x) }, thesis section 5.4.3. Lengths in
    m, angles in rad.
    """
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    s = {n: symbol(n) for n in ("goal_x", "goal_y", "distance", "goal_radius", "goal_angle")}
    guard = GUARD**2
    pose = greatest(
        length(x - s["goal_x"], y - s["goal_y"], guard) / s["goal_radius"],
        magnitude(wrap(psi)) / s["goal_angle"],
    )
    circle = greatest(
        magnitude(length(x, y, guard) - s["distance"]) / s["goal_radius"],
        magnitude(wrap(psi - angle(-y, -x, guard))) / s["goal_angle"],
    )
    return Region(
        name="inspection_goal",
        reads=(Quantity("x", "m"), Quantity("y", "m"), Quantity("psi", "rad", angle=True)),
        inequalities=(Inequality("at_goal", least(pose, circle) - 1, "1", "at a goal pose"),),
        parameters=(
            Parameter("goal_x", "m", "goal position", value=goal_x),
            Parameter("goal_y", "m", "goal position", value=goal_y),
            Parameter("distance", "m", "distance to the target", value=distance, above=0.0),
            Parameter("goal_radius", "m", "position tolerance", value=goal_radius, above=0),
            Parameter("goal_angle", "rad", "heading tolerance", value=goal_angle, above=0.0),
        ),
        scene=(Circle("goals", (sp.S.Zero, sp.S.Zero), s["distance"]),),
        description="at the inspection pose, or facing the target at the desired distance",
        source="thesis section 5.4.3, goal set G",
    )
