"""Model reduction: states become inputs or disturbances (`promote`), or are left out.

The bounds of a velocity that becomes an input are those that the inputs can hold steadily.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.bounds import Bounds, Box, product, section
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.definitions.system import System

LOOKED_AT = 64
"""Number of values tried below the first doubled value that cannot be held."""
LARGEST = 1e9
"""Beyond this a value counts as unbounded."""


@checked
def steady_bounds(system: System, states: tuple[str, ...]) -> Box:
    """The interval around 0 of every state in which the inputs can hold it, as a box.

    A value s of a state with the rate f + g . u is held while some u within the input bounds gives

        f(s) + g(s) . u = 0

    with all other states and the disturbances 0: still water. The interval ends at the first value
    that cannot be held. Each state is taken by itself, so that a corner of the box may be more than
    the inputs can hold together. In the unit of the state, at the values of the parameters.

    Raises `DefinitionError` for an unknown state, inputs without bounds, a rate that depends on
    time or is not affine in the inputs, and a state that the inputs cannot hold at 0 or hold at
    any value.
    """
    for name in states:
        if name not in system.state_names:
            raise DefinitionError(
                f"'{name}' is not a state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    if system.input_bounds is None:
        raise DefinitionError(
            f"system '{system.name}' has no bounds for its inputs",
            expected="bounds, for the velocities that they hold",
        )
    sides = [(-_furthest(system, n, -1.0), _furthest(system, n, 1.0)) for n in states]
    return Box(tuple(low for low, _ in sides), tuple(high for _, high in sides))


def _furthest(system: System, name: str, side: float) -> float:
    """The largest distance from 0, on one side, at which the state can be held."""
    holds = _holds(system, name)
    if not holds(0.0):
        raise DefinitionError(
            f"the inputs of system '{system.name}' cannot hold '{name}' at 0",
            remedy=f"give an interval: {name} = [lowest, highest]",
        )
    high = 1e-6
    while holds(side * high):
        high *= 2
        if high > LARGEST:
            raise DefinitionError(
                f"the inputs of system '{system.name}' hold every value of '{name}'",
                remedy=f"give an interval: {name} = [lowest, highest]",
            )
    low = 0.0
    for k in range(1, LOOKED_AT):  # a gap below the end is not stepped over
        if not holds(side * high * k / LOOKED_AT):
            high *= k / LOOKED_AT
            break
        low = high * k / LOOKED_AT
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if holds(side * middle) else (low, middle)
    return low


def _holds(system: System, name: str) -> Callable[[float], bool]:
    rate = sp.sympify(system.rates[name])
    inputs = [q.symbol for q in system.inputs]
    if rate.has(TIME):
        raise DefinitionError(
            f"the rate of '{name}' depends on time, so that no value is held steadily",
            remedy=f"give an interval: {name} = [lowest, highest]",
        )
    gains = [rate.diff(u) for u in inputs]
    if any(g.free_symbols & set(inputs) for g in gains):
        raise DefinitionError(
            f"the rate of '{name}' is not affine in the inputs", expected="f + g . u"
        )
    own = next(q.symbol for q in system.states if q.name == name)
    others = (*system.states, *system.disturbances)
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    numbers |= {q.symbol: sp.S.Zero for q in others if q.symbol != own}
    drift = rate.xreplace(dict.fromkeys(inputs, sp.S.Zero)).xreplace(numbers)
    drift, *gains = (e.xreplace(numbers) for e in (drift, *gains))
    assert system.input_bounds is not None
    bounds = system.input_bounds.at({q.symbol: q.value for q in system.parameters})

    @cache
    def reach(*gain: float) -> tuple[float, float]:
        """The least and the largest of g . u."""
        return -bounds.support_value([-g for g in gain]), bounds.support_value(gain)

    def holds(value: float) -> bool:
        here = {own: sp.Float(value)}
        f, *g = (float(e.xreplace(here)) for e in (drift, *gains))
        if not all(map(math.isfinite, (f, *g))):
            return False
        least, most = reach(*g)
        return least <= -f <= most

    return holds


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
