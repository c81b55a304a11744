"""A ball: a bounded speed or force whose direction is unknown."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import Written, checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.sets.base import (
    WITHIN,
    Bounds,
    Box,
    Reach,
    Row,
    check_count,
    cube_surface,
    entries,
)
from holdfast.maths.expressions.functions import greatest, least, magnitude, select
from holdfast.maths.expressions.traversal import at_numbers

TINY = sp.Float(1e-150)
"""Beside a size of 0. Its inverse times any gain is a number."""

SIDES, ALONG, MOST_DIMENSIONS = 32, 5, 3  # of a polygon and a polytope in a ball


@checked
@dataclass(frozen=True)
class Ball(Bounds):
    """|u| <= radius in the Euclidean norm.

    radius: a number, or an expression of parameters, in the unit of the coordinates, which is the
    same for all. dimension: the number of coordinates.

    Raises `DefinitionError` for a radius below 0 and a dimension below 1.

    >>> hf.Ball(hf.symbol("speed"), 2)
    Ball(radius=speed, dimension=2)
    """

    radius: Written
    dimension: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", entries((self.radius,), "radius of a ball")[0])
        if self.radius.is_negative:
            raise DefinitionError(f"ball has the radius {self.radius}", expected="radius >= 0")
        if self.dimension < 1:
            raise DefinitionError(f"ball has dimension {self.dimension}", expected="at least 1")

    @property
    def free_symbols(self) -> set[sp.Symbol]:
        return set(self.radius.free_symbols)

    @checked
    def saturate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """Shortened to the radius, direction kept (the projection on the ball)."""
        check_count(values, self)
        size = sp.sqrt(sum((v**2 for v in values), start=sp.S.Zero))
        scale = least(1, self.radius / (size + TINY))
        return tuple(scale * v for v in values)

    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> Ball:
        return Ball(at_numbers(self.radius, parameters), self.dimension)

    @checked
    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        check_count(values, self)
        return math.hypot(*values) <= float(self.radius) * (1.0 + slack)

    def support(self, weights: Sequence[sp.Expr], sign: int) -> tuple[sp.Expr, list[sp.Expr]]:
        size = sp.sqrt(sum((w**2 for w in weights), start=sp.S.Zero))
        return sign * self.radius * size, [sign * self.radius * w / (size + TINY) for w in weights]

    def support_value(self, weights: Sequence[float]) -> float:
        return math.hypot(*weights) * float(self.radius)

    def range_along(self, weights: Sequence[sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
        size = self.radius * sp.sqrt(sp.Add(*(e**2 for e in weights)))
        return -size, size

    def ranges(self) -> list[tuple[sp.Expr, sp.Expr]]:
        return [(-self.radius, self.radius)] * self.dimension

    def largest_size(self) -> sp.Expr:
        return self.radius

    def ends(self) -> tuple[sp.Expr, ...]:
        return (self.radius,)

    def inscribed(self) -> list[Row]:
        """A regular polygon with `SIDES` corners on the rim; of a ball in space a polytope.

        Its normals are those of `points`, so that its offsets, the radius times the cosine of the
        largest angle to the nearest of them, leave no corner outside.
        """
        if self.dimension > MOST_DIMENSIONS:
            return self.half_spaces()
        if self.dimension == 2:
            turns = [math.pi * (2 * k + 1) / SIDES for k in range(SIDES)]
            normals = [(sp.Float(math.cos(a)), sp.Float(math.sin(a))) for a in turns]
        else:
            rim = [[float(e) for e in c] for c in cube_surface(self.dimension, ALONG)]
            normals = [tuple(sp.Float(e / math.hypot(*c)) for e in c) for c in rim]
        return [(n, self._inner) for n in normals]

    @property
    def _inner(self) -> sp.Expr:
        """The radius of the largest ball in `inscribed`."""
        if self.dimension == 1:
            return self.radius
        if self.dimension == 2:
            return self.radius * sp.Float(math.cos(math.pi / SIDES))
        # a direction is within half the diagonal of a square of the cube's surface of a normal
        chord = math.sqrt(self.dimension - 1) / (ALONG - 1)
        return self.radius * sp.Float(1 - chord**2 / 2)

    def inscribed_points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        return Ball(self._inner, self.dimension).points(samples)

    def corners(self) -> list[tuple[sp.Expr, ...]]:
        return [(-self.radius,), (self.radius,)] if self.dimension == 1 else super().corners()

    def reach(self, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int) -> Reach:
        """Centre and half-width of r G w/|w| for w = G'p, with p within the spread.

        w changes by at most d = |G|' dp. With s = |d|/|w| < 1 its direction turns by at most asin
        s, and w/|w| by 2 sin(asin(s)/2) = s sqrt(2 / (1 + sqrt(1 - s^2))); else it may be any. On a
        line there are two directions, and s < 1 leaves it as it is.
        """
        if self.dimension == 1:
            return Box((-self.radius,), (self.radius,)).reach(gain, p, spread, sign)
        n = gain.rows
        width = [self.radius * sp.sqrt(sum(e**2 for e in gain.row(i))) for i in range(n)]
        weights, change = gain.T * p, gain.applyfunc(magnitude).T * spread
        size, swing = (sp.sqrt(sum(e**2 for e in v)) for v in (weights, change))
        share = least(swing / (size + TINY), sp.S.One)
        turn = share * sp.sqrt(2 / (1 + sp.sqrt(1 - share**2)))
        best = gain * weights * (sign * self.radius / (size + TINY))
        room = size - WITHIN * swing
        near, narrow = [], []
        for middle, most in zip(best, width, strict=True):
            low, high = greatest(middle - most * turn, -most), least(middle + most * turn, most)
            near.append(select(room, (low + high) / 2, sp.S.Zero))
            narrow.append(select(room, (high - low) / 2, most))
        return [sp.S.Zero] * n, width, near, narrow

    def half_axes(self, gain: sp.Matrix) -> list[sp.Expr] | None:
        squares = (gain * gain.T).applyfunc(sp.expand)
        if not squares.is_diagonal():
            return None
        return [self.radius * sp.sqrt(e) for e in squares.diagonal()]

    def points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        """The centre, and the nodes of a cube's surface, put on the rim."""
        rim = [sp.Matrix(c) for c in cube_surface(self.dimension, samples)]
        put = [tuple(self.radius * (c / c.norm())) for c in rim]
        return [(sp.S.Zero,) * self.dimension, *put]

    def moving(self, wave: Callable[[str], sp.Expr]) -> list[sp.Expr]:
        way = [wave("ball") for _ in range(self.dimension)]
        size = sp.sqrt(sum(e**2 for e in way) + sp.Float(1e-12))
        return [self.radius * e / size for e in way]

    def within(self, other: Bounds) -> bool:
        return (
            isinstance(other, Ball)
            and self.dimension == other.dimension
            and bool((other.radius - self.radius).is_nonnegative)
        )

    def text(self) -> str:
        return f"a ball of radius {float(self.radius):g}"

    def lines(self) -> Iterator[str]:
        yield f"ball of radius {self.radius}"
