"""Random nodes of a grid that satisfy a condition, found in little memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Indices = npt.NDArray[np.intp]


class Places:
    """Nodes that satisfy a condition, counted slab by slab along the first axis.

    A list of all of them would take more memory than the value itself. holds(k): the condition at
    all nodes of the k-th slab.
    """

    def __init__(self, holds: Callable[[int], Any], shape: Sequence[int]) -> None:
        self._holds, self._shape = holds, tuple(shape)
        counts = [np.count_nonzero(holds(k)) for k in range(self._shape[0])]
        self._ends = np.cumsum(counts)

    def __len__(self) -> int:
        return int(self._ends[-1])

    def at(self, ranks: Indices) -> tuple[Indices, ...]:
        """The nodes of these ranks, as an index for every axis."""
        outer = np.searchsorted(self._ends, ranks, side="right")
        inner = np.empty(len(ranks), dtype=np.intp)
        for k in np.unique(outer):
            here = outer == k
            begins = self._ends[k - 1] if k else 0
            inner[here] = np.flatnonzero(self._holds(int(k)))[ranks[here] - begins]
        return (outer, *np.unravel_index(inner, self._shape[1:])) if self._shape[1:] else (outer,)
