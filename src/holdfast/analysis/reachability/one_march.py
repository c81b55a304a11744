"""A posed problem marched to its end: from its beginning or a checkpoint, alone or beside another.

With tau the time to go, W the value, l the margin of a region (`Region.margin`, positive inside):

    kernel      dW/dtau = min(0, H),   W(0) = l_K      stay in K for tau
    reach       dW/dtau = max(0, H),   W(0) = l_T      be in T within tau
    capture     dW/dtau = H,  l_G <= W, W <= l_K       be in G within tau, and in K until then

    where the problem depends on time   dW/dtau = H, and
    kernel      W <= l_K(t)            reach      l_T(t) <= W            capture as above, at t

H is the best of one player against the worst of the other (`maths/games/hamiltonian.py`). Positive
is in the set, in every problem.

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

Against an opponent F is not safe to that side. Where each player moves axes of his own, as in a
game of a pursuer at k and an evader at x, what one does and the other undoes is a way along a
diagonal of the grid, and every monotone step along its axes spreads a value across it: with a speed
s by sqrt(s h T) in a time T. A valley of V that the opponent holds, such as |x - k|, is filled up,
and lost states seem won, all of them where the valley is narrower than that. V is not spread so.
What is farther in the answer than from the set of V is therefore disputed, and is said to be
(`disputed`): V may stand still, or F be spread.

A set that is to be reached without an opponent has no ridge at which H is wrong: H is convex. It is
marched once, but for a basin that depends on time: what it is kept within makes it a kernel.

A scheme of first order with the largest speeds of an axis, or of a node, enlarges a set where its
value is convex. Beside it goes the same scheme with the speeds that two slopes allow, and the
answer is the lesser of both values.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any, Protocol, Self, Unpack

import numpy as np
import sympy as sp
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter

from holdfast._version import __version__
from holdfast.analysis.reachability.checkpoint import Checkpoint, Resumable
from holdfast.analysis.reachability.disk_estimate import check_disk
from holdfast.analysis.reachability.divided_march import DividedMarch, PartsLostError, Workplace
from holdfast.analysis.reachability.grid import Grid, whole
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.posed_march import (
    Facts,
    finer,
    march_here,
    named,
    on_finer_grid,
    room_of,
    stops,
)
from holdfast.analysis.reachability.problem import (
    Ends,
    Marching,
    MarchOptions,
    Posed,
    marching_of,
)
from holdfast.analysis.reachability.value_function import ValueFunction, to_value_function
from holdfast.arguments import checked
from holdfast.errors import DisputedSetWarning, SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import Done, March, Method, OverGrid
from holdfast.execution.level_set.refined_march import RefinedMarch
from holdfast.execution.level_set.schemes import schemes
from holdfast.execution.level_set.slab import Part
from holdfast.execution.level_set.sweeping import Within
from holdfast.execution.resources import Memory, Room, check_memory
from holdfast.maths.definitions.system import System
from holdfast.maths.games.hamiltonian import Hamiltonian, check_symmetry, hamiltonian

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


class MarchedValues(Resumable, Protocol):
    """The values of a march and its stages, as `PosedMarch` has them on this machine, or as
    `DividedMarch` has them of others."""

    @property
    def march(self) -> March | RefinedMarch: ...
    @property
    def start(self) -> Facts: ...
    def __enter__(self) -> Self: ...
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None: ...
    def advances(
        self, times: Sequence[float], within: Within, done: Done
    ) -> Iterator[float | None]: ...
    def keep(self, time: float) -> None: ...
    def largest(self) -> float: ...
    def highest(self) -> float: ...
    def on_one_side(self, limit: str) -> bool: ...
    def ends(self) -> Ends: ...


class OneMarch:
    """A march from its beginning, or from its checkpoint, to its end."""

    def __init__(
        self,
        posed: Posed,
        h: Hamiltonian,
        progress: Progress | None,
        until: Until | None,
        *,
        memory: int,
        begun: bool,
    ) -> None:
        """memory: that the march takes [bytes]. begun: whether it begins with another value than
        that of the problem."""
        self._posed, self._h, self._progress, self._until = posed, h, progress, until
        self._enough, self._memory, self._begun = False, memory, begun
        self._saved: Checkpoint | None = None
        self.got_further = False  # than the checkpoint that it began with

    def result(self, values: MarchedValues) -> ValueFunction:
        posed = self._posed
        self._values, self._march = values, values.march
        self._rounding = float(np.finfo(posed.marching.precision).eps) / self._march.longest_step
        room, done = room_of(posed), Done()
        if posed.marching.checkpoint is not None:
            self._saved = Checkpoint(posed, values, values.divided or room.on_disk)
            done = self._saved.load()
            if done.steps == 0:
                self._saved.save(done)  # if it cannot be written, that is said now
        self._to_the_end(done)
        values.keep(done.time)
        largest = values.largest()
        _check_growth(largest, values.highest(), values.start.cell, done.time)
        if self._saved is not None:
            self._saved.save(done)
        report = self._report(done, largest)
        return _result(posed, values.arrays(room), report, room)

    def _to_the_end(self, done: Done) -> None:
        values, posed, began = self._values, self._posed, time.perf_counter() - done.seconds
        with values:
            advances = values.advances(stops(posed), self._within(), done)
            for end in advances if not done.stopped else ():
                done.seconds = time.perf_counter() - began
                if end is not None:
                    values.keep(end)
                done.stopped = self._tell(done)
                if done.stopped:
                    break

    def _within(self) -> Within:
        posed, start, band = self._posed, self._values.start, self._posed.marching.band
        shrinks = posed.problem.limit == "shrink"
        deepest = max(start.highest, DEEPEST * start.cell) if shrinks else DEEPEST * start.deepest
        ceiling = min(band, start.highest) if posed.beyond else band
        return Within(-min(band, deepest), ceiling, 1e-9 * start.highest)

    def _tell(self, done: Done) -> bool:
        """Whether the march ends here."""
        values, posed = self._values, self._posed
        if self._progress is not None:
            self._progress(done.time / posed.horizon)
        if posed.arrival_steps and done.measured:
            values.keep(done.time)  # before it converges: the first stop may be later
        if done.steps % GROWTH_CHECKED == 0:
            _check_growth(values.largest(), values.highest(), values.start.cell, done.time)
        if self._saved is not None and self._saved.due:
            self._saved.save(done)
            self.got_further = True
        if self._until is not None and done.steps % LOOKED == 0:
            table = values.arrays(Memory())["values"].reshape(posed.grid.shape)
            self._enough = self._until(to_value_function(posed.grid, table, Report()))
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
        return not posed.varies and done.last == 0.0 and self._values.on_one_side(posed.limit)

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
        posed, h, values = self._posed, self._h, self._values
        problem, marching = posed.problem, posed.marching
        refined = marching.refine > 1
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
            ends_reached="" if posed.filtered else _ends_reached(posed, h.system, values.ends()),
            cell=values.start.cell,
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
            refine=marching.refine if refined else None,
            marched_share=done.marched / max(done.steps * posed.grid.nodes, 1) if refined else None,
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
            remedy="let what is to be reached end within the grid, or widen the grid; or take a "
            "lower order or a smaller cfl",
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


@checked
def march_memory(
    grid: Grid,
    *,
    capture: bool = False,
    moving: bool = False,
    opposed: bool = False,
    times: int = 0,
    least_times: bool | None = None,
    **options: Unpack[MarchOptions],
) -> int:
    """The bytes of the arrays of a march over `grid` at its peak.

    capture: of a capture basin. least_times: whether it has these, as it has unless arrival_steps =
    0. moving: the problem depends on time. opposed: a disturbance works against getting to a basin.
    times: the number of requested values. options: those of `Marching`; precision, order (or
    scheme), estimate_error and check_outside matter.

    In units of the value at every node: one for each stage of the Runge-Kutta method (two at
    least), two for obstacles, two for each of the times (one until the end of the march), one for
    the error estimate, two and 8 bytes a node for the least times, four and a byte a node for
    `check_outside`. Of what is marched twice (all but basins that nothing opposes or moves, and
    what is of first order with local-local) what the first gave: one, or one for each of the times,
    and 8 bytes a node for least times. With `refine` the nodes are those of the finer grid; of the
    stages of the method only the blocks that are marched take memory, so that this is then the most
    that it can be. An answer of first order that is opposed remains while another march says what
    of it is disputed. The compiled march and its libraries take some 300 MB more, independent
    of the grid.

    Raises `SimulationError` for invalid options.

    >>> hf.march_memory(nodes, precision="float32") / 1e6
    0.02178
    """
    wanted = capture if least_times is None else least_times
    count = whole("times: ", times, 0)
    marching = marching_of(options)
    held = not marching.first_order and (opposed or moving or not capture)
    beside = marching.smeared or held
    compared = marching.first_order and opposed
    return _bytes(grid, marching, capture or moving, count, wanted, beside, compared)


def memory_of(posed: Posed) -> int:
    """The same for a complete problem."""
    return _bytes_of(posed, beside=posed.marched_twice, compared=posed.compared)


def _bytes_of(posed: Posed, *, beside: bool, compared: bool) -> int:
    obstacles = posed.problem.limit == "free" or posed.varies
    times = len(posed.asked) if posed.several else 0
    arrivals = bool(posed.arrival_steps)
    return _bytes(posed.grid, posed.marching, obstacles, times, arrivals, beside, compared)


def part_memory(posed: Posed, part: Part) -> int:
    """The same for the part of a march that is divided, with its halo, and with two times what it
    hands over, which is as much as it is handed. The workers do not hold what a first march gave.
    """
    planes = part.planes.own_nodes
    halo = (len(part.nodes) - (planes.stop - planes.start)) * posed.grid.nodes // part.of.nodes
    edges = 2 * halo * np.dtype(posed.marching.precision).itemsize
    return _bytes_of(posed, beside=False, compared=False) * len(part.nodes) // part.of.nodes + edges


def check_fits(posed: Posed) -> None:
    """Refuse a march that exceeds the memory of this machine.

    Of one on a cluster, its answer; one on a disk needs memory for a few planes.
    """
    marching, needed, what = posed.marching, memory_of(posed), f"{_nodes(posed):,} nodes"
    if marching.on_disk is not None:
        return
    if marching.cluster is not None:
        needed, what = answer_bytes(posed), f"the answer at {what}"
    remedy = "take fewer nodes"
    if marching.precision == "float64":
        remedy += ', or precision="float32"'
    if marching.cluster is None:
        remedy += ", or march from a disk (on_disk=FOLDER), or on a cluster (cluster=...)"
    else:
        remedy += ", or have it on a disk (on_disk=FOLDER)"
    check_memory(needed, what, remedy)


def _nodes(posed: Posed) -> int:
    """Of the grid of the answer."""
    return finer(posed.grid, posed.marching.refine).nodes


def answer_bytes(posed: Posed) -> int:
    """Of the values that are brought together, with their records, of each march."""
    size = np.dtype(posed.marching.precision).itemsize
    times = 2 * len(posed.asked) if posed.several else 0
    arrivals = (8 + size) * bool(posed.arrival_steps)
    marches = 1 + posed.marched_twice
    return posed.grid.nodes * (size * (1 + times) + arrivals) * marches


def _bytes(
    grid: Grid,
    marching: Marching,
    obstacles: bool,
    times: int,
    arrivals: bool,
    beside: bool,
    compared: bool,
) -> int:
    arrays = 1 + max(marching.method.stages - 1, 1) + 2 * obstacles + 2 * arrivals
    if marching.check_outside:
        arrays += 4
    elif marching.estimate_error:
        arrays += 1
    arrays = max(arrays + times, 2 * times + 1) + beside * max(times, 1)
    size = np.dtype(marching.precision).itemsize
    nodes = grid.nodes
    if marching.refine > 1:
        nodes += finer(grid, marching.refine).nodes
    needed = nodes * (size * arrays + 8 * arrivals * (1 + beside) + marching.check_outside)
    if not compared:
        return needed
    answer = grid.nodes * (size * max(times, 1) + 8 * arrivals)
    return max(needed, answer + _bytes(grid, marching.sharp, obstacles, 0, False, False, False))


LOSSES = 3
"""Times that workers may be lost between two checkpoints."""


def marched(
    posed: Posed,
    h: Hamiltonian,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
) -> ValueFunction:
    """The value at the end of the march, with what it is worth.

    h: the Hamiltonian of the problem. begin: values at the nodes that it begins with, where they
    are less than those of the problem, shape (nodes,), or that of the grid.
    """
    check_fits(posed)
    if posed.marching.symmetry is not None:
        check_symmetry(h, posed.problem.regions, posed.marching.symmetry)
    if posed.marching.on_disk is not None and not posed.filtered:
        check_disk(posed, h, memory_of(posed), answer_bytes(posed))  # of two marches at once
    place: Workplace | None = posed.marching.cluster
    refined, losses = on_finer_grid(posed), 0
    while True:
        attempt = OneMarch(
            refined, h, progress, until, memory=memory_of(posed), begun=begin is not None
        )
        if place is None:
            return attempt.result(march_here(refined, posed.grid, h, begin))
        try:
            with place.parts(refined, h) as parts:
                return attempt.result(DividedMarch(refined, h, parts, begin))
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
    h: Hamiltonian,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
) -> ValueFunction:
    """As `marched`, of a scheme that stands still only where the equation does.

    A march that `until` ended has no other beside it. progress: half of it is that of the first
    march, which may be the only one. begin: shape (nodes,), or that of the grid.
    """
    if not posed.marched_twice:
        return marched(posed, h, progress, begin, until)
    first = marched(posed, h, _half(progress, 0), begin, until)
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
    second = marched(beside, h, _half(progress, 1), begin)
    left, rests = second.report.residual_cells, second.report.converged
    if at_rest and not rests and left is not None and left <= marching.tolerance:
        begin = np.array(second.values())
        second = marched(beside.renamed("at rest"), h, _half(progress, 1), begin)
    return _of_both(first, second, posed)


def _steps_beside(marching: Marching) -> Method:
    """Of the march beside one that does not come to rest."""
    method = marching.method
    order, cfl = min(method.order, ORDER), max(method.cfl, min(LONGER * method.cfl, LONGEST))
    return replace(method, order=order, cfl=cfl, long=method.order > ORDER and marching.refine == 1)


def _half(progress: Progress | None, which: int) -> Progress | None:
    """What the first or the second of two marches calls with its share."""
    return None if progress is None else lambda share: progress(0.5 * (which + share))


def answered(
    posed: Posed,
    h: Hamiltonian,
    progress: Progress | None,
    begin: Array | None,
    until: Until | None,
) -> ValueFunction:
    """As `marched_to_rest`, with a warning where a part of the set is disputed.

    begin: shape (nodes,), or that of the grid.
    """
    value = marched_to_rest(posed, h, progress, begin, until)
    if posed.compared and not value.report.ended_early:
        value = _compared(value, posed, h)
    if share := value.report.disputed_share:
        warnings.warn(
            f"{100 * share:.2g} % of the {value.report.kind.replace('-', ' ')} are disputed: there "
            "a scheme of first order wins against the disturbance, and one of high order does not. "
            "The first may win what is lost, the other may miss what is won. Let differences be "
            "states where two players move something apart, take a finer grid, or try the set in "
            "closed loop (check_promise)",
            DisputedSetWarning,
            stacklevel=5,
        )
    return value


def _compared(value: ValueFunction, posed: Posed, h: Hamiltonian) -> ValueFunction:
    """The answer of a scheme of first order, with the share of it that is disputed."""
    aside = posed.aside("sharp")
    aside = replace(aside, marching=aside.marching.sharp)
    if min(a.count for a in posed.grid.axes) <= 2 * schemes()[aside.marching.scheme].ghosts:
        return value  # a grid of too few nodes
    sharp = marched(aside, h)
    values = value.values()
    answers = ((planes, values[planes]) for planes in _some_planes(values))
    count = disputed(sharp.values(), answers, value.grid)
    return value.reported(disputed_share=count / max(int((values > 0).sum()), 1))


def disputed(sharp: Array, answers: Iterable[tuple[slice, Array]], grid: Grid) -> int:
    """How many nodes of an answer are farther than two rims from the set of a sharp march.

    So many steps along the axes: a valley along a diagonal of the grid is narrow across corners.
    answers: the values by planes. sharp: shape (nodes of the first axis, nodes of the second, ...).
    """
    far = 2 * rim_of(grid)

    def near_set(values: Array, *, size: int, mode: list[str]) -> Array:
        ghosts = [size // 2 * (m == "wrap") for m in mode]
        padded = np.pad(values > 0, [(g, g) for g in ghosts], mode="wrap")
        near: Array = binary_dilation(padded, iterations=size // 2)
        return near[tuple(slice(g, n - g) for g, n in zip(ghosts, near.shape, strict=True))]

    return sum(
        int(((answer > 0) & ~_around(sharp, planes, grid, near_set, far)).sum())
        for planes, answer in answers
    )


def _of_both(first: ValueFunction, second: ValueFunction, posed: Posed) -> ValueFunction:
    """The answer of two marches: the values of the first are changed in place, plane by plane, so
    that they may be larger than the memory."""
    report, grid = first.report, second.grid
    tables = [v.dataset["value"].values for v in (first, second)]
    several, lesser = "time" in first.dataset["value"].dims, posed.marching.first_order
    apart = None
    if posed.opposed and not lesser:
        sharp, filtered = (table[-1] for table in tables) if several else tables
        apart = disputed(sharp, _held(sharp, filtered, grid, posed), grid)
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
        disputed_share=None if apart is None else apart / max(after, 1),
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
    rim = rim_of(grid)
    for planes in _some_planes(values):
        v = values[planes]
        if sides.above:
            highest = _around(filtered, planes, grid, maximum_filter, rim)
            v = np.where(highest > 0, v, np.minimum(v, highest))
        if sides.below:
            lowest = _around(filtered, planes, grid, minimum_filter, rim)
            v = np.where(lowest > 0, np.maximum(v, lowest), v)
        yield planes, v


def _no_later(times: Array, filtered: Array, grid: Grid) -> None:
    """Times of arrival, NaN for none, no later than the latest filtered one within the rim."""

    def latest_of(arrivals: Array, **options: Any) -> Array:
        latest: Array = maximum_filter(np.where(np.isnan(arrivals), math.inf, arrivals), **options)
        return latest

    for planes in _some_planes(times):
        latest = _around(filtered, planes, grid, latest_of, rim_of(grid))
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


def _around(
    values: Array, planes: slice, grid: Grid, extreme: Callable[..., Array], rim: int
) -> Array:
    """Of these planes the largest or the least value within a rim of so many cells."""
    count = len(values)
    modes = ["wrap" if axis.ends == "periodic" else "nearest" for axis in grid.axes]
    near = np.arange(planes.start - rim, planes.stop + rim)
    near = near % count if modes[0] == "wrap" else np.clip(near, 0, count - 1)
    extremes = extreme(values[near], size=2 * rim + 1, mode=["nearest", *modes[1:]])
    return extremes[rim : rim + planes.stop - planes.start]
