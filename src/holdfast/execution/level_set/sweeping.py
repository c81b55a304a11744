"""The values of a march in the memory of this machine, and its stages, carried out by threads."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march_arrays import MarchArrays
from holdfast.execution.level_set.mirrored_grid import Flags
from holdfast.execution.level_set.stage_steps import INFINITE
from holdfast.execution.level_set.workers import Counts, Workers
from holdfast.execution.working_room import Memory, Room

if TYPE_CHECKING:
    from holdfast.execution.level_set.march import March


TOGETHER = 1 << 20
"""Nodes that are looked at together."""


class Sweeping(MarchArrays):
    """Used in a `with` statement. Others do the same elsewhere (`device_sweeping.py`)."""

    def __init__(
        self,
        march: March,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        room: Room | None = None,
    ) -> None:
        """room: for the values of stages."""
        super().__init__(march, values, upper, lower, (room or Memory()).copy)
        self._values = values
        self._workers = Workers(march.code, march.threads, march.places)

    def __enter__(self) -> Sweeping:
        self._workers.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        if kind is None and self.values() is not self._values:
            self._values[:] = self.arrays[0]
        self._workers.__exit__(kind, error, at)

    def all_again(self) -> None:
        """Have all units computed."""
        self.flags[:] = 1

    def bounds_moved(self) -> None:
        """The bounds at nodes are others now."""

    def stage(self, s: int, u: Array, numbers: Array, measures: bool) -> Counts:
        """Carry out a stage of a step: units computed, nodes not finite, the largest move."""
        self._narrow(s, self.marks(s)[0])
        found = self.swept(self._workers, s, u, numbers, measures)
        self._out = self.out(s)
        self._reflect(self._out)
        self.ended(s)
        return found

    def _narrow(self, s: int, here: Flags) -> None:
        """Of the units to be computed those that are computed here."""
        if self.march.fold is not None:
            self.march.fold.narrow(here)

    def _reflect(self, values: Array) -> None:
        """Of the half that is not computed, what the next stage reads."""
        if self.march.fold is not None:
            self._mirror(values, self.march.fold.needed)

    def not_finite(self) -> int:
        """The first of the nodes that the last stage has made not finite."""
        return first_not_finite(self._out)

    @property
    def fixed(self) -> bool:
        """Whether nothing is left to be computed."""
        return not self.flags[0].any()

    def values(self) -> Array:
        """The values at the nodes, between two steps; they change with the next."""
        if self.march.fold is not None:
            self._mirror(self.arrays[0], self.march.fold.rest)
        return self.arrays[0]

    def largest(self) -> float:
        return float(self.values().max())

    def on_one_side(self, limit: str) -> bool:
        return on_one_side(self.values(), limit)

    def _mirror(self, values: Array, chosen: Array) -> None:
        """Of the half that is not computed, what lies at those places."""
        fold, code = self.march.fold, self.march.code
        assert fold is not None
        half = (values, self.march.shape, fold.places, fold.axis, chosen)
        self._workers.run(code.mirror, *half)


def on_one_side(values: Array, limit: str) -> bool:
    """Whether nothing is left of a set that shrinks, or nothing is left for one that grows."""
    parts = (values[k : k + TOGETHER] for k in range(0, len(values), TOGETHER))  # to save memory
    return not any((v > 0 if limit == "shrink" else v <= 0).any() for v in parts)


def first_not_finite(values: Array) -> int:
    """The place of the first; some at a time, to save memory."""
    for first in range(0, len(values), TOGETHER):
        wrong = ~(np.abs(values[first : first + TOGETHER]) < np.float64(INFINITE))
        if wrong.any():
            return first + int(np.argmax(wrong))
    return 0
