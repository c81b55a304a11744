"""Sets of states by the level sets of a value: what the problems of viability have in common.

With tau the time to go, W the value, l the margin of a region (`Region.margin`, positive inside):

    kernel      dW/dtau = min(0, H),   W(0) = l_K      stay in K for tau
    reach       dW/dtau = max(0, H),   W(0) = l_T      be in T within tau
    capture     dW/dtau = H,  l_G <= W, W <= l_K       be in G within tau, and in K until then

    where the problem depends on time   dW/dtau = H, and
    kernel      W <= l_K(t)            reach      l_T(t) <= W            capture as above, at t

H is the best of one player against the worst of the other (`maths/hamiltonian.py`). Positive is in
the set, in every problem.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from holdfast._version import __version__
from holdfast.analysis.reachability.checkpoint import Checkpoint
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.memory_estimate import check_fits
from holdfast.analysis.reachability.obstacles import Obstacles
from holdfast.analysis.reachability.problem import Posed
from holdfast.analysis.reachability.refinement import march_of, on_finer_grid, refinement_of
from holdfast.analysis.reachability.snapshots import Record
from holdfast.analysis.reachability.value_function import ValueFunction, to_value_function
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.settling import Done
from holdfast.maths.games.hamiltonian import Hamiltonian, hamiltonian
from holdfast.maths.games.symmetry import check_symmetry

GROWTH_CHECKED = 25
"""Steps from one look at whether the value has grown to the next: they cost it nothing."""

DEEPEST = 4.0
"""Times the largest magnitude of the start value: the value is cut off so far below zero.

