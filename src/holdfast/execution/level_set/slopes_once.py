"""The nodes on either side of a run, for a scheme that has one slope of every interval.

All arrays have one dimension; n is the number of axes:

    values                  (size,)             nodes of the grid, the last axis is the fastest
    own                     (2 * n * PITCH,)    two rows of nodes for each axis
    places                  (SLOPES + 4 * n,)   addresses; from SLOPES on two for each axis
    kept, strides, within   (n,)                not read: no slopes are kept
    falls                   (4 * n,)            as `stencils.py` says
"""

# ruff: noqa: F403, F405
# mypy: ignore-errors

from __future__ import annotations

from holdfast.execution.level_set.stencils import *


def begin_slopes(kept: Wholes, strides: Wholes, within: Wholes, n: int, plain: int):
    """No slopes are kept."""


def remember_slopes(
    kept: Wholes, own: Values, i: int, n: int, unit: int, several: int, here: int,
    stride: int, count: int, plain: int,
):  # fmt: skip
    """No slopes are kept."""


def slopes_across(
    scheme: int, values: Values, size: int, here: int, i: int, n: int, outer: int,
    place: int, tall: int, wide: int, stride: int, nodes: int, kind: int,
    ghosts: int, unit: int, several: int, count: int, kept: Wholes, own: Values,
    places: Wholes, plain: int, falls: Floats,
):  # fmt: skip
    """Where the nodes are on either side along an axis that is not the last."""
    if outer:
        tall, wide = 1, count
    for side in range(2):
        there = place + 2 * side - 1
        if tall == 1:
            there = place_of(there, nodes, kind)
        first = here + (there - place) * stride
        if there >= 0 and there + tall <= nodes and first + count + VECTOR <= size:
            places[SLOPES + 2 * i + side] = address(values, first)
            continue
        to = (2 * i + side) * PITCH
        for k in range(tall):
            fetch(
                values, here, place, there + k, nodes, stride, kind, wide, own, to + k * wide,
                falls[i:], n,
            )  # fmt: skip
        places[SLOPES + 2 * i + side] = address(own, to)


def slopes_along_rows(
    scheme: int, values: Values, size: int, here: int, begin: int, tall: int,
    wide: int, nodes: int, kind: int, ghosts: int, count: int, i: int, n: int,
    own: Values, places: Wholes, plain: int, falls: Floats,
):  # fmt: skip
    """The same along the last axis."""
    for side in range(2):
        there = begin - 1 if side == 0 else begin + wide
        inside = 0 <= there < nodes
        first = here + 2 * side - 1
        if inside and first + count + VECTOR <= size:
            places[SLOPES + 2 * i + side] = address(values, first)
            continue
        to = (2 * i + side) * PITCH
        low, high = max(first, 0), min(first + count, size)
        copy(values, low, high - low, own, to + low - first)
        if not inside:
            end = 0 if side == 0 else wide - 1
            for k in range(tall):
                row = here - begin + k * nodes
                own[to + k * wide + end] = value_at(
                    values, row, 0, there, nodes, 1, kind, falls[i:], n
                )
        places[SLOPES + 2 * i + side] = address(own, to)
