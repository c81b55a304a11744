"""One-sided derivatives along an axis of a grid, on a stretch of nodes at a time.

`source[at[k] + j]` is the node k - GHOSTS places along the axis from node j of the stretch: in the
value itself, or, at an end of the axis that the value has to be continued beyond, in a copy. Each
scheme leaves, from the place `to` on, the mean of the left and the right derivative and half their
gap, which is what a Lax-Friedrichs scheme asks for. The generated sweeps are joined to these.

Sources: S. Osher, C.-W. Shu, SIAM J. Numer. Anal. 28, 1991 (essentially non-oscillatory, ENO);
G.-S. Jiang, D. Peng, SIAM J. Sci. Comput. 21, 2000 (fifth-order weighted, WENO5).
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on

EXTRAPOLATED, PERIODIC, LIMITED = 0, 1, 2
BEND = 13.0 / 3.0
LONGEST = 64  # nodes of a stretch; a multiple of VECTOR
VECTOR = 8  # numbers in single precision in one register

swept = njit(
    cache=True, error_model="numpy", nogil=True, forceinline=True, fastmath={"contract"}
)  # fused multiplications and additions: the inner loops of the sweeps are made of them
called = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})


@swept
def beyond(edge, inner, distance):
    """The value `distance` nodes beyond an edge: linear, and away from zero so no sign is made."""
    slope = abs(edge - inner)
    return edge + distance * (slope if edge >= 0.0 else -slope)


@swept
def place_of(there, nodes, kind):
    """The place of an axis that stands for one beyond its ends; itself where none does."""
    if kind == PERIODIC:
        return (there + nodes) % nodes
    return min(max(there, 0), nodes - 1) if kind == LIMITED else there


@swept
def reach(at, first, place, tall, nodes, stride, kind, ghosts, end):
    """Where the nodes around `tall` places from `place` on, which is at `first`, are.

    False if they are not on the grid, or not in as many runs, or if runs of `LONGEST` would not
    stop before `end`: they are gathered then.
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
    return furthest + LONGEST <= end


@swept
def fetch(values, first, place, there, nodes, stride, kind, count, target, to):
    """The run of `count` nodes at the place `there` of an axis; that at `place` is at `first`."""
    there = place_of(there, nodes, kind)
    if 0 <= there < nodes:
        run = first + (there - place) * stride
        for j in range(count):
            target[to + j] = values[run + j]
        return
    edge = 0 if there < 0 else nodes - 1
    inner = 1 if there < 0 else nodes - 2
    distance = float(abs(there - edge))
    at_edge = first + (edge - place) * stride
    inside = first + (inner - place) * stride
    for j in range(count):
        target[to + j] = beyond(float(values[at_edge + j]), float(values[inside + j]), distance)


@called
def gather(values, first, place, tall, nodes, stride, wide, kind, ghosts, rows):
    """rows[k LONGEST + j]: the nodes k - ghosts places along an axis from those at `first`...

    Of `tall` places from `place` on, `wide` nodes of each.
    """
    for k in range(2 * ghosts + 1):
        for r in range(tall):
            here, there = first + r * stride, place + r + k - ghosts
            to = k * LONGEST + r * wide
            fetch(values, here, place + r, there, nodes, stride, kind, wide, rows, to)


@called
def gather_along(values, first, start, nodes, wide, kind, ghosts, line):
    """line[j]: the nodes from `start` - ghosts on of a row of the last axis that is at `first`."""
    length = wide + 2 * ghosts
    low = min(max(0, ghosts - start), length)
    high = max(min(length, nodes - start + ghosts), low)
    inside = first + start - ghosts
    for j in range(low, high):
        line[j] = values[inside + j]
    for j in range(low):
        fetch(values, first, 0, start - ghosts + j, nodes, 1, kind, 1, line, j)
    for j in range(high, length):
        fetch(values, first, 0, start - ghosts + j, nodes, 1, kind, 1, line, j)


@swept
def lanes(count):
    """How many to compute so that vector instructions leave no rest; some are not used."""
    return np.uint64((count + VECTOR - 1) & ~(VECTOR - 1))


@called
def upwind(source, at, count, inverse, mean, gap, to):
    """First order."""
    low, here, high = at[0], at[1], at[2]
    half = 0.5 * inverse
    to = np.uint64(to)
    for j in range(lanes(count)):
        left = source[here + j] - source[low + j]
        right = source[high + j] - source[here + j]
        mean[to + j] = half * (left + right)
        gap[to + j] = half * (right - left)


@swept
def smaller(a, b):
    """The one of smaller magnitude."""
    return a if abs(a) <= abs(b) else b


@swept
def same_way(slope, plain):
    """A slope of higher order; zero where the plain difference has the other sign.

    Else the nodes on either side of a ridge that lies between them would both rise to a summit
    that no node is at, and so would never learn that it falls.
    """
    limited = slope if abs(slope) <= 2.0 * abs(plain) else 2.0 * plain
    return limited if slope * plain > 0.0 else 0.0


@called
def eno2(source, at, count, inverse, mean, gap, to):
    """Second order: the first derivative, corrected by the smaller of two second differences."""
    i0, i1, i2, i3, i4 = at[0], at[1], at[2], at[3], at[4]
    half = 0.5 * inverse
    to = np.uint64(to)
    for j in range(lanes(count)):
        a = source[i1 + j] - source[i0 + j]
        b = source[i2 + j] - source[i1 + j]
        c = source[i3 + j] - source[i2 + j]
        d = source[i4 + j] - source[i3 + j]
        left = same_way(b + 0.5 * smaller(b - a, c - b), b)
        right = same_way(c - 0.5 * smaller(c - b, d - c), c)
        mean[to + j] = half * (left + right)
        gap[to + j] = half * (right - left)


