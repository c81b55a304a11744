"""The admissible input nearest to a wanted one: small strictly convex quadratic programs, exactly.

    minimise  sum_i ((u_i - wanted_i) / scale_i)^2   subject to   normals u <= offsets

The constraints are met one after the other (R. Seidel, Discrete Comput. Geom. 6, 1991): where the
best point so far violates the next one, the new best point lies on its plane, which is the same
problem with one dimension less and the constraints met before. Joined after `primitives.py` into
the generated modules.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on

CLOSE = 1e-10  # what counts as on a plane, relative to its distance
PARALLEL = 1e-9  # the sine of the angle below which two planes are parallel
APART = 1e-8  # the gap, relative to their distance, above which two such planes exclude each other
ACTIVE = 1e-9  # the distance to a plane, relative to its terms, below which it holds a point back
PULL = -1e6  # where the slack is wanted, in its own unit: so it is as small as it can be
FAINT = 1e-6  # the size of a normal, against the largest, below which it does not set that unit


@inlined
def interval(rows, count, m, base, along):
    """The lowest and the highest s with rows[j, :m] . (base + s along) <= rows[j, m], j < count.

    `along` has unit length, m is 1 or 2. The lowest is above the highest where there is none.
    """
    low, high = -np.inf, np.inf
    for j in range(count):
        slope, offset = 0.0, rows[j, m]
        for i in range(m):
            slope += rows[j, i] * along[i]
            offset -= rows[j, i] * base[i]
        if abs(slope) <= PARALLEL:
            if offset < -APART * (1.0 + abs(rows[j, m])):
                return np.inf, -np.inf
        elif slope > 0.0:
            high = min(high, offset / slope)
        else:
            low = max(low, offset / slope)
    if high < low <= high + CLOSE * (1.0 + abs(low)):
        low = high
    return low, high


@inlined
def dot(a, b, m):
    """The inner product of the first m entries."""
    total = 0.0
    for i in range(m):
        total += a[i] * b[i]
    return total


@apart
def span(normal, plane, m):
    """Fill `plane` with orthonormal columns that span the plane normal to a unit vector.

    They are those of I - 2 w w^T / |w|^2, the reflection of the normal to an axis, but one.
    """
    pivot = 0
    for i in range(m):
        if abs(normal[i]) > abs(normal[pivot]):
            pivot = i
    side = 1.0 if normal[pivot] >= 0.0 else -1.0
    size = 2.0 * (1.0 + abs(normal[pivot]))  # |w|^2 of w = normal + side e_pivot
    for column in range(m - 1):
        k = column if column < pivot else column + 1
        for i in range(m):
            w = normal[i] + (side if i == pivot else 0.0)
            plane[i, column] = (1.0 if i == k else 0.0) - 2.0 * normal[k] * w / size


@apart
def nearest_in_plane(rows, count, m, x):
    """`nearest` for one or two coordinates."""
    if m == 1:
        low, high = interval(rows, count, 1, (0.0,), (1.0,))
        x[0] = min(max(x[0], low), high)
        return low <= high
    given = (x[0], x[1])
    for j in range(count):
        n0, n1, offset = rows[j, 0], rows[j, 1], rows[j, 2]
        if n0 * x[0] + n1 * x[1] - offset <= CLOSE * (1.0 + abs(offset)):
            continue
        base = (offset * n0, offset * n1)
        low, high = interval(rows, j, 2, base, (-n1, n0))
        if low > high:
            return False
        s = min(max(n0 * given[1] - n1 * given[0], low), high)
        x[0], x[1] = base[0] - s * n1, base[1] + s * n0
    return True


@apart
def restrict(rows, count, m, normal, offset, base, plane, inner):
    """The constraints on the plane base + plane s where `normal` has its `offset`, in terms of s.

    Returns how many there are; -1 where one is parallel to the plane and excludes it.
    """
    for i in range(m):
        base[i] = offset * normal[i]
    span(normal, plane, m)
    kept = 0
    for j in range(count):
        size = 0.0
        for column in range(m - 1):
            inner[kept, column] = dot(rows[j], plane[:, column], m)
            size += inner[kept, column] ** 2
        size = math.sqrt(size)
        rest = rows[j, m] - dot(rows[j], base, m)
        if size <= PARALLEL:
            if rest < -APART * (1.0 + abs(rows[j, m])):
                return -1
            continue
        for column in range(m - 1):
            inner[kept, column] /= size
        inner[kept, m - 1] = rest / size
        kept += 1
    return kept


@apart
def nearest(rows, count, m, x):
    """Move x in R^m to the nearest point with rows[j, :m] . x <= rows[j, m], j < count.

    The normals have unit length. Returns whether there is such a point. The problems of fewer
    dimensions are solved floor by floor, without recursion: machine code that calls itself does
    not survive Numba's cache.
    """
    if m <= 2:
        return nearest_in_plane(rows, count, m, x)
    tables = np.empty((m + 1, count, m + 1))  # the constraints of each floor
    points, given, bases = np.empty((m + 1, m)), np.empty((m + 1, m)), np.empty((m + 1, m))
    planes = np.empty((m + 1, m, m))
    counts, met = np.zeros(m + 1, dtype=np.int64), np.zeros(m + 1, dtype=np.int64)
    for j in range(count):
        for i in range(m + 1):
            tables[m, j, i] = rows[j, i]
    for i in range(m):
        points[m, i] = given[m, i] = x[i]
    counts[m] = count
    floor = m
    while True:
        table, point = tables[floor], points[floor]
        if floor == 2:
            if not nearest_in_plane(table, counts[2], 2, point):
                return False
        else:
            j = met[floor]
            while j < counts[floor]:
                offset = table[j, floor]
                if dot(table[j], point, floor) - offset > CLOSE * (1.0 + abs(offset)):
                    break
                j += 1
            met[floor] = j + 1
            if j < counts[floor]:
                below, plane = floor - 1, planes[floor]
                normal, base = table[j], bases[floor]
                kept = restrict(table, j, floor, normal, offset, base, plane, tables[below])
                if kept < 0:
                    return False
                for i in range(below):
                    given[below, i] = points[below, i] = dot(given[floor], plane[:, i], floor)
                counts[below], met[below] = kept, 0
                floor = below
                continue
        if floor == m:
            for i in range(m):
                x[i] = point[i]
            return True
        floor += 1
        for i in range(floor):
            points[floor, i] = bases[floor, i] + dot(planes[floor, i], point, floor - 1)


@inlined
def unit_of_slack(constraints_, scales, m, hard):
    """The size of the smallest normal that may be relaxed: no two of them then look parallel."""
    least, most = np.inf, 0.0
    for j in range(hard, len(constraints_) // (m + 1)):
        size = 0.0
        for i in range(m):
            size += (constraints_[j * (m + 1) + i] * scales[i]) ** 2
        if size > 0.0:
            least, most = min(least, size), max(most, size)
    return max(math.sqrt(least), FAINT * math.sqrt(most)) if most > 0.0 else 1.0


@inlined
def fill(rows, constraints_, scales, m, hard, relaxed):
    """Constraints in units of the scales, with unit normals; the slack is one more coordinate.

    Returns how many rows there are; -1 where one without inputs cannot be met.
    """
    count, unit = 0, 0.0
    if relaxed:
        unit = unit_of_slack(constraints_, scales, m, hard)
        for i in range(m + 2):
            rows[0, i] = -1.0 if i == m else 0.0  # the slack is 0 or more
        count = 1
    for j in range(len(constraints_) // (m + 1)):
        first = j * (m + 1)
        size = 0.0
        for i in range(m):
            entry = constraints_[first + i] * scales[i]
            rows[count, i] = entry
            size += entry * entry
        offset = constraints_[first + m]
        last = m
        if relaxed:
            rows[count, m] = 0.0 if j < hard else -unit
            size += rows[count, m] * rows[count, m]
            last = m + 1
        size = math.sqrt(size)
        if not size > 1e-300:
            if offset < 0.0:
                return -1
            continue
        for i in range(last):
            rows[count, i] /= size
        rows[count, last] = offset / size
        count += 1
    return count


@apart
def solve(wanted, scales, constraints_, hard, result):
    """The case of `keep_within` in which the wanted input violates a constraint."""
    m = len(wanted)
    most = len(constraints_) // (m + 1)
    rows = np.empty((most + 1, m + 2))
    x = np.empty(m)
    for i in range(m):
        x[i] = wanted[i] / scales[i]
        result[i] = wanted[i]
    result[m] = 0.0
    count = fill(rows, constraints_, scales, m, hard, False)
    if count >= 0 and nearest(rows, count, m, x):
        for i in range(m):
            result[i] = x[i] * scales[i]
        return
    count = fill(rows, constraints_, scales, m, hard, True)
    y = np.empty(m + 1)
    reach = 1.0
    for i in range(m):
        y[i] = wanted[i] / scales[i]
        reach = max(reach, abs(y[i]))
    y[m] = PULL * reach
    if count < 0 or not nearest(rows, count, m + 1, y):
        result[m] = np.inf
        return
    for i in range(m):
        result[i] = y[i] * scales[i]
    for j in range(hard, most):
        offset = constraints_[j * (m + 1) + m]
        level, size = -offset, 0.0
        for i in range(m):
            entry = constraints_[j * (m + 1) + i]
            level += entry * result[i]
            size += (entry * scales[i]) ** 2
        if level > CLOSE * (math.sqrt(size) + abs(offset)):  # else it is on its plane
            result[m] = max(result[m], level)


@inlined
def overrules(wanted, given, constraints_, hard):
    """1 where a constraint after the first `hard` is why `given` is not what was wanted, else 0.

    `given` is what `keep_within` found. Where only the first `hard` ones hold it back, the wanted
    input is beyond its bounds, and nothing but saturation took place.
    """
    m = len(wanted)
    same = True
    for i in range(m):
        same = same and given[i] == wanted[i]
    if given[m] > 0.0:
        return 1.0
    if same:
        return 0.0
    for j in range(hard, len(constraints_) // (m + 1)):
        level = -constraints_[j * (m + 1) + m]
        reach, size = abs(level), 0.0
        for i in range(m):
            entry = constraints_[j * (m + 1) + i]
            level += entry * given[i]
            reach += abs(entry * given[i])
            size += abs(entry)
        if size > 0.0 and level >= -ACTIVE * reach:
            return 1.0
    return 0.0


@inlined
def keep_within(wanted, scales, constraints_, hard):
    """The admissible input nearest to `wanted`, and the slack it needed: 0 where there is one.

    `constraints_` holds the entries of each normal and its offset, one after the other. Where
    none is admissible, the constraints after the first `hard` are all relaxed by the same least
    slack; the slack is infinite where the hard ones exclude each other.
    """
    m = len(wanted)
    good = number = True
    for j in range(len(constraints_) // (m + 1)):
        level = -constraints_[j * (m + 1) + m]
        for i in range(m):
            level += constraints_[j * (m + 1) + i] * wanted[i]
        good = good and level <= 0.0
        number = number and level < np.inf  # which what is not a number is not
    result = np.empty(m + 1)
    if not number:
        result[:] = np.nan
    elif good:
        for i in range(m):
            result[i] = wanted[i]
        result[m] = 0.0
    else:
        solve(wanted, scales, constraints_, hard, result)
    return result
