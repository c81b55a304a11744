"""What every enclosure of the states of a held flow says, and how a step carries it on.

States x are near a trajectory y of the rates with every free number in its middle, which is in N.
Their difference goes on, over a step, to M (x - y) and what is added. An enclosure says which set
holds x - y, and gives the same for the step after.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from holdfast.execution.arithmetic.steps import Steps
from holdfast.execution.intervals.enclosure import Row, dot


@dataclass(frozen=True)
class Motion:
    """How a step carries on: the difference d of a state to the trajectory in N goes to `carries` d
    plus one number of each row of `added`; the trajectory goes to `nominal`."""

    steps: Steps
    nominal: Row
    carries: list[Row]
    added: Sequence[Row]


@dataclass(frozen=True)
class Enclosure(ABC):
    """The states at one instant: in `box`, and in a set around the trajectory in `nominal`.

    Rows are of intervals, one for each state. halves: how often the checker of certificates may
    halve a cell (up to 8 times), to follow what this encloses more narrowly than its
    parallelepipeds do.
    """

    box: Row
    nominal: Row

    halves: ClassVar[int] = 0

    @staticmethod
    @abstractmethod
    def sizes(states: int) -> tuple[int, int]:
        """Of how many rows the set is: those that a step changes, and those that stay."""

    @classmethod
    @abstractmethod
    def begun(cls, steps: Steps, box: Row, center: Row) -> Self:
        """A box, around the trajectory of a point."""

    @classmethod
    @abstractmethod
    def of(cls, steps: Steps, box: Row, nominal: Row, rows: Sequence[Row]) -> Self:
        """From the rows that change, and those that stay."""

    @abstractmethod
    def rows(self) -> tuple[Sequence[Row], Sequence[Row]]:
        """Those that change, and those that stay."""

    @abstractmethod
    def spread(self, steps: Steps) -> Row:
        """A box of all differences."""

    @abstractmethod
    def hull(self, steps: Steps) -> Row:
        """A box of all states of the set."""

    @abstractmethod
    def after(self, motion: Motion) -> Self:
        """The set after a step, whose box is not yet that of it."""

    def inside(self, steps: Steps, box: Row) -> Self:
        """The same states, of which it is sure that they are in the box.

        A set may go on around another trajectory from here, if that begins in the box: the slopes
        and remainders of the next step are those of all states that do.
        """
        return replace(self, box=box)


def times(matrix: Sequence[Row], x: Row, steps: Steps) -> Row:
    return [dot(row, x, steps) for row in matrix]
