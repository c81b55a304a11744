"""The image of a set under a matrix: inputs that actuators produce together.

Of more actuators than inputs each has its least-squares share.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import expression_of
from holdfast.maths.definitions.sets.base import Bounds, Reach, Row
from holdfast.maths.expressions.functions import least, magnitude, select, sgn
from holdfast.maths.expressions.random_points import full_rank
from holdfast.maths.expressions.traversal import at_numbers


@checked
@dataclass(frozen=True)
class LinearImage(Bounds):
    """{ M a : a in `of` }, e.g. force and moment from two thrusters.

    matrix: M, of numbers or expressions of parameters; it has full row rank. of: the set of a, a
    `Box`. actuators: the names of the coordinates a.

    A given u is produced by the least-squares allocation a = M^T (M M^T)^-1 u, and saturated
    actuator by actuator.

    Raises `DefinitionError` for rows that depend on each other, and for another number of columns
    or of names than coordinates.

    >>> arms = sp.Matrix([[1, 1], [-0.2, 0.2]])
    >>> two = hf.LinearImage(arms, hf.Box((-5, -5), (5, 5)), ("port", "starboard"))
    >>> two.allocate([6, 0.4])
    (2.00000000000000, 4.00000000000000)
    """

    matrix: sp.ImmutableMatrix
    of: Bounds
    actuators: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        matrix = sp.ImmutableMatrix(self.matrix).applyfunc(expression_of)
        object.__setattr__(self, "matrix", matrix)
        _, columns = self.matrix.shape
        if columns != self.of.dimension:
            raise DefinitionError(
                f"linear image: the matrix has {columns} columns, the set {self.of.dimension} "
                "coordinates",
                expected="as many of each",
            )
        if not full_rank(self.matrix):
            raise DefinitionError(
                "linear image: the rows of the matrix are dependent",
                remedy="leave out the inputs that no actuator can produce on its own",
            )
        names = self.actuators or tuple(f"a{i + 1}" for i in range(columns))
        if len(names) != columns:
            raise DefinitionError(
                f"linear image: {len(names)} actuator names for {columns} columns"
            )
        object.__setattr__(self, "actuators", tuple(names))

    @property
    def dimension(self) -> int:
        return int(self.matrix.rows)

    @property
    def free_symbols(self) -> set[sp.Symbol]:
        return set(self.matrix.free_symbols) | self.of.free_symbols

    @property
    def limited(self) -> Bounds:
        return self.of

    @checked
    def allocate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """The actuator values that produce `values`, before saturation."""
        m = self.matrix
        inverse = m.inv() if m.is_square else m.T * (m * m.T).inv()
        return tuple(inverse * sp.Matrix(values))

    @checked
    def saturate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """M times the saturated allocation."""
        return self.produce(self.of.saturate(self.allocate(values)))

    @checked
    def produce(self, actuators: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """M a, what the actuators bring about."""
        return tuple(self.matrix * sp.Matrix(actuators))

    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> LinearImage:
        matrix = self.matrix.applyfunc(lambda e: at_numbers(e, parameters))
        return LinearImage(matrix, self.of.at(parameters), self.actuators)

    @checked
    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        allocated = self.allocate([sp.Float(v) for v in values])
        return self.of.contains([float(a) for a in allocated], slack)

    def support(self, weights: Sequence[sp.Expr], sign: int) -> tuple[sp.Expr, list[sp.Expr]]:
        value, best = self.of.support(list(self.matrix.T * sp.Matrix(weights)), sign)
        return value, list(self.produce(best))

    def support_value(self, weights: Sequence[float]) -> float:
        back = self.matrix.T * sp.Matrix([sp.Float(w) for w in weights])
        return self.of.support_value([float(w) for w in back])

    def range_along(self, weights: Sequence[sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
        return self.of.range_along(list(self.matrix.T * sp.Matrix(weights)))

    def ranges(self) -> list[tuple[sp.Expr, sp.Expr]]:
        return list(self._ranges)

    @cached_property
    def _ranges(self) -> list[tuple[sp.Expr, sp.Expr]]:
        return [self.of.range_along(list(self.matrix.row(i))) for i in range(self.dimension)]

    def ends(self) -> tuple[sp.Expr, ...]:
        return self.of.ends()

    def half_widths(self) -> list[sp.Expr]:
        half = self.of.half_widths()
        rows = [list(self.matrix.row(i)) for i in range(self.dimension)]
        return [
            sp.Add(*(sp.Abs(e) * h for e, h in zip(row, half, strict=True) if e != 0))
            for row in rows
        ]

    def half_spaces(self) -> list[Row]:
        return self._rows(self.of.half_spaces)

    def inscribed(self) -> list[Row]:
        return self._rows(self.of.inscribed)

    def inscribed_points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        return [tuple(self.produce(a)) for a in self.of.inscribed_points(samples)]

    def _rows(self, of: Callable[[], list[Row]]) -> list[Row]:
        if not self.matrix.is_square:
            raise DefinitionError(
                "there are more actuators than inputs", expected="as many of each"
            )
        inverse = self.matrix.inv()
        return [(tuple(sp.Matrix([normal]) * inverse), limit) for normal, limit in of()]

    def corners(self) -> list[tuple[sp.Expr, ...]]:
        return [self.produce(c) for c in self.of.corners()]

    def reach(self, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int) -> Reach:
        return self.of.reach(gain * self.matrix, p, spread, sign)

    def half_axes(self, gain: sp.Matrix) -> list[sp.Expr] | None:
        return self.of.half_axes(gain * self.matrix)

    def points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        return [tuple(self.produce(a)) for a in self.of.points(samples)]

    def moving(self, wave: Callable[[str], sp.Expr]) -> list[sp.Expr]:
        return list(self.produce(self.of.moving(wave)))

    def within(self, other: Bounds) -> bool:
        return (
            isinstance(other, LinearImage)
            and type(other) is type(self)
            and self.matrix == other.matrix
            and self.of.within(other.of)
        )

    def text(self) -> str:
        return "the image of " + self.of.text()

    def lines(self) -> Iterator[str]:
        rows = [
            ", ".join(f"{float(e):g}" if e.is_number else str(e) for e in row)
            for row in self.matrix.tolist()
        ]
        yield f"[[{'], ['.join(rows)}]] times ({', '.join(self.actuators)})"
        yield from self.of.lines()


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
