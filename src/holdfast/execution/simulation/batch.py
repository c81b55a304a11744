"""Computations for a whole batch at once: starts, draws, values at given states and times.

Joined after `driver.py` into the generated module, whose functions and constants it uses.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.simulation.driver import *  # noqa: F403

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
    """The values that follow from the draws of every run."""
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


@compiled
def one_sample(
    t, fresh, start, held, mode, in_mode, plant, gains, table, sample_time, substeps, state_out,
    held_out, input_out,
):  # fmt: skip
    """One control sample as `simulate_runs` has it, from a state, a memory and a mode.

    Behind the inputs `input_out` has what a safeguard was given, and its slack, where there is one.
    `fresh`: nothing is remembered yet. Returns the mode and for how long it lasts at the end.
    """
    q = as_tuple(start)
    seen = q + felt(t, plant)
    memory = as_memory(held)
    if fresh:
        memory = first_memory(seen, gains)
    seen = seen + memory
    now = next_mode(t, seen, mode, in_mode, gains)
    lasts = in_mode if now == mode else 0.0
    command = law(t, seen, now, gains, table)
    asked = allocate(command, gains)
    memory = next_memory(t, seen, produce(limit(asked, gains), gains), gains, sample_time)
    u = produce(limit(asked, plant), plant)
    h = sample_time / substeps
    for k in range(substeps):
        k0 = field(t + k * h, q, u, now, plant, gains, table)
        q, _ = step(t + k * h, h, q, k0, u, now, plant, gains, table)
    for i in range(len(state_out)):
        state_out[i] = q[i]
    for i in range(len(held_out)):
        held_out[i] = memory[i]
    m = len(u)
    for i in range(m):
        input_out[i] = u[i]
    if SAFEGUARDED:
        wanted = nominal(command)
        for i in range(m):
            input_out[m + i] = wanted[i]
        input_out[2 * m] = command[m]
    return now, lasts + sample_time
