"""Actuators that act late: a first-order lag, and a limit on how fast they change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from numbers import Real

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.extension import per_second
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import clip

PREFIX = "actual_"


@checked
def lagged(
    system: System, lag: Mapping[str, float], slew: Mapping[str, float] | None = None
) -> System:
    """`system` whose inputs act through a lag: what is asked for comes later, and not faster.

        qdot = f(q, a, d),   adot_i = (u_i - a_i) / T_i,   within [-R_i, R_i]

    lag: input -> T_i [s], above 0; slew: input -> R_i [unit of the input per second]. a_i is the
    state actual_NAME, 0 at the start unless given. The inputs keep their names and bounds, so that
    a law or a filter of `system` runs on the lagged system as it is; a law derived from the lagged
    system itself would know the lag.

    Raises `DefinitionError` for unknown names and numbers that are not above 0.
    """
    slew = {} if slew is None else slew
    for what, table in (("lag", lag), ("slew", slew)):
        for name, value in table.items():
            if name not in system.input_names:
                raise DefinitionError(
                    f"'{name}' is not an input of system '{system.name}'",
                    remedy=suggestion(str(name), system.input_names),
                )
            if isinstance(value, bool) or not (isinstance(value, Real) and 0 < value < math.inf):
                raise DefinitionError(f"{what} of '{name}' is {value!r}", expected="above 0")
    if not lag:
        raise DefinitionError("lag is empty", expected="{input: seconds}")
    if alone := [name for name in slew if name not in lag]:
        raise DefinitionError(f"slew of '{alone[0]}' without its lag", expected="both")
    units = {q.name: q.unit for q in system.inputs}
    parameters = [
        Parameter(f"lag_{n}", "s", f"time constant of {n}", value=float(v), above=0)
        for n, v in lag.items()
    ] + [
        Parameter(f"slew_{n}", per_second(units[n]), f"fastest {n}", value=float(v), above=0)
        for n, v in slew.items()
    ]
    actual = {symbol(n): symbol(PREFIX + n) for n in lag}
    rates = {name: rate.xreplace(actual) for name, rate in system.rates.items()}
    for name in lag:
        change: sp.Expr = (symbol(name) - symbol(PREFIX + name)) / symbol(f"lag_{name}")
        if name in slew:
            change = clip(change, -symbol(f"slew_{name}"), symbol(f"slew_{name}"))
        rates[PREFIX + name] = change
    return replace(
        system,
        name=f"{system.name}, {' and '.join(lag)} late",
        states=(
            *system.states,
            *(Quantity(PREFIX + n, units[n], f"{n} that acts") for n in lag),
        ),
        rates=rates,
        parameters=(*system.parameters, *parameters),
    )
