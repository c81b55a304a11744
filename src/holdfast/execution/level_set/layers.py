"""A grid cut into parts along its first axis: their own layers of nodes, and those around them.

A layer is what is computed together along that axis: a plane of a grid of three or more states,
several rows of one of two. A part holds its own layers and the halo, the layers on either side that
a number of stages of a march reads; with more stages between two exchanges of halos there are
fewer messages, and the inner part of a halo is computed twice.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from holdfast.errors import SimulationError
from holdfast.execution.level_set.units import layout

Places = npt.NDArray[np.int64]


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

    @property
    def whole(self) -> bool:
        return self.last - self.first == self.of.count

    @cached_property
    def layers(self) -> Places:
        """Which layer of the grid every one of its layers is, those of the halo included."""
        return np.arange(self.first - self.before, self.last + self.after) % self.of.count

    @cached_property
    def starts(self) -> Places:
        """The first of its nodes along the axis in each of its layers, and the end."""
        left = np.minimum(self.of.thick, self.of.nodes - self.layers * self.of.thick)
        return np.concatenate([[0], np.cumsum(left)])

    @cached_property
    def nodes(self) -> Places:
        """Which place of the axis each of its nodes along it is at."""
        wide = np.diff(self.starts)
        return np.concatenate(
            [np.arange(w) + k * self.of.thick for k, w in zip(self.layers, wide, strict=True)]
        )

    @property
    def own(self) -> slice:
        """Its own nodes along the axis, among those that it holds."""
        last = self.before + self.last - self.first
        return slice(int(self.starts[self.before]), int(self.starts[last]))

    @property
    def ends(self) -> tuple[bool, bool]:
        """Whether it has the first plane of the grid, and whether it has the last."""
        return self.first == 0, self.last == self.of.count

    @property
    def own_layers(self) -> range:
        """The same for layers."""
        return range(self.before, self.before + self.last - self.first)

    @property
    def own_nodes(self) -> slice:
        """Its own nodes along the axis, among those of the grid."""
        first = self.first * self.of.thick
        return slice(first, min(self.last * self.of.thick, self.of.nodes))

    def wanted(self, others: Sequence[Part]) -> list[tuple[int, list[int]]]:
        """The parts that hand something over to this one, and of which layers of the grid."""
        halo, of = set(self.layers.tolist()), self.of
        found = []
        for k, other in enumerate(others):
            near = range(other.first - of.reach, other.last + of.reach)
            theirs = {j % of.count if of.around else j for j in near}
            if (other != self or of.around) and (both := sorted(halo & theirs)):
                found.append((k, both))
        return found

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
