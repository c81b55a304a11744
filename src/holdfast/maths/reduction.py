"""Smaller systems out of larger ones: states promoted to inputs."""

from __future__ import annotations

from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.bounds import Bounds
from holdfast.maths.system import System


def promote(system: System, states: tuple[str, ...], bounds: Bounds | None = None) -> System:
    """The subsystem in which `states` are inputs and the former inputs are gone.

    The subsystem Sigma_1 of section 5.4.2 is promote(marine_vehicle, ("u", "r")). Raises
    `DefinitionError` for an unknown state, or when a remaining rate contains an old input.
    """
    for name in states:
        if name not in system.state_names:
            raise DefinitionError(
                f"'{name}' is no state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    rates = {n: r for n, r in system.rates.items() if n not in states}
    old_inputs = {q.symbol for q in system.inputs}
    for name, rate in rates.items():
        if rate.free_symbols & old_inputs:
            raise DefinitionError(
                f"the rate of '{name}' depends on an input of system '{system.name}'",
                expected="only promoted states to be driven by the inputs",
                remedy=f"promote '{name}' too",
            )
    rows = tuple(row for row in system.pfaffian if not set(row.coefficients) & set(states))
    return System(
        name=f"{system.name}, {' and '.join(states)} as inputs",
        states=tuple(q for q in system.states if q.name not in states),
        inputs=tuple(q for n in states for q in system.states if q.name == n),
        rates=rates,
        parameters=system.parameters,
        disturbances=system.disturbances,
        input_bounds=bounds,
        disturbance_bounds=system.disturbance_bounds,
        pfaffian=rows,
        description=system.description,
        source=system.source,
    )
