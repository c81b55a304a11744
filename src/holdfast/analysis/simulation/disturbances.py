"""The disturbances of simulated runs: refused beyond their bounds, recorded where they vary."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import sympy as sp

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.simulation.trajectories import Trajectories
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.quantity import TIME, symbol
from holdfast.maths.definitions.system import System

MOST = 1 << 16
"""Samples at which a disturbance is evaluated at a time."""


def check_disturbance(
    system: System,
    loop: ClosedLoop,
    settings: Settings,
    plant: Mapping[str, float],
    given: Mapping[str, sp.Expr],
    own: Array,
    first: int,
) -> None:
    """Refuse a disturbance that is not finite, or leaves its bounds, in any run.

    A field is judged along the runs (`check_field`): here its states are not known.
    """
    if not system.disturbances or loop.program.bounded:
        return
    used = set().union(*(e.free_symbols for e in given.values()))
    steps = 4 * settings.samples + 1 if TIME in used else 1
    times = np.arange(steps, dtype=np.float64) * (settings.sample_time / 4)
    bounds = system.disturbance_bounds
    names = [*loop.program.varied.names, *loop.program.varied.plant]
    varied = {symbol(n) for n in names}
    bound_varies = bounds is not None and bool(bounds.free_symbols & varied)
    rows = own if used & varied or bound_varies else own[:1]
    values = {p.symbol: p.value for p in loop.program.parameters}
    worst: list[tuple[int, float, Array]] = []

    def check(run: int, time: float, sample: Array, bound: Bounds) -> None:
        if not bound.contains([float(v) for v in sample]):
            shown = ", ".join(
                f"{n} = {v:.4g}" for n, v in zip(system.disturbance_names, sample, strict=True)
            )
            at = f"t = {time:.4g} s" + (f" of run {run}" if len(rows) > 1 else "")
            raise SimulationError(
                f"the disturbance leaves its bounds at {at}: {shown}",
                remedy=f"reduce it, or raise the bound of system '{system.name}'",
                key="disturbance",
            )

    for run, row in enumerate(rows, first):
        real = {**plant, **dict(zip(names, row, strict=True))}
        samples = loop.disturbances(times, p=loop.parameter_array(real))
        if not np.isfinite(samples).all():
            raise SimulationError(
                f"a disturbance is not finite at some time of run {run}", key="disturbance"
            )
        extremes = [(run, times[i], samples[i]) for i in _extremes(samples)]
        if bounds is not None and (bound_varies or run == first):
            bound = bounds.at(values | {symbol(n): v for n, v in real.items()})
        if bound_varies:
            for where in extremes:
                check(*where, bound)
        worst += extremes
    if bounds is not None and not bound_varies:
        for index in _extremes(np.array([w[2] for w in worst])):
            check(*worst[index], bound)


def _extremes(samples: Array) -> list[int]:
    """The decisive rows for a box and for a ball: extreme components, extreme size."""
    sizes = np.linalg.norm(samples, axis=1)
    return sorted({int(sizes.argmax()), *samples.argmin(axis=0), *samples.argmax(axis=0)})


def check_field(system: System, trajectories: Trajectories, first: int) -> None:
    """Refuse a field that was beyond its bounds, or not finite, where a run was at a sample."""
    if not trajectories.beyond.size:
        return
    since = trajectories.beyond[:, 0]
    runs = np.flatnonzero(~np.isnan(since))
    if not runs.size:
        return
    run = runs[0]
    time, *values = trajectories.beyond[run]
    shown = ", ".join(
        f"{n} = {v:.4g}" for n, v in zip(system.disturbance_names, values, strict=True)
    )
    count = f", as in {len(runs)} of {len(since)} runs" if len(since) > 1 else ""
    raise SimulationError(
        f"the disturbance leaves its bounds where run {first + run} is at t = {time:.4g} s: "
        f"{shown}{count}",
        remedy="limit the field, for example by clip or tanh, or raise the bound of system "
        f"'{system.name}'",
        key="disturbance",
    )


def felt_along(
    loop: ClosedLoop, trajectories: Trajectories, settings: Settings, plant: Mapping[str, float]
) -> Array | None:
    """The disturbance at every recorded sample, (run, time, disturbance); None where constant."""
    program = loop.program
    if not program.in_run:
        return None
    runs, times = trajectories.state.shape[:2]
    columns = loop.columns((*program.varied.names, *program.varied.plant))
    numbers = loop.parameter_array(plant, settings.sample_time)
    found = np.empty((runs, times, len(program.disturbances)))
    several = max(1, MOST // times)
    for begin in range(0, runs, several):
        part = slice(begin, begin + several)
        states = trajectories.state[part]
        p = np.tile(numbers, (len(states), 1))
        p[:, columns] = trajectories.varied[part]
        values = loop.disturbances(
            np.tile(trajectories.time, len(states)),
            states.reshape(len(states) * times, -1),
            np.repeat(p, times, axis=0),
        )
        values[np.isnan(states).any(axis=2).reshape(-1)] = np.nan  # after the end of a run
        found[part] = values.reshape(len(states), times, -1)
    return found
