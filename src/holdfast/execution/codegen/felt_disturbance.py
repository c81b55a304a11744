"""The disturbances of a closed loop as expressions: numbers, functions of time, fields of a state.

A field d(t, q, p) is evaluated at the true state of the plant: its rates at every stage of a step,
what a law measures of it at the state and the time that the law sees, without noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import SimulationError, suggestion
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.definitions.system import System


@dataclass(frozen=True)
class FeltDisturbance:
    """What a plant feels of each disturbance, in the order of the system.

    expressions: of t, states, parameters and the symbols of `given`, numbers that are handed over
    as parameters are, so that another current needs no new program. in_run: whether it varies
    within a run; of_state: whether it is a field of the state. bounded: how many have to be
    watched during a run, since only the states that are reached tell whether a field keeps its
    bounds.
    """

    expressions: tuple[sp.Expr, ...]
    given: Mapping[sp.Symbol, float]
    in_run: bool
    of_state: bool
    bounded: int

    def excess(self, system: System) -> list[sp.Expr]:
        """How far the disturbance is outside its bounds, above 0 where it is, then its values."""
        if not self.bounded:
            return []
        assert system.disturbance_bounds is not None
        nearest = system.disturbance_bounds.saturate(self.expressions)
        pairs = zip(self.expressions, nearest, strict=True)
        beyond = sp.Add(*((e - n) ** 2 for e, n in pairs))
        size = sp.Add(*(e**2 for e in self.expressions))
        return [beyond - SLACK**2 * size, *self.expressions]


SLACK = sp.Float(1e-9)
"""The share of its size by which a value may exceed its bounds: that of `Bounds.contains`."""


def felt_disturbance(
    system: System, disturbance: Mapping[str, sp.Expr], parameters: Iterable[sp.Symbol]
) -> FeltDisturbance:
    """The given disturbances, those not named 0.

    Raises `SimulationError` for an expression of anything but t, states and parameters.
    """
    own = [sp.sympify(disturbance.get(q.name, 0)) for q in system.disturbances]
    states, known = {q.symbol for q in system.states}, set(parameters)
    for q, expression in zip(system.disturbances, own, strict=True):
        unknown = sorted(map(str, expression.free_symbols - known - states - {TIME}))
        if unknown:
            raise SimulationError(
                f"disturbance '{q.name}' uses '{unknown[0]}'",
                expected="an expression of t, states of the plant and declared parameters",
                remedy=suggestion(unknown[0], sorted(map(str, known | states))),
            )
    names = [q.name for q in system.disturbances]
    numbers = [
        n in disturbance and e.is_Number and e.is_finite for n, e in zip(names, own, strict=True)
    ]
    used = set().union(*(e.free_symbols for e in own)) if own else set()
    of_state = bool(used & states)
    as_symbols = {n: sp.Symbol(f"_given_{n}", real=True) for n in names}  # no user name begins so
    return FeltDisturbance(
        expressions=tuple(
            as_symbols[n] if is_number else e
            for n, e, is_number in zip(names, own, numbers, strict=True)
        ),
        given={
            as_symbols[n]: float(e)
            for n, e, is_number in zip(names, own, numbers, strict=True)
            if is_number
        },
        in_run=of_state or TIME in used,
        of_state=of_state,
        bounded=len(own) if of_state and system.disturbance_bounds is not None else 0,
    )
