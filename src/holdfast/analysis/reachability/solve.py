"""A problem of viability from its definition to its answer, and what the answer is worth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.reachability.claim import Claim
from holdfast.analysis.reachability.error_estimate import coarser, with_error, with_outside
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.hamilton_jacobi import marched
from holdfast.analysis.reachability.inner_set import with_error_in_cells
from holdfast.analysis.reachability.march_part import hamiltonian_of
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.one_march import Progress, Until
from holdfast.analysis.reachability.options import Problem, marching_of
from holdfast.analysis.reachability.problem import Posed, definition, pose
from holdfast.analysis.reachability.refinement import check_refined
from holdfast.analysis.reachability.resting_set import marched_to_rest
from holdfast.analysis.reachability.value_function import ValueFunction, to_value_function
from holdfast.errors import SimulationError
from holdfast.execution.level_set.over_grid import over_grid
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.games.monotone_flux import is_sharp


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
    begin: ValueFunction | None = None,
    until: Until | None = None,
    **options: Any,
) -> ValueFunction:
    """March `problem` over `grid` for `horizon` seconds, or until it has converged.

    Rates, given disturbances and regions may depend on `TIME`. The problem runs from t = start_time
    to start_time + horizon, and the value is that at its beginning; at one of the `times`, that of
    a problem which begins so many seconds before the same end. A forward reachable set is that at
    the end; at one of the `times`, so many seconds after the beginning. Where something depends on
    time, nothing converges: the march goes the whole way.

    begin: the converged value of the same kernel for disturbances that can do no more than these,
    as those of a smaller bound. The march begins with it, for with l the margin of the region

        V <= begin <= l,   so that   V <= W(tau) <= W(tau) from l   for all tau

    and it converges to the same kernel; before that, W is not the value for tau seconds. The steps
    have to be monotone for that, those of the scheme "upwind" with local-local dissipation, where
    no input in a ball moves several states. Others are refused: weno5 may come to rest above the
    kernel.
    until: called with the value so far every few steps, ends the march where it gives True. The
    two are refused together with what rests on the whole march: times, a checkpoint, an error.
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
    check_refined(posed)
    marching = posed.marching
    grids = {False: 0, True: 1, "order": 2}[marching.estimate_error]
    further = coarser(posed, grids)  # refused before the march, if it cannot be
    start = _begun(posed, begin, until)
    found = marched_to_rest(posed, progress, start, until)
    if further:
        sharp = problem.limit == "shrink" and not marching.first_order
        march = marched if sharp else marched_to_rest
        rougher = [march(other) for other in further]
        found = with_error_in_cells(with_error(found, rougher), rougher[0])
    if marching.check_outside:
        found = with_outside(found, posed, marched_to_rest)
    if progress is not None:
        progress(1.0)  # a march that comes to rest has not gone the whole way
    found = found.reported(definition=definition(system))
    return replace(found, claim=_claim(problem))


def _claim(problem: Problem) -> Claim:
    if problem.limit == "shrink":
        return Claim(problem.start)
    return Claim(problem.above, problem.start)


def _begun(
    posed: Posed, begin: ValueFunction | None, until: Until | None
) -> npt.NDArray[Any] | None:
    """The values to begin with; refused where they are those of another problem."""
    if begin is None and until is None:
        return None
    marching = posed.marching
    for what, there in (
        ("times", posed.several),
        ("arrival_steps", posed.arrival_steps),
        ("a checkpoint", marching.checkpoint),
        ("estimate_error", marching.estimate_error),
        ("check_outside", marching.check_outside),
        ("a cluster", marching.cluster),
        ("refine", marching.refine > 1),
    ):
        if there:
            raise SimulationError(f"begin or until with {what}", remedy="leave one of them out")
    if begin is None:
        return None
    if posed.limit != "shrink":
        raise SimulationError(
            f"a {posed.problem.kind} cannot begin with another value function",
            expected="a kernel whose rates and regions do not depend on time",
        )
    if not (marching.monotone and is_sharp(hamiltonian_of(posed))):
        raise SimulationError(
            f"scheme {marching.scheme}, dissipation {marching.dissipation} cannot begin with "
            "another value: its steps are not monotone",
            expected='scheme="upwind" with local-local dissipation and steps of order 1, and no '
            "input in a ball that moves several states",
        )
    known = begin.report
    here = {
        "kind": posed.problem.kind,
        "system": posed.system.name,
        "region": posed.problem.start.name,
        "converged": True,
    }
    for name, value in here.items():
        if getattr(known, name) != value:
            raise SimulationError(
                f"the value to begin with has {name} = {getattr(known, name)}", expected=str(value)
            )
    axes = [
        [(a.name, a.low, a.high, a.count, a.ends) for a in g.axes] for g in (begin.grid, posed.grid)
    ]
    if axes[0] != axes[1]:
        raise SimulationError(
            "the value function to begin with is on another grid", expected="the same grid"
        )
    return np.asarray(begin.values())


def set_on_grid(
    region: Region, grid: Grid, *, band: float = math.inf, precision: str = "float64"
) -> ValueFunction:
    """The margin of a region over a grid, cut off at +-band: what a march begins with.

    Read-only, and in no more memory than the states that it depends on take.
    """
    symbols = [a.state.symbol for a in grid.axes]
    matters = [s in region.margin.free_symbols for s in symbols]
    nodes = [a.nodes if m else a.nodes[:1] for a, m in zip(grid.axes, matters, strict=True)]
    at = over_grid(region.margin, symbols, region.parameters, nodes, band=band, precision=precision)
    values = np.broadcast_to(at(0.0).reshape([len(n) for n in nodes]), grid.shape)
    report = Report(kind="region", region=region.name, value_unit=region.margin_unit)
    return to_value_function(grid, values, report)
