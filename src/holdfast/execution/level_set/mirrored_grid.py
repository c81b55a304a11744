"""Half of a grid that tells the other half: which units are computed, and what is copied."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Flags = npt.NDArray[np.uint8]
Places = npt.NDArray[np.int64]


class Fold:
    """The grid folded along `axis`, the first that is reflected.

    places: for every axis, at which place of it the reflected node is. There are as many units in
    a row of the grid, and in a stretch of its last axis, as `cut` says (`sweep.layout`).
    needed: places along `axis` that are not computed, but that the computed ones reach; rest: all
    that are not computed.
    """

    def __init__(
        self, places: Sequence[Places], kinds: Sequence[str], cut: Sequence[int], ghosts: int
    ) -> None:
        self.axis = next(i for i, p in enumerate(places) if (p != np.arange(len(p))).any())
        self.places = np.zeros((len(places), max(map(len, places))), dtype=np.int64)
        for row, p in zip(self.places, places, strict=True):
            row[: len(p)] = p
        own = places[self.axis]
        mine = np.arange(len(own)) <= own
        around = kinds[self.axis] == "periodic"
        self.needed = np.flatnonzero(_within(mine, ghosts, around) & ~mine)
        self.rest = np.flatnonzero(~mine)
        shape = [len(p) for p in places]
        many, groups, stretches, longest = cut
        of_units = [*shape[:-2], groups, stretches]
        sizes = [1] * len(shape[:-2]) + [many, longest]
        reflected = [*places[:-2], places[-2] if len(shape) > 1 else np.zeros(1, int), places[-1]]
        along = self.axis + len(of_units) - len(shape)
        size, count = sizes[along], of_units[along]

        def units(chosen: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
            """Those with a node at one of the chosen places of the folded axis."""
            any_of = [chosen[k * size : (k + 1) * size].any() for k in range(count)]
            row = np.reshape(any_of, [-1 if i == along else 1 for i in range(len(of_units))])
            return np.broadcast_to(row, of_units)

        self.computed = units(mine).ravel().astype(np.uint8)
        near = np.nonzero(units(_within(~mine, ghosts, around) & mine))
        self.near = np.ravel_multi_index(near, of_units)
        others = [
            k[:, np.newaxis] if i == along else _images(places, size, count)[k]
            for i, (k, places, size, count) in enumerate(
                zip(near, reflected, sizes, of_units, strict=True)
            )
        ]
        self.images = [
            np.ravel_multi_index([o[:, c] for o, c in zip(others, columns, strict=True)], of_units)
            for columns in itertools.product(*(range(o.shape[1]) for o in others))
        ]

    def narrow(self, active: Flags) -> None:
        """Of the units to be computed those of this half.

        What changes near the fold changes its image beyond it, which reaches the images, on this
        side, of the units that it reaches itself.
        """
        active &= self.computed
        found = active[self.near]
        for image in self.images:
            found |= active[image]
        active[self.near] = found


def _within(chosen: npt.NDArray[np.bool_], reach: int, around: bool) -> npt.NDArray[np.bool_]:
    """The places that are within reach of a chosen one."""
    found = np.zeros_like(chosen)
    for k in range(-reach, reach + 1):
        shifted = np.roll(chosen, k)
        if not around:
            shifted[slice(0, k) if k >= 0 else slice(k, None)] = False
        found |= shifted
    return found


def _images(places: Places, size: int, count: int) -> Places:
    """For every one of `count` runs of `size` places, the runs that its reflection lies in.

    Shape (count, most of them); those that have fewer name one of them again.
    """
    rows = [np.unique(places[k * size : (k + 1) * size] // size) for k in range(count)]
    most = max(map(len, rows))
    return np.array([np.resize(row, most) for row in rows])
