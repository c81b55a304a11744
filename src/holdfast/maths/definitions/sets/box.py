"""A box: every member between two ends, whatever the others are."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.sets.base import (
    WITHIN,
    Bounds,
    Reach,
    Row,
    V,
    check_count,
    entries,
)
from holdfast.maths.expressions.functions import clip, magnitude, select, sgn
from holdfast.maths.expressions.traversal import at_numbers


@checked
@dataclass(frozen=True)
class Box(Bounds):
    """lower_i <= u_i <= upper_i; entries are numbers or expressions in parameters."""

    lower: tuple[sp.Expr, ...]
    upper: tuple[sp.Expr, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", entries(self.lower, "lower bound"))
        object.__setattr__(self, "upper", entries(self.upper, "upper bound"))
        if len(self.lower) != len(self.upper):
            raise DefinitionError(
                f"box has {len(self.lower)} lower and {len(self.upper)} upper bounds",
                expected="as many of each",
            )
        for low, high in self._sides:
            if (high - low).is_negative:
                raise DefinitionError(f"box has the empty interval [{low}, {high}]")

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
