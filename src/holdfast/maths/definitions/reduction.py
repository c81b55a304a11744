"""Model reduction: states become inputs or disturbances (`promote`), or are left out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.bounds import Bounds, product, section
from holdfast.maths.definitions.system import System


@checked
def promote(
    system: System,
    states: tuple[str, ...],
    bounds: Bounds | None = None,
    *,
    disturbances: tuple[str, ...] = (),
    disturbance_bounds: Bounds | None = None,
) -> System:
    """The subsystem in which `states` are the inputs, and the former inputs are gone.

    disturbances: states that become disturbances, listed before the existing ones, within
    `disturbance_bounds`. `steady_bounds` gives the `bounds` that the former inputs can hold. The
    subsystem Sigma_1 of section 5.4.2 is promote(marine_vehicle, ("u", "r")); (7.4) of the thesis
    has the sway velocity "v" as a disturbance too. Raises `DefinitionError` for an unknown state,
    or when a remaining rate contains an old input.
    """
    promoted = (*states, *disturbances)
    _check_names(system, promoted)
    rates = {n: r for n, r in system.rates.items() if n not in promoted}
    old_inputs = {q.symbol for q in system.inputs}
    for name, rate in rates.items():
        if rate.free_symbols & old_inputs:
            raise DefinitionError(
                f"the rate of '{name}' depends on an input of system '{system.name}'",
                expected="only promoted states to be driven by the inputs",
                remedy=f"promote '{name}' too",
            )
    by_name = {q.name: q for q in system.states}
    name = f"{system.name}, {' and '.join(states)} as inputs"
    if disturbances:
        name += f", {' and '.join(disturbances)} as disturbance"
    felt = system.disturbance_bounds
    if disturbances:
        felt = product(disturbance_bounds, felt) if system.disturbances else disturbance_bounds
    return System(
        name=name,
        states=tuple(q for q in system.states if q.name not in promoted),
        inputs=tuple(by_name[n] for n in states),
        rates=rates,
        parameters=system.parameters,
        disturbances=(*(by_name[n] for n in disturbances), *system.disturbances),
        input_bounds=bounds,
        disturbance_bounds=felt,
        pfaffian=tuple(row for row in system.pfaffian if not set(row.coefficients) & set(promoted)),
        description=system.description,
        source=system.source,
        promoted=promoted,
    )


@checked
def subsystem(system: System, states: tuple[str, ...]) -> System:
    """The subsystem of these states, whose rates do not depend on the others.

    (7.5) of the thesis is the subsystem of ("u", "v", "r"). Disturbances that no remaining rate
    depends on are left out. Raises `DefinitionError` for an unknown state, and for a rate that
    depends on a state that is left out.
    """
    _check_names(system, states)
    rates = {n: r for n, r in system.rates.items() if n in states}
    others = {q.symbol for q in system.states if q.name not in states}
    for name, rate in rates.items():
        if found := rate.free_symbols & others:
            raise DefinitionError(
                f"the rate of '{name}' depends on '{min(map(str, found))}'",
                expected="states whose rates depend on no other",
            )
    used = set().union(*(r.free_symbols for r in rates.values()))
    felt = [q.symbol in used for q in system.disturbances]
    if not any(felt):
        bounds: Bounds | None = None
    else:
        felt = felt if _separable(system.disturbance_bounds, felt) else [True] * len(felt)
        bounds = section(system.disturbance_bounds, felt)
    return replace(
        system,
        name=f"{system.name}, {', '.join(states)} alone",
        states=tuple(q for q in system.states if q.name in states),
        rates=rates,
        disturbances=tuple(q for q, k in zip(system.disturbances, felt, strict=True) if k),
        disturbance_bounds=bounds,
        pfaffian=(),
    )


def _separable(bounds: Bounds | None, kept: list[bool]) -> bool:
    try:
        section(bounds, kept)
    except DefinitionError:
        return False
    return True


def _check_names(system: System, names: Iterable[str]) -> None:
    for name in names:
        if name not in system.state_names:
            raise DefinitionError(
                f"'{name}' is not a state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
