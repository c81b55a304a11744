"""One-sided derivatives along an axis of a grid, on a stretch of nodes at a time.

`rows[k]` holds the nodes k - GHOSTS beyond those of the stretch along the axis. Each function
leaves the mean of the left and the right derivative and half their gap, which is what a
Lax-Friedrichs scheme asks for. Joined after `primitives.py` into the generated sweeps.

Sources: S. Osher, C.-W. Shu, SIAM J. Numer. Anal. 28, 1991 (essentially non-oscillatory, ENO);
G.-S. Jiang, D. Peng, SIAM J. Sci. Comput. 21, 2000 (fifth-order weighted, WENO5).
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on

EXTRAPOLATED, PERIODIC, LIMITED = 0, 1, 2
BEND = 13.0 / 12.0

swept = njit(
    cache=True, error_model="numpy", nogil=True, forceinline=True, fastmath={"contract"}
)  # fused multiplications and additions: the inner loops of the sweeps are made of them


@swept
def beyond(edge, inner, distance):
    """The value `distance` nodes beyond an edge: linear, and away from zero so no sign is made."""
    slope = abs(edge - inner)
    return edge + distance * (slope if edge >= 0.0 else -slope)


@swept
def fetch(values, first, place, there, nodes, stride, kind, count, target):
    """The run of `count` nodes at the place `there` of an axis; that at `place` is at `first`."""
    if kind == PERIODIC:
        there = (there + nodes) % nodes
    elif kind == LIMITED:
        there = min(max(there, 0), nodes - 1)
    if 0 <= there < nodes:
        run = values[first + (there - place) * stride :]
        for j in range(count):
            target[j] = run[j]
        return
    edge = 0 if there < 0 else nodes - 1
    inner = 1 if there < 0 else nodes - 2
    distance = float(abs(there - edge))
    at_edge = values[first + (edge - place) * stride :]
    inside = values[first + (inner - place) * stride :]
    for j in range(count):
        target[j] = beyond(float(at_edge[j]), float(inside[j]), distance)


@swept
def gather(values, first, place, nodes, stride, kind, ghosts, count, rows):
    """rows[k, :count]: the nodes k - ghosts places along an axis from those at `first`..."""
    for k in range(2 * ghosts + 1):
        fetch(values, first, place, place + k - ghosts, nodes, stride, kind, count, rows[k])


@swept
def gather_rows(values, first, row, tall, nodes, stride, wide, kind, ghosts, rows):
    """The same along the axis before the last, for `tall` rows of `wide` nodes from `row` on."""
    for k in range(2 * ghosts + 1):
        lowest = row + k - ghosts
        if (tall == 1 or wide == stride) and lowest >= 0 and lowest + tall <= nodes:
            run = values[first + (k - ghosts) * stride :]
            target = rows[k]
            for j in range(tall * wide):
                target[j] = run[j]
            continue
        for r in range(tall):
            fetch(
                values, first + r * stride, row + r, lowest + r, nodes, stride, kind, wide,
                rows[k, r * wide : (r + 1) * wide],
            )  # fmt: skip


@swept
def gather_along(values, first, tall, start, nodes, wide, kind, ghosts, line, rows):
    """The same along the last axis, whose nodes begin at `first`, for those from `start` on."""
    length = wide + 2 * ghosts
    low = min(max(0, ghosts - start), length)
    high = max(min(length, nodes - start + ghosts), low)
    for r in range(tall):
        begin = first + r * nodes
        inside = line[low:high]
        source = values[begin + start - ghosts + low :]
        for j in range(high - low):
            inside[j] = source[j]
        for j in range(low):
            fetch(values, begin, 0, start - ghosts + j, nodes, 1, kind, 1, line[j : j + 1])
        for j in range(high, length):
            fetch(values, begin, 0, start - ghosts + j, nodes, 1, kind, 1, line[j : j + 1])
        for k in range(2 * ghosts + 1):
            target = rows[k, r * wide : (r + 1) * wide]
            shifted = line[k : k + wide]
            for j in range(wide):
                target[j] = shifted[j]


@swept
def upwind(rows, count, inverse, mean, gap):
    """First order."""
    for j in range(count):
        left = (rows[1, j] - rows[0, j]) * inverse
        right = (rows[2, j] - rows[1, j]) * inverse
        mean[j] = 0.5 * (left + right)
        gap[j] = 0.5 * (right - left)


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


@swept
def eno2(rows, count, inverse, mean, gap):
    """Second order: the first derivative, corrected by the smaller of two second differences."""
    for j in range(count):
        a = (rows[1, j] - rows[0, j]) * inverse
        b = (rows[2, j] - rows[1, j]) * inverse
        c = (rows[3, j] - rows[2, j]) * inverse
        d = (rows[4, j] - rows[3, j]) * inverse
        left = same_way(b + 0.5 * smaller(b - a, c - b), b)
        right = same_way(c - 0.5 * smaller(c - b, d - c), c)
        mean[j] = 0.5 * (left + right)
        gap[j] = 0.5 * (right - left)


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
def six(rows, j, inverse):
    """The first differences of seven nodes in a row."""
    return (
        (rows[1, j] - rows[0, j]) * inverse,
        (rows[2, j] - rows[1, j]) * inverse,
        (rows[3, j] - rows[2, j]) * inverse,
        (rows[4, j] - rows[3, j]) * inverse,
        (rows[5, j] - rows[4, j]) * inverse,
        (rows[6, j] - rows[5, j]) * inverse,
    )


@swept
def eno3(rows, count, inverse, mean, gap):
    """Third order: the smoothest of three stencils."""
    for j in range(count):
        a, b, c, d, e, f = six(rows, j, inverse)
        left = same_way(eno3_side(a, b, c, d, e), c)
        right = same_way(eno3_side(f, e, d, c, b), d)
        mean[j] = 0.5 * (left + right)
        gap[j] = 0.5 * (right - left)


@swept
def weno5_side(a, b, c, d, e, bend_1, bend_2, bend_3):
    """Three third-order derivatives, weighted by the smoothness of their stencils.

    `bend_k` are 13/12 of the squares of the second differences. The weights are multiplied out, so
    that there is one division; `small` keeps their products above the smallest number there is.
    """
    largest = max(max(max(a * a, b * b), max(c * c, d * d)), e * e)
    small = 1e-6 * largest + 1e-40
    t1, t2, t3 = a - 4.0 * b + 3.0 * c, b - d, 3.0 * c - 4.0 * d + e
    s1 = bend_1 + 0.25 * t1 * t1 + small
    s2 = bend_2 + 0.25 * t2 * t2 + small
    s3 = bend_3 + 0.25 * t3 * t3 + small
    s1, s2, s3 = s1 * s1, s2 * s2, s3 * s3
    w1, w2, w3 = s2 * s3, 6.0 * s1 * s3, 3.0 * s1 * s2
    p1 = 2.0 * a - 7.0 * b + 11.0 * c
    p2 = 5.0 * c - b + 2.0 * d
    p3 = 2.0 * c + 5.0 * d - e
    return (w1 * p1 + w2 * p2 + w3 * p3) / (6.0 * (w1 + w2 + w3))


@swept
def weno5(rows, count, inverse, mean, gap):
    """Fifth order where the value is smooth and has no extremum."""
    for j in range(count):
        a, b, c, d, e, f = six(rows, j, inverse)
        d1, d2, d3, d4 = a - 2.0 * b + c, b - 2.0 * c + d, c - 2.0 * d + e, d - 2.0 * e + f
        d1, d2 = BEND * d1 * d1, BEND * d2 * d2
        d3, d4 = BEND * d3 * d3, BEND * d4 * d4
        left = same_way(weno5_side(a, b, c, d, e, d1, d2, d3), c)
        right = same_way(weno5_side(f, e, d, c, b, d4, d3, d2), d)
        mean[j] = 0.5 * (left + right)
        gap[j] = 0.5 * (right - left)


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
