"""A set of admissible inputs or disturbances: what each of them answers, and a box.

A set of another shape is a class of its own, in a file of its own. It gives `dimension`,
`free_symbols`, `at`, `contains`, `saturate` and `support`. Everything else follows from these, for
a compact convex set; a set that has a sharper or shorter form overrides it. In a box every member
is between two ends, whatever the others are.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import sympy as sp

from holdfast.arguments import Written, checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import expression_of
from holdfast.maths.definitions.value import Value
from holdfast.maths.expressions.functions import clip, greatest, magnitude, select, sgn
from holdfast.maths.expressions.traversal import at_numbers

V = TypeVar("V")
Row = tuple[tuple[sp.Expr, ...], sp.Expr]
"""normal . u <= offset"""
Reach = tuple[list[sp.Expr], list[sp.Expr], list[sp.Expr], list[sp.Expr]]
"""Of every rate: centre and half-width for any costate, and for those within the spread."""

WITHIN = sp.Float(1 - 1e-6)
"""The share of the spread that counts.

Where the value is flat on one side of a node, one end of the spread is, within rounding, the
costate at which an input switches. Whether it may switch decides the dissipation, and so is no
matter of rounding: the last millionth of the spread does not count."""


class Bounds(Value, ABC):
    """A set of admissible values."""

    if TYPE_CHECKING:  # a field or a property of the set

        @property
        def dimension(self) -> int:
            """The number of members of a value."""

    @property
    @abstractmethod
    def free_symbols(self) -> set[sp.Symbol]:
        """The parameters that the set depends on."""

    @abstractmethod
    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> Bounds:
        """The set with these for its parameters; `DefinitionError` if these give an empty one."""

    @abstractmethod
    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        """Whether the numbers lie in a set without parameters, within this share of its size."""

    @abstractmethod
    def saturate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """The admissible value taken in place of `values`, symbolically."""

    @abstractmethod
    def support(self, weights: Sequence[sp.Expr], sign: int) -> tuple[sp.Expr, list[sp.Expr]]:
        """The most (sign 1) or the least (-1) of weights . u over the set, and where it is."""

    # -- what follows from these

    def support_value(self, weights: Sequence[float]) -> float:
        """The most of weights . u over a set without parameters."""
        return float(self.support([sp.Float(w) for w in weights], 1)[0])

    def range_along(self, weights: Sequence[sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
        """The least and the largest of weights . u over the set."""
        return self.support(weights, -1)[0], self.support(weights, 1)[0]

    def ranges(self) -> list[tuple[sp.Expr, sp.Expr]]:
        """The least and the largest value of every member of the set."""
        axes = range(self.dimension)
        return [self.range_along([sp.Integer(i == k) for k in axes]) for i in axes]

    def largest_size(self) -> sp.Expr:
        """The largest Euclidean norm over the box of the ranges, which no member exceeds."""
        sizes = (high if low == -high else greatest(-low, high) for low, high in self.ranges())
        return sp.sqrt(sp.Add(*(size**2 for size in sizes)))

    def ends(self) -> tuple[sp.Expr, ...]:
        """Expressions of which one is infinite where the set is not bounded."""
        return tuple(e for pair in self.ranges() for e in pair)

    def half_widths(self) -> list[sp.Expr]:
        """Half of the range of every member; oo says nothing about it."""
        return [(high - low) / 2 for low, high in self.ranges()]

    def half_spaces(self) -> list[Row]:
        """The set as normals . u <= offsets; `DefinitionError` for any set but a polytope."""
        raise DefinitionError(
            f"inputs are bounded by {self.shape}, which is not a polytope",
            expected="a box, or a linear image of one with as many actuators as inputs",
        )

    def inscribed(self) -> list[Row]:
        """A polytope within the set, as `half_spaces`: the set itself where it is one."""
        return self.half_spaces()

    def inscribed_points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        """`points` of that polytope."""
        return self.points(samples)

    def corners(self) -> list[tuple[sp.Expr, ...]]:
        """Points whose convex hull is the set; `DefinitionError` for a set that has none."""
        raise DefinitionError(
            f"inputs are bounded by {self.shape}, which is not a polytope",
            expected="a box, or a linear image of one",
        )

    def reach(self, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int) -> Reach:
        """The part gain . u of the rates at the optimal u for a costate p.

        Centre and half-width of it for any p, and for those within the spread of this one.
        """
        rows = [list(gain.row(i)) for i in range(gain.rows)]
        least, most = ([self.support(row, side)[0] for row in rows] for side in (-1, 1))
        centre = [(a + b) / 2 for a, b in zip(least, most, strict=True)]
        width = [(b - a) / 2 for a, b in zip(least, most, strict=True)]
        return centre, width, centre, width

    def half_axes(self, gain: sp.Matrix) -> list[sp.Expr] | None:
        """The half-axes of the set of all gain . u, where that is an ellipsoid around 0 along the
        coordinates; else None."""
        return None

    def points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        """Points that stand for the set: the furthest in the directions of a cube's surface."""
        rim = [self.support(way, 1)[1] for way in cube_surface(self.dimension, samples)]
        mean = tuple(sp.Add(*members) / len(rim) for members in zip(*rim, strict=True))
        return [mean, *map(tuple, rim)]

    def groups(self, members: Sequence[V]) -> list[Sequence[V]]:
        """The members that are free of each other; here none is."""
        return [members]

    def section(self, kept: Sequence[bool]) -> Bounds | None:
        """The set of the members that are `kept` when the others are given numbers."""
        raise DefinitionError(
            "values are given for some members of a set whose members depend on each other",
            expected="values for all of them, or for none",
        )

    def moving(self, wave: Callable[[str], sp.Expr]) -> list[sp.Expr]:
        """A point that moves within the set as waves between -1 and 1 drive it."""
        return self.support([wave("direction") for _ in range(self.dimension)], 1)[1]

    def within(self, other: Bounds) -> bool:
        """Whether a set of numbers is seen to lie in the other."""
        return self == other

    @property
    def shape(self) -> str:
        """The name of the set, in two words."""
        name = type(self).__name__.lower()
        return f"{'an' if name[0] in 'aeiou' else 'a'} {name}"

    def text(self) -> str:
        """A set of numbers, in a message."""
        return self.shape

    def lines(self) -> Iterator[str]:
        """A description of the set."""
        yield self.shape

    # -- actuators: the inputs themselves, unless a set says otherwise

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of what produces the inputs; empty where these are the inputs themselves."""
        return ()

    @property
    def limited(self) -> Bounds:
        """The set that the actuators live in."""
        return self

    def allocate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """The actuator values that produce `values`, before saturation."""
        return tuple(values)

    def produce(self, actuators: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """The inputs that the actuators produce."""
        return tuple(actuators)


def entries(values: Sequence[object], what: str) -> tuple[sp.Expr, ...]:
    """The values as expressions; `DefinitionError` for NaN and other objects."""
    result = tuple(map(expression_of, values))
    for value in result:
        if not isinstance(value, sp.Expr) or value.has(sp.nan):
            raise DefinitionError(f"{what} has the entry {value}", expected="a number")
    return result


def check_count(values: Sequence[object], bounds: Bounds) -> None:
    """Refuse a value with another number of members."""
    if len(values) != bounds.dimension:
        raise DefinitionError(
            f"got {len(values)} values", expected=f"{bounds.dimension}, one for each member"
        )


def cube_surface(dimension: int, samples: int) -> list[list[sp.Expr]]:
    """The nodes on the surface of a cube [-1, 1]^n with `samples` along every edge."""
    ticks = [2 * sp.Rational(k, samples - 1) - 1 for k in range(samples)]
    cube = itertools.product(ticks, repeat=dimension)
    return [list(c) for c in cube if max(abs(e) for e in c) == 1]


def section(bounds: Bounds | None, remaining: Sequence[bool]) -> Bounds | None:
    """The set of the `remaining` members when the others are given numbers.

    Raises `DefinitionError` where the others are not free of those that remain, as in a ball.
    """
    if bounds is None or not any(remaining):
        return None
    return bounds if all(remaining) else bounds.section(remaining)


@checked
@dataclass(frozen=True)
class Box(Bounds):
    """lower_i <= u_i <= upper_i.

    lower, upper: a number, or an expression of parameters, for each coordinate, in its unit.

    Raises `DefinitionError` for an interval that is empty, and unless there are as many lower
    bounds as upper ones.

    >>> hf.Box((-1, 0), (1, 2)).dimension
    2
    """

    lower: tuple[Written, ...]
    upper: tuple[Written, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", entries(self.lower, "lower bound"))
        object.__setattr__(self, "upper", entries(self.upper, "upper bound"))
        if len(self.lower) != len(self.upper):
            raise DefinitionError(
                f"box has {len(self.lower)} lower and {len(self.upper)} upper bounds",
                expected="as many of each",
            )
        for place, (low, high) in enumerate(self._sides):
            if (high - low).is_negative:
                which = f" at place {place} of 0 to {len(self.lower) - 1}" * (len(self.lower) > 1)
                raise DefinitionError(f"box has the empty interval [{low}, {high}]{which}")

    @property
    def _sides(self) -> list[tuple[sp.Expr, sp.Expr]]:
        return list(zip(self.lower, self.upper, strict=True))

    @property
    def dimension(self) -> int:
        return len(self.lower)

    @property
    def free_symbols(self) -> set[sp.Symbol]:
        return set().union(*(e.free_symbols for e in self.lower + self.upper))

    @checked
    def saturate(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """Each component clipped: unbounded sides (oo) leave it alone."""
        check_count(values, self)
        result = []
        for value, (low, high) in zip(values, self._sides, strict=True):
            unbounded = low == -sp.oo and high == sp.oo
            result.append(value if unbounded else clip(value, low, high))
        return tuple(result)

    def at(self, parameters: Mapping[sp.Symbol, sp.Expr | float]) -> Box:
        sides = (self.lower, self.upper)
        return Box(*(tuple(at_numbers(e, parameters) for e in side) for side in sides))

    @checked
    def contains(self, values: Sequence[float], slack: float = 1e-9) -> bool:
        check_count(values, self)
        for value, ends in zip(values, self._sides, strict=True):
            low, high = map(float, ends)
            more = slack * max((abs(e) for e in (low, high) if math.isfinite(e)), default=0.0)
            if not low - more <= value <= high + more:
                return False
        return True

    def support(self, weights: Sequence[sp.Expr], sign: int) -> tuple[sp.Expr, list[sp.Expr]]:
        middle, half = self._middle, self.half_widths()
        terms = [
            m * w + sign * h * magnitude(w) for m, h, w in zip(middle, half, weights, strict=True)
        ]
        best = [m + sign * h * sgn(w) for m, h, w in zip(middle, half, weights, strict=True)]
        return sum(terms, start=sp.S.Zero), best

    def support_value(self, weights: Sequence[float]) -> float:
        sides = zip(weights, self.lower, self.upper, strict=True)
        return float(sum(max(c * float(a), c * float(b)) for c, a, b in sides if c))

    @property
    def _middle(self) -> list[sp.Expr]:
        return [(a + b) / 2 for a, b in self._sides]

    def half_widths(self) -> list[sp.Expr]:
        return [(b - a) / 2 for a, b in self._sides]

    def range_along(self, weights: Sequence[sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
        ends = [
            (e * low, e * high)
            for e, (low, high) in zip(weights, self._sides, strict=True)
            if e != 0
        ]
        return sp.Add(*(sp.Min(*p) for p in ends)), sp.Add(*(sp.Max(*p) for p in ends))

    def ranges(self) -> list[tuple[sp.Expr, sp.Expr]]:
        return self._sides

    def ends(self) -> tuple[sp.Expr, ...]:
        return (*self.lower, *self.upper)

    def half_spaces(self) -> list[Row]:
        rows: list[Row] = []
        for i, (low, high) in enumerate(self._sides):
            for side, limit in ((1, high), (-1, -low)):
                if limit != sp.oo:
                    rows.append(
                        (tuple(sp.Integer(side * (i == k)) for k in range(self.dimension)), limit)
                    )
        return rows

    def corners(self) -> list[tuple[sp.Expr, ...]]:
        return list(itertools.product(*self._sides))

    def reach(self, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int) -> Reach:
        """A member whose weight changes its sign for no p within the spread does not switch."""
        middle, half = sp.Matrix(self._middle), self.half_widths()
        sizes = gain.applyfunc(magnitude)
        weights, swings = gain.T * p, sizes.T * (WITHIN * spread)
        fixed = [
            select(magnitude(w) - r, sp.S.One, sp.S.Zero)
            for w, r in zip(weights, swings, strict=True)
        ]
        held = [sign * h * f * sgn(w) for h, f, w in zip(half, fixed, weights, strict=True)]
        loose = sp.Matrix([h * (1 - f) for h, f in zip(half, fixed, strict=True)])
        centre = gain * middle
        return (
            list(centre),
            list(sizes * sp.Matrix(half)),
            list(centre + gain * sp.Matrix(held)),
            list(sizes * loose),
        )

    def points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        """`samples` along every side, with its ends."""
        shares = [sp.Rational(k, samples - 1) for k in range(samples)]
        return list(itertools.product(*([a + (b - a) * s for s in shares] for a, b in self._sides)))

    def groups(self, members: Sequence[V]) -> list[Sequence[V]]:
        return [[m] for m in members]

    def section(self, kept: Sequence[bool]) -> Bounds | None:
        sides = [tuple(itertools.compress(side, kept)) for side in (self.lower, self.upper)]
        return Box(*sides)

    def moving(self, wave: Callable[[str], sp.Expr]) -> list[sp.Expr]:
        return [(a + b) / 2 + (b - a) / 2 * wave("box") for a, b in self._sides]

    def within(self, other: Bounds) -> bool:
        if not isinstance(other, Box):
            return False
        pairs = [
            *zip(other.lower, self.lower, strict=True),
            *zip(self.upper, other.upper, strict=True),
        ]
        return all((b - a).is_nonnegative for a, b in pairs)

    def text(self) -> str:
        return " x ".join(f"[{float(a):g}, {float(b):g}]" for a, b in self._sides)

    def lines(self) -> Iterator[str]:
        yield "box " + ", ".join(f"[{a}, {b}]" for a, b in self._sides)
