"""Thrusters of a craft on the plane: where each stands, and the forces that they give together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import AllocatedImage, Box, LinearImage
from holdfast.maths.definitions.quantity import Quantity

INPUTS = (
    Quantity("tau_u", "N", "surge force"),
    Quantity("tau_v", "N", "sway force"),
    Quantity("tau_r", "N m", "yaw moment"),
)
DEPENDENT = 1e-9
"""Share of a row that counts as rounding when it is a combination of others."""
EXACT = 15
"""Multiples of this angle [deg] have a sine and a cosine without rounding."""


@dataclass(frozen=True)
class Thruster:
    """A fixed thruster: at (x, y) [m], pushing along `direction` [rad], from -astern to ahead [N].

    x ahead and y to port of the origin of the body; direction counter-clockwise from ahead.
    """

    name: str
    x: sp.Expr
    y: sp.Expr
    direction: float
    ahead: sp.Expr
    astern: sp.Expr

    @property
    def effect(self) -> tuple[sp.Expr, sp.Expr, sp.Expr]:
        """(cos a, sin a, x sin a - y cos a): surge, sway and yaw moment of one newton."""
        degrees = math.degrees(self.direction)
        near = EXACT * round(degrees / EXACT)
        exact = abs(degrees - near) < 1e-9 * max(1.0, abs(near))
        angle = sp.pi * sp.Rational(near, 180) if exact else sp.Float(self.direction)
        cos, sin = sp.cos(angle), sp.sin(angle)
        return cos, sin, self.x * sin - self.y * cos


@dataclass(frozen=True)
class Actuation:
    """The inputs that thrusters produce, their set, and the force on each axis of the body.

    inputs: surge force and yaw moment, and the sway force where it can be chosen by itself.
    """

    inputs: tuple[Quantity, ...]
    bounds: LinearImage
    force: tuple[sp.Expr, sp.Expr, sp.Expr]


def actuation(thrusters: Sequence[Thruster]) -> Actuation:
    """tau = B f of the thrusters, f in the box of their limits.

    B has a column (cos a, sin a, x sin a - y cos a) for each. With three independent rows surge,
    sway and yaw are inputs (fully actuated). With two, surge and yaw are, and the sway force that
    comes with them is their combination: 0 without a thruster across, else tau_v = a tau_u +
    b tau_r, such as that of a single tunnel. Raises `DefinitionError` where surge and yaw cannot
    be chosen independently. With more thrusters than inputs the inputs are those that the
    least-squares allocation produces exactly.
    """
    matrix = sp.Matrix.hstack(*(sp.Matrix(t.effect) for t in thrusters))
    surge, sway, yaw = (list(matrix.row(i)) for i in range(3))
    rows: tuple[int, ...] = (0, 2)
    beside = sp.zeros(1, 2)
    if any(e != 0 for e in sway):
        beside, rest = _combination(sway, surge, yaw)
        if rest:
            rows = (0, 1, 2)
    elif not matrix.free_symbols:
        _combination(sway, surge, yaw)
    inputs = tuple(INPUTS[i] for i in rows)
    by_name = {q.name: q.symbol for q in inputs}
    along, turn = by_name["tau_u"], by_name["tau_r"]
    across = by_name.get("tau_v", beside[0] * along + beside[1] * turn)
    image = LinearImage if len(thrusters) == len(rows) else AllocatedImage
    bounds = image(
        sp.ImmutableMatrix(matrix.extract(list(rows), list(range(len(thrusters))))),
        Box(tuple(-t.astern for t in thrusters), tuple(t.ahead for t in thrusters)),
        tuple(t.name for t in thrusters),
    )
    return Actuation(inputs, bounds, (along, across, turn))


def _combination(
    sway: Sequence[sp.Expr], surge: Sequence[sp.Expr], yaw: Sequence[sp.Expr]
) -> tuple[sp.Matrix, bool]:
    """(a, b) with sway = a surge + b yaw by least squares, and whether something remains."""
    lever = max(abs(float(e)) for e in yaw) or 1.0
    pair = sp.Matrix([list(surge), [e / lever for e in yaw]])
    gram = pair * pair.T
    scale = float(gram[0, 0]) * float(gram[1, 1])
    if not float(gram.det()) > DEPENDENT * scale:
        raise DefinitionError(
            "the thrusters cannot give a surge force and a yaw moment independently",
            expected="two at least, at different distances from the centre line, or one across",
        )
    row = sp.Matrix([list(sway)])
    shares = (row * pair.T * gram.inv()).applyfunc(sp.nsimplify)
    rest = row - shares * pair
    size = max(abs(float(e)) for e in row)
    remains = any(abs(float(e)) > DEPENDENT * size for e in rest)
    return sp.Matrix([[shares[0], shares[1] / lever]]), remains
