"""The stages of a march in a part of a grid, with the layers around it from other parts.

Between two exchanges of halos the stages compute the part itself and what the stages to come need
of the halo. What a unit's change marks to be computed again may lie in another part, and is handed
over with the values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.layers import Part
from holdfast.execution.level_set.mirrored_grid import Flags
from holdfast.execution.level_set.sweeping import (
    Sweeping,
    first_not_finite,
    not_finite,
    on_one_side,
)
from holdfast.execution.level_set.workers import Counts
from holdfast.execution.working_room import Room

if TYPE_CHECKING:
    from holdfast.execution.level_set.march import March


@dataclass(frozen=True)
class Edges:
    """What a part hands over to another. marked: layers of the grid, and for each of them the units
    to be computed again, in every stage; values: of the layers in which a node has changed."""

    marked: Sequence[int]
    flags: Flags
    changed: Sequence[int]
    values: Sequence[Array]

    def copy(self) -> Edges:
        """The same, once the part goes on."""
        values = [v.copy() for v in self.values]
        return Edges(self.marked, self.flags, self.changed, values)

    @property
    def bytes(self) -> int:
        return self.flags.nbytes + sum(v.nbytes for v in self.values)


class Slab(Sweeping):
    """stages: from an exchange of halos to the next, one or those of a whole step. The last of
    the rows of flags has the units that have changed in the last of these."""

    def __init__(
        self,
        march: March,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        room: Room,
        part: Part,
        stages: int,
    ) -> None:
        super().__init__(march, values, upper, lower, room)
        assert march.units == len(part.layers) * part.of.units
        self.part, self._stages = part, stages
        self._rows = np.ones((max(self.stages, 2) + 1, march.units), dtype=np.uint8)
        self.flags = self._rows[:-1]
        self._layer = len(values) // int(part.starts[-1])  # nodes at a place of the axis
        self._of = {k: np.flatnonzero(part.layers == k).tolist() for k in part.layers.tolist()}
        self._latest = 0

    def marks(self, s: int) -> tuple[Flags, Flags, Flags]:
        here, there, own = super().marks(s)
        return here, there, self._rows[1:] if len(own) else self._rows[-1:]

    def _narrow(self, s: int, here: Flags) -> None:
        super()._narrow(s, here)
        part, k = self.part, s % self._stages
        own = part.own_layers
        around = part.of.reach * (self._stages - 1 - k)
        here[: part.units(max(own.start - around, 0)).start] = 0
        here[part.units(own.stop + around).start :] = 0
        self._rows[-1] = 0
        self._computed = int(here[self._own].sum())

    @property
    def _own(self) -> slice:
        own = self.part.own_layers
        return slice(self.part.units(own.start).start, self.part.units(own.stop).start)

    def stage(self, s: int, u: Array, numbers: Array, measures: bool) -> Counts:
        found = super().stage(s, u, numbers, measures)
        found[0] = self._computed
        if found[1] and self._stages > 1:  # some of them may lie in the halo
            found[1] = np.count_nonzero(not_finite(self.own_values(self._out)))
        self._latest = 0 if s == self.stages - 1 else s + 1
        return found

    def own_values(self, array: Array | None = None) -> Array:
        """Those of the part without its halo."""
        own = self.part.own
        array = self.values() if array is None else array
        return array[own.start * self._layer : own.stop * self._layer]

    def largest(self) -> float:
        return float(self.own_values().max())

    def on_one_side(self, limit: str) -> bool:
        return on_one_side(self.own_values(), limit)

    def not_finite(self) -> int:
        """The first of the grid's nodes that the last stage has made not finite."""
        first = first_not_finite(self.own_values(self._out))
        return self.part.own_nodes.start * self._layer + first

    def edges(self, wanted: Sequence[int]) -> Edges:
        """Of these layers of the grid what has become of them here since the last exchange."""
        part, array = self.part, self.arrays[self._latest]
        own, reach = part.own_layers, part.of.reach
        near = range(max(own.start - reach, 0), min(own.stop + reach, len(part.layers)))
        asked = set(wanted)
        mine = [j for j in near if int(part.layers[j]) in asked]
        flags = np.array([self._rows[:, part.units(j)] for j in mine])
        sent = [j for j in mine if j in own and self._rows[-1, part.units(j)].any()]
        values = [array[self._nodes(j)] for j in sent]
        named = part.layers.tolist()
        return Edges([named[j] for j in mine], flags, [named[j] for j in sent], values)

    def take(self, found: Sequence[Edges]) -> None:
        """What other parts, or this one at the other end, have handed over."""
        array, own = self.arrays[self._latest], self.part.own_layers
        halo = {k: [j for j in at if j not in own] for k, at in self._of.items()}
        if self.stages == 1:  # where nothing was handed over, the last two steps are equal
            for j in (j for at in halo.values() for j in at):
                array[self._nodes(j)] = self.arrays[1][self._nodes(j)]
        for edges in found:
            for k, flags in zip(edges.marked, edges.flags, strict=True):
                for j in self._of[k]:
                    self._rows[:, self.part.units(int(j))] |= flags
            for k, values in zip(edges.changed, edges.values, strict=True):
                for j in halo[k]:
                    array[self._nodes(int(j))] = values

    def _nodes(self, layer: int) -> slice:
        starts = self.part.starts
        return slice(int(starts[layer]) * self._layer, int(starts[layer + 1]) * self._layer)
