"""Slopes of a value along an axis of a grid, at a run of nodes.

`source[at[k] + j]` is the node k - GHOSTS places along the axis from node j of the run: in the
value itself, or where it has to be continued beyond an end of the axis, in a copy.

Of every interval between two nodes a scheme gives the slope at its upper end, which is the left
derivative there, and at its lower end, the right derivative there. A node takes one of the interval
below and one of that above, and leaves their mean and half their gap, which is what a
Lax-Friedrichs scheme asks for. At first order both ends have the same: they are not kept.

Sources: S. Osher, C.-W. Shu, SIAM J. Numer. Anal. 28, 1991 (essentially non-oscillatory, ENO);
G.-S. Jiang, D. Peng, SIAM J. Sci. Comput. 21, 2000 (fifth-order weighted, WENO5).
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.stencils import *  # noqa: F403

# -- joined from here on

BEND = 13.0 / 3.0


@called
def upwind(source, at, count, inverse, work, mean, gap):
    """First order: work[mean + j] and work[gap + j], the mean of two slopes and half their gap."""
    low, here, high = at[0], at[1], at[2]
    half = 0.5 * inverse
    mean, gap = np.uint64(mean), np.uint64(gap)
    for j in range(lanes(count)):
        left = source[here + j] - source[low + j]
        right = source[high + j] - source[here + j]
        work[mean + j] = half * (left + right)
        work[gap + j] = half * (right - left)


@called
def upwind_ends(values, first, tall, nodes, kind, inverse, work, mean, gap):
    """The same at the first and the last node of whole rows of the last axis."""
    half = 0.5 * inverse
    for k in range(tall):
        row = first + k * nodes
        for j in (0, nodes - 1):
            low = values[row + j - 1] if j > 0 else ghost(values, row, -1, nodes, kind)
            high = values[row + j + 1] if j < nodes - 1 else ghost(values, row, nodes, nodes, kind)
            left, right = values[row + j] - low, high - values[row + j]
            work[mean + k * nodes + j] = half * (left + right)
            work[gap + k * nodes + j] = half * (right - left)


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


@called
def eno2(source, at, k, count, left, right, to):
    """Second order: the first derivative, corrected by the smaller of two second differences."""
    i0, i1, i2, i3 = at[k], at[k + 1], at[k + 2], at[k + 3]
    to = np.uint64(to)
    for j in range(lanes(count)):
        a = source[i1 + j] - source[i0 + j]
        b = source[i2 + j] - source[i1 + j]
        c = source[i3 + j] - source[i2 + j]
        bend = 0.5 * smaller(b - a, c - b)
        left[to + j] = same_way(b + bend, b)
        right[to + j] = same_way(b - bend, b)


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


@swept
def eno3_side(a, b, c, d, e):
    """The derivative between b and c from five successive first differences, c being upwind's."""
    d1, d2, d3, d4 = b - a, c - b, d - c, e - d
    if abs(d2) <= abs(d3):
        second, third = d2, smaller(d2 - d1, d3 - d2)
        return c + 0.5 * second + third / 3.0
    second, third = d3, smaller(d3 - d2, d4 - d3)
    return c + 0.5 * second - third / 6.0


@called
def eno3(source, at, k, count, left, right, to):
    """Third order: the smoothest of three stencils."""
    at = (at[k], at[k + 1], at[k + 2], at[k + 3], at[k + 4], at[k + 5])
    to = np.uint64(to)
    for j in range(lanes(count)):
        a, b, c, d, e = five(source, at, j)
        left[to + j] = same_way(eno3_side(a, b, c, d, e), c)
        right[to + j] = same_way(eno3_side(e, d, c, b, a), c)


@called
def weno5(source, at, k, count, left, right, to):
    """Fifth order where the value is smooth and has no extremum.

    Three third-order derivatives, weighted by the smoothness of their stencils, which is the same
    for the slopes at both ends of an interval. It is measured by the sum of all three and of the
    plain difference, so that no product is too small or too large for single precision, and the
    weights are multiplied out.
    """
    at = (at[k], at[k + 1], at[k + 2], at[k + 3], at[k + 4], at[k + 5])
    to = np.uint64(to)
    for j in range(lanes(count)):
        a, b, c, d, e = five(source, at, j)
        d1, d2, d3, d4 = b - a, c - b, d - c, e - d
        t1, t2, t3 = 3.0 * d2 - d1, d2 + d3, 3.0 * d3 - d4
        s1 = BEND * (d2 - d1) * (d2 - d1) + t1 * t1
        s2 = BEND * (d3 - d2) * (d3 - d2) + t2 * t2
        s3 = BEND * (d4 - d3) * (d4 - d3) + t3 * t3
        scale = 1e3 / (c * c + s1 + s2 + s3 + 1e-30)
        s1, s2, s3 = scale * s1 + 1e-3, scale * s2 + 1e-3, scale * s3 + 1e-3
        s1, s2, s3 = s1 * s1, s2 * s2, s3 * s3
        w1, w2, w3 = s2 * s3, 6.0 * (s1 * s3), s1 * s2
        from_left, from_right = w1 + w2 + 3.0 * w3, 3.0 * w1 + w2 + w3
        rise = w1 * (2.0 * t1 - d2) + w2 * (t2 + d3) + 3.0 * w3 * (t3 + d3)
        fall = w3 * (2.0 * t3 - d3) + w2 * (t2 + d2) + 3.0 * w1 * (t1 + d2)
        sixth = (1.0 / 6.0) / (from_left * from_right)
        left[to + j] = same_way(c + rise * (from_right * sixth), c)
        right[to + j] = same_way(c - fall * (from_left * sixth), c)


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
