"""A grid cut into parts along its first axis, and the stages of a march in one of them.

A layer is what is computed together along that axis: a plane of a grid of three or more states,
several rows of one of two. A part holds its own layers and the halo, the layers on either side that
a number of stages of a march reads; with more stages between two exchanges of halos there are
fewer messages, and the inner part of a halo is computed twice. Between two exchanges the stages
compute the part itself and what the stages to come need of the halo. What a unit's change marks to
be computed again may lie in another part, and is handed over with the values.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.fold import Flags, Places
from holdfast.execution.level_set.sweeping import (
    Bounds,
    Counts,
    Planes,
    StageOrder,
    Sweeping,
    first_not_finite,
    layout,
    not_finite,
    on_one_side,
)
from holdfast.execution.resources import Room

if TYPE_CHECKING:
    from holdfast.execution.level_set.march import March


@dataclass(frozen=True)
class Layers:
    """nodes: along the first axis; thick: those of a layer, the last may have fewer; units: of a
    layer; reach: layers on either side that a stage reads; around: whether the axis is periodic."""

    nodes: int
    thick: int
    units: int
    reach: int
    around: bool

    @property
    def count(self) -> int:
        return -(-self.nodes // self.thick)

    def parts(self, count: int, stages: int) -> list[Part]:
        """So many parts of about the same size, with halos for so many stages.

        One part is the whole grid, without a halo. There are no more parts than layers.
        """
        count = min(count, self.count)
        if count == 1:
            return [Part(self, 0, self.count, 0, 0)]
        ends = [self.count * k // count for k in range(count + 1)]
        halo = stages * self.reach
        return [
            Part(
                self,
                first,
                last,
                halo if self.around else min(halo, first),
                halo if self.around else min(halo, self.count - last),
            )
            for first, last in itertools.pairwise(ends)
        ]


@dataclass(frozen=True)
class Part:
    """The layers from `first` to `last`, and those of the halo `before` and `after` them."""

    of: Layers
    first: int
    last: int
    before: int
    after: int

    @cached_property
    def layers(self) -> Places:
        """Which layer of the grid every one of its layers is, those of the halo included, shape
        (layers,)."""
        return np.arange(self.first - self.before, self.last + self.after) % self.of.count

    @cached_property
    def starts(self) -> Places:
        """The first of its nodes along the axis in each of its layers, and the end, shape
        (layers + 1,)."""
        left = np.minimum(self.of.thick, self.of.nodes - self.layers * self.of.thick)
        return np.concatenate([[0], np.cumsum(left)])

    @cached_property
    def nodes(self) -> Places:
        """Which place of the axis each of its nodes along it is at, shape (planes,)."""
        wide = np.diff(self.starts)
        return np.concatenate(
            [np.arange(w) + k * self.of.thick for k, w in zip(self.layers, wide, strict=True)]
        )

    @cached_property
    def planes(self) -> Planes:
        last = self.before + self.last - self.first
        inner = slice(int(self.starts[self.before]), int(self.starts[last]))
        return Planes(self.nodes, inner, self.of.nodes)

    @property
    def own_layers(self) -> range:
        """Its own, among those that it holds."""
        return range(self.before, self.before + self.last - self.first)

    def wanted(self, others: Sequence[Part]) -> list[tuple[int, list[int]]]:
        """The parts that hand something over to this one, and of which layers of the grid."""
        halo, of = set(self.layers.tolist()), self.of
        senders = []
        for k, other in enumerate(others):
            near = range(other.first - of.reach, other.last + of.reach)
            theirs = {j % of.count if of.around else j for j in near}
            if (other != self or of.around) and (both := sorted(halo & theirs)):
                senders.append((k, both))
        return senders

    def units(self, layer: int) -> slice:
        """The units of one of its layers."""
        return slice(layer * self.of.units, (layer + 1) * self.of.units)


def layers(shape: Sequence[int], ghosts: int, ends: str) -> Layers:
    """The layers of a grid for a scheme that reaches `ghosts` nodes."""
    many, groups, stretches, longest = layout(shape)
    if len(shape) == 1:  # the sweep marks so many stretches of a row
        return Layers(shape[0], longest, 1, ghosts, ends == "periodic")
    if len(shape) == 2:
        return Layers(shape[0], many, stretches, -(-ghosts // many), ends == "periodic")
    units = math.prod(shape[1:-2]) * groups * stretches
    return Layers(shape[0], 1, units, ghosts, ends == "periodic")


def check_cut(of: Layers, name: str, reflected: bool) -> None:
    """Refuse a grid that cannot be cut along its first axis."""
    if of.around and of.nodes % of.thick:
        raise SimulationError(
            f"a grid of {of.nodes} nodes along the angle '{name}' cannot be cut into parts",
            expected=f"a multiple of {of.thick}, or three or more states",
        )
    if reflected:
        raise SimulationError(
            f"the symmetry reflects '{name}', along which the grid is cut into parts",
            expected="a symmetry of other states",
            remedy="leave it out, or define the system with another state first",
        )


@dataclass(frozen=True)
class Edges:
    """What a part hands over to another. marked: layers of the grid, and for each of them the units
    to be computed again, in every stage, and those that have changed: flags, shape (marked, rows of
    flags, units of a layer); values: of the layers in which a node has changed, each of shape
    (nodes of the layer,)."""

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
    """values, upper, lower: at the nodes of the part and its halo, shape (nodes,). stages: from an
    exchange of halos to the next, one or those of a whole step. The last of the rows of flags has
    the units that have changed in the last of these."""

    def __init__(
        self,
        march: March,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        room: Room,
        bounds: Bounds | None,
        part: Part,
        stages: int,
    ) -> None:
        super().__init__(march, values, upper, lower, room, bounds)
        assert march.units == len(part.layers) * part.of.units
        self.part, self._stages = part, stages
        # What has changed stands behind the flags: a sweep marks rows that follow one another.
        self._rows = np.ones((max(self.stages, 2) + 1, march.units), dtype=np.uint8)
        self.flags = self._rows[:-1]
        self._layer = len(values) // int(part.starts[-1])  # nodes at a place of the axis
        self._of = {k: np.flatnonzero(part.layers == k).tolist() for k in part.layers.tolist()}
        self._latest = 0

    def marks(self, s: int) -> tuple[Flags, Flags, Flags]:
        """As of any, (units,) twice and (later, units), with what has changed among the latter."""
        here, there, later = super().marks(s)
        return here, there, self._rows[1:] if len(later) else self._rows[-1:]

    def _narrow(self, s: int, here: Flags) -> None:
        super()._narrow(s, here)
        part, k = self.part, s % self._stages
        inner = part.own_layers
        around = part.of.reach * (self._stages - 1 - k)
        here[: part.units(max(inner.start - around, 0)).start] = 0
        here[part.units(inner.stop + around).start :] = 0
        self._rows[-1] = 0
        self._computed = int(here[self._own].sum())

    @property
    def _own(self) -> slice:
        inner = self.part.own_layers
        return slice(self.part.units(inner.start).start, self.part.units(inner.stop).start)

    def _carry_out(self, order: StageOrder) -> Counts:
        counts = super()._carry_out(order)
        counts[0] = self._computed
        if counts[1] and self._stages > 1:  # some of them may lie in the halo
            counts[1] = np.count_nonzero(not_finite(self.own_values(self._out)))
        self._latest = 0 if order.s == self.stages - 1 else order.s + 1
        return counts

    def own_values(self, array: Array | None = None) -> Array:
        """Those of the part without its halo, shape (own nodes,); array: (nodes,)."""
        inner = self.part.planes.own
        array = self.values() if array is None else array
        return array[inner.start * self._layer : inner.stop * self._layer]

    def largest(self) -> float:
        return float(self.own_values().max())

    def on_one_side(self, limit: str) -> bool:
        return on_one_side(self.own_values(), limit)

    def not_finite(self) -> int:
        first = first_not_finite(self.own_values(self._out))
        return self.part.planes.own_nodes.start * self._layer + first

    def edges(self, wanted: Sequence[int]) -> Edges:
        """Of these layers of the grid what has become of them here since the last exchange."""
        part, array = self.part, self.arrays[self._latest]
        inner, reach = part.own_layers, part.of.reach
        near = range(max(inner.start - reach, 0), min(inner.stop + reach, len(part.layers)))
        asked = set(wanted)
        mine = [j for j in near if int(part.layers[j]) in asked]
        flags = np.array([self._rows[:, part.units(j)] for j in mine])
        sent = [j for j in mine if j in inner and self._rows[-1, part.units(j)].any()]
        values = [array[self._nodes(j)] for j in sent]
        named = part.layers.tolist()
        return Edges([named[j] for j in mine], flags, [named[j] for j in sent], values)

    def take(self, received: Sequence[Edges]) -> None:
        """What other parts, or this one at the other end, have handed over."""
        array, inner = self.arrays[self._latest], self.part.own_layers
        halo = {k: [j for j in at if j not in inner] for k, at in self._of.items()}
        if self.stages == 1:  # where nothing was handed over, the last two steps are equal
            for j in (j for at in halo.values() for j in at):
                array[self._nodes(j)] = self.arrays[1][self._nodes(j)]
        for edges in received:
            for k, flags in zip(edges.marked, edges.flags, strict=True):
                for j in self._of[k]:
                    self._rows[:, self.part.units(int(j))] |= flags
            for k, values in zip(edges.changed, edges.values, strict=True):
                for j in halo[k]:
                    array[self._nodes(int(j))] = values

    def _nodes(self, layer: int) -> slice:
        starts = self.part.starts
        return slice(int(starts[layer]) * self._layer, int(starts[layer + 1]) * self._layer)
