"""ENO of second order (Osher, Shu 1991)."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.finite_differences import *  # noqa: F403

SCHEME = {"ghosts": 2, "order": 2}

# -- joined from here on


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
