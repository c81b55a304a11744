"""The share of a grid's cells in which a value between the nodes is positive."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from holdfast.execution.arrays import AnyArray as Array

TOGETHER = 1_000_000
"""The most nodes of a block evaluated at once, unless two axes alone have more."""


def share_inside(values: Array, periodic: Sequence[bool]) -> float:
    """The mean over all cells of the share of a cell in which the value is positive.

    A cell whose corners are all positive counts 1, one that has no positive corner 0. For the
    others let m be the mean of the corners and d_i the mean difference along axis i: the share is

        1/2 + m / sum_i |d_i|   within [0, 1]

    which is exact for a boundary normal to an axis, and correct on average over many cells for any
    other plane.
    """
    outer = 0  # axes traversed cell by cell
    while outer < values.ndim - 1 and math.prod(values.shape[outer:]) * 2**outer > TOGETHER:
        outer += 1
    cells = [n if around else n - 1 for n, around in zip(values.shape, periodic, strict=True)]
    inside = 0.0
    for place in itertools.product(*(range(c) for c in cells[:outer])):
        block = values
        for axis, k in enumerate(place):
            if k + 1 < values.shape[axis]:  # a view: the block may be large
                block = block[(slice(None),) * axis + (slice(k, k + 2),)]
            else:
                block = block.take([k, 0], axis=axis)
        for axis in range(outer, values.ndim):
            if periodic[axis]:
                block = np.concatenate([block, block.take([0], axis=axis)], axis=axis)
        inside += _shares(block)
    return inside / math.prod(cells)


def _shares(corners: Array) -> float:
    mean = corners.astype(np.float64)
    some = every = corners > 0
    slopes: list[Array] = []
    for axis in range(corners.ndim):
        above, below = (_part(mean, axis, k) for k in (1, 0))
        slopes = [0.5 * (_part(s, axis, 1) + _part(s, axis, 0)) for s in slopes]
        slopes.append(above - below)
        mean = 0.5 * (above + below)
        some = _part(some, axis, 1) | _part(some, axis, 0)
        every = _part(every, axis, 1) & _part(every, axis, 0)
    cut = some & ~every
    swing = sum((np.abs(s[cut]) for s in slopes), start=np.zeros(int(cut.sum())))
    level = np.divide(mean[cut], swing, out=np.zeros_like(swing), where=swing > 0)
    return float(every.sum() + np.clip(0.5 + level, 0.0, 1.0).sum())


def _part(values: Array, axis: int, first: int) -> Array:
    """The upper (1) or lower (0) ends of all intervals along an axis."""
    count = values.shape[axis] - 1
    return values[(slice(None),) * axis + (slice(first, first + count),)]
