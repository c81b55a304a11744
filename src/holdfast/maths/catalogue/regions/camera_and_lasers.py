"""The target in view and wide enough, two laser dots on the wall, seen and apart: chapter 7."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Cone, Inequality, Region, Segment
from holdfast.maths.expressions.functions import magnitude


@checked
def camera_and_lasers(
    *,
    half_angle: float = 0.5235987755982988,
    target_half_width: float = 0.10,
    laser_offset: float = 0.05,
    range_max: float = 2.0,
    dot_separation: float = 0.04,
    image_width: float = 0.08,
    stand_off: float = 0.3,
) -> Region:
    """The safe set S of chapter 7, in which a camera and two laser pointers can measure the pose.

    The camera is at the vehicle's origin, its half angle alpha, its focal length 1; the target is
    on the wall x = 0, centred at the origin, of half-width yT; two parallel laser pointers are at
    body (0, +-d). With c = cos(psi), s = sin(psi), each <= 0, in metres:

        c1 = (y + yT) cos(psi - alpha) - x sin(psi - alpha)     edge_low: -yT in view
        c2 = (yT - y) cos(psi + alpha) + x sin(psi + alpha)     edge_high: +yT in view
        c3, c4 = d cos(psi -+ alpha) + x sin(alpha)             dot_left, dot_right: dots in view
        c5 = -x + d |s| - Lmax c                                too_far: both ranges <= Lmax
        c6 = (e (x^2 - d^2 s^2) + 2 d x c) / (2 d)              dots_close: apart by e on the image
        c7 = (w (Fc^2 - yT^2 s^2) + 2 x yT) / (2 yT)            too_small: w wide on the image
        c8 = x + x_min                                          too_near: stand-off

    Fc = -x c - y s. No division, so that they are Lipschitz and hold for every |psi| <= pi/2 with
    x < 0. The forms with tan(psi + alpha) change sign where that angle exceeds pi/2. The
    thesis (section 7.1) names these limits without the formulas. Angles in rad, lengths
    in m, e and w in focal lengths.
    """
    x, y, psi = (symbol(n) for n in ("x", "y", "psi"))
    alpha, width, d = symbol("half_angle"), symbol("target_half_width"), symbol("laser_offset")
    far, e, w = symbol("range_max"), symbol("dot_separation"), symbol("image_width")
    off = symbol("stand_off")
    c, s = sp.cos(psi), sp.sin(psi)
    ahead = -x * c - y * s
    rows = {
        "edge_low": (y + width) * sp.cos(psi - alpha) - x * sp.sin(psi - alpha),
        "edge_high": (width - y) * sp.cos(psi + alpha) + x * sp.sin(psi + alpha),
        "dot_left": d * sp.cos(psi - alpha) + x * sp.sin(alpha),
        "dot_right": d * sp.cos(psi + alpha) + x * sp.sin(alpha),
        "too_far": -x + d * magnitude(s) - far * c,
        "dots_close": (e * (x**2 - d**2 * s**2) + 2 * d * x * c) / (2 * d),
        "too_small": (w * (ahead**2 - width**2 * s**2) + 2 * x * width) / (2 * width),
        "too_near": x + off,
    }
    meaning = {
        "edge_low": "low end of target in view",
        "edge_high": "high end of target in view",
        "dot_left": "left laser dot in view",
        "dot_right": "right laser dot in view",
        "too_far": "laser ranges at most Lmax",
        "dots_close": "laser dots apart on the image",
        "too_small": "target wide enough on the image",
        "too_near": "stand-off from the wall",
    }
    parameters = {
        "half_angle": (half_angle, "rad", "half angle of view alpha"),
        "target_half_width": (target_half_width, "m", "half-width yT"),
        "laser_offset": (laser_offset, "m", "offset d of each laser pointer"),
        "range_max": (range_max, "m", "largest laser range Lmax"),
        "dot_separation": (dot_separation, "1", "least distance e of the dots on the image"),
        "image_width": (image_width, "1", "least width w of the target on the image"),
        "stand_off": (stand_off, "m", "least distance x_min from the wall"),
    }
    return Region(
        name="camera_and_lasers",
        reads=(Quantity("x", "m"), Quantity("y", "m"), Quantity("psi", "rad", angle=True)),
        inequalities=tuple(Inequality(n, r, "m", meaning[n]) for n, r in rows.items()),
        parameters=tuple(
            Parameter(n, unit, text, value=value, above=0)
            for n, (value, unit, text) in parameters.items()
        ),
        scene=(
            Segment("wall", (sp.S.Zero, -10 * far), (sp.S.Zero, 10 * far)),
            Segment("target", (sp.S.Zero, -width), (sp.S.Zero, width)),
            Cone("view", (x, y), psi, alpha, -x / sp.cos(psi)),
        ),
        description="target in view and wide enough, two laser dots seen and apart",
        source="thesis section 7.1; the formulas are holdfast's own",
    )
