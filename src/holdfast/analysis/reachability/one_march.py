"""A march from its beginning, or from its checkpoint, to its end: what is decided on the way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import sympy as sp

from holdfast._version import __version__
from holdfast.analysis.reachability.checkpoint import Checkpoint
from holdfast.analysis.reachability.divided_march import DividedMarch, room_of
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.memory_estimate import memory_of
from holdfast.analysis.reachability.posed_march import march_of
from holdfast.analysis.reachability.problem import Ends, Posed
from holdfast.analysis.reachability.refinement import on_finer_grid, refined_march, refinement_of
from holdfast.analysis.reachability.snapshots import named, stops
from holdfast.analysis.reachability.value_function import ValueFunction, to_value_function
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import March
from holdfast.execution.level_set.over_grid import OverGrid
from holdfast.execution.level_set.refined_march import RefinedMarch
from holdfast.execution.level_set.settling import Done
from holdfast.execution.working_room import Memory, Room
from holdfast.maths.definitions.system import System
from holdfast.maths.games.hamiltonian import Hamiltonian, hamiltonian

GROWTH_CHECKED = 25
"""Steps from one look at whether the value has grown to the next: they cost it nothing."""

DEEPEST = 4.0
"""Times the largest magnitude of the start value, or cells of a set that is kept: the value is cut
off so far below zero.

