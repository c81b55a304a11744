"""The leader in the view of the follower's camera: chapter 6."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Circle, Footprint, Inequality, Region
from holdfast.maths.expressions.functions import angle, length, magnitude
from holdfast.maths.formations.footprint import body_coordinates, polygon, side_parameters, triangle
from holdfast.maths.reference_fields.dipole import GUARD, UNSEEN

POSE = (Quantity("x", "m"), Quantity("y", "m"), Quantity("beta", "rad", angle=True))


@checked
def leader_in_view(
    *,
    range_max: float = 2.5,
    half_angle: float = 0.6108652381980153,
    robot_radius: float = 0.2,
) -> Region:
    """The visibility set K: the leader in the follower's field of view, the robots apart.

        h1 = |bearing| - alpha <= 0                        bearing
        h2 = range cos(bearing) - Ls cos(alpha) <= 0       range          (6.8), (6.9)
        2 r0 - range <= 0                                  apart

    The footprint is the triangle of apex angle 2 alpha and sides Ls. h2 is thesis (6.8) times
    cos(bearing) > 0: the same set, and straight in the follower's own frame. Angle in rad,
    lengths in m.
    """
    ahead, left = body_coordinates()
    reach, alpha, radius = (symbol(n) for n in ("range_max", "half_angle", "robot_radius"))
    x, y, beta = (q.symbol for q in POSE)
    return Region(
        name="leader_in_view",
        reads=POSE,
        inequalities=(
            Inequality(
                "bearing",
                magnitude(angle(left, ahead, GUARD**2)) - alpha,
                "rad",
                "leader between the sides of the view",
            ),
            Inequality("range", ahead - reach * sp.cos(alpha), "m", "leader within range"),
            Inequality("apart", 2 * radius - length(x, y, UNSEEN), "m", "robots do not touch"),
        ),
        parameters=(
            Parameter("range_max", "m", "range Ls of the camera", value=range_max, above=0.0),
            Parameter("half_angle", "rad", "half angle of view alpha", value=half_angle, above=0.0),
            Parameter("robot_radius", "m", "radius r0 of a robot", value=robot_radius, above=0.0),
        ),
        scene=(
            Circle("leader", (sp.S.Zero, sp.S.Zero), radius),
            Footprint("view", (x, y), beta, triangle(reach, alpha)),
        ),
        description="leader in the follower's field of view, robots apart",
        source="thesis (6.8), (6.9)",
    )


@checked
def leader_in_footprint(*, vertices: object = None) -> Region:
    """The leader within a convex sensor footprint, a polygon in the follower's own frame.

        n_i . s <= b_i for every side i,   s = range (cos(bearing), sin(bearing))

    vertices: (ahead, left) in m, in order around the polygon; by default the triangle of
    `leader_in_view`. Raises `DefinitionError` for a polygon that is not convex.
    """
    ahead, left = body_coordinates()
    corners = polygon(vertices)
    sides, numbers = side_parameters(corners)
    x, y, beta = (q.symbol for q in POSE)
    return Region(
        name="leader_in_footprint",
        reads=POSE,
        inequalities=tuple(
            Inequality(
                f"side_{i}",
                side.ahead * ahead + side.left * left - side.offset,
                "m",
                f"leader inside side {i} of the footprint",
            )
            for i, side in enumerate(sides, start=1)
        ),
        parameters=numbers,
        scene=(
            Circle("leader", (sp.S.Zero, sp.S.Zero), sp.Float(0.05)),
            Footprint("view", (x, y), beta, tuple((sp.Float(a), sp.Float(b)) for a, b in corners)),
        ),
        description="leader within a convex footprint of the follower's sensor",
        source="thesis section 6.6: any closed convex footprint",
    )
