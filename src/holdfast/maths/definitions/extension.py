"""Dynamic extension: inputs become states, and constraints on them constraints of the state."""

from __future__ import annotations

from dataclasses import replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.bounds import Bounds, Box, product, section
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System


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
