"""The target in the camera's view and the wall within range."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Cone, Inequality, Region, Segment
from holdfast.maths.expressions.functions import angle, wrap


@checked
def camera_view(
    *,
    half_angle: float = 0.5235987755982988,
    target_half_width: float = 0.10,
    range_min: float = 0.35,
    range_max: float = 2.0,
    along_wall: float | None = None,
) -> Region:
    """The target in the view of a forward camera, and the wall within laser range.

        c1 = psi - alpha - beta_low <= 0      edge_low: the low end of the target is in view
        c2 = beta_up - psi - alpha <= 0       edge_high: so is its high end
        c3 = Lmin cos(psi) + x <= 0           too_near
        c4 = -x - Lmax cos(psi) <= 0          too_far
        c5, c6 = +-y - along_wall <= 0        too_high, too_low, if along_wall is given

    beta_low, beta_up = atan2(-+yT - y, -x) are the bearings of the ends of the target, which is
    centred at the origin of the wall x = 0; the vehicle is at x < 0. The angular form has the zero
    set of thesis (5.23) for x < 0 and |psi| < pi/2 - alpha, and stays regular beyond (E10). Without
    `along_wall` the set is unbounded along the wall: a vehicle that looks along it at more than
    pi/2 - alpha sees the target from any distance. A grid needs a bound. along_wall [m]: that
    bound; None for none.
    """
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    alpha, width = symbol("half_angle"), symbol("target_half_width")
    near, far = symbol("range_min"), symbol("range_max")
    guard = sp.Float(1e-6)
    low = angle(-width - y, -x, guard)
    high = angle(width - y, -x, guard)
    ends: tuple[Inequality, ...] = ()
    bounds: tuple[Parameter, ...] = ()
    if along_wall is not None:
        most = symbol("along_wall")
        ends = (
            Inequality("too_high", y - most, "m", "not too far along the wall, to +y"),
            Inequality("too_low", -y - most, "m", "not too far along the wall, to -y"),
        )
        bounds = (
            Parameter("along_wall", "m", "largest |y| along the wall", value=along_wall, above=0.0),
        )
    return Region(
        name="camera_view",
        reads=(
            Quantity("x", "m"),
            Quantity("y", "m"),
            Quantity("psi", "rad", angle=True),
        ),
        inequalities=(
            Inequality("edge_low", wrap(psi - low) - alpha, "rad", "low end of target in view"),
            Inequality("edge_high", wrap(high - psi) - alpha, "rad", "high end of target in view"),
            Inequality("too_near", near * sp.cos(psi) + x, "m", "range at least Lmin"),
            Inequality("too_far", -x - far * sp.cos(psi), "m", "range at most Lmax"),
            *ends,
        ),
        parameters=(
            Parameter("half_angle", "rad", "half angle of view alpha", value=half_angle, above=0),
            Parameter(
                "target_half_width", "m", "half-width yT", value=target_half_width, above=0.0
            ),
            Parameter("range_min", "m", "least laser range Lmin", value=range_min, above=0),
            Parameter("range_max", "m", "largest laser range Lmax", value=range_max, above=0),
            *bounds,
        ),
        scene=(
            Segment("wall", (sp.S.Zero, -10 * far), (sp.S.Zero, 10 * far)),
            Segment("target", (sp.S.Zero, -width), (sp.S.Zero, width)),
            Cone("view", (x, y), psi, alpha, -x / sp.cos(psi)),
        ),
        description="target in the camera's view, wall within laser range",
        source="thesis (5.23), angular form",
    )
