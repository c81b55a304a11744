"""A step over a grid on a disk: its stages go through the planes of the first axis close together.

Each stage follows the one before at the distance that a scheme reaches, so that the planes between
the first and the last of them are in memory, and every array is read and written once in a step
instead of once in every stage. The numbers are the same: a plane is computed when what it depends
on has been, and overwritten when nothing depends on it any more.
"""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.execution.level_set.stage_orders import StageAnswer, StageOrder
from holdfast.execution.level_set.sweeping import Sweeping, first_not_finite
from holdfast.execution.level_set.workers import Counts

NODES = 1_000_000
"""Nodes that a stage computes before the next follows, at least."""


class Streaming(Sweeping):
    """A sweeping whose arrays are on a disk."""

    @property
    def streams(self) -> bool:
        """Whether its stages may follow one another so."""
        march = self._march
        return len(march.shape) > 2 and march.fold is None and self._order > 1

    def step(self, orders: Sequence[StageOrder]) -> list[StageAnswer]:
        """All stages of a step."""
        if orders[0].again:
            self.all_again()
        march, many = self._march, len(orders)
        planes, reach = int(march.shape[0]), int(self._sizes[3])
        around = bool(march.kinds[0] == 1)
        block = max(2 * march.threads, -(-NODES // (march.nodes // planes)))
        ends = [planes + s * reach * around for s in range(many)]
        done = [end - planes for end in ends]
        found = [StageAnswer(0, 0, 0, 0.0, False)] * many
        while done[-1] < ends[-1]:
            for s, order in enumerate(orders):
                ready = ends[s] if s == 0 or done[s - 1] == ends[s - 1] else done[s - 1] - reach
                last = min(ready, done[s] + block)
                if last <= done[s]:
                    continue
                for low, high in _unrolled(done[s], last, planes):
                    self._workers.share(low, high)
                    found[s] = _added(
                        found[s], self._swept(s, order.u, order.numbers, order.measures)
                    )
                done[s] = last
        self._end(many - 1)
        for s, answer in enumerate(found):
            if answer.wrong:
                out = self._arrays[(s + 1) % many]
                found[s] = StageAnswer(0, answer.wrong, first_not_finite(out), 0.0, False)
                return found
        last_one = found[-1]
        found[-1] = StageAnswer(last_one.computed, 0, 0, last_one.move, self.fixed)
        return found


def _unrolled(first: int, last: int, planes: int) -> list[tuple[int, int]]:
    """The same planes of a ring, as one or two ranges of the axis."""
    if first >= planes:
        return [(first - planes, last - planes)]
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
