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


@compiled
def beyond(edge, inner, distance):
    """The value `distance` nodes beyond an edge: linear, and away from zero so no sign is made."""
    slope = abs(edge - inner)
    return edge + distance * (slope if edge >= 0.0 else -slope)


@compiled
def gather(values, first, place, nodes, stride, kind, ghosts, count, rows):
    """rows[k, :count]: the nodes k - ghosts places along an axis from those at `first`..."""
    for k in range(2 * ghosts + 1):
        there = place + k - ghosts
        if kind == PERIODIC:
            there = (there + nodes) % nodes
        elif kind == LIMITED:
            there = min(max(there, 0), nodes - 1)
        if 0 <= there < nodes:
            row = values[first + (there - place) * stride :]
            for j in range(count):
                rows[k, j] = row[j]
            continue
        edge = 0 if there < 0 else nodes - 1
        inner = 1 if there < 0 else nodes - 2
        distance = float(abs(there - edge))
        at_edge = values[first + (edge - place) * stride :]
        inside = values[first + (inner - place) * stride :]
        for j in range(count):
            rows[k, j] = beyond(float(at_edge[j]), float(inside[j]), distance)


@compiled
def gather_along(values, first, start, nodes, kind, ghosts, count, rows):
    """The same along the last axis, whose nodes begin at `first`, for those from `start` on."""
    for k in range(2 * ghosts + 1):
        shift = start + k - ghosts
        low = min(max(0, -shift), count)
        high = max(min(count, nodes - shift), low)
        row = values[first + shift + low :]
        for j in range(high - low):
            rows[k, low + j] = row[j]
        for j in range(count):
            if low <= j < high:
                continue
            there = shift + j
            if kind == PERIODIC:
                rows[k, j] = values[first + (there + nodes) % nodes]
            elif kind == LIMITED:
                rows[k, j] = values[first + min(max(there, 0), nodes - 1)]
            else:
                edge = 0 if there < 0 else nodes - 1
                inner = 1 if there < 0 else nodes - 2
                rows[k, j] = beyond(
                    float(values[first + edge]), float(values[first + inner]), abs(there - edge)
                )


@compiled
def upwind(rows, count, inverse, mean, gap):
    """First order."""
    for j in range(count):
        left = (rows[1, j] - rows[0, j]) * inverse
        right = (rows[2, j] - rows[1, j]) * inverse
        mean[j] = 0.5 * (left + right)
        gap[j] = 0.5 * (right - left)


@compiled
def smaller(a, b):
    """The one of smaller magnitude."""
    return a if abs(a) <= abs(b) else b


@compiled
def eno2(rows, count, inverse, mean, gap):
    """Second order: the first derivative, corrected by the smaller of two second differences."""
    for j in range(count):
        a = (rows[1, j] - rows[0, j]) * inverse
        b = (rows[2, j] - rows[1, j]) * inverse
        c = (rows[3, j] - rows[2, j]) * inverse
        d = (rows[4, j] - rows[3, j]) * inverse
        left = b + 0.5 * smaller(b - a, c - b)
        right = c - 0.5 * smaller(c - b, d - c)
        mean[j] = 0.5 * (left + right)
        gap[j] = 0.5 * (right - left)


@compiled
def eno3_side(a, b, c, d, e):
    """The derivative between b and c from five successive first differences, c being upwind's."""
    d1, d2, d3, d4 = b - a, c - b, d - c, e - d
    if abs(d2) <= abs(d3):
        second, third = d2, smaller(d2 - d1, d3 - d2)
        return c + 0.5 * second + third / 3.0
    second, third = d3, smaller(d3 - d2, d4 - d3)
    return c + 0.5 * second - third / 6.0


@compiled
def eno3(rows, count, inverse, mean, gap):
    """Third order: the smoothest of three stencils."""
    for j in range(count):
        a = (rows[1, j] - rows[0, j]) * inverse
        b = (rows[2, j] - rows[1, j]) * inverse
        c = (rows[3, j] - rows[2, j]) * inverse
        d = (rows[4, j] - rows[3, j]) * inverse
        e = (rows[5, j] - rows[4, j]) * inverse
        f = (rows[6, j] - rows[5, j]) * inverse
        left = eno3_side(a, b, c, d, e)
        right = eno3_side(f, e, d, c, b)
        mean[j] = 0.5 * (left + right)
        gap[j] = 0.5 * (right - left)


@compiled
def weno5_side(a, b, c, d, e):
    """Three third-order derivatives, weighted by the smoothness of their stencils."""
    s1 = 13.0 / 12.0 * (a - 2.0 * b + c) ** 2 + 0.25 * (a - 4.0 * b + 3.0 * c) ** 2
    s2 = 13.0 / 12.0 * (b - 2.0 * c + d) ** 2 + 0.25 * (b - d) ** 2
    s3 = 13.0 / 12.0 * (c - 2.0 * d + e) ** 2 + 0.25 * (3.0 * c - 4.0 * d + e) ** 2
    largest = max(max(max(a * a, b * b), max(c * c, d * d)), e * e)
    small = 1e-6 * largest + 1e-99
    w1 = 0.1 / ((s1 + small) * (s1 + small))
    w2 = 0.6 / ((s2 + small) * (s2 + small))
    w3 = 0.3 / ((s3 + small) * (s3 + small))
    p1 = a / 3.0 - 7.0 / 6.0 * b + 11.0 / 6.0 * c
    p2 = -b / 6.0 + 5.0 / 6.0 * c + d / 3.0
    p3 = c / 3.0 + 5.0 / 6.0 * d - e / 6.0
    return (w1 * p1 + w2 * p2 + w3 * p3) / (w1 + w2 + w3)


@compiled
def weno5(rows, count, inverse, mean, gap):
    """Fifth order where the value is smooth."""
    for j in range(count):
        a = (rows[1, j] - rows[0, j]) * inverse
        b = (rows[2, j] - rows[1, j]) * inverse
        c = (rows[3, j] - rows[2, j]) * inverse
        d = (rows[4, j] - rows[3, j]) * inverse
        e = (rows[5, j] - rows[4, j]) * inverse
        f = (rows[6, j] - rows[5, j]) * inverse
        left = weno5_side(a, b, c, d, e)
        right = weno5_side(f, e, d, c, b)
        mean[j] = 0.5 * (left + right)
        gap[j] = 0.5 * (right - left)
