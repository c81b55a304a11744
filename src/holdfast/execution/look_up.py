"""Values between the nodes of a grid, at many points."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.execution.arrays import AnyArray, Array
from holdfast.execution.interpolate import numbers_of_places
from holdfast.execution.scalar import called
from holdfast.execution.table_in_parts import TableInParts

Grid = tuple[AnyArray, ...]
"""The lowest nodes, the steps, the shape, and whether an axis is periodic."""


def values_at(values: AnyArray | TableInParts, points: Array, grid: Grid) -> Array:
    """The values at points (count, axes), linear along each axis; NaN outside the grid."""
    if isinstance(values, TableInParts):
        return values.values_at(points, grid)
    return _found("interpolate_many", values, points, grid, np.empty(len(points)))


def slopes_at(values: AnyArray | TableInParts, points: Array, grid: Grid) -> Array:
    """The central differences at points, interpolated, of shape (count, axes)."""
    if isinstance(values, TableInParts):
        return values.slopes_at(points, grid)
    return _found("slopes_many", values, points, grid, np.empty(points.shape))


def _found(name: str, values: AnyArray, points: Array, grid: Grid, out: Array) -> Array:
    low, steps, shape, periodic = grid
    room, whole = numbers_of_places(len(shape))
    whole_numbers = (np.ascontiguousarray(a, dtype=np.int64) for a in (shape, periodic))
    given: tuple[Any, ...] = (len(points), values, points, low, steps, *whole_numbers, len(shape))
    called("interpolate", name, *given, out, np.empty(room), np.empty(whole, dtype=np.int64))
    return out
