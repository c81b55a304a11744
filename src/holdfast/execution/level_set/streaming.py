"""A step over a grid on a disk: its stages go through the planes of the first axis close together.

Each stage follows the one before at the distance that a scheme reaches, so that the planes between
the first and the last of them are in memory, and every array is read and written once in a step
instead of once in every stage. The numbers are the same: a plane is computed when what it depends
on has been, and overwritten when nothing depends on it any more. Bounds that move are those of its
time in every stage, and a symmetry reflects a plane onto itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from holdfast.execution.level_set.stage_orders import Bounds, StageAnswer, StageOrder
from holdfast.execution.level_set.sweeping import Sweeping, first_not_finite
from holdfast.execution.level_set.workers import Counts

NODES = 1_000_000
"""Nodes that a stage computes before the next follows, at least."""


def streams(states: int, stages: int, reflects_first: bool) -> bool:
    """Whether the stages of a step may follow one another so.

    reflects_first: whether a symmetry has a plane of the first axis reflected onto another.
    """
    return states > 2 and stages > 1 and not reflects_first


class Streaming(Sweeping):
    """A sweeping whose arrays are on a disk."""

    @property
    def streams(self) -> bool:
        """Whether its stages may follow one another so."""
        fold = self.march.fold
        return streams(len(self.march.shape), self.stages, fold is not None and fold.axis == 0)

    def step(self, orders: Sequence[StageOrder], bounds: Bounds) -> list[StageAnswer]:
        """All stages of a step."""
        if orders[0].again:
            self.all_again()
        march, many = self.march, len(orders)
        planes, reach = int(march.shape[0]), int(self.sizes[3])
        around = bool(march.kinds[0] == 1)
        block = max(2 * march.threads, -(-NODES // (march.nodes // planes)))
        ends = [planes + s * reach * around for s in range(many)]
        done = [end - planes for end in ends]
        found = [StageAnswer(0, 0, 0, 0.0, False)] * many
        told: list[list[Any]] = [[] for _ in orders]
        while done[-1] < ends[-1]:
            for s, order in enumerate(orders):
                ready = ends[s] if s == 0 or done[s - 1] == ends[s - 1] else done[s - 1] - reach
                last = min(ready, done[s] + block)
                if last <= done[s]:
                    continue
                for low, high in _unrolled(done[s], last, planes):
                    if order.time is not None:
                        told[s].append(bounds.renew(order.time, low, high))
                    found[s] = _added(found[s], self._planes(order, low, high))
                done[s] = last
        self._workers.share(0, planes)
        return self._answers(found, told, bounds)

    def _planes(self, order: StageOrder, low: int, high: int) -> Counts:
        """A stage of some planes."""
        march, s = self.march, order.s
        planes = int(march.shape[0])
        units, nodes = march.units // planes, march.nodes // planes
        self._narrow(s, self.marks(s)[0][low * units : high * units])
        self._workers.share(low, high)
        found = self.swept(self._workers, s, order.u, order.numbers, order.measures)
        self._workers.share(0, high - low)
        self._reflect(self.out(s)[low * nodes : high * nodes])
        return found

    def _answers(
        self, found: list[StageAnswer], told: Sequence[Sequence[Any]], bounds: Bounds
    ) -> list[StageAnswer]:
        """Those of the stages, up to the first at which the march ends."""
        for s, answer in enumerate(found):
            if told[s]:
                bounds.check(told[s])
            if answer.wrong:
                first = first_not_finite(self.out(s))
                return [*found[:s], StageAnswer(0, answer.wrong, first, 0.0, False)]
        last = found[-1]
        return [*found[:-1], StageAnswer(last.computed, 0, 0, last.move, self.fixed)]


def _unrolled(first: int, last: int, planes: int) -> list[tuple[int, int]]:
    """The same planes of a ring, at most all of it, as one or two ranges of the axis."""
    around = first // planes * planes
    first, last = first - around, last - around
    if last <= planes:
        return [(first, last)]
    return [(first, planes), (0, last - planes)]


def _added(answer: StageAnswer, counts: Counts) -> StageAnswer:
    return StageAnswer(
        answer.computed + int(counts[0]),
        answer.wrong + int(counts[1]),
        0,
        max(answer.move, float(counts[2])),
        False,
    )
