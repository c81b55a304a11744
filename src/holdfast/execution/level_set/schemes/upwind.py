"""Upwind differences, of first order."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.finite_differences import *  # noqa: F403

SCHEME = {"ghosts": 1, "order": 1, "one_slope": True, "monotone": True}

# -- joined from here on


@called
def upwind(source, at, count, inverse, work, mean, gap):
    """First order: work[mean + j] and work[gap + j], the mean of two slopes and half their gap."""
    low, here, high = at[0], at[1], at[2]
    half = 0.5 * inverse
    mean, gap = np.uint64(mean), np.uint64(gap)
    for j in range(lanes(count)):
        left = source[here + j] - source[low + j]
        right = source[high + j] - source[here + j]
        work[mean + j] = half * (left + right)
        work[gap + j] = half * (right - left)


@called
def upwind_ends(values, first, tall, nodes, kind, inverse, work, mean, gap):
    """The same at the first and the last node of whole rows of the last axis."""
    half = 0.5 * inverse
    for k in range(tall):
        row = first + k * nodes
        for j in (0, nodes - 1):
            low = values[row + j - 1] if j > 0 else ghost(values, row, -1, nodes, kind)
            high = values[row + j + 1] if j < nodes - 1 else ghost(values, row, nodes, nodes, kind)
            left, right = values[row + j] - low, high - values[row + j]
            work[mean + k * nodes + j] = half * (left + right)
            work[gap + k * nodes + j] = half * (right - left)
