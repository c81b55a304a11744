"""The point of a polyhedron that is nearest to a given one, exactly; in few dimensions.

Half-spaces are met one after the other (R. Seidel, Discrete Comput. Geom. 6, 1991): where the best
point so far violates the next one, the new best point lies on its plane, which is the same problem
with one dimension less and the half-spaces met before. These are scalar functions
(`codegen/scalar_functions.py`). Half-spaces are rows of `wide` numbers, a normal of unit length and
behind it the offset.
"""

from __future__ import annotations

import math

from holdfast.execution.arrays import Floats, Wholes

CLOSE = 1e-10  # what counts as on a plane, relative to its distance
PARALLEL = 1e-9  # the sine of the angle below which two planes are parallel
APART = 1e-8  # the gap, relative to their distance, above which two such planes exclude each other


def interval(
    rows: Floats, wide: int, count: int, m: int, base: Floats, along: Floats, found: Floats
) -> bool:
    """Whether some s has rows[j, :m] . (base + s along) <= rows[j, m] for all j < count.

    `found` becomes the lowest and the highest; `along` has unit length, m is 1 or 2.
    """
    low, high = -math.inf, math.inf
    for j in range(count):
        row = rows[j * wide :]
        slope, offset = 0.0, row[m]
        for i in range(m):
            slope += row[i] * along[i]
            offset -= row[i] * base[i]
        if abs(slope) <= PARALLEL:
            if offset < -APART * (1.0 + abs(row[m])):
                found[0], found[1] = math.inf, -math.inf
                return False
        elif slope > 0.0:
            high = min(high, offset / slope)
        else:
            low = max(low, offset / slope)
    if high < low and low <= high + CLOSE * (1.0 + abs(low)):
        low = high
    found[0], found[1] = low, high
    return low <= high


def dot(a: Floats, b: Floats, m: int) -> float:
    """The inner product of the first m entries."""
    total = 0.0
    for i in range(m):
        total += a[i] * b[i]
    return total


def span(normal: Floats, plane: Floats, wide: int, m: int) -> None:
    """Fill the rows of `plane` with an orthonormal basis of the plane normal to a unit vector.

    They are those of I - 2 w w^T / |w|^2, the reflection of the normal to an axis, but one.
    """
    pivot = 0
    for i in range(m):
        if abs(normal[i]) > abs(normal[pivot]):
            pivot = i
    side = 1.0 if normal[pivot] >= 0.0 else -1.0
    size = 2.0 * (1.0 + abs(normal[pivot]))  # |w|^2 of w = normal + side e_pivot
    for c in range(m - 1):
        k = c if c < pivot else c + 1
        for i in range(m):
            w = normal[i] + (side if i == pivot else 0.0)
            plane[c * wide + i] = (1.0 if i == k else 0.0) - 2.0 * normal[k] * w / size


def nearest_in_plane(rows: Floats, wide: int, count: int, m: int, x: Floats, small: Floats) -> bool:
    """`nearest` for one or two coordinates."""
    base, along, found = small, small[2:], small[4:]
    if m == 1:
        base[0], along[0] = 0.0, 1.0
        inside = interval(rows, wide, count, 1, base, along, found)
        x[0] = min(max(x[0], found[0]), found[1])
        return inside
    given0, given1 = x[0], x[1]
    for j in range(count):
        row = rows[j * wide :]
        n0, n1, offset = row[0], row[1], row[2]
        if n0 * x[0] + n1 * x[1] - offset <= CLOSE * (1.0 + abs(offset)):
            continue
        base[0], base[1] = offset * n0, offset * n1
        along[0], along[1] = -n1, n0
        if not interval(rows, wide, j, 2, base, along, found):
            return False
        s = min(max(n0 * given1 - n1 * given0, found[0]), found[1])
        x[0], x[1] = base[0] - s * n1, base[1] + s * n0
    return True


def restrict(
    rows: Floats, wide: int, count: int, m: int, normal: Floats, offset: float, base: Floats,
    plane: Floats, inner: Floats,
) -> int:  # fmt: skip
    """The constraints on the plane base + plane s where `normal` has its `offset`, in terms of s.

    Returns how many there are; -1 where one is parallel to the plane and excludes it.
    """
    for i in range(m):
        base[i] = offset * normal[i]
    span(normal, plane, wide, m)
    kept = 0
    for j in range(count):
        row, own = rows[j * wide :], inner[kept * wide :]
        size = 0.0
        for c in range(m - 1):
            own[c] = dot(row, plane[c * wide :], m)
            size += own[c] * own[c]
        size = math.sqrt(size)
        rest = row[m] - dot(row, base, m)
        if size <= PARALLEL:
            if rest < -APART * (1.0 + abs(row[m])):
                return -1
            continue
        for c in range(m - 1):
            own[c] /= size
        own[m - 1] = rest / size
        kept += 1
    return kept


def nearest(
    rows: Floats, wide: int, count: int, m: int, x: Floats, room: Floats, counts: Wholes
) -> bool:
    """Move x in R^m to the nearest point with rows[j, :m] . x <= rows[j, m], j < count.

    The normals have unit length. Returns whether there is such a point. The problems of fewer
    dimensions are solved floor by floor, without recursion.
    """
    if m <= 2:
        return nearest_in_plane(rows, wide, count, m, x, room)
    small, floor_size = room, count * wide + (3 + wide) * wide
    floors = room[6:]  # of each: its point, what was wanted, its base, its plane, its constraints
    met = counts[m + 1 :]
    top = floors[m * floor_size :]
    for i in range(m):
        top[i] = top[wide + i] = x[i]
    top = top[(3 + wide) * wide :]
    for k in range(count * wide):
        top[k] = rows[k]
    counts[m], met[m] = count, 0
    floor = m
    while True:
        own = floors[floor * floor_size :]
        given, base, plane = own[wide:], own[2 * wide :], own[3 * wide :]
        table = own[(3 + wide) * wide :]
        if floor == 2:
            if not nearest_in_plane(table, wide, counts[2], 2, own, small):
                return False
        else:
            j = met[floor]
            while j < counts[floor]:
                row = table[j * wide :]
                if dot(row, own, floor) - row[floor] > CLOSE * (1.0 + abs(row[floor])):
                    break
                j += 1
            met[floor] = j + 1
            if j < counts[floor]:
                normal, below = table[j * wide :], floors[(floor - 1) * floor_size :]
                inner = below[(3 + wide) * wide :]
                kept = restrict(
                    table, wide, j, floor, normal, normal[floor], base, plane, inner
                )  # fmt: skip
                if kept < 0:
                    return False
                for i in range(floor - 1):
                    below[i] = below[wide + i] = dot(given, plane[i * wide :], floor)
                floor -= 1
                counts[floor], met[floor] = kept, 0
                continue
        if floor == m:
            for i in range(m):
                x[i] = own[i]
            return True
        floor += 1
        above = floors[floor * floor_size :]
        for i in range(floor):
            total = 0.0
            for c in range(floor - 1):
                total += above[(3 + c) * wide + i] * own[c]
            above[i] = above[2 * wide + i] + total
