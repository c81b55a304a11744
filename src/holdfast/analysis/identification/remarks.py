"""Why numbers may be wrong although their intervals are narrow, and numbers that cannot be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from holdfast.analysis.identification.identified import IDENTIFIED, Estimate, Unexplained
from holdfast.analysis.identification.least_squares import Fitted
from holdfast.analysis.identification.log import Floats
from holdfast.analysis.identification.noise import first_noise
from holdfast.analysis.identification.windows import Windows
from holdfast.errors import SimulationError
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import derivatives
from holdfast.maths.identification.measured_motion import MeasuredMotion

NOISY, EXPLAINED, SMALL_BOX = 3.0, 0.5, 20
"""The residuals of a signal in parts of the noise between neighbours, the part of what is left
unexplained that noise has to explain, and the windows of a log, from which nothing is said."""


def refuse_no_commands(motion: MeasuredMotion, windows: Windows) -> None:
    """Raises `SimulationError` where all commands are 0: nothing tells force from inertia."""
    if motion.inputs and len(_absent(motion, windows)) == len(motion.inputs):
        raise SimulationError(
            f"{', '.join(q.name for q in motion.inputs)} are 0 throughout the log",
            expected="the commands that moved the vehicle",
        )


def refuse_other_way(before: System, own: System, motion: MeasuredMotion) -> None:
    """Raises `SimulationError` where an input moves a state the other way than before, at rest.

    The inertia that fits has another sign then: no vehicle has it.
    """
    states = [q.name for q in motion.states]
    inputs = [q.symbol for q in motion.inputs]
    symbols = [q.symbol for q in (*own.states, *own.inputs, *own.disturbances)]
    slopes = [derivatives(own.rates[name], inputs) for name in states]
    flat = [slope[s] for slope in slopes for s in inputs]
    if not flat:
        return
    at = np.zeros((1, len(symbols)))
    old, new = (
        Evaluator(flat, symbols, s.parameters).values(at).reshape(len(states), -1)
        for s in (before, own)
    )
    size = np.abs(old).max(axis=0, initial=0.0)
    for i, j in zip(*np.nonzero((old * new < 0) & (np.abs(old) > 0.1 * size)), strict=True):
        raise SimulationError(
            f"the numbers that fit make {motion.inputs[j].name} move {states[i]} the other way: "
            f"{new[i, j]:.3g} {motion.states[i].unit}/s for 1 {motion.inputs[j].unit}, "
            f"not {old[i, j]:.3g}",
            expected="commands in the sign, the unit and at the time in which they acted",
        )


def remarks(
    motion: MeasuredMotion,
    windows: Windows,
    fit: Fitted,
    told: Mapping[str, Estimate],
    bound: Unexplained,
) -> tuple[str, ...]:
    """What a reader of the intervals has to know beside them."""
    found: list[str] = []
    if not fit.settled:
        found.append("the fit did not settle: begin with better numbers, or estimate fewer")
    found += _absent(motion, windows)
    found += _noisy(motion.names, windows, fit.noise)
    for e in told.values():
        if e.status == IDENTIFIED and e.before * e.value < 0 and e.low * e.high > 0:
            found.append(f"{e.name} has the other sign than before")
    shares = zip(bound.names, bound.noise_share, strict=True)
    if more := [n for n, share in shares if share < EXPLAINED]:
        found.append(
            f"noise is less than half of what is left unexplained of {', '.join(more)}: the model "
            "lacks something (an effect, a delay, a unit), which intervals do not count"
        )
    if windows.count < SMALL_BOX:
        found.append(f"intervals and bound are those of {windows.count} windows only")
    return tuple(found)


def _absent(motion: MeasuredMotion, windows: Windows) -> list[str]:
    size = np.abs(windows.inputs).max(axis=(0, 1), initial=0.0)
    least = 1e-9 * size.max(initial=0.0)  # what an allocation rounds
    absent = zip(motion.inputs, size, strict=True)
    return [f"{q.name} is 0 throughout" for q, most in absent if most <= least]


def _noisy(names: Sequence[str], windows: Windows, noise: Floats) -> list[str]:
    usual = first_noise(windows, len(names))
    return [
        f"{n} is {float(f'{now / before:.2g}'):g} times as far from the model as its values from "
        "their neighbours: its unit, its time or the model is wrong"
        for n, now, before in zip(names, noise, usual, strict=True)
        if now > NOISY * before
    ]
