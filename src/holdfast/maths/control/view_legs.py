"""Legs towards a target and away from it, along the edges of the view: log-polar coordinates."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.expressions.functions import angle, greatest, length, magnitude, wrap
from holdfast.maths.reference_fields.dipole import GUARD

AHEAD, BACK = "ahead", "back"
POSITIVE = (
    "distance", "k1", "mu", "kv", "kb", "leg_speed", "half_angle", "range_max", "turn_first",
)  # fmt: skip
"""Numbers of the laws by legs that have to be above 0."""


@dataclass(frozen=True)
class ViewLegs:
    """A target at the origin as the vehicle at (x, y, psi) sees it.

    radius: R [m]; bearing: beta = atan2(-y, -x); depth: ln(R / distance). leg: the largest offset
    of the heading from the bearing that keeps the target in view, half_angle - half the angle of
    the target - leg_margin; usual: the same in the middle of the way home, which represents all of
    it. pressed: leg -> from 0 to 1 and beyond where a range limit keeps the vehicle from turning,
    so that only speed frees it.
    """

    radius: sp.Expr
    bearing: sp.Expr
    depth: sp.Expr
    leg: sp.Expr
    usual: sp.Expr
    pressed: Mapping[str, sp.Expr]


def view_legs() -> ViewLegs:
    """In the parameters distance, half_angle, target_half_width, leg_margin, range_min, range_max.

    The ends of the target are at (0, +-target_half_width), on the wall x = 0.
    """
    x, y, psi = (symbol(name) for name in ("x", "y", "psi"))
    width, start, margin = (symbol(n) for n in ("target_half_width", "distance", "leg_margin"))
    guard = GUARD**2
    radius, bearing = length(x, y, guard), angle(-y, -x, guard)
    ends = (angle(-width - y, -x, guard), angle(width - y, -x, guard))
    half = greatest(*(magnitude(wrap(bearing - end)) for end in ends))
    middle = sp.atan(width / sp.sqrt(radius * start))
    return ViewLegs(
        radius=radius,
        bearing=bearing,
        depth=sp.log((radius + GUARD**2) / start),
        leg=greatest(symbol("half_angle") - half - margin, sp.S.Zero),
        usual=greatest(symbol("half_angle") - middle - margin, sp.S.Zero),
        pressed={
            AHEAD: 1 - (x + symbol("range_max") * sp.cos(psi)) / sp.Rational(3, 10),
            BACK: 1 + (x + symbol("range_min") * sp.cos(psi)) / sp.Rational(1, 10),
        },
    )


def leg_parameters(
    values: Mapping[str, tuple[float, str, str]],
    gains: Collection[str],
    *,
    nearest: float,
    farthest: float,
) -> tuple[Parameter, ...]:
    """The parameters of a law by legs, name -> (value, unit, meaning).

    Raises `DefinitionError` for exponent <= 1, a target that fills the view at `distance`, and a
    distance that is not between `nearest` and `farthest`.
    """
    number = {name: value for name, (value, _, _) in values.items()}
    exponent, distance = number["exponent"], number["distance"]
    if not exponent > 1:
        raise DefinitionError(f"exponent is {exponent:g}", expected="above 1")
    half = math.atan2(number["target_half_width"], distance)
    if not number["half_angle"] - half > number["leg_margin"]:
        raise DefinitionError(
            f"the target leaves no room in the view at {distance:g} m",
            expected="half_angle above that of the target and leg_margin",
        )
    if not nearest < distance < farthest:
        raise DefinitionError(
            f"the pose at {distance:g} m is out of range",
            expected=f"between {nearest:g} m and {farthest:g} m",
        )
    return tuple(
        Parameter(
            name,
            unit,
            text,
            value=value,
            above=0 if name in POSITIVE else -math.inf,
            gain=name in gains,
        )
        for name, (value, unit, text) in values.items()
    )
