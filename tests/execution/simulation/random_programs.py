"""Random quadratic programs of seven kinds, and what the compiled solver says to each."""

import numpy as np

from holdfast.execution.codegen.scalar_llvm import called
from holdfast.execution.simulation.quadratic_program import numbers_of_programs

MOST_ROWS = 14


# -- random programs: normals a, offsets b, wanted w around a point p, scales s


def inside(rng, a, b, p):
    """Room around p."""


def anywhere(rng, a, b, p):
    """Offsets that know of no point: many are infeasible."""
    b[:] = rng.normal(size=len(b)) + 0.5


def opposed(rng, a, b, p):
    """Two rows that exclude each other."""
    other = rng.integers(1, len(b))
    a[other] = -a[0] * 10 ** rng.uniform(-1, 1)
    b[0], b[other] = a[0] @ p, a[other] @ p - rng.exponential()


def thin(rng, a, b, p):
    """A gap of 1e-7 to 1e-2 between two rows."""
    other, gap = rng.integers(1, len(b)), 10 ** rng.uniform(-7, -2) * np.linalg.norm(a[0]) / 2
    size = 10 ** rng.uniform(-1, 1)
    a[other] = -a[0] * size
    b[0], b[other] = a[0] @ p + gap, a[other] @ p + gap * size


def vertex(rng, a, b, p):
    """Two rows or more through p."""
    n = rng.integers(2, len(b) + 1)
    b[:n] = a[:n] @ p


def repeated(rng, a, b, p):
    """The same row again, a multiple of it, one turned by 1e-12 to 1e-4; rows of zeros."""
    for j in range(1, len(b)):
        kind, before = rng.integers(5), rng.integers(j)
        if kind < 2:
            a[j] = a[before] * (1.0, 10 ** rng.uniform(-1, 1))[kind]
        elif kind == 2:
            a[j] = a[before] * (1 + 10 ** rng.uniform(-12, -4) * rng.normal(size=len(p)))
        elif kind == 3 and rng.random() < 0.3:
            a[j] = 0.0
    b[:] = a @ p + np.where(rng.random(len(b)) < 0.3, 0.0, rng.exponential(size=len(b)))


def boxed(rng, a, b, p):
    """The image of a box, as bounds of actuators are, and conditions that may not admit it."""
    m = len(p)
    image = rng.normal(size=(m, m))
    b[:] = rng.normal(size=len(b)) + 1.0
    n = min(2 * m, len(b))
    a[:n], b[:n] = np.vstack([image, -image])[:n], 1.0


FAMILIES = (inside, anywhere, opposed, thin, vertex, repeated, boxed)
COUNTS = {1: 800, 2: 5000, 3: 1350}


def program(rng, family, m, badly_scaled):
    """Normals, offsets, how many of them are hard, wanted input, scales."""
    k = rng.integers(3, MOST_ROWS + 1)
    a, p = rng.normal(size=(k, m)), rng.normal(size=m)
    b = a @ p + rng.exponential(size=k)
    family(rng, a, b, p)
    wanted = p + (rng.random() > 0.1) * rng.normal(size=m) * 10 ** rng.uniform(-2, 1.5)
    scales = 10 ** rng.uniform(-0.5, 0.5, m)
    hard = rng.integers(min(k, 6) + 1)
    if family is boxed:
        hard = min(2 * m, k)
    else:
        order = rng.permutation(k)
        a, b = a[order], b[order]
    if badly_scaled:
        scales = 10 ** rng.uniform(-3, 3, m)
        size = 10 ** rng.uniform(-3, 3, k)
        a, b, wanted = a * size[:, None] / scales, b * size, wanted * scales
    return a, b, hard, wanted, scales


def programs(family, m, badly_scaled, count):
    rng = np.random.default_rng([FAMILIES.index(family), m, badly_scaled])
    return [program(rng, family, m, badly_scaled) for _ in range(count)]


def packed(given):
    """Arrays of them all, as the compiled sweep takes them."""
    m = len(given[0][3])
    rows, counts = np.zeros((len(given), MOST_ROWS * (m + 1))), [len(b) for _, b, *_ in given]
    for row, (a, b, *_) in zip(rows, given, strict=True):
        row[: len(b) * (m + 1)] = np.column_stack([a, b]).ravel()
    hard, wanted, scales = (np.array([g[i] for g in given]) for i in (2, 3, 4))
    return {
        "wanted": wanted,
        "scales": scales,
        "rows": rows,
        "counts": np.array(counts),
        "hard": hard,
    }


def answers(given):
    """What the compiled solver says to each, an input and its slack."""
    return solved(*packed(given).values())


def solved(wanted, scales, rows, counts, hard):
    """The input nearest to each wanted one, and its slack, by the compiled solver."""
    number, m = wanted.shape
    room, whole = numbers_of_programs(m, counts.max())
    out = np.empty((number, m + 1))
    called(
        "simulation/quadratic_program", "keep_many", number, wanted, scales, rows, rows.shape[1],
        counts, hard, m, out, np.empty(room), np.empty(whole, dtype=np.int64),
    )  # fmt: skip
    return out
