"""Leaves that draw random numbers: measurement noise, starts, what differs from run to run."""

from __future__ import annotations

from holdfast.execution.arithmetic.random import (
    NORMAL,
    START,
    UNIFORM,
    VARIED,
    normal,
    two_uniforms,
)
from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value
from holdfast.execution.codegen.lane_leaves import Results, Rows, made
from holdfast.execution.codegen.llvm_text import Leaf

DRAW = ("run", "draw", "seed_low", "seed_high")
"""Rows of what a number is drawn for: which run, which of its draws; the seed's two words."""


def noise_leaf(states: int) -> Leaf:
    """The states x with noise: half-widths, then standard deviations p, for `DRAW` t."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        run, sample, *seed = values["t"]
        wide, deviations = values["p"][:states], values["p"][states:]
        found = []
        for i, x in enumerate(values["x"]):
            a, _ = two_uniforms((seed[0], seed[1]), run, sample, i, UNIFORM)
            b, c = two_uniforms((seed[0], seed[1]), run, sample, i, NORMAL)
            found.append(x + wide[i] * (2.0 * a - 1.0) + deviations[i] * normal(b, c))
        return found

    return made(results, t=len(DRAW), x=states, p=2 * states)


def starts_leaf(count: int) -> Leaf:
    """A uniform state of the box from q to x, at the draw of `DRAW` t."""
    return made(_uniform(count, START), t=len(DRAW), q=count, x=count)


def varied_leaf(count: int) -> Leaf:
    """Uniform numbers from q to x for a run."""
    return made(_uniform(count, VARIED), t=len(DRAW), q=count, x=count)


def _uniform(count: int, purpose: int) -> Results:
    def results(steps: Steps, values: Rows) -> list[Value]:
        run, sample, *seed = values["t"]
        sample = steps.constant(0.0, FLOAT) if purpose == VARIED else sample
        found = []
        for i in range(count):
            a, _ = two_uniforms((seed[0], seed[1]), run, sample, i, purpose)
            low, high = values["q"][i], values["x"][i]
            found.append(low + a * (high - low))
        return found

    return results
