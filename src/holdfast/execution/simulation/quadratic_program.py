"""The admissible input nearest to a wanted one: small strictly convex quadratic programs, exactly.

    minimise  sum_i ((u_i - wanted_i) / scale_i)^2   subject to   normals u <= offsets

In units of the scales it is the nearest point of a polyhedron. Its half-spaces are met one after
the other (R. Seidel, Discrete Comput. Geom. 6, 1991): where the best point so far violates the next
one, the new best point lies on its plane, which is the same problem with one dimension less and the
half-spaces met before. Half-spaces are rows of `wide` numbers, a normal of unit length and behind
it the offset.

These are scalar functions (`codegen/scalar_reader.py`): the closed loop, exported laws and Python
run the same text. All arrays have one dimension; m is the number of inputs:

    wanted, scales, given, result     (m,)               in the units of the inputs
    constraints                       (most * (m + 1),)  of each the normal, then the offset
    rows                              (count * wide,)    half-spaces; of `keep_many` for each
    inner, plane                      (count * wide,)    as rows; the rows of a basis
    a, b, normal, base, x             (m,)
    small                             (6,)               of a line: base, direction, interval
    along, found                      (2,)               of such a line; lowest and highest
    ends                              (levels,)          where each level of conditions ends
    hard                              (number,)
    out                               (number * (m + 1),)
    room, counts, own                 (numbers_of_programs,)
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


ACTIVE = 1e-9  # the distance to a plane, relative to its terms, below which it holds a point back
PULL = -1e6  # where the slack is wanted, in its own unit: so it is as small as it can be
FAINT = 1e-6  # the size of a normal, against the largest, below which it does not set that unit


def numbers_of_programs(m: int, most: int) -> tuple[int, int]:
    """The numbers of `room` and of `counts` that the programs need for so many constraints."""
    # With the slack a problem has m + 1 coordinates, and a row has the offset behind them. A floor
    # is a problem on a plane of the one above: its rows, its point, what was wanted and its base,
    # and a plane of wide rows. The last two coordinates need 6: base, direction and interval.
    wide, floors = m + 2, m + 2
    rows = (most + 1) * wide
    return m + rows + wide + 6 + floors * (rows + 3 * wide + wide * wide), 2 * floors


def unit_of_slack(constraints: Floats, scales: Floats, m: int, most: int, hard: int) -> float:
    """The size of the smallest normal that may be relaxed: no two of them then look parallel."""
    least, largest = math.inf, 0.0
    for j in range(hard, most):
        size = 0.0
        for i in range(m):
            entry = constraints[j * (m + 1) + i] * scales[i]
            size += entry * entry
        if size > 0.0:
            least, largest = min(least, size), max(largest, size)
    if largest > 0.0:
        return max(math.sqrt(least), FAINT * math.sqrt(largest))
    return 1.0


def fill(
    rows: Floats, constraints: Floats, scales: Floats, m: int, most: int, hard: int, relaxed: bool
) -> int:
    """Constraints in units of the scales, with unit normals; the slack is one more coordinate.

    Returns how many rows there are; -1 where one without inputs cannot be met.
    """
    wide, count, unit, last = m + 2, 0, 0.0, m
    if relaxed:
        unit = unit_of_slack(constraints, scales, m, most, hard)
        for i in range(wide):
            rows[i] = -1.0 if i == m else 0.0  # the slack is 0 or more
        count, last = 1, m + 1
    for j in range(most):
        given, row = constraints[j * (m + 1) :], rows[count * wide :]
        size = 0.0
        for i in range(m):
            row[i] = given[i] * scales[i]
            size += row[i] * row[i]
        if relaxed:
            row[m] = 0.0 if j < hard else -unit
            size += row[m] * row[m]
        size = math.sqrt(size)
        if not size > 1e-300:
            if given[m] < 0.0:
                return -1
            continue
        for i in range(last):
            row[i] /= size
        row[last] = given[m] / size
        count += 1
    return count


def crossed(given: Floats, constraints: Floats, m: int, hard: int) -> bool:
    """Whether one of the first `hard` constraints does not hold."""
    for j in range(hard):
        row = constraints[j * (m + 1) :]
        level, size = -row[m], 0.0
        for i in range(m):
            level += row[i] * given[i]
            size += row[i] * row[i]
        if level > CLOSE * (math.sqrt(size) + abs(row[m])):
            return True
    return False


def solve(
    wanted: Floats, scales: Floats, constraints: Floats, m: int, most: int, hard: int,
    result: Floats, room: Floats, counts: Wholes,
) -> float:  # fmt: skip
    """The case of `keep_within` in which the wanted input violates a constraint."""
    wide, rows = m + 2, room
    y = room[(most + 1) * wide :]
    rest = y[wide:]
    for i in range(m):
        y[i] = wanted[i] / scales[i]
        result[i] = wanted[i]
    count = fill(rows, constraints, scales, m, most, hard, False)
    if count >= 0 and nearest(rows, wide, count, m, y, rest, counts):
        for i in range(m):
            result[i] = y[i] * scales[i]
        return 0.0
    count = fill(rows, constraints, scales, m, most, hard, True)
    reach = 1.0
    for i in range(m):
        y[i] = wanted[i] / scales[i]
        reach = max(reach, abs(y[i]))
    y[m] = PULL * reach
    met = count >= 0 and nearest(rows, wide, count, m + 1, y, rest, counts)
    for i in range(m):
        result[i] = y[i] * scales[i] if met else wanted[i]
    if crossed(result, constraints, m, hard):  # by rounding, beside a faint normal
        for i in range(m):
            y[i] = result[i] / scales[i]
        count = fill(rows, constraints, scales, m, hard, hard, False)
        if count >= 0 and nearest(rows, wide, count, m, y, rest, counts):
            for i in range(m):
                result[i] = y[i] * scales[i]
    if not met:
        return math.inf
    slack = 0.0
    for j in range(hard, most):
        given = constraints[j * (m + 1) :]
        level, size = -given[m], 0.0
        for i in range(m):
            entry = given[i] * scales[i]
            level += given[i] * result[i]
            size += entry * entry
        if level > CLOSE * (math.sqrt(size) + abs(given[m])):  # else it is on its plane
            slack = max(slack, level)
    return slack


def overrules(
    wanted: Floats, given: Floats, slack: float, constraints: Floats, m: int, most: int, hard: int
) -> bool:
    """Whether a constraint after the first `hard` is why `given` is not what was wanted.

    `given` and `slack` are what `keep_within` found. Where only the first `hard` ones hold it back,
    the wanted input is beyond its bounds, and nothing but saturation took place.
    """
    if slack > 0.0:
        return True
    same = True
    for i in range(m):
        same = same and given[i] == wanted[i]
    if same:
        return False
    for j in range(hard, most):
        row = constraints[j * (m + 1) :]
        level, size = -row[m], 0.0
        reach = abs(level)
        for i in range(m):
            level += row[i] * given[i]
            reach += abs(row[i] * given[i])
            size += abs(row[i])
        if size > 0.0 and level >= -ACTIVE * reach:
            return True
    return False


def keep_within(
    wanted: Floats, scales: Floats, constraints: Floats, m: int, most: int, hard: int,
    result: Floats, room: Floats, counts: Wholes,
) -> float:  # fmt: skip
    """The admissible input nearest to `wanted`; returns the slack it needed: 0 where there is one.

    `constraints` holds the m entries of each normal and its offset, one after the other. Where none
    is admissible, the constraints after the first `hard` are all relaxed by the same least slack;
    it is infinite where the hard ones exclude each other. NaN gives NaN. `room` and `counts`:
    see `numbers_of_programs`.
    """
    good, number = True, True
    for j in range(most):
        level = -constraints[j * (m + 1) + m]
        for i in range(m):
            level += constraints[j * (m + 1) + i] * wanted[i]
        good = good and level <= 0.0
        number = number and level < math.inf  # which NaN is not
    if number and not good:
        return solve(wanted, scales, constraints, m, most, hard, result, room, counts)
    for i in range(m):
        result[i] = wanted[i] if number else math.nan
    return 0.0 if number else math.nan


def keep_in_order(
    wanted: Floats, scales: Floats, constraints: Floats, m: int, most: int, hard: int,
    ends: Wholes, levels: int, result: Floats, room: Floats, counts: Wholes,
) -> float:  # fmt: skip
    """`keep_within`, in which the last constraints give way first; returns the largest slack.

    Level i has the constraints up to ends[i], and the last all that are left. Where not all can be
    met, those of each level in turn are relaxed by the least slack that the levels before it, as
    relaxed as they are, allow. The offsets of relaxed constraints are changed.
    """
    own = room[m:]
    slack = keep_within(wanted, scales, constraints, m, most, hard, result, own, counts)
    if levels < 2 or not 0.0 < slack < math.inf:
        return slack
    largest, begin = 0.0, hard
    for i in range(m):
        room[i] = result[i]
    for level in range(levels):
        last = ends[level]
        slack = keep_within(wanted, scales, constraints, m, last, begin, result, own, counts)
        if not slack < math.inf:  # by rounding: the levels before this one are met
            for i in range(m):
                result[i] = room[i]
            return largest
        for i in range(m):
            room[i] = result[i]
        if slack > 0.0:
            largest = max(largest, slack)
            for j in range(begin, last):
                constraints[j * (m + 1) + m] += slack * (1.0 + ACTIVE)
        begin = last
    return largest


def keep_many(
    number: int, wanted: Floats, scales: Floats, rows: Floats, wide: int, counts: Wholes,
    hard: Wholes, m: int, out: Floats, room: Floats, own: Wholes,
) -> None:  # fmt: skip
    """`keep_within` of many programs: each has a row of `wide` numbers and its own counts."""
    for k in range(number):
        result = out[k * (m + 1) :]
        result[m] = keep_within(
            wanted[k * m :], scales[k * m :], rows[k * wide :], m, counts[k], hard[k], result, room,
            own,
        )  # fmt: skip
