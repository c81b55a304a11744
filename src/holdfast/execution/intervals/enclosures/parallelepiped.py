"""N + C (X - c) + E: what is left of a box that a matrix carries on, and a box of the rest.

R. J. Lohner, Computation of guaranteed enclosures for the solutions of ordinary initial and
boundary value problems, 1992. The checker follows the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from holdfast.execution.arithmetic.steps import Steps
from holdfast.execution.intervals.enclosure import Row, dot, number
from holdfast.execution.intervals.enclosures.base import Enclosure, Motion, times


@dataclass(frozen=True)
class Parallelepiped(Enclosure):
    """carried: C. rest: E. off: X - c of the box X with the middle c, which stays."""

    carried: list[Row]
    rest: Row
    off: Row

    @staticmethod
    def sizes(states: int) -> tuple[int, int]:
        return states + 1, 1

    @classmethod
    def begun(cls, steps: Steps, box: Row, center: Row) -> Self:
        zero, one = number(steps, 0.0), number(steps, 1.0)
        carried = [[one if i == j else zero for j in range(len(box))] for i in range(len(box))]
        off = [q - c for q, c in zip(box, center, strict=True)]
        return cls(box, center, carried, [zero] * len(box), off)

    @classmethod
    def of(cls, steps: Steps, box: Row, nominal: Row, rows: Sequence[Row]) -> Self:
        *carried, rest, off = rows
        return cls(box, nominal, carried, rest, off)

    def rows(self) -> tuple[Sequence[Row], Sequence[Row]]:
        return [*self.carried, self.rest], [self.off]

    def spread(self, steps: Steps) -> Row:
        moved = times(self.carried, self.off, steps)
        return [q + r for q, r in zip(moved, self.rest, strict=True)]

    def hull(self, steps: Steps) -> Row:
        moved = times(self.carried, self.off, steps)
        return [c + q + r for c, q, r in zip(self.nominal, moved, self.rest, strict=True)]

    def after(self, motion: Motion) -> Self:
        steps, m = motion.steps, motion.carries
        rest = times(m, self.rest, steps)
        for more in motion.added:
            rest = [q + r for q, r in zip(rest, more, strict=True)]
        columns = [[row[j] for row in self.carried] for j in range(len(rest))]
        carried = [[dot(row, column, steps) for column in columns] for row in m]
        return type(self)(self.box, motion.nominal, carried, rest, self.off)


ENCLOSURE = Parallelepiped
