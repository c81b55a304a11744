"""A grid of which one half is computed, since the other is its image in a reflection."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Flags = npt.NDArray[np.uint8]
Places = npt.NDArray[np.int64]
Chosen = npt.NDArray[np.bool_]


class Fold:
    """The grid folded along `axis`, the first that is reflected.

    places: for every axis, at which place of it the reflected node is, shape (nodes of the axis,);
    here they are rows of one array, shape (axes, nodes of the longest), since a sweep takes one
    address. There are as many units in a row of the grid, and in a stretch of its last axis, as
    `cut` says (`layout`). needed: places along `axis` that are not computed, but that the computed
    ones reach, shape (needed,); rest: all that are not computed, shape (rest,). Units are those at
    a place of the axes before, where all is alike: computed has the shape (units,), near (near,) as
    each of the images.
    """

    def __init__(
        self, places: Sequence[Places], kinds: Sequence[str], cut: Sequence[int], ghosts: int
    ) -> None:
        self.axis = first_reflected(places)
        self.places = np.zeros((len(places), max(map(len, places))), dtype=np.int64)
        for row, p in zip(self.places, places, strict=True):
            row[: len(p)] = p
        around = kinds[self.axis] == "periodic"
        mine, reached = halves(places[self.axis], ghosts, around)
        self.needed = np.flatnonzero(reached & ~mine)
        self.rest = np.flatnonzero(~mine)
        shape = [len(p) for p in places]
        many, groups, stretches, longest = cut
        of_units = [*shape[:-2], groups, stretches]
        sizes = [1] * len(shape[:-2]) + [many, longest]
        reflected = [*places[:-2], places[-2] if len(shape) > 1 else np.zeros(1, int), places[-1]]
        along = self.axis + len(of_units) - len(shape)
        of_units, sizes, reflected = of_units[along:], sizes[along:], reflected[along:]
        size, count = sizes[0], of_units[0]

        def units(chosen: Chosen) -> Chosen:
            """Those with a node at one of the chosen places of the folded axis."""
            any_of = [chosen[k * size : (k + 1) * size].any() for k in range(count)]
            return np.broadcast_to(np.reshape(any_of, [-1, *[1] * (len(of_units) - 1)]), of_units)

        self.computed = units(mine).ravel().astype(np.uint8)
        near = np.nonzero(units(_within(~mine, ghosts, around) & mine))
        self.near = np.ravel_multi_index(near, of_units)
        others = [near[0][:, np.newaxis]] + [
            _images(places, size, count)[k]
            for k, places, size, count in zip(
                near[1:], reflected[1:], sizes[1:], of_units[1:], strict=True
            )
        ]
        self.images = [
            np.ravel_multi_index([o[:, c] for o, c in zip(others, columns, strict=True)], of_units)
            for columns in itertools.product(*(range(o.shape[1]) for o in others))
        ]

    def narrow(self, active: Flags) -> None:
        """Of the units to be computed, shape (units,), those of this half; at some places of the
        axes before it.

        What changes near the fold changes its image beyond it, which reaches the images, on this
        side, of the units that it reaches itself.
        """
        active = active.reshape(-1, len(self.computed))
        active &= self.computed
        near = active[:, self.near]
        for image in self.images:
            near |= active[:, image]
        active[:, self.near] = near


def first_reflected(places: Sequence[Places]) -> int:
    """The first axis of which a node is reflected onto another place."""
    return next(i for i, p in enumerate(places) if (p != np.arange(len(p))).any())


def halves(places: Places, ghosts: int, around: bool) -> tuple[Chosen, Chosen]:
    """Of the places along a folded axis those that are computed, and all that these read.

    places: those that its nodes are reflected to. All three have the shape (nodes of the axis,).
    """
    mine = np.arange(len(places)) <= places
    return mine, _within(mine, ghosts, around)


def _within(chosen: Chosen, reach: int, around: bool) -> Chosen:
    """The places that are within reach of a chosen one."""
    places = np.zeros_like(chosen)
    for k in range(-reach, reach + 1):
        shifted = np.roll(chosen, k)
        if not around:
            shifted[slice(0, k) if k >= 0 else slice(k, None)] = False
        places |= shifted
    return places


def _images(places: Places, size: int, count: int) -> Places:
    """For every one of `count` runs of `size` places, the runs that its reflection lies in.

    Shape (count, most of them); those that have fewer name one of them again.
    """
    rows = [np.unique(places[k * size : (k + 1) * size] // size) for k in range(count)]
    most = max(map(len, rows))
    return np.array([np.resize(row, most) for row in rows])
