"""Values between the nodes of a grid, linear along every axis, in any dimension."""

from __future__ import annotations

# mypy: ignore-errors
# ruff: noqa: F405
from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on


@inlined
def interpolate(values, q, low, steps, shape, periodic):
    """The multilinear interpolant at q; NaN outside the grid."""
    n = len(shape)
    fractions = np.empty(n)
    near = np.empty(n, dtype=np.int64)
    far = np.empty(n, dtype=np.int64)
    for i in range(n):
        x = (q[i] - low[i]) / steps[i]
        if periodic[i]:
            x -= shape[i] * math.floor(x / shape[i])
        elif not -1e-9 <= x <= shape[i] - 1 + 1e-9:
            return math.nan
        k = min(max(int(math.floor(x)), 0), shape[i] - 1 if periodic[i] else shape[i] - 2)
        near[i] = k
        far[i] = (k + 1) % shape[i]
        fractions[i] = x - k
    total = 0.0
    for corner in range(1 << n):
        at, weight = 0, 1.0
        for i in range(n):
            if (corner >> i) & 1:
                at = at * shape[i] + far[i]
                weight *= fractions[i]
            else:
                at = at * shape[i] + near[i]
                weight *= 1.0 - fractions[i]
        if weight != 0.0:
            total += weight * values[at]
    return total


@inlined
def slopes(values, q, low, steps, shape, periodic, out):
    """The interpolated central differences at q; one-sided at the ends of the grid."""
    n = len(shape)
    place = np.empty(n)
    for i in range(n):
        place[i] = q[i]
    for i in range(n):
        above, below = q[i] + steps[i], q[i] - steps[i]
        if not periodic[i]:
            top = low[i] + steps[i] * (shape[i] - 1)
            above, below = min(above, top), max(below, low[i])
        place[i] = above
        upper = interpolate(values, place, low, steps, shape, periodic)
        place[i] = below
        lower = interpolate(values, place, low, steps, shape, periodic)
        out[i] = (upper - lower) / (above - below)
        place[i] = q[i]


@compiled
def interpolate_many(values, points, low, steps, shape, periodic, out):
    for k in range(points.shape[0]):
        out[k] = interpolate(values, points[k], low, steps, shape, periodic)


@compiled
def slopes_many(values, points, low, steps, shape, periodic, out):
    for k in range(points.shape[0]):
        slopes(values, points[k], low, steps, shape, periodic, out[k])


@inlined
def beyond_grid(table, place, first):
    """Whether a point is outside the grid, or NaN, along an axis from `first` on.

    The tolerance for rounding at the ends is a millionth of a cell.
    """
    _, low, steps, shape, periodic = table
    outside = False
    for i in range(first, len(shape)):
        x = (place[i] - low[i]) / steps[i]
        if periodic[i]:
            outside = outside or not math.isfinite(x)
        else:
            outside = outside or not -1e-6 <= x <= shape[i] - 1 + 1e-6
    return outside


@inlined
def look_up(table, place, out):
    """Fill `out` with the value and its slopes at a point, or at the nearest point of the grid."""
    values, low, steps, shape, periodic = table
    n = len(shape)
    at = np.empty(n)
    for i in range(n):
        at[i] = place[i]
        if not periodic[i]:
            at[i] = min(max(at[i], low[i]), low[i] + steps[i] * (shape[i] - 1))
    out[0] = interpolate(values, at, low, steps, shape, periodic)
    slopes(values, at, low, steps, shape, periodic, out[1:])
