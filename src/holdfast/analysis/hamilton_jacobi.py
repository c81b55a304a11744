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
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast._version import __version__
from holdfast.analysis.grid import Grid
from holdfast.analysis.marching import Marching, Problem
from holdfast.analysis.value_function import ValueFunction, to_value_function
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.closed_loop import available_cores, check_memory
from holdfast.execution.march import Done, March
from holdfast.execution.over_grid import values_on_grid
from holdfast.execution.sweep import SCHEMES
from holdfast.maths.bounds import section
from holdfast.maths.hamiltonian import hamiltonian
from holdfast.maths.quantity import TIME, Parameter, merge_parameters
from holdfast.maths.region import Region
from holdfast.maths.system import System
from holdfast.maths.tangency import check_reads

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
    marching = Marching(**options)
    if not (math.isfinite(horizon) and horizon > 0):
        raise SimulationError(f"the horizon is {horizon!r} s", expected="above 0")
    asked = _times(times, horizon)
    moved = with_disturbance(system, disturbance or {})
    if problem.backwards:
        moved = replace(moved, rates={n: -r for n, r in moved.rates.items()}, pfaffian=())
    for region in problem.regions:
        check_reads(moved, region)
    if tuple(a.name for a in grid.axes) != moved.state_names:
        raise SimulationError(
            "the grid is one of another system: " + ", ".join(a.name for a in grid.axes),
            expected="the states " + ", ".join(moved.state_names),
        )
    reach = SCHEMES[marching.scheme]
    for axis in grid.axes:
        if axis.count < 2 * reach + 1:
            raise SimulationError(
                f"{axis.count} nodes along '{axis.name}'",
                expected=f"at least {2 * reach + 1} for {marching.scheme}",
            )
    known = merge_parameters(moved.parameters, *(r.parameters for r in problem.regions))
    known = _given(known, parameters or {})
    numbers = {q.symbol: sp.Float(q.value) for q in known}
    moved = replace(
        moved,
        input_bounds=moved.input_bounds.at(numbers) if moved.input_bounds else None,
        disturbance_bounds=moved.disturbance_bounds.at(numbers)
        if moved.disturbance_bounds
        else None,
    )
    if any(r.has(TIME) for r in moved.rates.values()):
        raise SimulationError(f"the rates of system '{system.name}' depend on time")
    symbols = [a.state.symbol for a in grid.axes]
    order = marching.method.order
    obstacles = problem.kept + (problem.above is not None)
    arrays = 1 + max(order - 1, 1) + obstacles + (2 if arrival_steps else 0)
    size = np.dtype(marching.precision).itemsize
    kept = len(asked) if times is not None else 0
    check_memory(size * grid.nodes * (arrays + kept), f"{grid.nodes:,} nodes")
    h = hamiltonian(moved, inputs=problem.inputs, disturbances=problem.disturbances)

    def margin(region: Region) -> npt.NDArray[Any]:
        nodes = [a.nodes for a in grid.axes]
        return values_on_grid(
            region.margin,
            symbols,
            known,
            nodes,
            band=marching.band,
            precision=marching.precision,
        )

    values = margin(problem.start)
    _check_inside(problem, grid, values)
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
    cell = _largest_change(values.reshape(grid.shape))
    slow = marching.tolerance if marching.tolerance is not None else 1e-3 * cell
    march = March(
        h,
        known,
        [a.nodes for a in grid.axes],
        [a.step for a in grid.axes],
        [a.ends for a in grid.axes],
        method=marching.method,
        limit=problem.limit,
        threads=marching.threads or available_cores(),
    )
    highest = float(values.max())
    record = _Record(grid, values.copy() if arrival_steps else None, asked, times is not None)
    stops = asked if not arrival_steps else record.refined(horizon, arrival_steps)

    def tell(done: Done) -> bool:
        if progress is not None:
            progress(done.time / horizon)
        return done.moving == 0

    done = march.run(
        values,
        stops,
        upper=above,
        lower=below,
        floor=-marching.band,
        ceiling=marching.band,
        near=-cell,
        slow=slow,
        keep=lambda k, now: record.keep(stops[k], now),
        tell=tell,
    )
    _check_growth(float(values.max()), highest, cell)
    converged = done.moving == 0
    empty = not (values > 0).any()
    attributes = {
        "holdfast_version": __version__,
        "kind": problem.kind,
        "system": system.name,
        "region": problem.start.name,
        "value_unit": problem.start.inequalities[0].unit,
        "horizon_s": horizon,
        "reached_s": done.time,
        "converged": int(converged),
        "empty": int(empty),
        "tolerance_per_s": slow,
        "nodes_moving": done.moving,
        "ends_reached": _ends_reached(grid, values),
        "cell": cell,
        "scheme": marching.scheme,
        "order": order,
        "dissipation": marching.dissipation,
        "cfl": marching.cfl,
        "precision": marching.precision,
        "steps": done.steps,
        "computed_share": done.computed / max(done.of, 1),
        "wall_time_s": done.seconds,
        "parameters": json.dumps({q.name: q.value for q in known}),
        "disturbance": json.dumps({k: float(v) for k, v in (disturbance or {}).items()}),
    }
    return record.value_function(values, attributes)


