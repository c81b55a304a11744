"""A zonotope: N + sum_i g_i e_i with |e_i| <= 1, whose generators are carried on one by one.

Those of the box at the begin stay for good. What a step adds is a box, whose sides are generators
of their own for `BLOCKS` steps more, so that turning does not widen it; then the oldest of them are
enclosed in a box again (A. Girard, Reachability of uncertain linear systems using zonotopes, HSCC
2005). The rounding of every generator is in what the step adds. The trajectory in N begins anew
after each step, at a point of the box of all states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from holdfast.execution.arithmetic.steps import Steps
from holdfast.execution.intervals.enclosure import Interval, Row, constant, largest, middle, number
from holdfast.execution.intervals.enclosures.base import Enclosure, Motion, times

BLOCKS = 4


@dataclass(frozen=True)
class Zonotope(Enclosure):
    """generators: of the box at the begin, then of the last steps, the newest first. rest: the box
    that the last step added, until it has generators."""

    generators: list[Row]
    rest: Row

    halves: ClassVar[int] = 8

    @staticmethod
    def sizes(states: int) -> tuple[int, int]:
        return states * (1 + BLOCKS), 0

    @classmethod
    def begun(cls, steps: Steps, box: Row, center: Row) -> Self:
        off = [q - c for q, c in zip(box, center, strict=True)]
        none = [[number(steps, 0.0)] * len(box)] * (BLOCKS * len(box))
        return cls(box, center, [*_sides(steps, off), *none], none[0])

    @classmethod
    def of(cls, steps: Steps, box: Row, nominal: Row, rows: Sequence[Row]) -> Self:
        return cls(box, nominal, list(rows), [number(steps, 0.0)] * len(box))

    def rows(self) -> tuple[Sequence[Row], Sequence[Row]]:
        return self.generators, []

    def spread(self, steps: Steps) -> Row:
        return _sum(steps, self.generators)

    def hull(self, steps: Steps) -> Row:
        every = zip(self.nominal, self.rest, self.spread(steps), strict=True)
        return [c + r + q for c, r, q in every]

    def after(self, motion: Motion) -> Self:
        steps, n = motion.steps, len(self.nominal)
        moved = [times(motion.carries, g, steps) for g in self.generators]
        mapped = [[middle(q) for q in g] for g in moved]
        rounded = [[q - c for q, c in zip(g, m, strict=True)]
                   for g, m in zip(moved, mapped, strict=True)]  # fmt: skip
        begin, *recent = (mapped[k : k + n] for k in range(0, len(mapped), n))
        rest = _sum(steps, [*rounded, *recent.pop()])
        for more in motion.added:
            rest = [q + r for q, r in zip(rest, more, strict=True)]
        generators = [g for block in (begin, *recent) for g in block]
        return type(self)(self.box, motion.nominal, generators, rest)

    def inside(self, steps: Steps, box: Row) -> Self:
        n = len(box)
        around = [c + r for c, r in zip(self.nominal, self.rest, strict=True)]
        nominal = [middle(q).within(b.low, b.high) for q, b in zip(around, box, strict=True)]
        newest = _sides(steps, [q - c for q, c in zip(around, nominal, strict=True)])
        generators = [*self.generators[:n], *newest, *self.generators[n:]]
        return type(self)(box, nominal, generators, [number(steps, 0.0)] * n)


def _sides(steps: Steps, box: Row) -> list[Row]:
    """The generators of a box around zero."""
    sizes = [largest(-q.low, q.high) for q in box]
    zero = number(steps, 0.0)
    return [
        [Interval(size, size) if i == j else zero for i in range(len(box))]
        for j, size in enumerate(sizes)
    ]


def _sum(steps: Steps, generators: Sequence[Row]) -> Row:
    """A box of all that the generators reach."""
    unit = constant(steps, -1.0, 1.0)
    total = [number(steps, 0.0)] * len(generators[0])
    for g in generators:
        total = [q + e * unit for q, e in zip(total, g, strict=True)]
    return total


ENCLOSURE = Zonotope
