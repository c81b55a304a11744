"""Near a pose in the plane."""

from __future__ import annotations

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Circle, Inequality, Region
from holdfast.maths.expressions.functions import greatest, length, magnitude, wrap
from holdfast.maths.reference_fields.dipole import GUARD


@checked
def near_pose(
    *,
    goal_x: float = -0.5,
    goal_y: float = 0.0,
    goal_heading: float = 0.0,
    goal_radius: float = 0.03,
    goal_angle: float = 0.05,
) -> Region:
    """Near the pose (goal_x, goal_y, goal_heading).

        max(|(x - goal_x, y - goal_y)| / goal_radius, |wrap(psi - goal_heading)| / goal_angle) <= 1

    Lengths in m, angles in rad. The standard pose is eta_d of thesis section 5.4.
    """
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    names = ("goal_x", "goal_y", "goal_heading", "goal_radius", "goal_angle")
    s = {n: symbol(n) for n in names}
    distance = length(x - s["goal_x"], y - s["goal_y"], GUARD**2) / s["goal_radius"]
    turn = magnitude(wrap(psi - s["goal_heading"])) / s["goal_angle"]
    return Region(
        name="near_pose",
        reads=(Quantity("x", "m"), Quantity("y", "m"), Quantity("psi", "rad", angle=True)),
        inequalities=(Inequality("at_pose", greatest(distance, turn) - 1, "1", "at the pose"),),
        parameters=(
            Parameter("goal_x", "m", "goal position", value=goal_x),
            Parameter("goal_y", "m", "goal position", value=goal_y),
            Parameter("goal_heading", "rad", "goal heading", value=goal_heading),
            Parameter("goal_radius", "m", "position tolerance", value=goal_radius, above=0),
            Parameter("goal_angle", "rad", "heading tolerance", value=goal_angle, above=0),
        ),
        scene=(Circle("goals", (s["goal_x"], s["goal_y"]), s["goal_radius"]),),
        description="near a pose in the plane",
        source="thesis section 5.4, pose eta_d",
    )
