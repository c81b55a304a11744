"""Slopes of a value along an axis of a grid, at a run of nodes: what all schemes share.

`source[at[k] + j]` is the node k - GHOSTS places along the axis from node j of the run: in the
value itself, or where it has to be continued beyond an end of the axis, in a copy.

Of every interval between two nodes a scheme gives the slope at its upper end, which is the left
derivative there, and at its lower end, the right derivative there. A node takes one of the interval
below and one of that above, and leaves their mean and half their gap, which is what a
Lax-Friedrichs scheme asks for. At first order both ends have the same: they are not kept.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.stencils import *  # noqa: F403

# -- joined from here on


@swept
def smaller(a, b):
    """The one of smaller magnitude."""
    return a if abs(a) <= abs(b) else b


@swept
def same_way(slope, plain):
    """A slope of higher order, between zero and twice the plain difference.

    Else the nodes on either side of a ridge that lies between them would both rise to a summit
    that no node is at, and so would never learn that it falls.
    """
    twice = 2.0 * plain
    low, high = min(twice, 0.0), max(twice, 0.0)
    return min(max(slope, low), high)


@swept
def five(source, at, j):
    """The first differences of six nodes in a row."""
    return (
        source[at[1] + j] - source[at[0] + j],
        source[at[2] + j] - source[at[1] + j],
        source[at[3] + j] - source[at[2] + j],
        source[at[4] + j] - source[at[3] + j],
        source[at[5] + j] - source[at[4] + j],
    )


@called
def combine(left, right, after, count, inverse, work, mean, gap):
    """Of the slopes that every interval has at its upper (left) and lower (right) end, at nodes.

    The interval above a node is `after` further than the one below.
    """
    half = 0.5 * inverse
    mean, gap, after = np.uint64(mean), np.uint64(gap), np.uint64(after)
    for j in range(lanes(count)):
        work[mean + j] = half * (left[j] + right[after + j])
        work[gap + j] = half * (right[after + j] - left[j])


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
