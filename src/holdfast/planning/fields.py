"""The field of every cell of a route, verified on every face."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.maths.formations.cell_field import (
    Field,
    blended,
    direction_of,
    exit_field,
    goal_field,
)
from holdfast.planning.environment import CLOSE, Leg, Route, shown

X, Y = symbol("xL"), symbol("yL")

SAMPLES = 401
"""Number of points on every face at which the field is checked."""

DEPTH = 0.1
"""Depth of the faces' influence in a blended cell, as a share of the root of its area."""


@dataclass(frozen=True)
class Fields:
    """One field for every leg of a route, in xL and yL, with the values of its parameters."""

    route: Route
    fields: tuple[Field, ...]
    parameters: tuple[Parameter, ...]

    @cached_property
    def _headings(self) -> Evaluator:
        return Evaluator([direction_of(f) for f in self.fields], [X, Y], self.parameters)

    def headings(self, number: int, places: Array) -> Array:
        """The direction of the field of a leg at places of shape (n, 2), numbers from 0."""
        found: Array = self._headings.values(places)[:, number]
        return found


def route_fields(route: Route, exponent: float = 3.0) -> Fields:
    """The field of every leg: dipolar to its exit, the last straight to the goal.

    exponent: lambda. If a dipolar field points out of a wall, or into the cell at its exit, it is
    blended with terms that point away from the faces. Raises `DefinitionError`, naming cell and
    face, if the blended field does so too.
    """
    parameters = _parameters(route, exponent)
    fields = [_field(number, leg) for number, leg in enumerate(route.legs, start=1)]
    for number in {leg for leg, _ in _wrong_faces(route, fields, parameters)}:
        leg = route.legs[number]
        depth = DEPTH * math.sqrt(leg.cell.shape.area)
        fields[number] = blended(fields[number], X, Y, leg.cell.faces, _senses(leg), depth)
    wrong = _wrong_faces(route, fields, parameters)
    if wrong:
        number, face = wrong[0]
        leg = route.legs[number]
        out = leg.exit is not None and leg.exit.face == face
        a, b = leg.cell.side(face)
        raise DefinitionError(
            f"the field of cell '{leg.cell.name}' does not point {'out' if out else 'inwards'} all "
            f"along its face from {shown(a)} to {shown(b)}",
            remedy="split the cell, so that its angles are smaller",
        )
    return Fields(route, tuple(fields), parameters)


def _parameters(route: Route, exponent: float) -> tuple[Parameter, ...]:
    """The parameters of the fields, by name."""
    found = [
        Parameter("lam", "1", "exponent lambda of the fields", value=exponent, above=1.0),
        Parameter("goal_x", "m", "goal of the leader", value=route.goal[0]),
        Parameter("goal_y", "m", "goal of the leader", value=route.goal[1]),
    ]
    for number, leg in enumerate(route.legs, start=1):
        if leg.exit is not None:
            direction = math.atan2(leg.exit.normal[1], leg.exit.normal[0])
            shift = leg.exit.width / 2 / math.sqrt(exponent - 1)  # all of the passage only
            found += [
                Parameter(f"exit{number}_x", "m", "middle of a passage", value=leg.exit.middle[0]),
                Parameter(f"exit{number}_y", "m", "middle of a passage", value=leg.exit.middle[1]),
                Parameter(f"exit{number}_direction", "rad", "of its normal", value=direction),
                Parameter(f"exit{number}_shift", "m", "zero of the field beyond it", value=shift),
            ]
    return tuple(found)


def _field(number: int, leg: Leg) -> Field:
    if leg.exit is None:
        return goal_field(X, Y, (symbol("goal_x"), symbol("goal_y")))
    x, y, direction, shift = (symbol(f"exit{number}_{n}") for n in ("x", "y", "direction", "shift"))
    return exit_field(X, Y, (x, y), direction, shift, symbol("lam"))


def _senses(leg: Leg) -> list[int]:
    """Of every face: -1 for a wall, +1 for the exit, 0 for a face that is partly the exit."""
    senses = [-1] * len(leg.cell.faces)
    if leg.exit is not None:
        a, b = leg.cell.side(leg.exit.face)
        whole = leg.exit.width > float(np.linalg.norm(b - a)) - 4 * CLOSE
        senses[leg.exit.face] = 1 if whole else 0
    return senses


def _wrong_faces(
    route: Route, fields: Sequence[Field], values: Sequence[Parameter]
) -> list[tuple[int, int]]:
    """The first (leg, face) where the field does not point inwards, or outwards at the exit.

    On a face that is partly the exit, the rest is a wall. The field of the goal's cell points
    straight to a point of a convex cell, and so out of no face.
    """
    check = Evaluator([e for field in fields for e in field], [X, Y], values)
    wrong = []
    for number, leg in enumerate(route.legs[:-1]):
        for k, face in enumerate(leg.cell.faces):
            a, b = leg.cell.side(k)
            share = (np.arange(SAMPLES) + 0.5)[:, None] / SAMPLES  # ends belong to two faces
            places = a + share * (b - a)
            field = check.values(places)[:, 2 * number : 2 * number + 2]
            outwards = field @ np.array([face.ahead, face.left], dtype=float)
            out = np.zeros(SAMPLES, dtype=bool)
            if leg.exit is not None and leg.exit.face == k:
                from_middle = np.linalg.norm(places - np.array(leg.exit.middle), axis=1)
                out = from_middle < leg.exit.width / 2
            if not np.where(out, outwards > 0, outwards < 0).all():
                wrong.append((number, k))
    return wrong
