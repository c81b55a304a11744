"""The values of a march in the memory of this machine, and its stages, carried out by threads."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.mirrored_grid import Flags
from holdfast.execution.level_set.stage_steps import INFINITE
from holdfast.execution.level_set.sweep_code import address
from holdfast.execution.level_set.workers import Counts, Workers
from holdfast.execution.working_room import Memory, Room

if TYPE_CHECKING:
    from holdfast.execution.level_set.march import March


TOGETHER = 1 << 20
"""Nodes that are looked at together."""


class Sweeping:
    """arrays[0] are the values at the beginning of a step and at its end, the others those of its
    stages. flags: of every stage the units that are to be computed.

    Used in a `with` statement. Others do the same elsewhere (`device_sweeping.py`).
    """

    def __init__(
        self,
        march: March,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        steps: int,
        room: Room | None = None,
    ) -> None:
        """steps: those that have been done. room: for the values of stages."""
        order = march.method.order
        self._march, self._order, self._steps = march, order, steps
        self._values = values
        copied = (room or Memory()).copy
        self._arrays = [values, *(copied(values) for _ in range(max(order - 1, 1)))]
        self._flags = np.ones((max(order, 2), march.units), dtype=np.uint8)
        plain, measured, sizes = march.leaves.found(
            lower=lower is not None, upper=upper is not None
        )
        self._leaves = {False: plain, True: measured}
        shape, axes = march.shape, march.axes
        self._room = march.code.room(shape.tolist(), march.cut.tolist(), sizes.tolist())
        self._bounds = [0 if a is None else address(a) for a in (upper, lower)]
        self._of_grid = [address(shape), len(shape), address(march.cut), address(march.kinds)]
        self._sizes = sizes
        self._of_axes = [address(sizes), address(axes), axes.shape[1]]
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
            self._values[:] = self._arrays[0]
        self._workers.__exit__(kind, error, at)

    def all_again(self) -> None:
        """Have all units computed."""
        self._flags[:] = 1

    def bounds_moved(self) -> None:
        """The bounds at nodes are others now."""

    def stage(self, s: int, u: Array, numbers: Array, measures: bool) -> Counts:
        """Carry out a stage of a step: units computed, nodes not finite, the largest move."""
        here, _, _ = self._marks(s)
        self._narrow(s, here)
        found = self._swept(s, u, numbers, measures)
        self._end(s)
        return found

    def _marks(self, s: int) -> tuple[Flags, Flags, Flags]:
        """The units to be computed in a stage, those in the next, and which of the later ones."""
        flags, order = self._flags, self._order
        if order == 1:
            k = self._steps % 2
            return flags[k], flags[1 - k], flags[:0]
        last = s == order - 1
        return flags[s], flags[(s + 1) % order], flags[1:order] if last else flags[:0]

    def _narrow(self, s: int, here: Flags) -> None:
        """Of the units to be computed those that are computed here."""
        if self._march.fold is not None:
            self._march.fold.narrow(here)

    def _swept(self, s: int, u: Array, numbers: Array, measures: bool) -> Counts:
        """A stage of the units at the places that the workers share."""
        order, arrays, march = self._order, self._arrays, self._march
        here, there, own = self._marks(s)
        out = self._out = arrays[1] if order == 1 else arrays[0 if s == order - 1 else s + 1]
        before = arrays[0] if order == 1 else out
        given = [
            *map(address, (u, numbers, arrays[s], arrays[0], out, before)),
            *self._bounds, len(self._values), *map(address, (here, there, own)), len(own),
            march.units, *self._of_grid, address(self._leaves[measures]), *self._of_axes,
        ]  # fmt: skip
        return self._workers.run(march.code.sweep, self._room, given)

    def _end(self, s: int) -> None:
        """What follows a stage over the whole grid."""
        if self._march.fold is not None:
            self._mirror(self._out, self._march.fold.needed)
        if s == self._order - 1:
            self._steps += 1
            if self._order == 1:
                self._arrays.reverse()

    def not_finite(self) -> int:
        """The first of the nodes that the last stage has made not finite."""
        return first_not_finite(self._out)

    @property
    def fixed(self) -> bool:
        """Whether nothing is left to be computed."""
        return not self._flags[0 if self._order > 1 else self._steps % 2].any()

    def values(self) -> Array:
        """The values at the nodes, between two steps; they change with the next."""
        if self._march.fold is not None:
            self._mirror(self._arrays[0], self._march.fold.rest)
        return self._arrays[0]

    def largest(self) -> float:
        return float(self.values().max())

    def on_one_side(self, limit: str) -> bool:
        return on_one_side(self.values(), limit)

    def _mirror(self, array: Array, chosen: Array) -> None:
        """Of the half that is not computed, what lies at those places."""
        fold, code = self._march.fold, self._march.code
        assert fold is not None
        half = (array, self._march.shape, fold.places, fold.axis, chosen)
        self._workers.run(code.mirror, *half)


def on_one_side(values: Array, limit: str) -> bool:
    """Whether nothing is left of a set that shrinks, or nothing is left for one that grows."""
    parts = (values[k : k + TOGETHER] for k in range(0, len(values), TOGETHER))  # to save memory
    return not any((v > 0 if limit == "shrink" else v <= 0).any() for v in parts)


def first_not_finite(values: Array) -> int:
    """The place of the first; some at a time, to save memory."""
    for first in range(0, len(values), TOGETHER):
        wrong = ~(np.abs(values[first : first + TOGETHER]) < INFINITE)
        if wrong.any():
            return first + int(np.argmax(wrong))
    return 0
