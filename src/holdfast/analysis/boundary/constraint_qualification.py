"""When the linearised cone of active constraints is the contingent cone.

    { v : g_i . v <= 0 for every active i },   g_i = grad c_i

Linear constraints alone need nothing more: the ray along v stays inside (Abadie). Beside others it
suffices that some v has g . v < 0 for these and g . v <= 0 for the linear ones (Mangasarian and
Fromovitz): a velocity of the cone and a little of v stay inside along a straight line. Linearly
dependent, redundant and opposed gradients are no obstacle to either.

Two constraints c <= 0 and -c <= 0 that are not linear are an equality, and the region has no
interior: their gradients have to be independent, and v tangent to them, with g . v < 0 for all
constraints that are no equalities. O. L. Mangasarian, Nonlinear Programming (1969), chapter 11.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from holdfast.execution.arrays import Array

Mask = npt.NDArray[np.bool_]

SMALL = 1e-9
"""Of gradients of length 1."""


def qualified(normals: Array, linear: Mask, equality: npt.NDArray[np.intp]) -> bool:
    """Whether the linearised cone is exact.

    normals: the gradients, shape (active, n), none of them 0. linear: which constraints are affine.
    equality: the number of the equality that each is a side of, or -1 (`equalities`).
    """
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    bent = (equality >= 0) & ~linear
    curved, flat = unit[~linear & ~bent], unit[linear]
    if not bent.any():
        return _has_direction(curved, flat, flat[:0])
    implied = np.array([not _has_direction(row[np.newaxis], flat, flat[:0]) for row in flat], bool)
    _, first = np.unique(equality[bent], return_index=True)
    ties = np.vstack([unit[bent][first], _independent(flat[implied])])
    if np.linalg.matrix_rank(ties, tol=SMALL) < len(ties):
        return False
    return _has_direction(np.vstack([curved, flat[~implied]]), flat[:0], ties)


def equalities(normals: Array, values: Array) -> npt.NDArray[np.intp]:
    """For each constraint the number of the equality that it is a side of, or -1.

    Two are the sides of one where c and -c are the same but for a factor above 0. values: those of
    the constraints at random states, shape (states, active).
    """
    sizes = np.linalg.norm(normals, axis=1)
    unit = normals / sizes[:, np.newaxis]
    values = values[np.isfinite(values).all(axis=1)] / sizes
    scale = np.abs(values).max(initial=0.0, axis=1)
    number, both = np.arange(len(unit)), np.zeros(len(unit), dtype=bool)
    for i in range(len(unit) if len(values) else 0):
        for j in range(i):
            sign = np.sign(unit[i] @ unit[j])
            same = np.abs(values[:, i] - sign * values[:, j]) <= SMALL * scale
            if np.abs(unit[i] - sign * unit[j]).max() <= SMALL and same.all():
                number[i] = number[j]
                both[number[i]] |= sign < 0
                break
    return np.where(both[number], number, -1)


def _has_direction(below: Array, at_most: Array, ties: Array) -> bool:
    """Whether some v has below v < 0, at_most v <= 0 and ties v = 0."""
    if not len(below):
        return True
    n = below.shape[1]
    rows = np.vstack(
        [
            np.hstack([below, np.ones((len(below), 1))]),
            np.hstack([at_most, np.zeros((len(at_most), 1))]),
        ]
    )
    found = linprog(
        [*np.zeros(n), -1.0],
        A_ub=rows,
        b_ub=np.zeros(len(rows)),
        A_eq=np.hstack([ties, np.zeros((len(ties), 1))]) if len(ties) else None,
        b_eq=np.zeros(len(ties)) if len(ties) else None,
        bounds=[(-1, 1)] * n + [(None, 1)],
    )
    return bool(found.status == 0 and -found.fun > SMALL)


def _independent(rows: Array) -> Array:
    """Rows that span what the rows span."""
    if not len(rows):
        return rows
    _, sizes, right = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(right[sizes > SMALL])
