"""What is asked of a whole batch at once: starts, draws, values at given states and times.

Joined after `driver.py` into the generated module, whose functions and constants it uses.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.driver import *  # noqa: F403

# -- joined from here on


@compiled
def sample_starts(first, last, lower, upper, plant, seed, watch, attempts, out):
    """Uniform states of the box that satisfy every inequality, by rejection.

    Run i draws from its own counter, so it gets the same start in any batch; `out` has a row for
    each of first..last-1. Returns the first run that found none in `attempts` draws, or -1.
    """
    n = len(lower)
    for run in range(first, last):
        found = False
        for attempt in range(attempts):
            for i in range(n):
                a, _ = two_uniforms(seed, run, attempt, i, START_STREAM)
                out[run - first, i] = lower[i] + a * (upper[i] - lower[i])
            found = True
            if watch > 0:
                c = constraints(as_tuple(out[run - first]), plant)
                for j in range(watch):
                    found = found and c[j] <= 0.0
            if found:
                break
        if not found:
            return run
    return -1


@compiled
def draw_varied(first, lower, upper, seed, out):
    """Uniform numbers of the runs from `first` on; run i draws from its own counter."""
    for run in range(out.shape[0]):
        for j in range(len(lower)):
            a, _ = two_uniforms(seed, first + run, 0, j, VARIED_STREAM)
            out[run, j] = lower[j] + a * (upper[j] - lower[j])


@compiled
def evaluate_varied(plant, columns, draws, out):
    """What follows from the draws of every run."""
    p = plant.copy()
    for run in range(draws.shape[0]):
        for j in range(len(columns)):
            p[columns[j]] = draws[run, j]
        values = varied(p)
        for j in range(out.shape[1]):
            out[run, j] = values[j]


@compiled
def evaluate_constraints(states, plant, watch, out):
    """c_j of every given state."""
    for run in range(states.shape[0]):
        c = constraints(as_tuple(states[run]), plant)
        for j in range(watch):
            out[run, j] = c[j]


@compiled
def evaluate_disturbance(times, plant, out):
    """d(t) at every given time."""
    for i in range(len(times)):
        d = disturbance(times[i], plant)
        for j in range(out.shape[1]):
            out[i, j] = d[j]