@swept
def eno3_side(a, b, c, d, e):
    """The derivative between b and c from five successive first differences, c being upwind's."""
    d1, d2, d3, d4 = b - a, c - b, d - c, e - d
    if abs(d2) <= abs(d3):
        second, third = d2, smaller(d2 - d1, d3 - d2)
        return c + 0.5 * second + third / 3.0
    second, third = d3, smaller(d3 - d2, d4 - d3)
    return c + 0.5 * second - third / 6.0


@swept
def six(source, at, j):
    """The first differences of seven nodes in a row."""
    return (
        source[at[1] + j] - source[at[0] + j],
        source[at[2] + j] - source[at[1] + j],
        source[at[3] + j] - source[at[2] + j],
        source[at[4] + j] - source[at[3] + j],
        source[at[5] + j] - source[at[4] + j],
        source[at[6] + j] - source[at[5] + j],
    )


@called
def eno3(source, at, count, inverse, mean, gap, to):
    """Third order: the smoothest of three stencils."""
    at = (at[0], at[1], at[2], at[3], at[4], at[5], at[6])
    half = 0.5 * inverse
    to = np.uint64(to)
    for j in range(lanes(count)):
        a, b, c, d, e, f = six(source, at, j)
        left = same_way(eno3_side(a, b, c, d, e), c)
        right = same_way(eno3_side(f, e, d, c, b), d)
        mean[to + j] = half * (left + right)
        gap[to + j] = half * (right - left)


@swept
def weno5_side(a, b, c, d, e, bend_1, bend_2, bend_3, scale):
    """Three third-order derivatives, weighted by the smoothness of their stencils.

    `bend_k` are 13/3 of the squares of the second differences. The smoothness is measured by the
    largest of the differences, so that no product is too small for single precision, and the
    weights are multiplied out.
    """
    t1, t2, t3 = a - 4.0 * b + 3.0 * c, b - d, 3.0 * c - 4.0 * d + e
    s1 = scale * (bend_1 + t1 * t1) + 4e-6
    s2 = scale * (bend_2 + t2 * t2) + 4e-6
    s3 = scale * (bend_3 + t3 * t3) + 4e-6
    s1, s2, s3 = s1 * s1, s2 * s2, s3 * s3
    w1, w2, w3 = s2 * s3, 6.0 * s1 * s3, 3.0 * s1 * s2
    p1 = (1.0 / 3.0) * a - (7.0 / 6.0) * b + (11.0 / 6.0) * c
    p2 = (5.0 / 6.0) * c - (1.0 / 6.0) * b + (1.0 / 3.0) * d
    p3 = (1.0 / 3.0) * c + (5.0 / 6.0) * d - (1.0 / 6.0) * e
    return (w1 * p1 + w2 * p2 + w3 * p3) / (w1 + w2 + w3)


@called
def weno5(source, at, count, inverse, mean, gap, to):
    """Fifth order where the value is smooth and has no extremum."""
    at = (at[0], at[1], at[2], at[3], at[4], at[5], at[6])
    half = 0.5 * inverse
    to = np.uint64(to)
    for j in range(lanes(count)):
        a, b, c, d, e, f = six(source, at, j)
        d1, d2, d3, d4 = a - 2.0 * b + c, b - 2.0 * c + d, c - 2.0 * d + e, d - 2.0 * e + f
        d1, d2 = BEND * d1 * d1, BEND * d2 * d2
        d3, d4 = BEND * d3 * d3, BEND * d4 * d4
        largest = max(max(max(a * a, b * b), max(c * c, d * d)), max(e * e, f * f))
        scale = 1.0 / (largest + 1e-30)
        left = same_way(weno5_side(a, b, c, d, e, d1, d2, d3, scale), c)
        right = same_way(weno5_side(f, e, d, c, b, d4, d3, d2, scale), d)
        mean[to + j] = half * (left + right)
        gap[to + j] = half * (right - left)


@swept
def mark(marks, unit, place, nodes, stride, kind, ghosts):
    """The units within reach along an outer axis have to be computed again."""
    for k in range(-ghosts, ghosts + 1):
        there = place + k
        if kind == PERIODIC:
            there = (there + nodes) % nodes
        if 0 <= there < nodes:
            marks[unit + (there - place) * stride] = 1


@swept
def mark_rows(marks, unit, row, tall, rows_of, many, stretches, kind, ghosts):
    """The same for the groups of rows that those within reach belong to."""
    for there in range(row - ghosts, row + tall + ghosts):
        if kind == PERIODIC:
            there = (there + rows_of) % rows_of
        if 0 <= there < rows_of:
            marks[unit + there // many * stretches] = 1


@swept
def mirror(first, last, whole, values, shape, places, axis, chosen, counts):
    """Values at the chosen places along an axis, from the nodes that they reflect.

    A share, from first to last of whole, of the rows for a worker.
    """
    n = len(shape)
    nodes = shape[n - 1]
    of_row = axis < n - 1  # else all rows, and the chosen places of each
    inner = 1  # rows within a place along the axis
    for i in range(axis + 1, n - 1):
        inner *= shape[i]
    many = len(chosen) if of_row else 1
    there = shape[axis] if of_row else 1
    rows = len(values) // nodes // there * many
    for k in range(rows * first // whole, rows * last // whole):
        row = k // inner // many * there * inner + k % inner
        if of_row:
            row += chosen[k // inner % many] * inner
        rest, other, stride = row, 0, 1
        for i in range(n - 2, -1, -1):
            other += places[i, rest % shape[i]] * stride
            rest //= shape[i]
            stride *= shape[i]
        for j in range(nodes if of_row else len(chosen)):
            place = j if of_row else chosen[j]
            values[row * nodes + place] = values[other * nodes + places[n - 1, place]]
