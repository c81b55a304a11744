"""Functions that every closed loop uses: measurement noise, a bound inside a step.

It knows no system. Names in lower case are places in the array w, as in `driver.py`.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on

U = (
    np.uint64
)  # of an index: one that may be negative, counted from the end, bars vector instructions

STAYED, REACHED, LEFT, DIVERGED, CHATTERED, OFF_GRID = 0, 1, 2, 3, 4, 5

# purposes of random numbers, so that no two uses share a counter
UNIFORM_STREAM, START_STREAM, NORMAL_STREAM, VARIED_STREAM = 1, 2, 3, 4


@inlined
def add_noise(noise, seed, run, sample, state):
    """Measurement noise on a state: uniform half-widths, then standard deviations."""
    for i in range(len(state)):
        if noise[0, i] > 0.0:
            a, _ = two_uniforms(seed, run, sample, i, UNIFORM_STREAM)
            state[i] += noise[0, i] * (2.0 * a - 1.0)
        if noise[1, i] > 0.0:
            a, b = two_uniforms(seed, run, sample, i, NORMAL_STREAM)
            state[i] += noise[1, i] * math.sqrt(-2.0 * math.log(a)) * math.cos(TWO_PI * b)


@inlined
def tangent_bound(h, c0, d0, c1, d1):
    """The value where the tangents at both ends of a step meet: a bound of c if it is concave."""
    s = (c1 - c0 - h * d1) / (h * (d0 - d1))
    return c0 + h * d0 * s
