"""The limits of a plot of paths, which a few far ones do not stretch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.execution.arrays import Array

FAR = 4.0
"""A path that goes this many times as far as half of them is cut at the frame."""

PAD = 0.06

LONGEST, FLAT = 8.0, 1e-12
"""A frame longer than so many widths has a scale for each axis; its width is at least a part of its
length."""


@dataclass(frozen=True)
class Frame:
    """Limits of both axes. equal: they have one scale. beyond: how many paths leave them."""

    x: tuple[float, float]
    y: tuple[float, float]
    equal: bool
    beyond: int

    @property
    def size(self) -> tuple[float, float]:
        """Width and height."""
        return self.x[1] - self.x[0], self.y[1] - self.y[0]

    def scaled(self, points: Array) -> Array:
        """Points in parts of the size of the plot."""
        size: Array = points / (max(self.size) if self.equal else self.size)
        return size


def frame_of(paths: Array, fixed: Array | None = None, *, equal: bool = True) -> Frame:
    """The frame of paths, shape (runs, times, 2), NaN where a run has ended.

    It has every start and the `fixed` points, shape (n, 2), and the paths that go at most `FAR`
    times as far from the middle of the starts as half of them do. equal: both axes have one unit,
    and one scale unless that would leave a line.
    """
    finite: Any = np.isfinite(paths).all(axis=2)
    starts = paths[:, 0][finite[:, 0]]
    away = np.abs(np.where(finite[..., None], paths - np.median(starts, axis=0), 0.0))
    far = np.hypot(away[..., 0], away[..., 1])[..., None] if equal else away
    reach = far.max(axis=1)
    allowed = np.maximum(FAR * np.median(reach, axis=0), far[:, 0].max(axis=0))
    near = (reach <= allowed).all(axis=1)
    points = np.vstack([paths[near][finite[near]], starts, *([] if fixed is None else [fixed])])
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    if equal:
        size = np.maximum(size, FLAT * size.max())
    equal = equal and bool(size.max() <= LONGEST * size.min())
    middle, half = (low + high) / 2, size / 2 + PAD * (size.max() if equal else size)
    low, high = middle - half, middle + half
    outside = finite & ((paths < low) | (paths > high)).any(axis=2)
    x, y = zip(low.tolist(), high.tolist(), strict=True)
    return Frame(x, y, equal, int(outside.any(axis=1).sum()))
