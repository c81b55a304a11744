"""Limits on how fast inputs and states change, as conditions of a safety filter.

    |u_i(k) - u_i(k - 1)| <= R_i h        an input, held for h, never faster than R_i
    |f_s(q, u)| <= A_s                    the rate of a state that the inputs reach: an acceleration

The first are as hard as the bounds of the inputs; the second are relaxed like the conditions of a
region where no input meets them all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from numbers import Real
from typing import TypeVar

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.control.safety_filter import Row, input_rows, input_scales, over_time
from holdfast.maths.control.velocity_tracking import believed_disturbances
from holdfast.maths.definitions.law import Law, Safeguard
from holdfast.maths.definitions.quantity import SAMPLE_TIME, Parameter, Quantity, symbol
from holdfast.maths.definitions.switching import (
    Memory,
    Switching,
    as_switching,
    check_outputs,
    joined,
)
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.random_points import is_zero
from holdfast.maths.expressions.traversal import derivatives, exchanged

L = TypeVar("L", bound=Law | Switching)


@checked
def limit_rates(
    system: System, law: Law | Switching, rates: Mapping[str, float]
) -> Law | Switching:
    """`law` with its inputs, or the rates of states, kept from changing faster.

    rates: name of an input, or of a state in whose rate an input is, -> the largest magnitude of
    its rate, in its unit per second. The law may have a safety filter; it keeps its conditions.
    The input before the first sample counts as 0. A law whose inputs are limited remembers the
    last ones, and is a `Switching`.

    Where the limit of an input leaves no input that meets the other conditions, these are
    relaxed by the least amount, and runs count it: a region's conditions know nothing of it.

    Raises `DefinitionError` for an unknown name, a number that is not above 0, and a state whose
    rate no input reaches, or not affinely.
    """
    check_outputs(system, law)
    if not rates:
        raise DefinitionError("there are no rates", expected="name -> the largest rate")
    for name, value in rates.items():
        if name not in (*system.input_names, *system.state_names):
            raise DefinitionError(
                f"rate of '{name}', which is neither an input nor a state of '{system.name}'",
                remedy=suggestion(str(name), (*system.input_names, *system.state_names)),
            )
        number = isinstance(value, Real) and not isinstance(value, bool)
        if not (number and 0 < float(value) < math.inf):
            raise DefinitionError(f"rate of '{name}' is {value!r}", expected="a number above 0")
    quantities = {q.name: q for q in (*system.inputs, *system.states)}
    parameters = tuple(
        Parameter(f"rate_{n}", over_time(quantities[n].unit, 1), "largest rate", value=float(v))
        for n, v in rates.items()
    )
    limited = [q for q in system.inputs if q.name in rates]
    last = {q.name: Quantity(f"last_{q.name}", q.unit, f"last {q.name}") for q in limited}
    hard = [row for q in limited for row in _steps(system, q.name, last[q.name].symbol)]
    fast = [q for q in system.states if q.name in rates]
    soft = [row for q in fast for row in _rates(system, q.name)]
    units = tuple(over_time(q.unit, 1) for q in fast for _ in range(2))
    names = tuple(f"rate of {q.name}" for q in fast for _ in range(2))

    def kept(mode: Law) -> Law:
        guard = mode.safeguard or _bounds(system)
        still = believed_disturbances(system, mode)
        inputs = system.input_names
        more = [
            [exchanged((e for n, b in rows for e in (*n, b)), still)[i :: len(inputs) + 1]
             for i in range(len(inputs) + 1)]
            for rows in (hard, soft)
        ]  # fmt: skip
        columns = {n: guard.normals[n] for n in inputs} | {"": guard.offsets}
        wider = {
            name: (*own[: guard.hard], *more[0][i], *own[guard.hard :], *more[1][i])
            for i, (name, own) in enumerate(columns.items())
        }
        reads = {q.name: q for q in (*mode.reads, *system.states, *last.values())}
        return replace(
            mode,
            name=f"{mode.name}, rates limited",
            reads=tuple(reads.values()),
            parameters=(*mode.parameters, *system.parameters, *parameters),
            safeguard=replace(
                guard,
                normals={n: wider[n] for n in inputs},
                offsets=wider[""],
                hard=guard.hard + len(hard),
                units=(*guard.units, *units),
                names=(*guard.names, *names),
                levels=(*guard.levels[:-1], guard.levels[-1] + len(soft)) if guard.levels else (),
            ),
        )

    if isinstance(law, Law) and not limited:
        return kept(law)
    modes = as_switching(law)
    found = modes.map_laws(kept, f"{law.name}, rates limited")
    if not limited:
        return found
    memory = Memory(
        quantities=tuple(last.values()),
        initial={q.name: sp.S.Zero for q in last.values()},
        following={last[q.name].name: q.symbol for q in limited},
        reads=(),
        inputs=system.inputs,
    )
    return replace(found, memory=joined(modes.memory, memory))


def _steps(system: System, name: str, last: sp.Symbol) -> list[Row]:
    """|u - last| <= R h."""
    step = symbol(f"rate_{name}") * SAMPLE_TIME
    unit = [sp.Integer(n == name) for n in system.input_names]
    return [(tuple(unit), last + step), (tuple(-e for e in unit), step - last)]


def _rates(system: System, name: str) -> list[Row]:
    """|f + g . u| <= A."""
    inputs = [q.symbol for q in system.inputs]
    rate = sp.sympify(system.rates[name])
    effect = tuple(derivatives(rate, inputs).values())
    if all(is_zero(e) for e in effect):
        raise DefinitionError(
            f"no input is in the rate of '{name}'",
            remedy="limit it by a constraint of the region, of its velocities",
        )
    if any(e.free_symbols & set(inputs) for e in effect):
        raise DefinitionError(f"the inputs do not appear affinely in the rate of '{name}'")
    drift = rate.xreplace(dict.fromkeys(inputs, sp.S.Zero))
    most = symbol(f"rate_{name}")
    return [(effect, most - drift), (tuple(-e for e in effect), most + drift)]


def _bounds(system: System) -> Safeguard:
    """A safety filter of the bounds of the inputs alone."""
    rows = input_rows(system)
    return Safeguard(
        {n: tuple(row[i] for row, _ in rows) for i, n in enumerate(system.input_names)},
        tuple(b for _, b in rows),
        len(rows),
        input_scales(system, {}),
    )
