"""Equilibria in a region: where a system can rest in a disturbance, farthest inside."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import sympy as sp

from holdfast.analysis.safety.resting_search import RestingState, Search
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

STARTS = 16


@checked
def resting_state(
    system: System,
    region: Region,
    disturbance: Mapping[str, float | sp.Expr] | None = None,
    *,
    box: Mapping[str, tuple[float, float]] | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> RestingState:
    """Where `system` rests in `region` in a steady disturbance d, as far inside as can be.

        maximise t   subject to   f(q, u, d(q)) = 0,   c_j(q) + t <= 0 for every j,   u in bounds

    A local solver (SLSQP, derivatives of the same expressions) begins at `starts` points of an even
    sequence over `box`: state -> (lowest, highest), unless given [-1, 1] in SI units and a whole
    turn of an angle. The answer is verified by its own rates, constraints and bounds. It is the
    best of the local ones: another may exist, and none found does not prove that there is none.
    c_j of different units count alike, 1 m as 1 rad. disturbance: name -> number, or expression of
    the states and parameters (a field, such as an eddy); those left out are 0.

    Raises `DefinitionError` for unknown names, rates, fields or constraints that depend on time, a
    region of other states, and inputs whose bounds are no half-spaces.
    """
    field, numbers = _disturbance(system, disturbance)
    return Search(system, region, box, starts, seed, field).solve(numbers, [])


@checked
def resting_directions(
    system: System,
    region: Region,
    speed: float,
    *,
    count: int = 360,
    box: Mapping[str, tuple[float, float]] | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> tuple[RestingState, ...]:
    """`resting_state` for a disturbance of one size in `count` directions of its plane.

        d = speed (cos theta, sin theta),   theta = 2 pi k / count,   k = 0 ... count - 1

    Each search begins at the answer of the direction before it too. Raises `DefinitionError` for a
    system that has not two disturbances, and as `resting_state`.
    """
    names = system.disturbance_names
    if len(names) != 2:
        raise DefinitionError(
            f"system '{system.name}' has {len(names)} disturbances", expected="two, as a current"
        )
    if not 0 <= speed < math.inf:
        raise DefinitionError(f"speed is {speed:g}", expected="0 or more")
    if not count >= 1:
        raise DefinitionError(f"count is {count}", expected="at least 1")
    search = Search(system, region, box, starts, seed)
    found: list[RestingState] = []
    last: list[Array] = []
    for theta in 2 * math.pi * np.arange(count) / count:
        d = {names[0]: speed * math.cos(theta), names[1]: speed * math.sin(theta)}
        found.append(search.solve(d, last))
        if found[-1].exists:
            values = [*found[-1].state.values(), *found[-1].inputs.values(), found[-1].margin]
            last = [np.array(values)]
    return tuple(found)


def _disturbance(
    system: System, given: Mapping[str, float | sp.Expr] | None
) -> tuple[dict[str, sp.Expr], dict[str, float]]:
    """The disturbances that are fields, and the numbers of all, 0 for a field."""
    field: dict[str, sp.Expr] = {}
    numbers = dict.fromkeys(system.disturbance_names, 0.0)
    for name, value in (given or {}).items():
        if name not in numbers:
            raise DefinitionError(
                f"'{name}' is not a disturbance of system '{system.name}'",
                remedy=suggestion(name, system.disturbance_names),
            )
        expression = sp.sympify(value)
        if expression.free_symbols:
            field[name] = expression
        elif math.isfinite(expression):
            numbers[name] = float(expression)
        else:
            raise DefinitionError(f"disturbance '{name}' is {value}", expected="a finite number")
    return field, numbers