Of an unstable system it would grow without end outside the set, and at a front of such a height the
boundary would run ahead of what it is the boundary of."""

ROUNDING = 64.0
"""Last places by which a node may change in a step without being said to move."""

LOOKED = 10
"""Steps from one look at whether the march has answered the question to the next."""

Progress = Callable[[float], None]
"""Called now and then with the finished fraction of the horizon."""

Until = Callable[[ValueFunction], bool]
"""Called now and then with the value so far; where it gives True, the march ends."""


def marched(
    posed: Posed,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
) -> ValueFunction:
    """The value at the end of the march, with what it is worth.

    begin: values at the nodes that it begins with, where they are less than those of the problem.
    """
    memory = check_fits(posed)
    base, posed = posed.grid, on_finer_grid(posed)
    problem, grid, marching = posed.problem, posed.grid, posed.marching
    h = hamiltonian(
        posed.system,
        inputs=problem.inputs,
        disturbances=problem.disturbances,
        samples=marching.samples,
    )
    obstacles = Obstacles(posed)
    values, cell = obstacles.start, obstacles.cell
    if begin is not None:
        np.minimum(values, begin.ravel(), out=values)
    march = march_of(posed, base, h, reflected=_reflected(posed, h))
    rounding = float(np.finfo(marching.precision).eps) / march.longest_step  # cells/s
    record = Record(posed, values)
    saved, done, enough = None, Done(), False
    if marching.checkpoint is not None:
        path = marching.checkpoint_file(problem.kind)
        saved = Checkpoint(path, marching.checkpoint_every, posed, march.code.name)
        done = saved.load(values, record)
        if posed.varies:  # what it has come to by now, when it may have been larger than now
            obstacles.highest = max(obstacles.highest, float(values.max()))
        if done.steps == 0:
            saved.save(done, values, record)  # if it cannot be written, that is said now

    def tell(done: Done, now: Callable[[], Array]) -> bool:
        nonlocal enough
        if progress is not None:
            progress(done.time / posed.horizon)
        if record.arrival is not None and done.measured:
            record.keep(done.time, now())  # before it converges: the first stop may be later
        if done.steps % GROWTH_CHECKED == 0:
            _check_growth(float(now().max()), obstacles.highest, cell, done.time)
        if saved is not None and saved.due:
            saved.save(done, now(), record)
        if until is not None and done.steps % LOOKED == 0:
            enough = until(to_value_function(grid, now().reshape(grid.shape), Report()))
        done.converged = done.measured and at_rest(done, now)
        return enough or done.converged

    def residual(done: Done) -> float:
        """Cells that the set still moves at its present speed: over the rest of the horizon, in as
        long again, and while a cell of the slowest axis is crossed, whichever is longest; at most
        all cells of every axis."""
        rest = max(posed.horizon - done.time, done.time, march.crossing)
        return min(float((done.speed + rounding) * rest), float(sum(grid.shape)))

    def decided(done: Done, now: Array) -> bool:
        """Whether nothing is left, or everything, and no node changes side again."""
        return not posed.varies and done.last == 0.0 and _all_on_one_side(now, posed.limit)

    def at_rest(done: Done, now: Callable[[], Array]) -> bool:
        if posed.varies or problem.limit == "exact":
            return False
        if decided(done, now()):
            return True
        little = residual(done) <= marching.tolerance
        still = done.settled(little and (done.slows or done.speed <= ROUNDING * rounding))
        return (still and done.steps >= max(grid.shape)) or (little and done.fixed)

    done = march.run(
        values,
        record.stops,
        upper=obstacles.upper,
        lower=obstacles.lower,
        refresh=obstacles.refresh if any(r.moves for r in problem.regions) else None,
        floor=-min(marching.band, DEEPEST * float(np.abs(obstacles.start).max())),
        ceiling=min(marching.band, obstacles.highest) if posed.beyond else marching.band,
        nearest=1e-9 * obstacles.highest,
        keep=record.keep,
        tell=tell,
        done=done,
    )
    record.keep(done.time, values)
    largest = float(values.max())
    _check_growth(largest, obstacles.highest, cell, done.time)
    if saved is not None:
        saved.save(done, values, record)
    report = Report(
        holdfast_version=__version__,
        kind=problem.kind,
        system=posed.system.name,
        disturbances=problem.disturbances,
        region=problem.start.name,
        value_unit=problem.start.margin_unit,
        horizon_s=posed.horizon,
        reached_s=done.time,
        start_time_s=posed.start_time,
        depends_on_time=posed.varies,
        converged=done.converged,
        empty=largest <= 0,
        ended_early=enough,
        begun_from_another=begin is not None,
        tolerance_cells=marching.tolerance,
        residual_cells=0.0 if decided(done, values) else residual(done),
        ends_reached=_ends_reached(grid, values),
        cell=cell,
        scheme=marching.scheme,
        order=marching.method.order,
        dissipation=marching.dissipation,
        cfl=marching.cfl,
        precision=marching.precision,
        samples=h.samples,
        separable=h.separable,
        steps=done.steps,
        memory_bytes=memory,
        computed_share=done.computed / max(done.of, 1),
        wall_time_s=done.seconds,
        **refinement_of(march),
        parameters={q.name: q.value for q in posed.named},
        disturbance={n: float(v) if v.is_number else str(v) for n, v in posed.disturbance.items()},
    )
    return record.value_function(values, report)


def _reflected(posed: Posed, h: Hamiltonian) -> list[npt.NDArray[np.int64]] | None:
    """The place of every node's reflection along each axis, where there is a symmetry."""
    signs = posed.marching.symmetry
    if signs is None:
        return None
    check_symmetry(h, posed.problem.regions, signs)
    return [
        a.reflected if signs.get(a.name) == -1 else np.arange(a.count, dtype=np.int64)
        for a in posed.grid.axes
    ]


def _ends_reached(grid: Grid, values: Array) -> str:
    """The nodes where the set touches an open end of the grid, so that the outside may matter."""
    table = values.reshape(grid.shape)
    found = []
    for i, axis in enumerate(grid.axes):
        if axis.ends in ("contained", "extrapolated"):
            for end, where in ((0, axis.low), (-1, axis.high)):
                if (np.take(table, end, axis=i) > 0).any():
                    found.append(f"{axis.name} = {where:g}")
    return ", ".join(found)


def _all_on_one_side(values: Array, limit: str) -> bool:
    """Whether nothing is left of a set that shrinks, or nothing is left for one that grows."""
    return not (values > 0 if limit == "shrink" else values <= 0).any()


def _check_growth(largest: float, highest: float, cell: float, time: float) -> None:
    """A value that is a best margin along a way cannot exceed the best margin there is.

    That may lie between nodes, so up to one change between neighbours more is let pass.
    """
    if largest > highest + cell:
        raise SimulationError(
            f"by {time:g} s the value has grown to {largest:g}, above the largest margin "
            f"{highest:g}: the march is unstable, or takes in information from outside the grid",
            remedy="widen the grid, or take a lower order or a smaller cfl",
        )
