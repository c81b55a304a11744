"""What is done with the nodes of blocks of a grid: filled, looked at, and handed to a coarser grid.

A grid has every node of the coarser one, and one more between two of them. `of` has five numbers
for every axis: nodes, those of the coarser grid, those of a block (even), blocks, and 1 for an axis
that is periodic. Threads share the blocks of each function as those of a sweep (`sweep.py`). All
arrays have one dimension; n is the number of axes, and the last axis is the fastest:

    taken                   (slices,)       as `stencils.py` says
    slices                  (slices + 1,)   the blocks that they begin at, and the end
    of                      (5 * n,)        five numbers of every axis, one kind after the other
    blocks                  (chosen,)       their numbers, in the order of the grid of blocks
    chosen, found           (blocks,)       flags of all blocks
    values, before, now     (nodes,)        of the grid
    one, other, coarse      (coarser nodes,)
    targets                 (targets,)      addresses of values of the grid
    out                     (nodes,)        of `between` (count,), a part of a row
    begin, count, index     (n,)            of a block its first node and its nodes; a row's place
    shape                   (n,)
    own                     (3,)            of a thread: the place after its last, the end of its
                                            slice, and `tried` of `stencils.py`
    numbers                 (2,)            the side, and the least value that counts
    counts                  (3,)            of a thread; the last is its largest share
    room                    (8 * n + 3,)    own, begin, count and index; then `of` of a thin grid
    rows                    ((2^(n - 1) + 2) * (block + 2),)  a row for every corner, and one more
"""

# ruff: noqa: F403, F405
# mypy: ignore-errors

from __future__ import annotations

from holdfast.execution.level_set.stencils import *

CROSSED = 1  # where the sign changes: in a block,
CROSSED_LOW = 2  # near its beginning along the last axis,
CROSSED_HIGH = 4  # near its end


def following(taken: Wholes, slices: Wholes, slice_count: int, thread: int, own: Wholes) -> int:
    """The next place of a thread's own slice, or of the next slice that no thread has; then -1.

    own: 0 to begin with.
    """
    if own[0] >= own[1]:
        slice_ = next_slice(taken, slice_count, thread, own[2:])
        if slice_ < 0:
            return -1
        own[0], own[1] = slices[slice_], slices[slice_ + 1]
    own[0] = own[0] + 1
    return own[0] - 1


def find_block(block: int, of: Wholes, n: int, begin: Wholes, count: Wholes):
    """The first node of a block along every axis, and how many nodes it has."""
    left = block
    for i in range(n - 1, -1, -1):
        begin[i] = left % of[3 * n + i] * of[2 * n + i]
        left = left // of[3 * n + i]
        count[i] = min(of[2 * n + i], of[i] - begin[i])


def on_coarser(begin: Wholes, count: Wholes, n: int):
    """The same of its nodes that the coarser grid has, on that grid."""
    for i in range(n):
        begin[i] = begin[i] // 2
        count[i] = (count[i] + 1) // 2


def rows_of_block(count: Wholes, n: int) -> int:
    """How many rows of the last axis a block has."""
    rows = 1
    for i in range(n - 1):
        rows *= count[i]
    return rows


def find_row(row: int, begin: Wholes, count: Wholes, n: int, index: Wholes):
    """The place of a row of a block along every axis but the last."""
    left = row
    for i in range(n - 2, -1, -1):
        index[i] = begin[i] + left % count[i]
        left = left // count[i]


def within(place: int, nodes: int, periodic: int) -> int:
    """The node at a place that may be one beyond the last."""
    if place < nodes:
        return place
    return 0 if periodic else nodes - 1


def node(index: Wholes, shape: Wholes, n: int) -> int:
    """The first node of a row."""
    at = 0
    for i in range(n - 1):
        at = at * shape[i] + index[i]
    return at * shape[n - 1]


