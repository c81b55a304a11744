"""Values between the nodes of a grid, linear along every axis, in any dimension.

These are scalar functions (`codegen/scalar_reader.py`): the closed loop, exported laws and
Python run the same text. A grid has `axes` axes: its lowest nodes, its steps, its shape, and
whether an axis is periodic. All arrays have one dimension:

    values                                  (nodes,)           the last axis is the fastest
    q, place, low, steps, shape, periodic   (axes,)            in the units of the axes
    points                                  (number * axes,)   one point after the other
    out                                     (results,)         a value, slopes, or nodes, by point
    room                                    (3 * axes,)        shares between nodes; two places
    whole                                   (2 * axes,)        the nodes below, and those above

A corner of a cell is a number of `axes` bits: bit i says whether it is above along axis i.
"""

from __future__ import annotations

import math

from holdfast.execution.arrays import Floats, Table, Wholes

ON_GRID = 1e-9  # cells by which a place may be beyond the last node
OFF_GRID = 1e-6  # cells from which on a place is reported to be outside the grid


def numbers_of_places(axes: int) -> tuple[int, int]:
    """The numbers of `room` and of `whole` that the functions need."""
    return 3 * axes, 2 * axes


def between_nodes(
    q: Floats, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes, axes: int,
    room: Floats, whole: Wholes,
) -> bool:  # fmt: skip
    """The nodes below and above q along every axis, and how far q is between; False outside."""
    near, far = whole, whole[axes:]
    for i in range(axes):
        x = (q[i] - low[i]) / steps[i]
        if not math.isfinite(x):
            return False
        last = shape[i] - 1
        if periodic[i]:
            if not 0.0 <= x < shape[i]:
                x -= shape[i] * math.floor(x / shape[i])
        elif not -ON_GRID <= x <= last + ON_GRID:
            return False
        else:
            last -= 1
        k = min(max(int(x), 0), last)
        near[i] = k
        far[i] = k + 1
        if k + 1 == shape[i]:
            far[i] = 0
        room[i] = x - k
    return True


def interpolate(
    values: Table, q: Floats, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes,
    axes: int, room: Floats, whole: Wholes,
) -> float:  # fmt: skip
    """The multilinear interpolant at q; NaN outside the grid."""
    near, far = whole, whole[axes:]
    if not between_nodes(q, low, steps, shape, periodic, axes, room, whole):
        return math.nan
    total = 0.0
    for corner in range(1 << axes):
        at, weight = 0, 1.0
        for i in range(axes):
            if (corner >> i) & 1:
                at = at * shape[i] + far[i]
                weight *= room[i]
            else:
                at = at * shape[i] + near[i]
                weight *= 1.0 - room[i]
        if weight != 0.0:
            total += weight * values[at]
    return total


def slopes(
    values: Table, q: Floats, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes,
    axes: int, out: Floats, room: Floats, whole: Wholes,
) -> None:  # fmt: skip
    """The interpolated central differences at q; one-sided at the ends of the grid."""
    place = room[axes:]
    for i in range(axes):
        place[i] = q[i]
    for i in range(axes):
        above, below = q[i] + steps[i], q[i] - steps[i]
        if not periodic[i]:
            above = min(above, low[i] + steps[i] * (shape[i] - 1))
            below = max(below, low[i])
        place[i] = above
        upper = interpolate(values, place, low, steps, shape, periodic, axes, room, whole)
        place[i] = below
        lower = interpolate(values, place, low, steps, shape, periodic, axes, room, whole)
        out[i] = (upper - lower) / (above - below)
        place[i] = q[i]


def beyond_grid(
    place: Floats, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes, axes: int,
    first: int,
) -> bool:  # fmt: skip
    """Whether a point is outside the grid, or NaN, along an axis from `first` on."""
    for i in range(first, axes):
        x = (place[i] - low[i]) / steps[i]
        if not math.isfinite(x):
            return True
        if not periodic[i] and not -OFF_GRID <= x <= shape[i] - 1 + OFF_GRID:
            return True
    return False


def look_up(
    values: Table, place: Floats, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes,
    axes: int, sloped: int, out: Floats, room: Floats, whole: Wholes,
) -> None:  # fmt: skip
    """Fill `out` with the value at a point, or at the nearest point of the grid; where `sloped`,
    then with its slopes."""
    at = room[2 * axes :]
    for i in range(axes):
        at[i] = place[i]
        if not periodic[i]:
            at[i] = min(max(at[i], low[i]), low[i] + steps[i] * (shape[i] - 1))
    out[0] = interpolate(values, at, low, steps, shape, periodic, axes, room, whole)
    if sloped != 0:
        slopes(values, at, low, steps, shape, periodic, axes, out[1:], room, whole)


def interpolate_many(
    number: int, values: Table, points: Floats, low: Floats, steps: Floats, shape: Wholes,
    periodic: Wholes, axes: int, out: Floats, room: Floats, whole: Wholes,
) -> None:  # fmt: skip
    """`interpolate` at many points."""
    for k in range(number):
        out[k] = interpolate(
            values, points[k * axes :], low, steps, shape, periodic, axes, room, whole
        )


def slopes_many(
    number: int, values: Table, points: Floats, low: Floats, steps: Floats, shape: Wholes,
    periodic: Wholes, axes: int, out: Floats, room: Floats, whole: Wholes,
) -> None:  # fmt: skip
    """`slopes` at many points."""
    for k in range(number):
        slopes(
            values, points[k * axes :], low, steps, shape, periodic, axes, out[k * axes :], room,
            whole,
        )  # fmt: skip


def corners(
    q: Floats, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes, axes: int,
    out: Wholes, room: Floats, whole: Wholes,
) -> None:  # fmt: skip
    """The nodes that `interpolate` may read at q, in the order of a table; -1 outside the grid."""
    near, far = whole, whole[axes:]
    inside = between_nodes(q, low, steps, shape, periodic, axes, room, whole)
    for corner in range(1 << axes):
        at = -1
        if inside:
            at = 0
            for i in range(axes):
                k = near[i]
                if (corner >> i) & 1:
                    k = far[i]
                at = at * shape[i] + k
        out[corner] = at


def corners_many(
    number: int, points: Floats, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes,
    axes: int, sloped: int, out: Wholes, room: Floats, whole: Wholes,
) -> None:  # fmt: skip
    """`corners` at many points; where `sloped`, then also those that `slopes` reads there."""
    count = 1 << axes
    at, place = 0, room[axes:]
    for j in range(number):
        q = points[j * axes :]
        corners(q, low, steps, shape, periodic, axes, out[at:], room, whole)
        at += count
        if sloped != 0:
            for i in range(axes):
                place[i] = q[i]
            for i in range(axes):
                above, below = q[i] + steps[i], q[i] - steps[i]
                if not periodic[i]:
                    above = min(above, low[i] + steps[i] * (shape[i] - 1))
                    below = max(below, low[i])
                place[i] = above
                corners(place, low, steps, shape, periodic, axes, out[at:], room, whole)
                at += count
                place[i] = below
                corners(place, low, steps, shape, periodic, axes, out[at:], room, whole)
                at += count
                place[i] = q[i]
