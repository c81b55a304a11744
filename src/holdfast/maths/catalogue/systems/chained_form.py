"""The chained form of any dimension."""

from __future__ import annotations

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Quantity, symbol, whole_number
from holdfast.maths.definitions.system import PfaffianRow, System

LARGEST = 12
"""Largest dimension: beyond it the inputs of any stabilising law exceed all bounds."""


@checked
def chained_form(n: int = 3) -> System:
    """Chained form with n states, thesis (4.21); all quantities without unit.

        x1' = u1,   x2' = u2,   xj' = x(j-1) u1   for j = 3 ... n

    The n - 2 Pfaffian rows are xj' - x(j-1) x1' = 0, (4.22). The inputs are not bounded.
    Raises `DefinitionError` unless n is a whole number from 3 to 12.
    """
    whole_number(n, "n of the chained form", 3, LARGEST)
    names = [f"x{i}" for i in range(1, n + 1)]
    u1, u2 = symbol("u1"), symbol("u2")
    rates = {"x1": u1, "x2": u2} | {f"x{j}": symbol(f"x{j - 1}") * u1 for j in range(3, n + 1)}
    return System(
        name="chained_form",
        states=tuple(Quantity(name, "1", f"state {name[1:]}") for name in names),
        inputs=(Quantity("u1", "1/s", "rate of x1"), Quantity("u2", "1/s", "rate of x2")),
        rates=rates,
        pfaffian=tuple(
            PfaffianRow({"x1": -symbol(f"x{j - 1}"), f"x{j}": 1}) for j in range(3, n + 1)
        ),
        description=f"chained form with {n} states",
        source="thesis (4.21), (4.22)",
    )
