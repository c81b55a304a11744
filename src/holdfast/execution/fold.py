"""Half of a grid that tells the other half: which units are computed, and what is copied."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Flags = npt.NDArray[np.uint8]


class Fold:
    """The grid folded along `axis`, the first that is reflected.

    places: for every axis, at which place of it the reflected node is. There are as many units in
    a row of the grid, and in a stretch of its last axis, as `cut` says (`sweep.layout`).
    """

    def __init__(
        self,
        places: Sequence[npt.NDArray[np.int64]],
        kinds: Sequence[str],
        cut: Sequence[int],
        ghosts: int,
    ) -> None:
        moved = [i for i, p in enumerate(places) if (p != np.arange(len(p))).any()]
        self.axis = moved[0]
        self.places = np.zeros((len(places), max(map(len, places))), dtype=np.int64)
        for row, p in zip(self.places, places, strict=True):
            row[: len(p)] = p
        own = places[self.axis]
        self.mine = (np.arange(len(own)) <= own).astype(np.uint8)
        near = np.zeros_like(self.mine)  # what is computed and reaches into what is not
        for k in range(-ghosts, ghosts + 1):
            beyond = np.roll(self.mine == 0, k)
            if kinds[self.axis] != "periodic":
                beyond[slice(0, k) if k >= 0 else slice(k, None)] = False
            near |= beyond & self.mine
        shape = [len(p) for p in places]
        self.computed = self._units(self.mine, shape, cut)
        self.always = self._units(near, shape, cut)

    def _units(self, chosen: Flags, shape: Sequence[int], cut: Sequence[int]) -> Flags:
        """The units with a node at one of the chosen places of the folded axis."""
        many, groups, stretches, longest = cut
        of_units = [*shape[:-2], groups, stretches]
        last = len(shape) - 1
        size, count = 1, shape[self.axis]
        if self.axis >= last - 1:
            size, count = (longest, stretches) if self.axis == last else (many, groups)
        any_of = [chosen[k * size : (k + 1) * size].any() for k in range(count)]
        along = len(of_units) - 1 - last + self.axis
        row = np.array(any_of, dtype=np.uint8).reshape(
            [-1 if i == along else 1 for i in range(len(of_units))]
        )
        return np.broadcast_to(row, of_units).ravel()

    def narrow(self, active: Flags) -> None:
        """Of the units to be computed, those of this half; always those at the fold."""
        active &= self.computed
        active |= self.always
