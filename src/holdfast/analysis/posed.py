"""A problem of viability, checked against its system and its grid, and ready to be marched."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.grid import Grid
from holdfast.analysis.marching import Marching, Problem
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.sweep import SCHEMES
from holdfast.maths.bounds import section
from holdfast.maths.quantity import TIME, Parameter, merge_parameters
from holdfast.maths.system import System
from holdfast.maths.tangency import check_reads


@dataclass(frozen=True)
class Posed:
    """What is marched.

    system: with numbers in its bounds and for the disturbances that are given, in reverse where
    the problem asks for it. asked: the times [s] at which the value is wanted, the last of them
    the horizon; several: whether all are kept. arrival_steps: how often it is looked which nodes
    are new. beyond: what leaving the grid is taken for, "lost" or "won"; "" continues the value.
    """

    system: System
    problem: Problem
    grid: Grid
    horizon: float
    marching: Marching
    parameters: tuple[Parameter, ...]
    disturbance: Mapping[str, float]
    asked: tuple[float, ...]
    several: bool = False
    arrival_steps: int = 0
    beyond: str = ""

    def aside(self, name: str) -> Posed:
        """The same problem for its end alone, to tell what its answer is worth."""
        marching = self.marching.aside(name, self.problem.kind)
        last = (self.horizon,)
        return replace(self, marching=marching, asked=last, several=False, arrival_steps=0)


def pose(
    system: System,
    problem: Problem,
    grid: Grid,
    horizon: float,
    marching: Marching,
    *,
    disturbance: Mapping[str, float],
    parameters: Mapping[str, float],
    times: Sequence[float] | None,
    arrival_steps: int,
) -> Posed:
    """The problem with everything in it checked; `SimulationError` for what cannot be solved."""
    if not (math.isfinite(horizon) and horizon > 0):
        raise SimulationError(f"the horizon is {horizon!r} s", expected="above 0")
    asked = _times(times, horizon)
    moved = with_disturbance(system, disturbance)
    if problem.backwards:
        moved = replace(moved, rates={n: -r for n, r in moved.rates.items()}, pfaffian=())
    for region in problem.regions:
        check_reads(moved, region)
    if tuple(a.name for a in grid.axes) != moved.state_names:
        raise SimulationError(
            "the grid is one of another system: " + ", ".join(a.name for a in grid.axes),
            expected="the states " + ", ".join(moved.state_names),
        )
    check_counts(grid, marching.scheme)
    known = merge_parameters(moved.parameters, *(r.parameters for r in problem.regions))
    known = _given(known, parameters)
    numbers = {q.symbol: sp.Float(q.value) for q in known}
    inputs, disturbances = moved.input_bounds, moved.disturbance_bounds
    moved = replace(
        moved,
        input_bounds=inputs.at(numbers) if inputs else None,
        disturbance_bounds=disturbances.at(numbers) if disturbances else None,
    )
    if any(r.has(TIME) for r in moved.rates.values()):
        raise SimulationError(f"the rates of system '{system.name}' depend on time")
    given = {k: float(v) for k, v in disturbance.items()}
    return Posed(
        moved, problem, grid, horizon, marching, known, given, tuple(asked),
        times is not None, arrival_steps,
    )  # fmt: skip


def check_counts(grid: Grid, scheme: str) -> None:
    """Refuse an axis with fewer nodes than the scheme reaches over."""
    least = 2 * SCHEMES[scheme] + 1
    for axis in grid.axes:
        if axis.count < least:
            raise SimulationError(
                f"{axis.count} nodes along '{axis.name}'", expected=f"at least {least} for {scheme}"
            )


def check_inside(posed: Posed, start: npt.NDArray[np.floating]) -> None:
    """Refuse a grid that cuts off the region along a state that the region is about."""
    if posed.problem.limit != "shrink":
        return
    region = posed.problem.start
    read = {q.name for q in region.reads}
    table = start.reshape(posed.grid.shape)
    for i, axis in enumerate(posed.grid.axes):
        if axis.ends != "contained" or axis.name not in read:
            continue
        for end, where in ((0, axis.low), (-1, axis.high)):
            if (np.take(table, end, axis=i) > 0).any():
                raise SimulationError(
                    f"the grid cuts off region '{region.name}' at {axis.name} = {where:g}",
                    expected="a grid that contains the region",
                    remedy=f'widen it, or say ends = {{"{axis.name}": "limited"}} if the state '
                    'itself ends there, or "extrapolated" to take the consequences',
                )


def _times(times: Sequence[float] | None, horizon: float) -> list[float]:
    asked = sorted(float(t) for t in (() if times is None else times))
    if asked and not (asked[0] > 0 and asked[-1] <= horizon):
        raise SimulationError(
            f"a value is asked for at {asked[0] if asked[0] <= 0 else asked[-1]:g} s",
            expected=f"times above 0 and up to the horizon, {horizon:g} s",
        )
    return asked if asked and asked[-1] == horizon else [*asked, float(horizon)]


def with_disturbance(system: System, given: Mapping[str, float]) -> System:
    """The system with numbers for some of its disturbances; those of one ball go together."""
    if not given:
        return system
    for name in given:
        if name not in system.disturbance_names:
            raise SimulationError(
                f"system '{system.name}' has no disturbance '{name}'",
                remedy=suggestion(name, system.disturbance_names),
            )
    values = {d.symbol: sp.Float(given[d.name]) for d in system.disturbances if d.name in given}
    left = tuple(d for d in system.disturbances if d.name not in given)
    return replace(
        system,
        rates={n: r.xreplace(values) for n, r in system.rates.items()},
        disturbances=left,
        disturbance_bounds=section(
            system.disturbance_bounds, [d in left for d in system.disturbances]
        ),
        pfaffian=(),
    )


def _given(known: tuple[Parameter, ...], values: Mapping[str, float]) -> tuple[Parameter, ...]:
    names = [q.name for q in known]
    for name in values:
        if name not in names:
            raise SimulationError(f"no parameter '{name}'", remedy=suggestion(name, names))
    return tuple(replace(q, value=float(values.get(q.name, q.value))) for q in known)
