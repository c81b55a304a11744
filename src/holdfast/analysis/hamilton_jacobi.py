"""Sets of states by the level sets of a value: what the problems of viability have in common.

With tau the time to go, W the value, l the margin of a region (`Region.margin`, positive inside):

    kernel      dW/dtau = min(0, H),   W(0) = l_K      stay in K for tau
    reach       dW/dtau = max(0, H),   W(0) = l_T      be in T within tau
    capture     dW/dtau = H,  l_G <= W, W <= l_K       be in G within tau, and in K until then

H is the best of one player against the worst of the other (`maths/hamiltonian.py`). Positive is in
the set, in every problem.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast._version import __version__
from holdfast.analysis.checkpoint import Checkpoint
from holdfast.analysis.grid import Grid
from holdfast.analysis.marching import Marching, Problem
from holdfast.analysis.posed import Posed, check_inside, pose
from holdfast.analysis.record import Record
from holdfast.analysis.value_function import ValueFunction
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.closed_loop import available_cores, check_memory
from holdfast.execution.march import Done, March
from holdfast.execution.over_grid import values_on_grid
from holdfast.maths.hamiltonian import hamiltonian
from holdfast.maths.region import Region
from holdfast.maths.system import System

Array = npt.NDArray[Any]

Progress = Callable[[float], None]
"""Called now and then with the finished fraction of the horizon."""


def solve(
    system: System,
    problem: Problem,
    grid: Grid,
    horizon: float,
    *,
    disturbance: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    times: Sequence[float] | None = None,
    arrival_steps: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> ValueFunction:
    """March `problem` over `grid` for `horizon` seconds, or until it has converged."""
    for name in options:
        if name not in Marching.__dataclass_fields__:
            raise SimulationError(
                f"unknown option '{name}'", remedy=suggestion(name, Marching.__dataclass_fields__)
            )
    posed = pose(
        system,
        problem,
        grid,
        horizon,
        Marching(**options),
        disturbance=disturbance or {},
        parameters=parameters or {},
        times=times,
        arrival_steps=arrival_steps,
    )
    return marched(posed, progress)


def marched(posed: Posed, progress: Progress | None = None) -> ValueFunction:
    """The value at the end of the march, with what it is worth."""
    problem, grid, marching = posed.problem, posed.grid, posed.marching
    _check_memory(posed)
    h = hamiltonian(posed.system, inputs=problem.inputs, disturbances=problem.disturbances)
    values, lower, upper = _start(posed)
    cell = _largest_change(values.reshape(grid.shape))
    slow = marching.tolerance if marching.tolerance is not None else 1e-3 * cell
    march = March(
        h,
        posed.parameters,
        [a.nodes for a in grid.axes],
        [a.step for a in grid.axes],
        [a.ends for a in grid.axes],
        method=marching.method,
        limit=problem.limit,
        threads=marching.threads or available_cores(),
    )
    highest = float(values.max())
    record = Record(posed, values)
    saved, done = None, Done()
    if marching.checkpoint is not None:
        path = marching.checkpoint_file(problem.kind)
        saved = Checkpoint(path, marching.checkpoint_every, posed, march.module.__name__)
        done = saved.load(values, record)
        if done.steps == 0:
            saved.save(done, values, record)  # if it cannot be written, that is said now

    def tell(done: Done, now: Array) -> bool:
        if progress is not None:
            progress(done.time / posed.horizon)
        if saved is not None:
            saved.offer(done, now, record)
        return done.moving == 0

    done = march.run(
        values,
        record.stops,
        upper=upper,
        lower=lower,
        floor=-marching.band,
        ceiling=marching.band,
        near=-cell,
        slow=slow,
        keep=record.keep,
        tell=tell,
        done=done,
    )
    record.keep(done.time, values)
    _check_growth(float(values.max()), highest, cell)
    if saved is not None:
        saved.save(done, values, record)
    attributes = {
        "holdfast_version": __version__,
        "kind": problem.kind,
        "system": posed.system.name,
        "region": problem.start.name,
        "value_unit": problem.start.inequalities[0].unit,
        "horizon_s": posed.horizon,
        "reached_s": done.time,
        "converged": int(done.moving == 0),
        "empty": int(not (values > 0).any()),
        "tolerance_per_s": slow,
        "nodes_moving": done.moving,
        "ends_reached": _ends_reached(grid, values),
        "cell": cell,
        "scheme": marching.scheme,
        "order": marching.method.order,
        "dissipation": marching.dissipation,
        "cfl": marching.cfl,
        "precision": marching.precision,
        "steps": done.steps,
        "computed_share": done.computed / max(done.of, 1),
        "wall_time_s": done.seconds,
        "parameters": json.dumps({q.name: q.value for q in posed.parameters}),
        "disturbance": json.dumps(posed.disturbance),
    }
    return record.value_function(values, attributes)


def _check_memory(posed: Posed) -> None:
    obstacles = posed.problem.kept + (posed.problem.above is not None)
    arrays = 1 + max(posed.marching.method.order - 1, 1) + obstacles
    arrays += 2 if posed.arrival_steps else 0
    arrays += len(posed.asked) if posed.several else 0
    size = np.dtype(posed.marching.precision).itemsize
    check_memory(size * posed.grid.nodes * arrays, f"{posed.grid.nodes:,} nodes")


def _start(posed: Posed) -> tuple[Array, Array | None, Array | None]:
    """The value that the march begins with, and the obstacles below and above it."""
    problem, marching = posed.problem, posed.marching

    def margin(region: Region) -> Array:
        return values_on_grid(
            region.margin,
            [a.state.symbol for a in posed.grid.axes],
            posed.parameters,
            [a.nodes for a in posed.grid.axes],
            band=marching.band,
            precision=marching.precision,
        )

    values = margin(problem.start)
    check_inside(posed, values)
    below = values.copy() if problem.kept else None
    above = margin(problem.above) if problem.above else None
    if above is not None:
        np.minimum(values, above, out=values)
    if np.isnan(values).any():
        raise SimulationError(
            "the margin of a region is no number at some nodes of the grid",
            remedy="take an interval on which its inequalities are defined",
        )
    if not (values > 0).any():
        raise SimulationError(
            f"no node of the grid is in region '{problem.start.name}'", remedy="take a finer grid"
        )
    return values, below, above


def _ends_reached(grid: Grid, values: Array) -> str:
    """Where the set touches an open end of the grid: what is beyond may matter there."""
    table = values.reshape(grid.shape)
    found = []
    for i, axis in enumerate(grid.axes):
        if axis.ends in ("contained", "extrapolated"):
            for end, where in ((0, axis.low), (-1, axis.high)):
                if (np.take(table, end, axis=i) > 0).any():
                    found.append(f"{axis.name} = {where:g}")
    return ", ".join(found)


def _check_growth(largest: float, highest: float, cell: float) -> None:
    """A value that is a best margin along a way cannot exceed the best margin there is.

    That may lie between nodes, so up to one change between neighbours more is let pass.
    """
    if largest > highest + cell:
        raise SimulationError(
            f"the value grew to {largest:g}, above the largest margin {highest:g}: the march is "
            "unstable, or takes in information from outside the grid",
            remedy="widen the grid, or take a lower order or a smaller cfl",
        )


def _largest_change(values: Array) -> float:
    """The largest difference between neighbours, at the nodes in the set or next to it."""

    def largest(ahead: Array, behind: Array) -> float:
        near = (ahead > 0) | (behind > 0)
        return float(np.abs(ahead - behind)[near].max(initial=0.0))

    found = 0.0
    for k, slab in enumerate(values):  # slab by slab, so that it takes little memory
        if k:
            found = max(found, largest(slab, values[k - 1]))
        for i in range(slab.ndim):
            rows = np.moveaxis(slab, i, 0)
            found = max(found, largest(rows[1:], rows[:-1]))
    return found
