"""A posed problem marched to its end: from its beginning or a checkpoint, alone or beside another.

With tau the time to go, W the value, l the margin of a region (`Region.margin`, positive inside):

    kernel      dW/dtau = min(0, H),   W(0) = l_K      stay in K for tau
    reach       dW/dtau = max(0, H),   W(0) = l_T      be in T within tau
    capture     dW/dtau = H,  l_G <= W, W <= l_K       be in G within tau, and in K until then

    where the problem depends on time   dW/dtau = H, and
    kernel      W <= l_K(t)            reach      l_T(t) <= W            capture as above, at t

H is the best of one player against the worst of the other (`maths/games/hamiltonian.py`). Positive
is in the set, in every problem.

The state of a march is in a file, to go on from. The file is replaced as a whole, so that whenever
a process ends, the last state or the one before is there. What is skipped in a march is only what
would not change: begun again from its values and the number of its steps alone, it goes on to the
same bit. A march that is divided, or on a disk, has a folder instead (`march_part.py`); any march
goes on from either, whichever is further.

A scheme of high order may stand still at a ridge at which the solution moves. The same scheme held
close to a monotone step (`execution/level_set/stage_leaf.py`) converges to the solution, at the
price of first order at every ridge. So both are asked: with V of the march of high order and F of
the filtered one the answer is

    V,  or F where no F within a cell along the axes is above 0, of a set that is to be kept
    V,  or F where all F within a cell are above 0,              of one that is to be reached
    V,  or F in either case,            of a set of an instant, or what is to be reached in time

It has the accuracy of high order where the two sets are that close. On fine grids it is a few cells
(`RIM`), a share of the grid that tends to 0, so that it converges with the filtered value. Where V
of a set that is to be kept has come to rest, the filtered march goes on from it, until it rests as
well. Elsewhere it goes the same way as the other from the start on.

A set that is to be reached without an opponent has no ridge at which H is wrong: H is convex. It is
marched once, but for a basin that depends on time: what it is kept within makes it a kernel.

A scheme of first order with the largest speeds of an axis, or of a node, enlarges a set where its
value is convex. Beside it goes the same scheme with the speeds that two slopes allow, and the
answer is the lesser of both values.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from scipy.ndimage import maximum_filter, minimum_filter

from holdfast._version import __version__
from holdfast.analysis.reachability.divided_march import (
    DividedMarch,
    PartsLostError,
    room_of,
    workplace,
)
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.march_part import (
    PartFiles,
    hamiltonian_of,
    named,
    readable,
    stops,
)
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.memory_estimate import check_disk, check_fits, memory_of
from holdfast.analysis.reachability.posed_march import (
    march_of,
    on_finer_grid,
    refined_march,
    refinement_of,
)
from holdfast.analysis.reachability.problem import Ends, Marching, Posed
from holdfast.analysis.reachability.value_function import ValueFunction, to_value_function
from holdfast.errors import OutputError, SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import Done, March, Method, OverGrid
from holdfast.execution.level_set.refined_march import RefinedMarch
from holdfast.execution.resources import Memory, Room
from holdfast.host.files import atomic_file, remove_left_over
from holdfast.maths.definitions.quantity import stated
from holdfast.maths.definitions.system import System
from holdfast.maths.games.hamiltonian import Hamiltonian, check_symmetry, hamiltonian

SHOWN = 40
"""Characters up to which two texts that differ are shown."""


class Checkpoint:
    """The state of the march of `posed` in the file `path`, written every `every` s of wall time.

    code: what the compiled march is called, which is a digest of its text. in_parts: whether every
    part of the march writes its own.
    """

    def __init__(self, path: Path, every: float, posed: Posed, code: str, in_parts: bool) -> None:
        self.path = path
        self.every = every
        self.identity = identity(posed) | {"the code of the march": code}
        self.written = time.monotonic()
        self._files = PartFiles(path.with_name(f"{path.name}.parts"))
        self._in_parts = in_parts

    def load(self, march: DividedMarch) -> Done:
        """Put back what was held; a march that has not begun where there is nothing.

        Raises `SimulationError` for another file than a checkpoint, and for one of another problem.
        """
        remove_left_over(self.path.parent)  # of a process that ended while it wrote
        saved = {p: said for p in (self.path, self._files.path) if (said := self._said(p))}
        if not saved:
            return Done()
        path = max(saved, key=lambda p: saved[p]["done"]["steps"])
        with readable(path):
            done = Done(**saved[path]["done"])
        march.each("restore", path.absolute(), saved[path].get("then", 0.0))
        return done

    def _said(self, path: Path) -> dict[str, Any] | None:
        """What a checkpoint says of itself; None where there is none."""
        if not path.exists():
            return None
        with readable(path):
            if path == self._files.path:
                said = self._files.said()
            elif path.is_file():
                with np.load(path, allow_pickle=False) as arrays:
                    said = json.loads(str(arrays["said"]))
            else:
                raise SimulationError(
                    f"{path} is not a regular file", remedy="choose another for it"
                )
            if said is not None:
                self._check(said["problem"])
        return said

    def save(self, done: Done, march: DividedMarch) -> None:
        said = {"problem": self.identity, "done": asdict(done), "then": march.recorded()}
        try:
            if self._in_parts:
                self._save_parts(said, march)
            else:
                with atomic_file(self.path) as partial, partial.open("wb") as file:
                    arrays: dict[str, Any] = dict(march.arrays())
                    np.savez(file, said=np.array(json.dumps(said)), **arrays)
        except OutputError as error:
            raise OutputError(
                f"the checkpoint {error.cause}",
                remedy="choose a folder that exists, with room for it"
                + (", which all machines of the cluster share" if march.divided else ""),
            ) from None
        self.written = time.monotonic()

    def _save_parts(self, said: Mapping[str, Any], march: DividedMarch) -> None:
        generation = self._files.begin()
        try:
            written = march.each("write", generation)
        except BaseException:
            self._files.remove(generation)
            raise
        self._files.finish(said, generation, written)

    @property
    def due(self) -> bool:
        """Whether the last time was long enough ago."""
        return time.monotonic() - self.written >= self.every

    def _check(self, other: Mapping[str, str]) -> None:
        here = self.identity
        unlike = [n for n in {**here, **other} if here.get(n) != other.get(n)]
        if not unlike:
            return
        name = unlike[0]
        two = other.get(name, "none"), here.get(name, "none")
        shown = f", {two[0]} there and {two[1]} here" if len("".join(two)) <= SHOWN else ""
        more = f" (and {', '.join(unlike[1:])})" if unlike[1:] else ""
        raise SimulationError(
            f"the checkpoint {self.path} belongs to another problem: {name} differs{shown}{more}",
            remedy="remove it to begin anew, or choose another file",
        )


def identity(posed: Posed) -> dict[str, str]:
    """All that the numbers of a march depend on, by what a user calls it."""
    system, problem, marching = posed.system, posed.problem, posed.marching
    facts = {
        "the version of holdfast": __version__,
        "the problem": problem.kind,
        "the horizon": repr(posed.horizon),
        "start_time": repr(posed.start_time),
        "the times": repr(posed.asked if posed.several else ()),
        "arrival_steps": repr(posed.arrival_steps),
        "what is beyond the grid": posed.beyond or "continued",
    }
    facts |= {f"the axis {a.name}": _text(a) for a in posed.grid.axes}
    facts |= {f"parameter {q.name}": repr(q.value) for q in posed.named}
    facts |= {f"disturbance {n}": _text(v) for n, v in posed.disturbance.items()}
    facts |= {f"the rate of {n}": sp.srepr(r) for n, r in system.rates.items()}
    facts["the bounds of the inputs"] = _text(system.input_bounds)
    facts["the bounds of the disturbances"] = _text(system.disturbance_bounds)
    facts["the players"] = f"{problem.inputs}, {problem.disturbances}"
    for i, region in enumerate(problem.regions):
        facts[f"the {'second ' if i else ''}region"] = f"{region.name}: {sp.srepr(region.margin)}"
    facts |= {
        name: repr(getattr(marching, name))
        for name in (
            "scheme", "dissipation", "precision", "band", "tolerance", "symmetry", "samples"
        )
    }  # fmt: skip
    facts["order"] = repr(posed.method.order)
    facts["cfl"] = repr(posed.method.cfl)
    facts["the Runge-Kutta method"] = repr(posed.method.steps)
    facts["whether it is filtered"] = repr(posed.filtered)
    return facts


def _text(value: object) -> str:
    """A value of the library, by its parts."""
    if is_dataclass(value) and not isinstance(value, type):
        return "; ".join(f"{name} {_text(v)}" for name, v in stated(value).items())
    if isinstance(value, (sp.Basic, sp.MatrixBase)):
        return str(sp.srepr(value))
    if isinstance(value, tuple):
        return "(" + ", ".join(_text(v) for v in value) + ")"
    return repr(value)


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
    return any(bool((rates > 0).any()) for _, (rates,) in rate.parts(0.0))


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
    for row, instant in zip(stack, asked, strict=True):  # converged before: it stays as it is
        row[:] = arrays.get(named(instant), values)
    table = stack.reshape(len(asked), *grid.shape)
    return to_value_function(grid, table, report, times=asked, arrival=arrival)


LOSSES = 3
"""Times that workers may be lost between two checkpoints."""


def marched(
    posed: Posed,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
    h: Hamiltonian | None = None,
) -> ValueFunction:
    """The value at the end of the march, with what it is worth.

    begin: values at the nodes that it begins with, where they are less than those of the problem.
    h: the Hamiltonian of the problem, if it is known.
    """
    check_fits(posed)
    h = h or hamiltonian_of(posed)
    if posed.marching.symmetry is not None:
        check_symmetry(h, posed.problem.regions, posed.marching.symmetry)
    if posed.marching.on_disk is not None and not posed.filtered:
        check_disk(posed, h)  # of two marches before the first
    place, finer = workplace(posed.marching), on_finer_grid(posed)
    losses = 0
    while True:
        attempt = OneMarch(posed, h, progress, until, begun=begin is not None)
        try:
            with place.parts(finer, h) as parts:
                return attempt.result(DividedMarch(finer, parts, begin))
        except PartsLostError as lost:
            losses = 0 if attempt.got_further else losses + 1
            if losses == LOSSES:
                raise lost.error from None


RIM = 0.078
"""Cells by which the set of high order may be larger than that of the filtered scheme, or smaller,
in roots of the mean number of nodes along an axis, rounded up: one on 164 nodes, two on 657. At its
tips, and all around where the value jumps, a monotone step wears off more cells of finer grids."""

TOGETHER = 1 << 22
"""Nodes that are looked at together."""

ORDER = 2
"""The order of the steps of the filtered march beside one that does not come to rest. Steps of
first order would wear off what goes round, and a third gains nothing: whole cells are asked of it.
Where a march comes to rest depends on roundings, so that one from a rest on has the order of the
other. Single precision would be faster, but which stencil is taken is left to rounding then: in
other units the sets of one in 300 problems differed by a node."""

LONGER, LONGEST = 1.25, 0.95
"""How many times as long its steps are, but no longer than this share of a stable one: a filtered
step is as good as monotone up to the whole."""


def marched_to_rest(
    posed: Posed,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
) -> ValueFunction:
    """As `marched`, of a scheme that stands still only where the equation does.

    A march that `until` ended has no other beside it. progress: half of it is that of the first
    march, which may be the only one.
    """
    if not posed.marched_twice:
        return marched(posed, progress, begin, until)
    h = hamiltonian_of(posed)
    first = marched(posed, _half(progress, 0), begin, until, h)
    report, is_kernel = first.report, posed.problem.limit == "shrink"
    if report.ended_early or (is_kernel and report.empty and not posed.several):
        return first
    beside = replace(posed.renamed("rest"), filtered=not posed.marching.first_order)
    marching = beside.marching
    if marching.first_order:
        marching = replace(marching, dissipation="local-local")
    else:
        rim = float(rim_of(posed.grid))
        marching = replace(marching, tolerance=max(marching.tolerance, rim))
    at_rest = report.converged and is_kernel and not posed.several
    if at_rest:
        begin = np.asarray(first.values())
    elif not (report.converged and is_kernel) and report.steps > 1:  # one may have no length
        beside = replace(beside, steps=_steps_beside(marching))
    beside = replace(beside, marching=marching)
    second = marched(beside, _half(progress, 1), begin, h=h)
    left, rests = second.report.residual_cells, second.report.converged
    if at_rest and not rests and left is not None and left <= marching.tolerance:
        begin = np.array(second.values())
        second = marched(beside.renamed("at rest"), _half(progress, 1), begin, h=h)
    return _of_both(first, second, posed)


def _steps_beside(marching: Marching) -> Method:
    """Of the march beside one that does not come to rest."""
    method = marching.method
    order, cfl = min(method.order, ORDER), max(method.cfl, min(LONGER * method.cfl, LONGEST))
    return replace(method, order=order, cfl=cfl, long=method.order > ORDER and marching.refine == 1)


def _half(progress: Progress | None, which: int) -> Progress | None:
    """What the first or the second of two marches calls with its share."""
    return None if progress is None else lambda share: progress(0.5 * (which + share))


def _of_both(first: ValueFunction, second: ValueFunction, posed: Posed) -> ValueFunction:
    """The answer of two marches: the values of the first are changed in place, plane by plane, so
    that they may be larger than the memory."""
    report, grid = first.report, second.grid
    tables = [v.dataset["value"].values for v in (first, second)]
    several, lesser = "time" in first.dataset["value"].dims, posed.marching.first_order
    before = after = moved = 0
    for values, other in zip(*tables, strict=True) if several else [tables]:
        before = after = moved = 0  # the last are those of the horizon
        answers = _lesser(values, other) if lesser else _held(values, other, grid, posed)
        for planes, answer in answers:
            was, now = values[planes] > 0, answer > 0
            values[planes] = answer
            before, after = before + int(was.sum()), after + int(now.sum())
            moved += int((was != now).sum())
    if "arrival" in first.dataset:
        times, others = (v.dataset["arrival"].values for v in (first, second))
        if lesser:
            np.maximum(times, others, out=times)  # NaN where one of them is never there
        else:
            _no_later(times, others, grid)
    is_kernel, rests = posed.problem.limit == "shrink", (report.converged, second.report.converged)
    reached = report.reached_s if is_kernel else max(report.reached_s, second.report.reached_s)
    return first.reported(
        converged=any(rests) if is_kernel and after == 0 else all(rests),
        empty=after == 0,
        filtered_share=moved / max(before, after, 1),
        reached_s=reached,
        wall_time_s=report.wall_time_s + second.report.wall_time_s,
    )


def _lesser(values: Array, other: Array) -> Iterator[tuple[slice, Array]]:
    for planes in _some_planes(values):
        yield planes, np.minimum(values[planes], other[planes])


def _held(
    values: Array, filtered: Array, grid: Grid, posed: Posed
) -> Iterator[tuple[slice, Array]]:
    """The value of the first where its set is within the rim of the filtered one."""
    sides = posed.held
    for planes in _some_planes(values):
        v = values[planes]
        if sides.above:
            highest = _around(filtered, planes, grid, maximum_filter)
            v = np.where(highest > 0, v, np.minimum(v, highest))
        if sides.below:
            lowest = _around(filtered, planes, grid, minimum_filter)
            v = np.where(lowest > 0, np.maximum(v, lowest), v)
        yield planes, v


def _no_later(times: Array, filtered: Array, grid: Grid) -> None:
    """Times of arrival, NaN for none, no later than the latest filtered one within the rim."""

    def latest_of(arrivals: Array, **options: Any) -> Array:
        latest: Array = maximum_filter(np.where(np.isnan(arrivals), math.inf, arrivals), **options)
        return latest

    for planes in _some_planes(times):
        latest = _around(filtered, planes, grid, latest_of)
        sharp = times[planes]
        times[planes] = np.where(latest < math.inf, np.fmin(sharp, latest), sharp)


def rim_of(grid: Grid) -> int:
    """Cells by which the set of high order may be beside the filtered one, which is also how far
    that may still move where it is said to rest."""
    return math.ceil(RIM * math.sqrt(float(np.mean([axis.count for axis in grid.axes]))))


def _some_planes(values: Array) -> Iterator[slice]:
    """Planes of the first axis that are looked at together."""
    count = len(values)
    step = max(1, TOGETHER // (values.size // count))
    return (slice(k, min(k + step, count)) for k in range(0, count, step))


def _around(values: Array, planes: slice, grid: Grid, extreme: Callable[..., Array]) -> Array:
    """Of these planes the largest or the least value within the rim."""
    rim, count = rim_of(grid), len(values)
    modes = ["wrap" if axis.ends == "periodic" else "nearest" for axis in grid.axes]
    near = np.arange(planes.start - rim, planes.stop + rim)
    near = near % count if modes[0] == "wrap" else np.clip(near, 0, count - 1)
    extremes = extreme(values[near], size=2 * rim + 1, mode=["nearest", *modes[1:]])
    return extremes[rim : rim + planes.stop - planes.start]
