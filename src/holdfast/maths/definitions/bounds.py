"""Sets in which inputs and disturbances live: a box, a ball, a linear image, a product of them.

Two thrusters in [-F, F] are the `LinearImage` of a `Box`; a current of bounded speed is a
velocity in a `Ball`. So plants stay affine in every input.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import clip, least

V = TypeVar("V")


def _expressions(values: Sequence[object], what: str) -> tuple[sp.Expr, ...]:
    result = tuple(sp.sympify(v) for v in values)
    for value in result:
        if not isinstance(value, sp.Expr) or value.has(sp.nan):
            raise DefinitionError(f"{what} has the entry {value}", expected="a number")
    return result


@runtime_checkable
class Bounds(Protocol):
    """What every set of admissible values answers."""

    @property
    def dimension(self) -> int: ...

    @property
    def free_symbols(self) -> set[sp.Symbol]: ...

    def saturate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """The admissible value taken in place of `values`, symbolically."""
        ...

    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> Bounds:
        """The set with these for its parameters; `DefinitionError` if it is none then."""
        ...

    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        """Whether the numbers lie in a set without parameters, within this share of its size."""
        ...


def _check_count(values: Sequence[object], bounds: Bounds) -> None:
    if len(values) != bounds.dimension:
        raise DefinitionError(f"{len(values)} values", expected=f"{bounds.dimension}")


@checked
@dataclass(frozen=True)
class Box:
    """lower_i <= u_i <= upper_i; entries are numbers or expressions in parameters."""

    lower: tuple[sp.Expr, ...]
    upper: tuple[sp.Expr, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", _expressions(self.lower, "lower bound"))
        object.__setattr__(self, "upper", _expressions(self.upper, "upper bound"))
        if len(self.lower) != len(self.upper):
            raise DefinitionError(
                f"box has {len(self.lower)} lower and {len(self.upper)} upper bounds",
                expected="as many of each",
            )
        for low, high in zip(self.lower, self.upper, strict=True):
            if (high - low).is_negative:
                raise DefinitionError(f"box has the empty interval [{low}, {high}]")

    @property
    def dimension(self) -> int:
        return len(self.lower)

    @property
    def free_symbols(self) -> set[sp.Symbol]:
        return set().union(*(e.free_symbols for e in self.lower + self.upper))

    @checked
    def saturate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """Each component clipped: unbounded sides (oo) leave it alone."""
        _check_count(values, self)
        result = []
        for value, low, high in zip(values, self.lower, self.upper, strict=True):
            unbounded = low == -sp.oo and high == sp.oo
            result.append(value if unbounded else clip(value, low, high))
        return tuple(result)

    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> Box:
        sides = [tuple(e.subs(parameters) for e in side) for side in (self.lower, self.upper)]
        return Box(*sides)

    @checked
    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        _check_count(values, self)
        for value, *ends in zip(values, self.lower, self.upper, strict=True):
            low, high = map(float, ends)
            more = slack * max((abs(e) for e in (low, high) if math.isfinite(e)), default=0.0)
            if not low - more <= value <= high + more:
                return False
        return True


@checked
@dataclass(frozen=True)
class Ball:
    """|u| <= radius in the Euclidean norm; the radius is a number or an expression."""

    radius: sp.Expr
    dimension: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", _expressions((self.radius,), "radius of a ball")[0])
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
        _check_count(values, self)
        size = sp.sqrt(sum((v**2 for v in values), start=sp.S.Zero))
        scale = least(1, self.radius / (size + sp.Float(1e-300)))
        return tuple(scale * v for v in values)

    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> Ball:
        return Ball(self.radius.subs(parameters), self.dimension)

    @checked
    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        _check_count(values, self)
        return math.hypot(*values) <= float(self.radius) * (1.0 + slack)


@checked
@dataclass(frozen=True)
class LinearImage:
    """{ M a : a in `of` }, e.g. force and moment from two thrusters.

    `actuators` names the coordinates a. M has full row rank; a given u is produced by the
    least-squares allocation a = M^T (M M^T)^-1 u, and saturated actuator by actuator.
    """

    matrix: sp.ImmutableMatrix
    of: Box | Ball
    actuators: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", sp.ImmutableMatrix(self.matrix))
        rows, columns = self.matrix.shape
        if columns != self.of.dimension:
            raise DefinitionError(
                f"linear image: the matrix has {columns} columns, the set {self.of.dimension} "
                "coordinates",
                expected="as many of each",
            )
        if self.matrix.rank() < rows:
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
        return LinearImage(self.matrix.subs(parameters), self.of.at(parameters), self.actuators)

    @checked
    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        allocated = self.allocate([sp.Float(v) for v in values])
        return self.of.contains([float(a) for a in allocated], slack)


@checked
@dataclass(frozen=True)
class Product:
    """A x B x ...: the first members in A, the next in B, each without regard to the others."""

    parts: tuple[Bounds, ...]

    @property
    def dimension(self) -> int:
        return sum(part.dimension for part in self.parts)

    @property
    def free_symbols(self) -> set[sp.Symbol]:
        return set().union(*(part.free_symbols for part in self.parts))

    def split(self, values: Sequence[V]) -> list[tuple[Bounds, Sequence[V]]]:
        """Every part with the values that belong to it."""
        ends = list(itertools.accumulate(part.dimension for part in self.parts))
        return [(b, values[e - b.dimension : e]) for b, e in zip(self.parts, ends, strict=True)]

    @checked
    def saturate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """Each part saturated by itself."""
        return tuple(e for part, mine in self.split(values) for e in part.saturate(mine))

    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> Product:
        return Product(tuple(part.at(parameters) for part in self.parts))

    @checked
    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        return all(part.contains(mine, slack) for part, mine in self.split(values))


def ranges(bounds: Bounds) -> list[tuple[sp.Expr, sp.Expr]]:
    """The least and the largest value of every member of the set."""
    if isinstance(bounds, Box):
        return list(zip(bounds.lower, bounds.upper, strict=True))
    if isinstance(bounds, Ball):
        return [(-bounds.radius, bounds.radius)] * bounds.dimension
    if isinstance(bounds, Product):
        return [pair for part in bounds.parts for pair in ranges(part)]
    assert isinstance(bounds, LinearImage)
    rows = [list(bounds.matrix.row(i)) for i in range(bounds.dimension)]
    if isinstance(bounds.of, Ball):
        sizes = [bounds.of.radius * sp.sqrt(sp.Add(*(e**2 for e in row))) for row in rows]
        return [(-size, size) for size in sizes]
    found = []
    for row in rows:
        ends = [
            (e * low, e * high)
            for e, low, high in zip(row, bounds.of.lower, bounds.of.upper, strict=True)
            if e != 0
        ]
        found.append((sp.Add(*(sp.Min(*p) for p in ends)), sp.Add(*(sp.Max(*p) for p in ends))))
    return found


def product(first: Bounds | None, second: Bounds | None) -> Bounds | None:
    """The product of two sets; None where one of them is missing, which leaves all unbounded."""
    if first is None or second is None:
        return None
    parts = [p for b in (first, second) for p in (b.parts if isinstance(b, Product) else (b,))]
    return Product(tuple(parts))


def section(bounds: Bounds | None, kept: Sequence[bool]) -> Bounds | None:
    """The set of the members that are `kept` when the others are given numbers.

    Raises `DefinitionError` where the others are not free of those that are kept, as in a ball.
    """
    if bounds is None or not any(kept):
        return None
    if all(kept):
        return bounds
    if isinstance(bounds, Box):
        sides = [tuple(itertools.compress(side, kept)) for side in (bounds.lower, bounds.upper)]
        return Box(*sides)
    if isinstance(bounds, Product):
        parts = [section(part, mine) for part, mine in bounds.split(kept)]
        left = tuple(part for part in parts if part is not None)
        return left[0] if len(left) == 1 else Product(left)
    raise DefinitionError(
        "some members of a set whose members depend on each other are given",
        expected="all of them, or none",
    )
