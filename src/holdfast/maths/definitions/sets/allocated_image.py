"""The inputs that more actuators than inputs produce, each by its least-squares share."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.sets.base import Bounds, Reach, Row
from holdfast.maths.definitions.sets.linear_image import LinearImage
from holdfast.maths.expressions.functions import least, magnitude, select, sgn

Candidate = tuple[sp.Expr, list[sp.Expr]]
SINGULAR = 1e-9
"""Determinant of unit rows that counts as zero."""


@checked
@dataclass(frozen=True)
class AllocatedImage(LinearImage):
    """{ u : P u in `of` }, P = M^T (M M^T)^-1: what the least-squares allocation produces exactly.

    For a matrix of numbers with more columns than rows, and a box. It lies within the image of the
    box: beyond it some actuator would have to saturate, and the sum would not be what was asked.
    What saturated actuators then produce may lie outside this set, within the image of the box.
    The support function is the dual of a linear programme,

        max w . u = min over T of sum_{j in T} (the most of y_j a_j),   y = P_T^-T w,

    over every set T of as many independent rows of P as there are inputs.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.matrix.free_symbols:
            raise DefinitionError(
                "allocated image: the matrix has symbols", expected="a matrix of numbers"
            )

    @cached_property
    def _shares(self) -> sp.Matrix:
        m = self.matrix
        return sp.Matrix(m.T * (m * m.T).inv()).evalf()

    @cached_property
    def _bases(self) -> list[tuple[tuple[int, ...], sp.Matrix]]:
        """Every set of independent rows of P, with the inverse of these rows."""
        rows = [self._shares.row(i) for i in range(self._shares.rows)]
        unit = [row / row.norm() if row.norm() > 0 else row for row in rows]
        return [
            (chosen, sp.Matrix.vstack(*(rows[i] for i in chosen)).inv())
            for chosen in itertools.combinations(range(len(rows)), self.dimension)
            if abs(sp.Matrix.vstack(*(unit[i] for i in chosen)).det()) > SINGULAR
        ]

    @property
    def _sides(self) -> list[tuple[sp.Expr, sp.Expr]]:
        return self.of.ranges()

    def support(self, weights: Sequence[sp.Expr], sign: int) -> tuple[sp.Expr, list[sp.Expr]]:
        value, best = reduce(_nearer, (self._candidate(b, weights, sign) for b in self._bases))
        return sign * value, best

    def _candidate(
        self, base: tuple[tuple[int, ...], sp.Matrix], weights: Sequence[sp.Expr], sign: int
    ) -> Candidate:
        """`sign` times the value for one set of rows, and the inputs at the ends of these."""
        chosen, inverse = base
        dual = list(inverse.T * sp.Matrix(weights))
        value, ends = sp.S.Zero, []
        for i, y in zip(chosen, dual, strict=True):
            low, high = self._sides[i]
            middle, half = (low + high) / 2, (high - low) / 2
            value += sign * middle * y + half * magnitude(y)
            ends.append(middle + sign * half * sgn(y))
        return value, list(inverse * sp.Matrix(ends))

    def support_value(self, weights: Sequence[float]) -> float:
        return float(self.support([sp.Float(w) for w in weights], 1)[0])

    def half_spaces(self) -> list[Row]:
        shares = [tuple(self._shares.row(i)) for i in range(self._shares.rows)]
        return [
            row
            for share, (low, high) in zip(shares, self._sides, strict=True)
            for row in ((share, high), (tuple(-e for e in share), -low))
        ]

    def inscribed(self) -> list[Row]:
        return self.half_spaces()

    def corners(self) -> list[tuple[sp.Expr, ...]]:
        """Of limits that are numbers: the points where as many actuators as inputs are at ends."""
        points = []
        for chosen, inverse in self._bases:
            for ends in itertools.product(*(self._sides[i] for i in chosen)):
                point = tuple(inverse * sp.Matrix(ends))
                if all(e.is_number for e in point) and self.contains([float(e) for e in point]):
                    points.append(point)
        return points or super(LinearImage, self).corners()

    # -- what follows from the support function

    def range_along(self, weights: Sequence[sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
        return Bounds.range_along(self, weights)

    def ranges(self) -> list[tuple[sp.Expr, sp.Expr]]:
        return Bounds.ranges(self)

    def half_widths(self) -> list[sp.Expr]:
        return Bounds.half_widths(self)

    def reach(self, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int) -> Reach:
        return Bounds.reach(self, gain, p, spread, sign)

    def half_axes(self, gain: sp.Matrix) -> list[sp.Expr] | None:
        return Bounds.half_axes(self, gain)

    def points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        return Bounds.points(self, samples)

    def moving(self, wave: Callable[[str], sp.Expr]) -> list[sp.Expr]:
        return Bounds.moving(self, wave)

    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> AllocatedImage:
        return AllocatedImage(self.matrix, self.of.at(parameters), self.actuators)

    def text(self) -> str:
        return "what is allocated within " + self.of.text()


def _nearer(first: Candidate, second: Candidate) -> Candidate:
    """The one with the smaller value."""
    (a, u), (b, v) = first, second
    return least(a, b), [select(b - a, p, q) for p, q in zip(u, v, strict=True)]
