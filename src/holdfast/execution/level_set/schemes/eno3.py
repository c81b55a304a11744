"""ENO of third order (Osher, Shu 1991)."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.finite_differences import *  # noqa: F403

SCHEME = {"ghosts": 3, "order": 3}

# -- joined from here on


@swept
def eno3_side(a, b, c, d, e):
    """The derivative between b and c from five successive first differences, c being upwind's."""
    d1, d2, d3, d4 = b - a, c - b, d - c, e - d
    if abs(d2) <= abs(d3):
        second, third = d2, smaller(d2 - d1, d3 - d2)
        return c + 0.5 * second + third / 3.0
    second, third = d3, smaller(d3 - d2, d4 - d3)
    return c + 0.5 * second - third / 6.0


@called
def eno3(source, at, k, count, left, right, to):
    """Third order: the smoothest of three stencils."""
    at = (at[k], at[k + 1], at[k + 2], at[k + 3], at[k + 4], at[k + 5])
    to = np.uint64(to)
    for j in range(lanes(count)):
        a, b, c, d, e = five(source, at, j)
        left[to + j] = same_way(eno3_side(a, b, c, d, e), c)
        right[to + j] = same_way(eno3_side(e, d, c, b, a), c)
