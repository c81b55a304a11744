"""The image of a set under a matrix: inputs that actuators produce together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.sets.base import Bounds, Reach, Row
from holdfast.maths.expressions.random_points import full_rank
from holdfast.maths.expressions.traversal import at_numbers


@checked
@dataclass(frozen=True)
class LinearImage(Bounds):
    """{ M a : a in `of` }, e.g. force and moment from two thrusters.

    `actuators` names the coordinates a. M has full row rank; a given u is produced by the
    least-squares allocation a = M^T (M M^T)^-1 u, and saturated actuator by actuator.
    """

    matrix: sp.ImmutableMatrix
    of: Bounds
    actuators: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", sp.ImmutableMatrix(self.matrix))
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
