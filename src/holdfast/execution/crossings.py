"""When, inside a step, an inequality peaks or is violated. Joined after `driver.py`."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.driver import *  # noqa: F403

# -- joined from here on


@compiled
def hermite(s, h, a, da, b, db, scratch):
    """The state at the fraction s of a step, from both ends and their rates."""
    s2 = s * s
    w = 3.0 * s2 - 2.0 * s2 * s
    for i in range(len(a)):
        rise = (s - 2.0 * s2 + s2 * s) * da[i] + (s2 * s - s2) * db[i]
        scratch[i] = (1.0 - w) * a[i] + w * b[i] + h * rise
    return as_tuple(scratch)


@compiled
def peak_fraction(j, h, q, k0, new, k1, plant, scratch):
    """Where in (0, 1) c_j is largest on a step at whose start it rises and at whose end it falls.

    By golden section along the interpolated state, so that a kink (the smaller of two
    constraints, a magnitude) is found as well as a smooth peak.
    """
    ratio = 0.6180339887498949
    lower, upper = 0.0, 1.0
    left, right = 1.0 - ratio, ratio
    c_left = constraints(hermite(left, h, q, k0, new, k1, scratch), plant)[j]
    c_right = constraints(hermite(right, h, q, k0, new, k1, scratch), plant)[j]
    for _ in range(40):
        if c_left > c_right:
            upper, right, c_right = right, left, c_left
            left = upper - ratio * (upper - lower)
            c_left = constraints(hermite(left, h, q, k0, new, k1, scratch), plant)[j]
        else:
            lower, left, c_left = left, right, c_right
            right = lower + ratio * (upper - lower)
            c_right = constraints(hermite(right, h, q, k0, new, k1, scratch), plant)[j]
    return 0.5 * (lower + upper)


@compiled
def tangent_bound(h, c0, d0, c1, d1):
    """Where the tangents at both ends of a step meet: c stays below it if it is concave."""
    s = (c1 - c0 - h * d1) / (h * (d0 - d1))
    return c0 + h * d0 * s


@compiled
def crossing_fraction(j, level, upper, h, q, k0, new, k1, plant, scratch):
    """The fraction of a step at which c_j first exceeds `level`, by bisection."""
    lower = 0.0
    for _ in range(50):
        middle = 0.5 * (lower + upper)
        if constraints(hermite(middle, h, q, k0, new, k1, scratch), plant)[j] > level:
            upper = middle
        else:
            lower = middle
    return upper
