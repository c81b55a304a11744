"""Means and half gaps of slopes by a scheme that has two slopes of every interval between nodes.

The slopes of an interval belong to the nodes on both sides of it: along an outer axis those above a
place are kept for the next place.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.stencils import *  # noqa: F403

# -- joined from here on

ENDS = 2 * RUN + VECTOR  # slopes at the upper ends of intervals; those at the lower ends follow


@swept
def shared_slopes(values, shape, strides, units_of):
    """Room for slopes: at both ends of intervals, and for each outer axis those of a place, with
    the units that they belong to, and where each axis has its own."""
    n = len(shape)
    ahead_at, units_at = np.zeros(n + 1, dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    for i in range(n):
        kept = 1 if i < n - 2 and strides[i] <= KEPT else 0
        ahead_at[i + 1] = ahead_at[i] + kept * strides[i]
        units_at[i + 1] = units_at[i] + kept * units_of[i]
    ends = np.zeros(2 * ENDS, dtype=values.dtype)
    ahead = np.zeros(ahead_at[n], dtype=values.dtype)
    return ends, ahead, ahead_at, np.full(units_at[n], -1), units_at


@swept
def borrowed_slopes(shared):
    ends, ahead, ahead_at, units, units_at = shared
    return borrowed(ends), borrowed(ahead), borrowed(ahead_at), borrowed(units), borrowed(units_at)


@swept
def held_slopes(shared):
    return len(shared)


@swept
def slopes_across(
    scheme, values, here, i, outer, place, tall, wide, stride, nodes, kind, ghosts, unit, several,
    count, half, rows, at, shared, work, mean, gap
):  # fmt: skip
    """Means and half gaps along an axis that is not the last, at a run of nodes."""
    ends, ahead_all, ahead_at, units_all, units_at = shared
    ahead = ahead_all[ahead_at[i] : ahead_at[i + 1]]
    units = units_all[units_at[i] : units_at[i + 1]]
    offset, start = here % stride, 0
    if outer:
        tall, wide = 1, count
        if place > 0 and recall(ahead, units, unit, several, offset, count, ends):
            start = 1
    if reach(at, here, place, tall, nodes, stride, count, kind, ghosts, len(values)):
        of_intervals(scheme, values, at, start, tall, wide, count, half, ends)
    else:
        gather(values, here, place, tall, nodes, stride, wide, kind, ghosts, rows, at)
        of_intervals(scheme, rows, at, start, tall, wide, count, half, ends)
    combine(ends, wide, count, float(half[0]), work, mean, gap)
    if outer:
        remember(ahead, units, unit, several, offset, count, ends)


@swept
def of_intervals(scheme, source, at, start, tall, wide, count, half, ends):
    """The slopes below and above every node; those of rows that follow one another are the same."""
    if tall > 1:
        call_scheme(scheme, source, at, 0, half, ends, 0, ENDS, count + wide)
        return
    for k in range(start, 2):
        call_scheme(scheme, source, at, k, half, ends, k * count, ENDS, count)


@swept
def slopes_along_rows(
    scheme, values, here, begin, tall, wide, nodes, kind, ghosts, count, half, line, of_line, at,
    shared, work, mean, gap
):  # fmt: skip
    """Means and half gaps along the last axis."""
    ends = shared[0]
    for k in range(tall):
        gather_along(values, here - begin + k * nodes, begin, nodes, wide, kind, ghosts, line)
        call_scheme(scheme, line, of_line, 0, half, ends, 0, ENDS, wide + 1)
        combine(ends, 1, wide, float(half[0]), work, mean + k * wide, gap + k * wide)


@called
def combine(ends, after, count, half, work, mean, gap):
    """Of the slopes that every interval has at its upper and lower end, at nodes.

    The interval above a node is `after` further than the one below.
    """
    mean, gap, above = np.uint64(mean), np.uint64(gap), np.uint64(ENDS + after)
    for j in range(lanes(count)):
        work[mean + j] = half * (ends[j] + ends[above + j])
        work[gap + j] = half * (ends[above + j] - ends[j])


@swept
def recall(ahead, units, unit, several, offset, count, left):
    """The slopes of the intervals below, if they were computed with the place before.

    units[k]: the unit whose slopes are kept for the k-th of a place along the axis.
    """
    if len(ahead) == 0:
        return False
    for k in range(several):
        if units[(unit + k) % len(units)] != unit + k:
            return False
    offset = np.uint64(offset)
    for j in range(np.uint64(count)):
        left[j] = ahead[offset + j]
    return True


@swept
def remember(ahead, units, unit, several, offset, count, left):
    """Keep the slopes of the intervals above for the next place along the axis."""
    if len(ahead) == 0:
        return
    for k in range(several):
        units[(unit + k) % len(units)] = unit + k + len(units)
    offset, count = np.uint64(offset), np.uint64(count)
    for j in range(count):
        ahead[offset + j] = left[count + j]
