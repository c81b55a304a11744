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
STIFFNESS = 1e-6  # of the slack, against the distance: it is as small as it can be, nearly

recursive = njit(cache=True, error_model="numpy", nogil=True)


@compiled
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
            if offset < -CLOSE * (1.0 + abs(rows[j, m])):
                return np.inf, -np.inf
        elif slope > 0.0:
            high = min(high, offset / slope)
        else:
            low = max(low, offset / slope)
    if high < low <= high + CLOSE * (1.0 + abs(low)):
        low = high
    return low, high


@compiled
def dot(a, b, m):
    """The inner product of the first m entries."""
    total = 0.0
    for i in range(m):
        total += a[i] * b[i]
    return total


@recursive
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


@recursive
def nearest(rows, count, m, x):
    """Move x in R^m to the nearest point with rows[j, :m] . x <= rows[j, m], j < count.

    The normals have unit length. Returns whether there is such a point.
    """
    if m == 1:
        low, high = interval(rows, count, 1, (0.0,), (1.0,))
        x[0] = min(max(x[0], low), high)
        return low <= high
    if m == 2:
        given = (x[0], x[1])
        for j in range(count):
            n0, n1, offset = rows[j, 0], rows[j, 1], rows[j, 2]
            if n0 * x[0] + n1 * x[1] - offset <= CLOSE * (1.0 + abs(offset)):
                continue
            height = n0 * given[0] + n1 * given[1] - offset
            base = (given[0] - height * n0, given[1] - height * n1)
            low, high = interval(rows, j, 2, base, (-n1, n0))
            if low > high:
                return False
            s = min(max(0.0, low), high)
            x[0], x[1] = base[0] - s * n1, base[1] + s * n0
        return True
    given = x.copy()
    base, plane, inner, s = np.empty(m), np.empty((m, m - 1)), np.empty((count, m)), np.empty(m - 1)
    for j in range(count):
        normal = rows[j]
        offset = normal[m]
        if dot(normal, x, m) - offset <= CLOSE * (1.0 + abs(offset)):
            continue
        height = dot(normal, given, m) - offset
        for i in range(m):
            base[i] = given[i] - height * normal[i]
        span(normal, plane, m)
        kept = 0
        for before in range(j):
            size = 0.0
            for column in range(m - 1):
                inner[kept, column] = dot(rows[before], plane[:, column], m)
                size += inner[kept, column] ** 2
            size = math.sqrt(size)
            offset = rows[before, m] - dot(rows[before], base, m)
            if size <= PARALLEL:
                if offset < -CLOSE * (1.0 + abs(rows[before, m])):
                    return False
                continue
            for column in range(m - 1):
                inner[kept, column] /= size
            inner[kept, m - 1] = offset / size
            kept += 1
        s[:] = 0.0
        if not nearest(inner, kept, m - 1, s):
            return False
        for i in range(m):
            x[i] = base[i] + dot(plane[i], s, m - 1)
    return True


@compiled
def fill(rows, constraints_, scales, m, hard, relaxed):
    """Constraints in units of the scales, with unit normals; the slack is one more coordinate.

    Returns how many rows there are; -1 where one without inputs cannot be met.
    """
    count = 0
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
            rows[count, m] = 0.0 if j < hard else -STIFFNESS
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


@recursive
def solve(wanted, scales, constraints_, hard, result):
    """What `keep_within` does where the wanted input violates a constraint."""
    m = len(wanted)
    most = len(constraints_) // (m + 1)
    rows = np.empty((most, m + 2))
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
    y = np.zeros(m + 1)
    for i in range(m):
        y[i] = wanted[i] / scales[i]
    if not nearest(rows, count, m + 1, y):
        result[m] = np.inf
        return
    for i in range(m):
        result[i] = y[i] * scales[i]
    worst = 0.0
    for j in range(hard, most):
        level = -constraints_[j * (m + 1) + m]
        for i in range(m):
            level += constraints_[j * (m + 1) + i] * result[i]
        worst = max(worst, level)
    result[m] = worst


@compiled
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
        number = number and level == level
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
