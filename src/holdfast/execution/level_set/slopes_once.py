"""The nodes on either side of a run, for a scheme that has one slope of every interval."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.stencils import *  # noqa: F403

# -- joined from here on

BUFFERS = 2  # rows of nodes for each axis


@swept
def shared_slopes(values, shape, strides, units_of):
    """No slopes are kept."""
    return 0


@swept
def borrowed_slopes(shared):
    return shared


@swept
def held_slopes(shared):
    return shared


@swept
def remember_slopes(shared, i, place, nodes, unit, several, here, stride, count):
    return


@called
def slopes_across(
    scheme, values, here, i, outer, place, tall, wide, stride, nodes, kind, ghosts, unit, several,
    count, at, shared, room, places
):  # fmt: skip
    """Where the nodes are on either side along an axis that is not the last."""
    if outer:
        tall, wide = 1, count
    for side in range(2):
        there = place + 2 * side - 1
        if tall == 1:
            there = place_of(there, nodes, kind)
        first = here + (there - place) * stride
        if there >= 0 and there + tall <= nodes and first + count + VECTOR <= len(values):
            places[SLOPES + 2 * i + side] = address(values, first)
            continue
        to = (2 * i + side) * PITCH
        for k in range(tall):
            fetch(values, here, place, there + k, nodes, stride, kind, wide, room, to + k * wide)
        places[SLOPES + 2 * i + side] = address(room, to)


@called
def slopes_along_rows(
    scheme, values, here, begin, tall, wide, nodes, kind, ghosts, count, i, at, shared, room, places
):  # fmt: skip
    """The same along the last axis."""
    for side in range(2):
        shift = 2 * side - 1
        there = begin - 1 if side == 0 else begin + wide
        inside = 0 <= there < nodes
        first = here + shift
        if inside and first + count + VECTOR <= len(values):
            places[SLOPES + 2 * i + side] = address(values, first)
            continue
        to = (2 * i + side) * PITCH
        low, high = max(first, 0), min(first + count, len(values))
        copy(values, low, high - low, room, to + low - first)
        if not inside:
            for k in range(tall):
                row = here - begin + k * nodes
                end = k * wide + (0 if side == 0 else wide - 1)
                room[to + end] = ghost(values, row, there, nodes, kind)
        places[SLOPES + 2 * i + side] = address(room, to)
