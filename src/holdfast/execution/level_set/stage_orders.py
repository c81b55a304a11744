"""Stages of a march: who carries them out, what is asked of a part of the grid, its answer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from holdfast.execution.arrays import AnyArray as Array


class Stages(Protocol):
    """What holds the values of a march and carries out the stages of its steps, wherever."""

    def all_again(self) -> None:
        """Have everything computed in the next step, also what is settled."""

    def bounds_moved(self) -> None:
        """The bounds at nodes are others now."""

    def stage(self, s: int, u: Array, numbers: Array, measures: bool) -> Array:
        """Units computed, nodes that are not finite, the largest move.

        These may be those of the stages before, where they have not been told yet.
        """

    def not_finite(self) -> int:
        """The first of the grid's nodes that are not finite after the last stage."""

    @property
    def fixed(self) -> bool:
        """Whether nothing is left to be computed."""


class Bounds(Protocol):
    """Bounds at nodes that move."""

    def refresh(self, time: float) -> None:
        """Have them be those of a time t."""

    def renew(self, time: float, first: int, last: int) -> Any:
        """The same at some places of the first axis; what there is to know of them there."""

    def check(self, found: Sequence[Any]) -> None:
        """Refuse what no march can go on with, once a stage has renewed all of them."""


@dataclass(frozen=True)
class StageOrder:
    """s: which stage of a step; u: what is the same at all nodes; numbers, measures: as a stage
    takes them. time: that of the bounds at nodes from this stage on, where they move; again:
    whether everything is computed, also what is settled."""

    s: int
    u: Array
    numbers: Array
    measures: bool
    time: float | None
    again: bool


@dataclass(frozen=True)
class StageAnswer:
    """Units computed, nodes that are not finite and the first of them among those of the grid, the
    largest move, whether nothing is left to be computed."""

    computed: int
    wrong: int
    first: int
    move: float
    fixed: bool


def carried_out(
    stages: Stages, orders: Sequence[StageOrder], bounds: Bounds
) -> Iterator[StageAnswer]:
    """One stage after another."""
    for order in orders:
        if order.again:
            stages.all_again()
        if order.time is not None:
            bounds.refresh(order.time)
            stages.bounds_moved()
        computed, wrong, move = stages.stage(order.s, order.u, order.numbers, order.measures)
        first = stages.not_finite() if wrong else 0
        yield StageAnswer(int(computed), int(wrong), first, float(move), stages.fixed)


def joined(answers: Sequence[Sequence[StageAnswer]]) -> StageAnswer:
    """Of all parts, and of stages that follow one another: where it is not finite, of the first."""
    stages = list(zip(*answers, strict=True))
    wrong = next((k for k, of in enumerate(stages) if any(a.wrong for a in of)), len(stages) - 1)
    bad = [a for a in stages[wrong] if a.wrong]
    return StageAnswer(
        sum(a.computed for of in stages for a in of),
        sum(a.wrong for a in bad),
        min((a.first for a in bad), default=0),
        max(a.move for a in stages[-1]),
        all(a.fixed for a in stages[-1]),
    )