Of an unstable system it would grow without end outside the set, and at a front of such a height the
boundary would run ahead of what it is the boundary of. Of a set that is kept it is cut off where it
is as far below zero as the start value is above it anywhere, however wide the grid is: the boundary
is in the middle of a front that is as deep as it is high."""

ROUNDING = 64.0
"""Last places by which a node may change in a step without being said to move."""

LOOKED = 10
"""Steps from one look at whether the march has answered the question to the next."""

Progress = Callable[[float], None]
"""Called now and then with the finished fraction of the horizon."""

Until = Callable[[ValueFunction], bool]
"""Called now and then with the value so far; where it gives True, the march ends."""


class OneMarch:
    """A march from its beginning, or from its checkpoint, to its end."""

    def __init__(
        self,
        posed: Posed,
        h: Hamiltonian,
        progress: Progress | None,
        until: Until | None,
        *,
        begun: bool,
    ) -> None:
        """posed: as it was asked for, on a grid that may be refined. begun: whether it begins with
        another value than that of the problem."""
        self._memory, self._base = memory_of(posed), posed.grid
        posed = on_finer_grid(posed)
        self._posed, self._h, self._progress, self._until = posed, h, progress, until
        self._enough, self._begun = False, begun
        self._saved: Checkpoint | None = None
        self.got_further = False  # than the checkpoint that it began with

    def result(self, held: DividedMarch) -> ValueFunction:
        posed, marching = self._posed, self._posed.marching
        self._held, refined = held, marching.refine > 1
        of_start = {"start_rate": held.start_rate, "falls": held.falls}
        self._march: March | RefinedMarch = (
            refined_march(posed, self._base, self._h, **of_start)
            if refined
            else march_of(posed, self._h, posed.grid, fastest=held.fastest, **of_start)
        )
        self._rounding = float(np.finfo(marching.precision).eps) / self._march.longest_step
        room, done = room_of(marching), Done()
        if marching.checkpoint is not None:
            path = marching.checkpoint_file(posed.problem.kind)
            in_parts = held.divided or room.on_disk
            self._saved = Checkpoint(path, marching.checkpoint_every, posed, held.code(), in_parts)
            done = self._saved.load(held)
            if done.steps == 0:
                self._saved.save(done, held)  # if it cannot be written, that is said now
        done = self._to_the_end(done)
        held.keep(done.time)
        largest = held.largest()
        _check_growth(largest, held.highest, held.start.cell, done.time)
        if self._saved is not None:
            self._saved.save(done, held)
        report = self._report(done, largest)
        return _result(posed, held.arrays(room), report, room)

    def _to_the_end(self, done: Done) -> Done:
        held, posed, march, band = self._held, self._posed, self._march, self._posed.marching.band
        start = held.start
        shrinks = posed.problem.limit == "shrink"
        deepest = max(start.highest, DEEPEST * start.cell) if shrinks else DEEPEST * start.deepest
        limits = {
            "floor": -min(band, deepest),
            "ceiling": min(band, start.highest) if posed.beyond else band,
            "nearest": 1e-9 * start.highest,
        }
        if isinstance(march, RefinedMarch):
            values, upper, lower = held.bounded()
            held.complete = lambda: march.complete()
            return march.run(
                values, stops(posed), upper=upper, lower=lower, keep=held.keep, tell=self._tell,
                **limits,
            )  # fmt: skip
        moves = any(r.moves for r in posed.problem.regions)
        held.open()
        done = march.drive(
            held, stops(posed), refresh=held.refresh if moves else None, keep=held.keep,
            tell=self._tell, done=done, **limits,
        )  # fmt: skip
        held.close()
        return done

    def _tell(self, done: Done) -> bool:
        held, posed = self._held, self._posed
        if self._progress is not None:
            self._progress(done.time / posed.horizon)
        if posed.arrival_steps and done.measured:
            held.keep(done.time)  # before it converges: the first stop may be later
        if done.steps % GROWTH_CHECKED == 0:
            _check_growth(held.largest(), held.highest, held.start.cell, done.time)
        if self._saved is not None and self._saved.due:
            self._saved.save(done, held)
            self.got_further = True
        if self._until is not None and done.steps % LOOKED == 0:
            values = held.arrays(Memory())["values"].reshape(posed.grid.shape)
            self._enough = self._until(to_value_function(posed.grid, values, Report()))
        done.converged = done.measured and self._at_rest(done)
        return self._enough or done.converged

    def _residual(self, done: Done) -> float:
        """Cells that the set still moves at its present speed: over the rest of the horizon, in as
        long again, and while a cell of the slowest axis is crossed, whichever is longest; at most
        all cells of every axis."""
        rest = max(self._posed.horizon - done.time, done.time, self._march.crossing)
        return min(float((done.speed + self._rounding) * rest), float(sum(self._posed.grid.shape)))

    def _decided(self, done: Done) -> bool:
        """Whether nothing is left, or everything, and no node changes side again."""
        posed = self._posed
        return not posed.varies and done.last == 0.0 and self._held.on_one_side(posed.limit)

    def _at_rest(self, done: Done) -> bool:
        posed = self._posed
        if posed.varies or posed.problem.limit == "exact":
            return False
        if self._decided(done):
            return True
        little = self._residual(done) <= posed.marching.tolerance
        still = done.settled(little and (done.slows or done.speed <= ROUNDING * self._rounding))
        lengths = done.steps * posed.method.steps.lengths
        return (still and lengths >= max(posed.grid.shape)) or (little and done.fixed)

    def _report(self, done: Done, largest: float) -> Report:
        posed, h, held = self._posed, self._h, self._held
        problem, marching = posed.problem, posed.marching
        return Report(
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
            ended_early=self._enough,
            begun_from_another=self._begun,
            tolerance_cells=marching.tolerance,
            residual_cells=0.0 if self._decided(done) else self._residual(done),
            ends_reached="" if posed.filtered else _ends_reached(posed, h.system, held.ends()),
            cell=held.start.cell,
            scheme=marching.scheme,
            order=posed.method.order,
            dissipation=marching.dissipation,
            cfl=posed.method.cfl,
            precision=marching.precision,
            samples=h.samples,
            separable=h.separable,
            steps=done.steps,
            memory_bytes=self._memory,
            computed_share=done.computed / max(done.of, 1),
            wall_time_s=done.seconds,
            **(refinement_of(self._march) if isinstance(self._march, RefinedMarch) else {}),
            parameters={q.name: q.value for q in posed.named},
            disturbance={
                n: float(v) if v.is_number else str(v) for n, v in posed.disturbance.items()
            },
        )


def _ends_reached(posed: Posed, system: System, reached: Ends) -> str:
    """The nodes where the set touches an open end of the grid, so that the outside may matter.

    It does not where no input and no disturbance leads out of that end at any node of it. What a
    forward set has beyond the grid is said in any case.
    """
    always = posed.varies or posed.problem.backwards
    speed = None if always or not reached else hamiltonian(system, inputs="max", disturbances="max")
    return ", ".join(
        f"{axis.name} = {where:g}"
        for i, axis in enumerate(posed.grid.axes)
        if axis.ends in ("contained", "extrapolated")
        for end, where in ((0, axis.low), (-1, axis.high))
        if (i, end) in reached and (speed is None or _leads_out(posed, speed, i, where))
    )


def _leads_out(posed: Posed, h: Hamiltonian, number: int, where: float) -> bool:
    """Whether the rate out of an end of an axis is above zero at a node of it.

    h: max_u max_d.
    """
    axes = posed.grid.axes
    outwards = sp.S.One if where == axes[number].high else sp.S.NegativeOne
    costates = dict.fromkeys(h.costates, sp.S.Zero) | {h.costates[number]: outwards}
    nodes = [np.array([where]) if i == number else a.nodes for i, a in enumerate(axes)]
    symbols = [a.state.symbol for a in axes]
    rate = OverGrid([h.value.xreplace(costates)], symbols, posed.parameters, nodes)
    return any(bool((found > 0).any()) for _, (found,) in rate.parts(0.0))


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


def _result(posed: Posed, arrays: dict[str, Array], report: Report, room: Room) -> ValueFunction:
    grid, asked, values = posed.grid, posed.asked, arrays["values"]
    arrival = arrays.get("arrival")
    if arrival is not None:
        arrival = arrival.reshape(grid.shape)
    if not posed.several:
        return to_value_function(grid, values.reshape(grid.shape), report, arrival=arrival)
    stack = room.empty(len(asked) * grid.nodes, values.dtype).reshape(len(asked), grid.nodes)
    for row, time in zip(stack, asked, strict=True):  # converged before: it stays as it is
        row[:] = arrays.get(named(time), values)
    found = stack.reshape(len(asked), *grid.shape)
    return to_value_function(grid, found, report, times=asked, arrival=arrival)
