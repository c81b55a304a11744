"""Times inside a step when an inequality peaks or is violated. Joined after `driver.py`."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.simulation.driver import *  # noqa: F403

# -- joined from here on


@inlined
def constraint_at(s, j, h, q, k0, new, k1, plant, scratch):
    """c_j at the fraction s of a step."""
    hermite(s, h, q, k0, new, k1, scratch)
    return constraints(as_tuple(scratch), plant)[j]


@inlined
def peak_fraction(j, h, q, k0, new, k1, plant, scratch):
    """The place in (0, 1) where c_j is largest, on a step where it rises first and falls last.

    By golden section along the interpolated state, so that a kink (the smaller of two
    constraints, a magnitude) is found as well as a smooth peak.
    """
    ratio = 0.6180339887498949
    lower, upper = 0.0, 1.0
    left, right = 1.0 - ratio, ratio
    c_left = constraint_at(left, j, h, q, k0, new, k1, plant, scratch)
    c_right = constraint_at(right, j, h, q, k0, new, k1, plant, scratch)
    for _ in range(40):
        if c_left > c_right:
            upper, right, c_right = right, left, c_left
            left = upper - ratio * (upper - lower)
            c_left = constraint_at(left, j, h, q, k0, new, k1, plant, scratch)
        else:
            lower, left, c_left = left, right, c_right
            right = lower + ratio * (upper - lower)
            c_right = constraint_at(right, j, h, q, k0, new, k1, plant, scratch)
    return 0.5 * (lower + upper)


@inlined
def crossing_fraction(j, level, upper, h, q, k0, new, k1, plant, scratch):
    """The fraction of a step at which c_j first exceeds `level`, by bisection."""
    lower = 0.0
    for _ in range(50):
        middle = 0.5 * (lower + upper)
        if constraint_at(middle, j, h, q, k0, new, k1, plant, scratch) > level:
            upper = middle
        else:
            lower = middle
    return upper
