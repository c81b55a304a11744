"""Checks of a prescribed disturbance against the bounds of its system."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import sympy as sp

from holdfast.errors import SimulationError
from holdfast.maths.definitions.bounds import section
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.definitions.system import System

LOOKED_AT = 257
"""Number of times at which a time-dependent disturbance is compared with its bounds."""

WITHOUT_END = 1e9
"""A larger factor counts as unbounded."""


def check_given(
    system: System,
    given: Mapping[str, sp.Expr],
    numbers: Mapping[sp.Symbol, sp.Float],
    interval: tuple[float, float],
) -> None:
    """Refuse a prescribed disturbance that leaves its bounds at any of many times."""
    which = [d.name in given for d in system.disturbances]
    bounds = section(system.disturbance_bounds, which)
    if bounds is None:
        return
    bounds = bounds.at(numbers)
    names = [n for n in system.disturbance_names if n in given]
    values = [given[n].xreplace(dict(numbers)) for n in names]
    moves = any(v.has(TIME) for v in values)
    for time in np.linspace(*interval, LOOKED_AT if moves else 1):
        now = [float(v.subs(TIME, float(time))) for v in values]
        if not bounds.contains(now):
            when = f" at {time:g} s" if moves else ""
            shown = ", ".join(f"{n} = {v:g}" for n, v in zip(names, now, strict=True))
            raise SimulationError(
                f"a disturbance is given outside its bounds: {shown}{when}",
                expected=f"values within {bounds.text()}",
                remedy="give a smaller disturbance, or widen the bounds of the system",
            )


def largest_factor(system: System, given: Mapping[str, float | sp.Expr]) -> float:
    """The largest factor that keeps a constant prescribed disturbance within its bounds."""
    bounds = section(system.disturbance_bounds, [d.name in given for d in system.disturbances])
    if bounds is None:
        return math.inf
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    bounds = bounds.at(numbers)
    told = [sp.sympify(given[n]) for n in system.disturbance_names if n in given]
    values = [float(e.xreplace(numbers)) for e in told]

    def allowed(factor: float) -> bool:
        return bounds.contains([factor * v for v in values], 0.0)

    low, high = 0.0, 1.0
    while allowed(high):
        low, high = high, 2 * high
        if high > WITHOUT_END:
            return math.inf
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if allowed(middle) else (low, middle)
    return low