def between(
    one: Values, other: Values, of: Wholes, n: int, index: Wholes, first: int, count: int,
    pitch: int, rows: Values, out: Values,
):  # fmt: skip
    """A part of a row from the lesser of two values on the coarser grid, linear along each axis."""
    last, corners, shape = n - 1, 1, of[n:]
    wide = (count + 1) // 2 + 1
    for i in range(last):
        if index[i] % 2 == 1:
            corners *= 2
    for c in range(corners):
        at, left = 0, c
        for i in range(last):
            place = index[i] // 2
            if index[i] % 2 == 1:
                place = within(place + left % 2, shape[i], of[4 * n + i])
                left = left // 2
            at = at * shape[i] + place
        at = at * shape[last]
        for j in range(wide):
            k = at + within(first // 2 + j, shape[last], of[4 * n + last])
            rows[c * pitch + j] = min(one[k], other[k])
    while corners > 1:
        corners = corners // 2
        for c in range(corners):
            for j in range(wide):
                a, b = rows[2 * c * pitch + j], rows[(2 * c + 1) * pitch + j]
                rows[c * pitch + j] = 0.5 * (a + b)
    for j in range((count + 1) // 2):
        out[2 * j] = rows[j]
    for j in range(count // 2):
        out[2 * j + 1] = 0.5 * (rows[j] + rows[j + 1])


def fill(
    taken: Wholes, slices: Wholes, slice_count: int, thread: int, counts: Floats, room: Wholes,
    rows: Values, blocks: Wholes, of: Wholes, n: int, one: Values, other: Values, targets: Wholes,
    target_count: int, upper: int, lower: int,
):  # fmt: skip
    """Blocks of grids from the lesser of two values on the coarser grid, within bounds.

    targets: addresses of the values. upper, lower: addresses of the bounds, or 0.
    """
    own, begin, count, index = room, room[3:], room[3 + n :], room[3 + 2 * n :]
    last = n - 1
    pitch = of[2 * n + last] // 2 + 1
    row = rows[(1 << last) * pitch :]
    while True:
        k = following(taken, slices, slice_count, thread, own)
        if k < 0:
            break
        find_block(blocks[k], of, n, begin, count)
        rows_here, nodes = rows_of_block(count, n), count[last]
        for r in range(rows_here):
            find_row(r, begin, count, n, index)
            between(one, other, of, n, index, begin[last], nodes, pitch, rows, row)
            at = node(index, of, n) + begin[last]
            if lower != 0:
                low = values_at(lower)
                for j in range(nodes):
                    row[j] = max(row[j], low[at + j])
            if upper != 0:
                high = values_at(upper)
                for j in range(nodes):
                    row[j] = min(row[j], high[at + j])
            for t in range(target_count):
                out = values_at(targets[t])
                for j in range(nodes):
                    out[at + j] = row[j]


def crossed(
    values: Values, of: Wholes, n: int, begin: Wholes, count: Wholes, reach: int, index: Wholes,
) -> int:  # fmt: skip
    """Where the sign changes from one node of a block, or just beyond it, to another."""
    last, rows = n - 1, 1
    some, every = 0, CROSSED | CROSSED_LOW | CROSSED_HIGH
    for i in range(last):
        rows *= count[i] + 1
    for r in range(rows):
        left = r
        for i in range(last - 1, -1, -1):
            index[i] = within(begin[i] + left % (count[i] + 1), of[i], of[4 * n + i])
            left = left // (count[i] + 1)
        at = node(index, of, n)
        for j in range(count[last] + 1):
            where = CROSSED
            if j <= reach:
                where = where | CROSSED_LOW
            if j >= count[last] - reach:
                where = where | CROSSED_HIGH
            if values[at + within(begin[last] + j, of[last], of[4 * n + last])] > 0.0:
                some = some | where
            else:
                every = every & (7 - where)
        if some & (7 - every) == 7:
            break
    return some & (7 - every)


def look_over(
    taken: Wholes, slices: Wholes, slice_count: int, thread: int, counts: Floats, room: Wholes,
    rows: Values, of: Wholes, n: int, chosen: Flags, values: Values, coarse: Values, reach: int,
    found: Flags,
):  # fmt: skip
    """Where the sign changes in every block: on its grid in chosen ones, else on the coarser."""
    own, begin, count, index = room, room[3:], room[3 + n :], room[3 + 2 * n :]
    thin = room[3 + 3 * n :]
    for i in range(n):
        thin[i] = of[n + i]
        thin[4 * n + i] = of[4 * n + i]
    while True:
        block = following(taken, slices, slice_count, thread, own)
        if block < 0:
            break
        find_block(block, of, n, begin, count)
        if chosen[block] != 0:
            found[block] = crossed(values, of, n, begin, count, reach, index)
        else:
            on_coarser(begin, count, n)
            found[block] = crossed(coarse, thin, n, begin, count, reach, index) & CROSSED


def hand_down(
    taken: Wholes, slices: Wholes, slice_count: int, thread: int, counts: Floats, room: Wholes,
    rows: Values, blocks: Wholes, of: Wholes, n: int, values: Values, coarse: Values,
):  # fmt: skip
    """The values of blocks to the nodes of the coarser grid in them."""
    own, begin, count, index = room, room[3:], room[3 + n :], room[3 + 2 * n :]
    last, thin = n - 1, of[n:]
    while True:
        k = following(taken, slices, slice_count, thread, own)
        if k < 0:
            break
        find_block(blocks[k], of, n, begin, count)
        on_coarser(begin, count, n)
        rows_here = rows_of_block(count, n)
        for r in range(rows_here):
            find_row(r, begin, count, n, index)
            to = node(index, thin, n) + begin[last]
            for i in range(last):
                index[i] = 2 * index[i]
            at = node(index, of, n) + 2 * begin[last]
            for j in range(count[last]):
                coarse[to + j] = values[at + 2 * j]


def take_over(
    taken: Wholes, slices: Wholes, slice_count: int, thread: int, counts: Floats, room: Wholes,
    rows: Values, blocks: Wholes, of: Wholes, n: int, values: Values, out: Values,
):  # fmt: skip
    """The values of blocks to another array of the same grid."""
    own, begin, count, index = room, room[3:], room[3 + n :], room[3 + 2 * n :]
    last = n - 1
    while True:
        k = following(taken, slices, slice_count, thread, own)
        if k < 0:
            break
        find_block(blocks[k], of, n, begin, count)
        rows_here = rows_of_block(count, n)
        for r in range(rows_here):
            find_row(r, begin, count, n, index)
            at = node(index, of, n) + begin[last]
            for j in range(count[last]):
                out[at + j] = values[at + j]


def losses(
    taken: Wholes, slices: Wholes, slice_count: int, thread: int, counts: Floats, room: Wholes,
    rows: Values, of: Wholes, n: int, chosen: Flags, before: Values, now: Values, numbers: Floats,
):  # fmt: skip
    """The largest share of its value that a node of the coarser grid changed by, of those that are
    in no chosen block, on one side of zero.

    numbers: 1 or -1, the side; values nearer to zero count as so large.
    """
    side, nearest = numbers[0], numbers[1]
    own, begin, count, index = room, room[3:], room[3 + n :], room[3 + 2 * n :]
    last, thin = n - 1, of[n:]
    most = 0.0
    while True:
        block = following(taken, slices, slice_count, thread, own)
        if block < 0:
            break
        if chosen[block] == 0:
            find_block(block, of, n, begin, count)
            on_coarser(begin, count, n)
            rows_here = rows_of_block(count, n)
            for r in range(rows_here):
                find_row(r, begin, count, n, index)
                at = node(index, thin, n) + begin[last]
                for j in range(at, at + count[last]):
                    was = float(before[j])
                    if side * was > 0.0:
                        moved = abs(float(now[j]) - was)
                        most = max(most, moved / max(abs(was), nearest))
    counts[2] = most
