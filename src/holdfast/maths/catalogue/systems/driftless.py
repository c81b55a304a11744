"""The driftless systems of the thesis: unicycle, nonholonomic integrator, chained form."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol, whole_number
from holdfast.maths.definitions.system import PfaffianRow, System


@checked
def unicycle(speed_limit: float = 1.0, turn_limit: float = 2.0) -> System:
    """Unicycle: xdot = v cos(psi), ydot = v sin(psi), psidot = r; thesis (2.10).

    The Pfaffian row is -sin(psi) xdot + cos(psi) ydot = 0: no sideways motion. Inputs are
    the speed v [m/s] in [-speed_limit, speed_limit] and the turn rate r [rad/s] likewise.
    """
    psi, v, r = symbol("psi"), symbol("v"), symbol("r")
    fast, turn = symbol("speed_limit"), symbol("turn_limit")
    return System(
        name="unicycle",
        states=(
            Quantity("x", "m", "position"),
            Quantity("y", "m", "position"),
            Quantity("psi", "rad", "heading", angle=True),
        ),
        inputs=(Quantity("v", "m/s", "speed"), Quantity("r", "rad/s", "turn rate")),
        rates={"x": v * sp.cos(psi), "y": v * sp.sin(psi), "psi": r},
        parameters=(
            Parameter("speed_limit", "m/s", "largest speed", value=speed_limit, above=0.0),
            Parameter("turn_limit", "rad/s", "largest turn rate", value=turn_limit, above=0.0),
        ),
        input_bounds=Box((-fast, -turn), (fast, turn)),
        pfaffian=(PfaffianRow({"x": -sp.sin(psi), "y": sp.cos(psi)}),),
        description="wheeled robot that cannot move sideways",
        source="thesis (2.10)",
    )


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


LARGEST = 12
"""Largest dimension: beyond it the inputs of any stabilising law exceed all bounds."""


@checked
def chained_form(n: int = 3) -> System:
    """Chained form with n states, thesis (4.21); all quantities without unit.

        x1' = u1,   x2' = u2,   xj' = x(j-1) u1   for j = 3 ... n

    n: the number of states.

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
