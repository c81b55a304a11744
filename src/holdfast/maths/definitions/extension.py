"""Inputs that become states: dynamic extension, and actuators that act late.

Constraints on such inputs become constraints of the state. An actuator has a lag of first order,
and a limit on how fast it changes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Real

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.bounds import Bounds, Box, product, section
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import clip


@checked
def dynamic_extension(
    system: System, inputs: tuple[str, ...], rates: Bounds | None = None
) -> System:
    """The system in which `inputs` are states, whose rates are inputs within `rates`.

        q' = f(q, u),   u' = u_rate

    With a velocity as input its rate is an acceleration, with a force it is how fast an actuator
    acts. A region may then constrain u, and f too, such as an acceleration. The bounds that u had
    do not bound the new inputs: `input_limits` gives them as constraints of the state, which
    belong in the region. Raises `DefinitionError` for an unknown input, and where the others are
    not free of those that are extended.
    """
    for name in inputs:
        if name not in system.input_names:
            raise DefinitionError(
                f"'{name}' is not an input of system '{system.name}'",
                remedy=suggestion(name, system.input_names),
            )
    by_name = {q.name: q for q in system.inputs}
    extended = tuple(by_name[name] for name in inputs)  # `rates` are in this order
    kept = tuple(q for q in system.inputs if q.name not in inputs)
    new = tuple(
        Quantity(f"{q.name}_rate", per_second(q.unit), f"rate of {q.description or q.name}")
        for q in extended
    )
    left = section(system.input_bounds, [q in kept for q in system.inputs]) if kept else None
    return replace(
        system,
        name=f"{system.name}, {' and '.join(inputs)} as states",
        states=(*system.states, *extended),
        inputs=(*kept, *new),
        rates={**system.rates, **{q.name: symbol(f"{q.name}_rate") for q in extended}},
        input_bounds=product(left or free_box(len(kept)), rates or free_box(len(new)))
        if kept
        else rates,
    )


@checked
def input_limits(system: System, inputs: tuple[str, ...] | None = None) -> Region:
    """The bounds of the inputs of a system as a region of its dynamic extension.

    inputs: those that are extended, by default all. Raises `DefinitionError` for inputs without
    bounds, and for a set that is not a polytope.
    """
    names = system.input_names if inputs is None else inputs
    chosen = [q for q in system.inputs if q.name in names]
    bounds = section(system.input_bounds, [q in chosen for q in system.inputs])
    if bounds is None:
        raise DefinitionError(
            f"the inputs {', '.join(names)} of system '{system.name}' have no bounds",
            expected="bounds, to be constraints of the extended system",
        )
    inequalities = []
    for number, (normal, offset) in enumerate(bounds.half_spaces(), start=1):
        felt = [(n, q) for n, q in zip(normal, chosen, strict=True) if n != 0]
        name = f"limit_{number}"
        if len(felt) == 1:
            name = f"{felt[0][1].name}_{'high' if felt[0][0] > 0 else 'low'}"
        expression = sp.Add(*(n * q.symbol for n, q in felt)) - offset
        inequalities.append(Inequality(name, expression, chosen[0].unit))
    return Region(
        name=f"limits of {' and '.join(names)}",
        reads=tuple(chosen),
        inequalities=tuple(inequalities),
        parameters=system.parameters,
        description="the bounds of inputs that are states",
        source="dynamic extension",
    )


@checked
def both(first: Region, second: Region) -> Region:
    """The states in both regions; the name and the text are those of the first."""
    reads = {q.name: q for q in (*first.reads, *second.reads)}
    return replace(
        first,
        reads=tuple(reads.values()),
        inequalities=(*first.inequalities, *second.inequalities),
        parameters=(*first.parameters, *second.parameters),
    )


def free_box(count: int) -> Box:
    """No bounds, as a set: a product with it keeps those of the others."""
    return Box((-sp.oo,) * count, (sp.oo,) * count)


def per_second(unit: str) -> str:
    """m/s -> m/s^2, N -> N/s"""
    if unit.endswith("/s"):
        return f"{unit}^2"
    return "1/s" if unit == "1" else f"{unit}/s"


PREFIX = "actual_"
LAG, SLEW = "_lag", "_slew"
"""Endings of the parameters by which a system declares the lag and the slew of an actuator."""


@checked
def lagged(
    system: System,
    lag: Mapping[str, float] | None = None,
    slew: Mapping[str, float] | None = None,
) -> System:
    """`system` whose actuators act through a lag: what is asked for comes later, and not faster.

        qdot = f(q, a, d),   adot_i = (u_i - a_i) / T_i,   within [-R_i, R_i]

    lag: input, or actuator such as a thruster -> T_i [s], above 0; slew: the same -> R_i [its unit
    per second]. Without both, those that the system declares: parameters NAME_lag and NAME_slew.
    a_i is the state actual_NAME, 0 at the start unless given. The inputs keep their names and
    bounds, so that a law or a filter of `system` runs on the lagged system as it is; a law derived
    from the lagged system itself would know the lag.

    Of actuators, u_i is the share of actuator i in the inputs that the limited actuators produce
    (`LinearImage.allocate`), and M a drives the system. With more actuators than inputs that share
    is the least-squares one, so that at their limits only its sum is what they really give.

    Raises `DefinitionError` for unknown names, inputs and actuators together, and numbers that are
    not above 0.
    """
    own = lag is None
    if lag is None:
        if slew is not None:
            raise DefinitionError("slew without a lag", expected="both, or neither")
        lag, slew = declared(system, LAG), declared(system, SLEW)
        if not lag:
            raise DefinitionError(
                f"system '{system.name}' declares no lag", expected="{input or actuator: seconds}"
            )
    slew = {} if slew is None else slew
    units = actuator_units(system)
    members = _members(system, [*lag, *slew])
    for what, table in (("lag", lag), ("slew", slew)):
        for name, value in table.items():
            if isinstance(value, bool) or not (isinstance(value, Real) and 0 < value < math.inf):
                raise DefinitionError(f"{what} of '{name}' is {value!r}", expected="above 0")
    if not lag:
        raise DefinitionError("lag is empty", expected="{input: seconds}")
    if alone := [name for name in slew if name not in lag]:
        raise DefinitionError(f"slew of '{alone[0]}' without its lag", expected="both")
    constant = {n: symbol(n + LAG if own else f"lag_{n}") for n in lag}
    fastest = {n: symbol(n + SLEW if own else f"slew_{n}") for n in slew}
    parameters = [
        Parameter(f"lag_{n}", "s", f"time constant of {n}", value=float(v), above=0)
        for n, v in lag.items()
    ] + [
        Parameter(f"slew_{n}", per_second(units[n]), f"fastest {n}", value=float(v), above=0)
        for n, v in slew.items()
    ]
    asked = [q.symbol for q in system.inputs]
    acting = {n: symbol(PREFIX + n) for n in lag}
    if members == system.actuators:
        shares = dict(zip(members, system.allocated(asked), strict=True))
        produced = system.produced([acting.get(n, shares[n]) for n in members])
        actual = dict(zip(asked, produced, strict=True))
    else:
        shares = {n: symbol(n) for n in members}
        actual = {symbol(n): a for n, a in acting.items()}
    rates = {name: rate.xreplace(actual) for name, rate in system.rates.items()}
    for name in lag:
        change: sp.Expr = (shares[name] - acting[name]) / constant[name]
        if name in slew:
            change = clip(change, -fastest[name], fastest[name])
        rates[PREFIX + name] = change
    return replace(
        system,
        name=f"{system.name}, {' and '.join(lag)} late",
        states=(
            *system.states,
            *(Quantity(PREFIX + n, units[n], f"{n} that acts") for n in lag),
        ),
        rates=rates,
        parameters=system.parameters if own else (*system.parameters, *parameters),
    )


def declared(system: System, ending: str) -> dict[str, float]:
    """Input or actuator -> the lag or the slew that the system declares for it."""
    values = {p.name: p.value for p in system.parameters}
    return {n: values[n + ending] for n in actuator_units(system) if n + ending in values}


def actuator_units(system: System) -> dict[str, str]:
    """Every input, and every actuator that produces them, with its unit."""
    unit = system.inputs[0].unit if system.inputs else "1"
    return {q.name: q.unit for q in system.inputs} | dict.fromkeys(system.actuators, unit)


def _members(system: System, names: Sequence[str]) -> tuple[str, ...]:
    """The inputs or the actuators, whichever the names are of."""
    for name in names:
        if name not in actuator_units(system):
            raise DefinitionError(
                f"'{name}' is not an input of system '{system.name}'",
                remedy=suggestion(str(name), actuator_units(system)),
            )
    of_actuators = [name in system.actuators for name in names]
    if any(of_actuators) and not all(of_actuators):
        raise DefinitionError(
            "lag of inputs and of the actuators that produce them", expected="one or the other"
        )
    return system.actuators if any(of_actuators) else system.input_names
