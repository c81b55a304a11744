"""The product of sets: each of its own, without regard to the others."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.sets.base import Bounds, Box, Reach, Row, V, section


@checked
@dataclass(frozen=True)
class Product(Bounds):
    """A x B x ...: the first members in A, the next in B, each without regard to the others.

    parts: A, B, ..., in the order of the members.

    >>> hf.Product((hf.Box((-1,), (1,)), hf.Ball(0.3, 2))).dimension
    3
    """

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

    def support(self, weights: Sequence[sp.Expr], sign: int) -> tuple[sp.Expr, list[sp.Expr]]:
        supports = [part.support(mine, sign) for part, mine in self.split(list(weights))]
        return sum((v for v, _ in supports), start=sp.S.Zero), [
            e for _, best in supports for e in best
        ]

    def support_value(self, weights: Sequence[float]) -> float:
        return sum(part.support_value(mine) for part, mine in self.split(list(weights)))

    def range_along(self, weights: Sequence[sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
        pairs = [part.range_along(mine) for part, mine in self.split(list(weights))]
        low, high = (sp.Add(*ends) for ends in zip(*pairs, strict=True))
        return low, high

    def ranges(self) -> list[tuple[sp.Expr, sp.Expr]]:
        return [pair for part in self.parts for pair in part.ranges()]

    def ends(self) -> tuple[sp.Expr, ...]:
        return tuple(e for part in self.parts for e in part.ends())

    def half_widths(self) -> list[sp.Expr]:
        return [e for part in self.parts for e in part.half_widths()]

    def half_spaces(self) -> list[Row]:
        return self._rows(lambda part: part.half_spaces())

    def inscribed(self) -> list[Row]:
        return self._rows(lambda part: part.inscribed())

    def _rows(self, of: Callable[[Bounds], list[Row]]) -> list[Row]:
        rows: list[Row] = []
        before = 0
        for part in self.parts:
            after = self.dimension - before - part.dimension
            for normal, limit in of(part):
                rows.append(((sp.S.Zero,) * before + normal + (sp.S.Zero,) * after, limit))
            before += part.dimension
        return rows

    def corners(self) -> list[tuple[sp.Expr, ...]]:
        every = itertools.product(*(part.corners() for part in self.parts))
        return [tuple(itertools.chain(*one)) for one in every]

    def reach(self, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int) -> Reach:
        columns = [gain.col(j) for j in range(gain.cols)]
        reaches = [
            part.reach(sp.Matrix.hstack(*mine), p, spread, sign)
            for part, mine in self.split(columns)
        ]
        every = ([sum(e) for e in zip(*same, strict=True)] for same in zip(*reaches, strict=True))
        centre, width, near, narrow = every
        return centre, width, near, narrow

    def points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        return self._joined(part.points(samples) for part in self.parts)

    def inscribed_points(self, samples: int) -> list[tuple[sp.Expr, ...]]:
        return self._joined(part.inscribed_points(samples) for part in self.parts)

    def _joined(self, points: Iterable[list[tuple[sp.Expr, ...]]]) -> list[tuple[sp.Expr, ...]]:
        return [tuple(itertools.chain(*one)) for one in itertools.product(*points)]

    def groups(self, members: Sequence[V]) -> list[Sequence[V]]:
        return [group for part, mine in self.split(members) for group in part.groups(mine)]

    def section(self, kept: Sequence[bool]) -> Bounds | None:
        parts = [section(part, mine) for part, mine in self.split(kept)]
        left = tuple(part for part in parts if part is not None)
        return left[0] if len(left) == 1 else Product(left)

    def moving(self, wave: Callable[[str], sp.Expr]) -> list[sp.Expr]:
        return [e for part in self.parts for e in part.moving(wave)]

    def within(self, other: Bounds) -> bool:
        if not (isinstance(other, Product) and len(self.parts) == len(other.parts)):
            return False
        return all(a.within(b) for a, b in zip(self.parts, other.parts, strict=True))

    def text(self) -> str:
        return " and ".join(part.text() for part in self.parts)

    def lines(self) -> Iterator[str]:
        for part in self.parts:
            yield from part.lines()


def product(first: Bounds | None, second: Bounds | None) -> Bounds | None:
    """The product of two sets; None where one of them is missing, which leaves all unbounded.

    That of two boxes is a box.
    """
    if first is None or second is None:
        return None
    parts: list[Bounds] = []
    for part in (p for b in (first, second) for p in (b.parts if isinstance(b, Product) else (b,))):
        last = parts[-1] if parts else None
        if isinstance(last, Box) and isinstance(part, Box):
            parts[-1] = Box((*last.lower, *part.lower), (*last.upper, *part.upper))
        else:
            parts.append(part)
    return parts[0] if len(parts) == 1 else Product(tuple(parts))
