"""Random numbers of a whole batch: states of a box, and what differs from run to run."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on

START_STREAM, VARIED_STREAM = 2, 4


@compiled
def draw_starts(runs, attempts, lower, upper, seed, out):
    """Uniform states of the box: the `attempts[i]`-th that run `runs[i]` draws.

    A run draws from its own counter, so it gets the same start in any batch.
    """
    for row in range(len(runs)):
        for i in range(len(lower)):
            a, _ = two_uniforms(seed, runs[row], attempts[row], i, START_STREAM)
            out[row, i] = lower[i] + a * (upper[i] - lower[i])


@compiled
def draw_varied(first, lower, upper, seed, out):
    """Uniform numbers of the runs from `first` on; run i draws from its own counter."""
    for run in range(out.shape[0]):
        for j in range(len(lower)):
            a, _ = two_uniforms(seed, first + run, 0, j, VARIED_STREAM)
            out[run, j] = lower[j] + a * (upper[j] - lower[j])