class _Record:
    """What is kept of a march: the values at the times asked for, and when nodes were reached."""

    def __init__(
        self, grid: Grid, first: npt.NDArray[Any] | None, asked: list[float], several: bool
    ) -> None:
        self.grid, self.asked, self.several = grid, asked, several
        self.found: dict[float, npt.NDArray[Any]] = {}
        self.before, self.then = first, 0.0
        self.arrival = None
        if first is not None:
            self.arrival = np.where(first > 0, 0.0, math.nan)

    def refined(self, horizon: float, count: int) -> list[float]:
        return sorted({*self.asked, *(float(t) for t in np.linspace(0, horizon, count + 1)[1:])})

    def keep(self, time: float, values: npt.NDArray[Any]) -> None:
        if self.several and time in self.asked:
            self.found[time] = values.reshape(self.grid.shape).copy()
        if self.arrival is not None and self.before is not None:
            new = (values > 0) & np.isnan(self.arrival)
            rise = values[new] - self.before[new]
            share = -self.before[new] / rise
            self.arrival[new] = self.then + share * (time - self.then)
            self.before, self.then = values.copy(), time

    def value_function(self, values: npt.NDArray[Any], attributes: dict[str, Any]) -> ValueFunction:
        shape = self.grid.shape
        arrival = None if self.arrival is None else self.arrival.reshape(shape)
        if not self.several:
            return to_value_function(self.grid, values.reshape(shape), attributes, arrival=arrival)
        for time in self.asked:  # converged before: it stays as it is
            self.found.setdefault(time, values.reshape(shape))
        stack = np.stack([self.found[t] for t in self.asked])
        return to_value_function(self.grid, stack, attributes, times=self.asked, arrival=arrival)


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


def _check_inside(problem: Problem, grid: Grid, start: npt.NDArray[Any]) -> None:
    """Refuse a grid that cuts off the region along a state that the region is about."""
    if problem.limit != "shrink":
        return
    read = {q.name for q in problem.start.reads}
    table = start.reshape(grid.shape)
    for i, axis in enumerate(grid.axes):
        if axis.ends != "contained" or axis.name not in read:
            continue
        for end, where in ((0, axis.low), (-1, axis.high)):
            if (np.take(table, end, axis=i) > 0).any():
                raise SimulationError(
                    f"the grid cuts off region '{problem.start.name}' at {axis.name} = {where:g}",
                    expected="a grid that contains the region",
                    remedy=f'widen it, or say ends = {{"{axis.name}": "limited"}} if the state '
                    'itself ends there, or "extrapolated" to take the consequences',
                )


def _ends_reached(grid: Grid, values: npt.NDArray[Any]) -> str:
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


def _largest_change(values: npt.NDArray[Any]) -> float:
    """The largest difference between neighbours, at the nodes in the set or next to it."""

    def largest(ahead: npt.NDArray[Any], behind: npt.NDArray[Any]) -> float:
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
