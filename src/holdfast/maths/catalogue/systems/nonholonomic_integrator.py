"""Brockett's nonholonomic double integrator."""

from __future__ import annotations

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Quantity, symbol
from holdfast.maths.definitions.system import PfaffianRow, System


@checked
def nonholonomic_integrator() -> System:
    """Nonholonomic double integrator, thesis (2.17), (4.15); all quantities without unit.

        x1' = u1,   x2' = u2,   x3' = -x2 u1 + x1 u2

    The Pfaffian row is x2 x1' - x1 x2' + x3' = 0, (2.18). The inputs are not bounded.
    """
    x1, x2, u1, u2 = (symbol(n) for n in ("x1", "x2", "u1", "u2"))
    return System(
        name="nonholonomic_integrator",
        states=tuple(Quantity(f"x{i}", "1", f"state {i}") for i in (1, 2, 3)),
        inputs=(Quantity("u1", "1/s", "rate of x1"), Quantity("u2", "1/s", "rate of x2")),
        rates={"x1": u1, "x2": u2, "x3": -x2 * u1 + x1 * u2},
        pfaffian=(PfaffianRow({"x1": x2, "x2": -x1, "x3": 1}),),
        description="Brockett's nonholonomic double integrator",
        source="thesis (2.17), (2.18), (4.15)",
    )
