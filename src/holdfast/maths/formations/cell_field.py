"""A reference field in a convex cell that exits through one face (thesis section 6.5.1)."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.maths.expressions.functions import angle, clip, length
from holdfast.maths.formations.footprint import Edge
from holdfast.maths.reference_fields.dipole import UNSEEN

Field = tuple[sp.Expr, sp.Expr]

WEIGHT = sp.Float(8)
"""Weight of a face's term, relative to the unit field, at the face itself."""


def exit_field(
    x: sp.Expr,
    y: sp.Expr,
    middle: tuple[sp.Expr, sp.Expr],
    direction: sp.Expr,
    shift: sp.Expr,
    exponent: sp.Expr,
) -> Field:
    """The dipolar field (6.10) that exits a cell through a passage.

    middle: midpoint of the passage; direction: of its outward normal and of the moment p. The zero
    of the field lies `shift` beyond the passage: at the midpoint itself, as in the thesis, the
    field points back into the cell all along the passage. On the line of the passage, at a distance
    eta from its middle, the outward component is (lambda - 1) shift^2 - eta^2.
    """
    along, left = _aligned(x - middle[0], y - middle[1], direction)
    along -= shift
    ahead = (exponent - 1) * along**2 - left**2
    aside = exponent * along * left
    cos, sin = sp.cos(direction), sp.sin(direction)
    return cos * ahead - sin * aside, sin * ahead + cos * aside


def goal_field(x: sp.Expr, y: sp.Expr, goal: tuple[sp.Expr, sp.Expr]) -> Field:
    """A field that points straight to a point of the cell from everywhere."""
    return goal[0] - x, goal[1] - y


def blended(
    field: Field,
    x: sp.Expr,
    y: sp.Expr,
    faces: Sequence[Edge],
    senses: Sequence[int],
    depth: float,
) -> Field:
    """The unit field plus, near every face, a term away from a wall or out through the exit.

        F / |F| + sum_i 8 sense_i smoothstep(1 - d_i / depth) n_i

    d_i: distance to face i [m]; n_i: its outward normal; senses: -1 for a wall, +1 for an exit, 0
    for a face that is both. For cells of any convex shape: where two faces meet, the weight has to
    be above 1 / (1 + n_i . n_j).
    """
    size = length(*field, UNSEEN)
    total = [component / size for component in field]
    for face, sense in zip(faces, senses, strict=True):
        inside = face.offset - face.ahead * x - face.left * y
        near = clip(1 - inside / sp.Float(depth), sp.S.Zero, sp.S.One)
        push = sense * WEIGHT * near**2 * (3 - 2 * near)
        total = [t + push * n for t, n in zip(total, (face.ahead, face.left), strict=True)]
    return total[0], total[1]


def direction_of(field: Field) -> sp.Expr:
    """The angle of a field without a zero in the region of use."""
    return angle(field[1], field[0], UNSEEN)


def _aligned(ahead: sp.Expr, aside: sp.Expr, direction: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    cos, sin = sp.cos(direction), sp.sin(direction)
    return cos * ahead + sin * aside, cos * aside - sin * ahead
