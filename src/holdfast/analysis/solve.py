"""A problem of viability from its definition to its answer, and what the answer is worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy as sp

from holdfast.analysis.grid import Grid
from holdfast.analysis.hamilton_jacobi import Progress, marched
from holdfast.analysis.marching import Problem, marching_of
from holdfast.analysis.posed import pose
from holdfast.analysis.value_function import ValueFunction, to_value_function
from holdfast.analysis.worth import coarser, with_error, with_outside
from holdfast.errors import SimulationError
from holdfast.execution.over_grid import over_grid
from holdfast.maths.region import Region
from holdfast.maths.system import System


def solve(
    system: System,
    problem: Problem,
    grid: Grid,
    horizon: float,
    *,
    disturbance: Mapping[str, float | sp.Expr] | None = None,
    parameters: Mapping[str, float] | None = None,
    times: Sequence[float] | None = None,
    arrival_steps: int | None = None,
    start_time: float = 0.0,
    progress: Progress | None = None,
    **options: Any,
) -> ValueFunction:
    """March `problem` over `grid` for `horizon` seconds, or until it has converged.

    Rates, given disturbances and regions may depend on `TIME`. The problem runs from t = start_time
    to start_time + horizon, and the value is that at its beginning; at one of the `times`, that of
    a problem which begins so many seconds before the same end. A forward reachable set is that at
    the end; at one of the `times`, so many seconds after the beginning. Where something depends on
    time, nothing converges: the march goes the whole way.
    """
    if progress is not None and not callable(progress):
        raise SimulationError(
            f"progress: {progress!r}", expected="a function of the share of the horizon"
        )
    posed = pose(
        system,
        problem,
        grid,
        horizon,
        marching_of(options),
        disturbance={} if disturbance is None else disturbance,
        parameters={} if parameters is None else parameters,
        times=times,
        arrival_steps=arrival_steps,
        start_time=start_time,
    )
    marching = posed.marching
    grids = {False: 0, True: 1, "order": 2}[marching.estimate_error]
    further = coarser(posed, grids)  # refused before the march, if it cannot be
    found = marched(posed, progress)
    if further:
        found = with_error(found, [marched(other) for other in further])
    if marching.check_outside:
        found = with_outside(found, posed, marched)
    return found


def set_on_grid(region: Region, grid: Grid) -> ValueFunction:
    """The margin of a region over a grid: what a march begins with."""
    at = over_grid(
        region.margin,
        [a.state.symbol for a in grid.axes],
        region.parameters,
        [a.nodes for a in grid.axes],
    )
    said = {"kind": "region", "region": region.name, "value_unit": region.inequalities[0].unit}
    return to_value_function(grid, at(0.0).reshape(grid.shape), said)
