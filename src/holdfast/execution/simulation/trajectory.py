"""Functions that every closed loop uses: noise, bounds, errors, points inside a step.

It knows no system, so that it is compiled once for all of as many states. Imported by the
generated modules.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on

STAYED, REACHED, LEFT, DIVERGED, CHATTERED, OFF_GRID = 0, 1, 2, 3, 4, 5

# purposes of random numbers, so that no two uses share a counter
UNIFORM_STREAM, START_STREAM, NORMAL_STREAM, VARIED_STREAM = 1, 2, 3, 4


@inlined
def below(values, bound):
    """Whether every value is a number of magnitude below the bound."""
    good = True
    for value in values:
        good = good and abs(value) < bound
    return good


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
def end_of(run, t, outcome, exit_time):
    """A run ends by diverging; one that had left the region keeps the time and the culprit."""
    if outcome[run] != LEFT:
        exit_time[run] = t
    outcome[run] = DIVERGED


@inlined
def error_size(q, new, error, absolute, relative):
    """The estimated error of a step, 1 where it is what is allowed."""
    total = 0.0
    for i in range(len(q)):
        scale = absolute + relative * max(abs(q[i]), abs(new[i]))
        total += (error[i] / scale) ** 2
    return math.sqrt(total / len(q))


@inlined
def hermite(s, h, a, da, b, db, state):
    """The state at the fraction s of a step, from both ends and their rates."""
    s2 = s * s
    w = 3.0 * s2 - 2.0 * s2 * s
    for i in range(len(a)):
        rise = (s - 2.0 * s2 + s2 * s) * da[i] + (s2 * s - s2) * db[i]
        state[i] = (1.0 - w) * a[i] + w * b[i] + h * rise


@inlined
def tangent_bound(h, c0, d0, c1, d1):
    """The value where the tangents at both ends of a step meet: a bound of c if it is concave."""
    s = (c1 - c0 - h * d1) / (h * (d0 - d1))
    return c0 + h * d0 * s
