"""Slopes by a scheme that has two of every interval between nodes, in cells.

A node takes the slope at the upper end of the interval below and that at the lower end of the
interval above. The slopes of an interval belong to the nodes on both sides of it: along an outer
axis those above a place are kept for the next place.

`at[k]` is the place of the node k - ghosts places along an axis from the first of a run: in the
value itself, or where it has to be continued beyond an end of the axis, in a copy.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.stencils import *  # noqa: F403

# -- joined from here on

ENDS = 2 * RUN + VECTOR  # slopes at the upper ends of intervals; those at the lower ends follow
MOST_GHOSTS = 3
BUFFERS = 0  # rows of nodes for each axis


@swept
def shared_slopes(values, shape, strides, units_of):
    """Room for nodes; for the slopes at both ends of intervals along each axis; for each outer axis
    for those of a place, with the units that they belong to, and where each axis has its own."""
    n = len(shape)
    ahead_at, units_at = np.zeros(n + 1, dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    for i in range(n):
        kept = 1 if i < n - 2 and strides[i] <= KEPT else 0
        ahead_at[i + 1] = ahead_at[i] + kept * strides[i]
        units_at[i + 1] = units_at[i] + kept * units_of[i]
    rows = np.zeros((2 * MOST_GHOSTS + 1) * RUN + 2 * VECTOR, dtype=values.dtype)
    ends = np.zeros(2 * ENDS * n, dtype=values.dtype)
    ahead = np.zeros(ahead_at[n] + VECTOR, dtype=values.dtype)
    return rows, ends, ahead, ahead_at, np.full(units_at[n], -1), units_at


@swept
def borrowed_slopes(shared):
    rows, ends, ahead, ahead_at, units, units_at = shared
    return (
        borrowed(rows), borrowed(ends), borrowed(ahead), borrowed(ahead_at), borrowed(units),
        borrowed(units_at),
    )  # fmt: skip


@swept
def held_slopes(shared):
    return len(shared)


@swept
def reach(at, first, place, tall, nodes, stride, count, kind, ghosts, end):
    """The places of the `count` nodes around `tall` places from `place` on, which is at `first`.

    False if they are not on the grid, or not in as many runs, or if whole registers of them would
    not stop before `end`: they are gathered then.
    """
    inside = place >= ghosts and place + tall + ghosts <= nodes
    if not inside and (kind == EXTRAPOLATED or tall > 1):
        return False
    furthest = 0
    for k in range(2 * ghosts + 1):
        there = place + k - ghosts
        run = first + ((there if inside else place_of(there, nodes, kind)) - place) * stride
        at[k] = run
        furthest = max(furthest, run)
    return furthest + count + VECTOR <= end


@called
def gather(values, first, place, tall, nodes, stride, wide, kind, ghosts, rows, at):
    """The `wide` nodes of each of `tall` places along an axis and those around, one after another.

    at[k]: where in `rows` the nodes k - ghosts places from those at `first` are.
    """
    for k in range(tall + 2 * ghosts):
        fetch(values, first, place, place + k - ghosts, nodes, stride, kind, wide, rows, k * wide)
    for k in range(2 * ghosts + 1):
        at[k] = k * wide


@called
def gather_along(values, first, start, nodes, wide, kind, ghosts, line):
    """line[j]: the nodes from `start` - ghosts on of a row of the last axis that is at `first`."""
    length = wide + 2 * ghosts
    low = min(max(0, ghosts - start), length)
    high = max(min(length, nodes - start + ghosts), low)
    copy(values, first + start - ghosts + low, high - low, line, low)
    for j in range(low):
        line[j] = ghost(values, first, start - ghosts + j, nodes, kind)
    for j in range(high, length):
        line[j] = ghost(values, first, start - ghosts + j, nodes, kind)


@swept
def call_scheme(scheme, source, at, k, ends, to, count):
    """Call the leaf of a scheme: its nodes are in `source` from at[k] on, its results in `ends`.

    A scheme that reads fewer nodes than others ignores the last.
    """
    call(
        scheme,
        (
            address(source, at[k]), address(source, at[k + 1]), address(source, at[k + 2]),
            address(source, at[k + 3]), address(source, at[k + 4]), address(source, at[k + 5]),
            address(ends, to), ENDS, count,
        ),
    )  # fmt: skip


@called
def slopes_across(
    scheme, values, here, i, outer, place, tall, wide, stride, nodes, kind, ghosts, unit, several,
    count, at, shared, room, places
):  # fmt: skip
    """Slopes below and above the nodes of a run along an axis that is not the last."""
    rows, ends, ahead, ahead_at, units, units_at = shared
    to, start = 2 * ENDS * i, 0
    places[SLOPES + 2 * i] = address(ends, to)
    if outer:
        tall, wide = 1, count
        if place > 0 and is_kept(units, units_at[i], units_at[i + 1], unit, several):
            start = 1
            places[SLOPES + 2 * i] = address(ahead, ahead_at[i] + here % stride)
    places[SLOPES + 2 * i + 1] = address(ends, to + ENDS + wide)
    source = values
    if not reach(at, here, place, tall, nodes, stride, count, kind, ghosts, len(values)):
        gather(values, here, place, tall, nodes, stride, wide, kind, ghosts, rows, at)
        source = rows
    if tall > 1:  # the slopes above a row are those below the next
        call_scheme(scheme, source, at, 0, ends, to, count + wide)
        return
    for k in range(start, 2):
        call_scheme(scheme, source, at, k, ends, to + k * count, count)


@called
def slopes_along_rows(
    scheme, values, here, begin, tall, wide, nodes, kind, ghosts, count, i, at, shared, room, places
):  # fmt: skip
    """The same along the last axis."""
    rows, ends = shared[0], shared[1]
    first = 2 * ENDS * i
    places[SLOPES + 2 * i] = address(ends, first)
    places[SLOPES + 2 * i + 1] = address(ends, first + ENDS + 1)
    for k in range(len(at)):
        at[k] = k
    for k in range(tall):
        gather_along(values, here - begin + k * nodes, begin, nodes, wide, kind, ghosts, rows)
        to = first + k * wide
        last = ends[to + ENDS]  # the slope above the row before
        call_scheme(scheme, rows, at, 0, ends, to, wide + 1)
        if k > 0:
            ends[to + ENDS] = last


@swept
def is_kept(units, first, last, unit, several):
    """Whether the slopes below several units were computed with the place before.

    units: of each of a place along the axis, the one whose slopes are kept.
    """
    many = last - first
    if many == 0:
        return False
    for k in range(several):  # noqa: SIM110
        if units[first + (unit + k) % many] != unit + k:
            return False
    return True


@called
def remember_slopes(shared, i, place, nodes, unit, several, here, stride, count):
    """Keep the slopes above for the next place along an outer axis."""
    _, ends, ahead, ahead_at, units, units_at = shared
    first, many = units_at[i], units_at[i + 1] - units_at[i]
    if many == 0:
        return
    for k in range(several):
        units[first + (unit + k) % many] = unit + k + many
    copy(ends, 2 * ENDS * i + count, count, ahead, ahead_at[i] + here % stride)
