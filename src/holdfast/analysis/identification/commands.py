"""The inputs that a vehicle was given: the commands of a log within the limits of the actuators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy as sp

from holdfast.analysis.identification.log import Log
from holdfast.analysis.identification.windows import Windows
from holdfast.errors import SimulationError
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.system import System

NOTICED = 0.01
"""The share of a log, and of a command, from which what is beyond a limit is said."""

MOST_BEYOND = 0.5
"""The share of a log from which the limits are not those of its vehicle."""


def commanded_names(system: System, log: Log, needed: Sequence[str]) -> tuple[str, ...]:
    """The signals that give the inputs: all inputs, all actuators, or those that are needed.

    Raises `SimulationError` where the log has none of these.
    """
    for names in (system.input_names, system.actuators, tuple(needed)):
        if names and all(n in log.inputs for n in names):
            return tuple(names)
    if not needed:
        return ()
    missing = [n for n in needed if n not in log.inputs]
    also = f", or of {', '.join(system.actuators)}" if system.actuators else ""
    raise SimulationError(
        f"{log.name} has no signal of {', '.join(missing)}",
        expected=f"signals of {', '.join(needed)}{also}",
    )


def applied(
    system: System, windows: Windows, names: Sequence[str], needed: Sequence[str]
) -> Windows:
    """The windows with the inputs that the actuators produce within their limits.

    names: what the windows have (`commanded_names`); needed: the inputs that they get.
    """
    given = [symbol(n) for n in names]
    wishes = _wishes(system, names)
    if wishes is None:
        return windows
    inputs = dict(zip(system.input_names, system.produced(system.limited(wishes)), strict=True))
    compute = Evaluator([inputs[n] for n in needed], given, system.parameters)
    flat = np.ascontiguousarray(windows.inputs.reshape(-1, len(names)))
    shape = (*windows.inputs.shape[:2], len(needed))
    return replace(windows, inputs=compute.values(flat).reshape(shape))


def beyond_limits(system: System, windows: Windows, names: Sequence[str]) -> dict[str, float]:
    """The share of the log in which each actuator is commanded beyond its limits, if it ever is.

    windows: with the commands, before they are limited.
    """
    wishes = _wishes(system, names)
    if wishes is None:
        return {}
    values = [*wishes, *system.limited(wishes)]
    compute = Evaluator(values, [symbol(n) for n in names], system.parameters)
    wished, limited = np.hsplit(compute.values(windows.inputs.reshape(-1, len(names))), 2)
    shares = np.mean(np.abs(wished - limited) > NOTICED * np.abs(wished), axis=0)
    told = zip(system.actuators or system.input_names, shares.tolist(), strict=True)
    return {name: share for name, share in told if share > NOTICED}


def beyond_words(shares: Mapping[str, float]) -> tuple[str, ...]:
    """A sentence for each actuator that is commanded beyond its limits."""
    return tuple(
        f"{name} is commanded beyond its limits in {100 * share:.0f} % of the log, "
        "and the model counts with the limits"
        for name, share in shares.items()
    )


def _wishes(system: System, names: Sequence[str]) -> list[sp.Expr] | None:
    """The actuator values that are asked for; None where only some inputs are known."""
    given = [symbol(n) for n in names]
    if tuple(names) == system.input_names:
        return system.allocated(given)
    return list(given) if tuple(names) == system.actuators else None
