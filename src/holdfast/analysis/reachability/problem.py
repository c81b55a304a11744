"""A problem of viability, checked against its system and its grid, and ready to be marched.

A `Problem` with `Marching`, the options, is what is asked. A `Posed` one is what is marched: a
disturbance that is prescribed is within the bounds of the system, and ends and times fit.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.reachability.grid import Grid, by_name, number, whole
from holdfast.arguments import Seconds
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.device.program import DEVICES
from holdfast.execution.level_set.march import Method, over_grid
from holdfast.execution.level_set.schemes import schemes
from holdfast.execution.level_set.stage_leaf import DISSIPATIONS
from holdfast.maths.definitions.bounds import section
from holdfast.maths.definitions.quantity import TIME, Parameter, expression_of, merge_parameters
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

Player = Literal["min", "max"]

REFINEMENTS = (1, 2, 4, 8)
"""How many times shorter the cells near a boundary may be."""


@dataclass(frozen=True)
class Marching:
    """Options for solving a problem.

    scheme: "upwind", "eno2", "eno3" or "weno5"; order: of the Runge-Kutta method, 1 to 3, by
    default that of the scheme; dissipation: "global", "local" or "local-local"; cfl: share of the
    largest stable Euler step, of which a step of order 2 or 3 has two (the march that is filtered,
    beside one that does not come to rest, is of order 2 at most and has steps up to a quarter
    longer); precision: "float64" or "float32"; band: the value is cut off at this
    distance from zero on either side, and what is beyond is settled and skipped, so that the cost
    is that of the boundary; skip: leave out what is settled, which does not change the answer;
    threads: by default all cores; of every worker of a cluster, by default those that it has.

    tolerance [cells]: the march has converged when the boundary of the set, at the speed that it
    still has, moves by no more than this share of a cell over the rest of the horizon, in as long
    again as the march has gone, and while a cell is crossed along the slowest axis; and when that
    speed falls. A node that is deeper inside counts by the share of its value that it loses. No
    unit enters: seconds, metres and radians may be rescaled. `residual_cells` of the result is
    what is left to move.

    checkpoint: a file that the state of the march is written to, at the start, from time to time
    and at the end, or a folder to put one in, named after the problem. The same problem goes on
    from it, to the same bit; another is refused. It stays when the march has ended, so that a
    result that was not saved is not lost: remove it then. checkpoint_every [s]: of wall time.

    symmetry: state -> -1 for those that change sign in a reflection that leaves the problem as it
    is; half of the grid is computed then. It is checked symbolically
    (`maths/games/hamiltonian.py`).

    refine: cells so many times shorter near the boundary of the set: 1, 2, 4 or 8. The value is
    that of the finer grid at all of its nodes, of which only blocks around the boundary are
    marched (`posed_march.py`).

    samples: where the rates have no closed form in an input or a disturbance, the points along
    every coordinate of its set that are looked at (`maths/games/hamiltonian.py`); by default the
    system's.

    estimate_error, check_outside: what the answer is worth, by further marches (`solve.py`).

    device: "cpu", or "gpu": the same definition as kernels of CUDA, by way of CuPy (an extra of
    this package); values differ from those of the processor by roundings. "c++" compiles the text
    of these kernels with the C++ compiler of this machine, to check it.

    on_disk: a folder for the arrays, of a grid that is larger than the memory; the march reads and
    writes them there. cluster: the workers that the grid is divided among (`march_cluster.py`).
    The answer is that of one machine in its memory, to the same bit.

    Raises `SimulationError` for a value that is none of these, and for options that do not go
    together.
    """

    scheme: str = "weno5"
    order: int | None = None
    dissipation: str = "local-local"
    cfl: float = 0.75
    precision: str = "float64"
    band: float = math.inf
    tolerance: float = 0.01
    skip: bool = True
    threads: int | None = None
    symmetry: Mapping[str, int] | None = None
    checkpoint: str | Path | None = None
    checkpoint_every: Seconds = 60.0
    refine: int = 1
    samples: int | None = None
    estimate_error: bool | str = False
    check_outside: bool = False
    device: str = "cpu"
    on_disk: str | Path | None = None
    cluster: Any = None

    def __post_init__(self) -> None:
        for name, choices in (
            ("scheme", tuple(schemes())),
            ("dissipation", DISSIPATIONS),
            ("precision", ("float64", "float32")),
            ("device", DEVICES),
        ):
            if (value := getattr(self, name)) not in choices:
                raise SimulationError(f"{name}: {value!r}", remedy=suggestion(str(value), choices))
        if self.order is not None:
            whole("order: ", self.order, 1, 3)
        number("cfl: ", self.cfl, "a number above 0, at most 1", lambda v: 0 < v <= 1)
        number("band: ", self.band, "a number above 0; infinite for none", lambda v: v > 0)
        number("tolerance: ", self.tolerance, "a number of cells above 0", lambda v: v > 0)
        if self.threads is not None:
            whole("threads: ", self.threads, 1, 1024)
        for name in ("skip", "check_outside", "estimate_error"):
            value = getattr(self, name)
            also = name == "estimate_error" and value == "order"
            if not (isinstance(value, (bool, np.bool_)) or also):
                both = name == "estimate_error"
                expected = 'True, False or "order"' if both else "True or False"
                raise SimulationError(f"{name}: {value!r}", expected=expected)
        if self.symmetry is not None:
            by_name("symmetry", self.symmetry, '{"y": -1}')
        if self.checkpoint is not None and not isinstance(self.checkpoint, (str, Path)):
            raise SimulationError(f"checkpoint: {self.checkpoint!r}", expected="a file or a folder")
        if self.on_disk is not None and not (
            isinstance(self.on_disk, (str, Path)) and str(self.on_disk)
        ):
            raise SimulationError(f"on_disk: {self.on_disk!r}", expected="a folder")
        if self.cluster is not None and not hasattr(self.cluster, "parts"):
            raise SimulationError(
                f"cluster: {self.cluster!r}",
                expected="a cluster",
                remedy="make one: holdfast.interop.march_cluster.march_cluster(address)",
            )
        for name in ("cluster", "on_disk"):
            if self.device != "cpu" and getattr(self, name) is not None:
                raise SimulationError(
                    f'device="{self.device}" with {name}', remedy="leave one of them out"
                )
        number("checkpoint_every: ", self.checkpoint_every, "seconds, at least 0", lambda v: v >= 0)
        if whole("refine: ", self.refine, 1) not in REFINEMENTS:
            raise SimulationError(f"refine: {self.refine}", expected="1, 2, 4 or 8")
        if self.refine > 1:
            for name in ("symmetry", "checkpoint", "check_outside", "cluster", "on_disk"):
                if getattr(self, name):
                    raise SimulationError(
                        f"refine with {name}, which needs a march of every node of the finer grid",
                        remedy=f"leave out {name}, or take more nodes in place of refine",
                    )
        if self.checkpoint is None and self.checkpoint_every != 60.0:
            raise SimulationError(
                "checkpoint_every without a checkpoint", remedy="say checkpoint=a file or a folder"
            )

    @property
    def method(self) -> Method:
        order = self.order or schemes()[self.scheme].order
        return Method(self.scheme, order, self.dissipation, self.cfl, self.skip)

    @property
    def first_order(self) -> bool:
        """Whether the slopes of the scheme are the plain differences."""
        return schemes()[self.scheme].one_slope

    @property
    def smeared(self) -> bool:
        """Whether a scheme of first order has speeds beyond those that the two slopes allow."""
        return self.first_order and self.dissipation != "local-local"

    @property
    def monotone(self) -> bool:
        """Whether a step keeps the order of two values, less everywhere before, less after, of a
        Hamiltonian that `is_sharp` (`maths/games/hamiltonian.py`)."""
        return self.first_order and self.method.order == 1 and not self.smeared

    @property
    def sharp(self) -> Marching:
        """The march of high order that one of first order is compared with."""
        alone = replace(self, estimate_error=False, check_outside=False)
        return replace(alone, scheme=SHARP, order=None, dissipation="local-local")

    def aside(self, name: str, kind: str) -> Marching:
        """For a further march that tells what the first is worth; its checkpoint is named so."""
        path = self.checkpoint
        if path is not None:
            path = self.checkpoint_file(kind)
            path = path.with_name(f"{path.name}.{name}")
        return replace(self, checkpoint=path, estimate_error=False, check_outside=False)

    def checkpoint_file(self, kind: str) -> Path:
        path = Path(self.checkpoint or ".")
        return path / f"{kind}.checkpoint" if path.is_dir() else path


SHARP = "eno2"
"""The scheme of high order with the shortest reach, for grids of few nodes."""


class MarchOptions(TypedDict, total=False):
    """The fields of `Marching`, as options of a function."""

    scheme: str
    order: int | None
    dissipation: str
    cfl: float
    precision: str
    band: float
    tolerance: float
    skip: bool
    threads: int | None
    symmetry: Mapping[str, int] | None
    checkpoint: str | Path | None
    checkpoint_every: Seconds
    refine: int
    samples: int | None
    estimate_error: bool | str
    check_outside: bool
    device: str
    on_disk: str | Path | None
    cluster: Any


def marching_of(options: Mapping[str, Any]) -> Marching:
    """The options as they were given, with a refusal of unknown names."""
    for name in options:
        if name not in Marching.__dataclass_fields__:
            raise SimulationError(
                f"unknown option '{name}'", remedy=suggestion(name, Marching.__dataclass_fields__)
            )
    return Marching(**options)


@dataclass(frozen=True)
class Problem:
    """A problem: the initial region, how the set changes, and the obstacles.

    limit: "shrink" if `start` is to be kept, "grow" if it is to be reached, "free" if it is to be
    reached within `above`, "exact" if it is to be reached at the horizon itself. inputs,
    disturbances: "max" or "min", what each player makes of the value. backwards: the dynamics run
    in reverse.
    """

    kind: str
    limit: str
    start: Region
    inputs: str = "max"
    disturbances: str = "min"
    above: Region | None = None
    backwards: bool = False

    @property
    def regions(self) -> tuple[Region, ...]:
        return (self.start,) if self.above is None else (self.start, self.above)


LOOKED_AT = 257
"""Number of times at which a time-dependent disturbance is compared with its bounds."""

WITHOUT_END = 1e9
"""A larger factor counts as unbounded."""


def check_given(
    system: System,
    disturbance: Mapping[str, sp.Expr],
    numbers: Mapping[sp.Symbol, sp.Float],
    interval: tuple[float, float],
) -> None:
    """Refuse a prescribed disturbance that leaves its bounds at any of many times."""
    which = [d.name in disturbance for d in system.disturbances]
    bounds = section(system.disturbance_bounds, which)
    if bounds is None:
        return
    bounds = bounds.at(numbers)
    names = [n for n in system.disturbance_names if n in disturbance]
    values = [disturbance[n].xreplace(dict(numbers)) for n in names]
    moves = any(v.has(TIME) for v in values)
    for time in np.linspace(*interval, LOOKED_AT if moves else 1):
        now = [float(v.subs(TIME, float(time))) for v in values]
        if not bounds.contains(now):
            when = f" at {time:g} s" if moves else ""
            shown = ", ".join(f"{n} = {v:g}" for n, v in zip(names, now, strict=True))
            raise SimulationError(
                f"a disturbance is given outside its bounds: {shown}{when}",
                expected=f"values within {bounds.text()}",
                remedy="give a smaller disturbance, or widen the bounds of the system",
            )


def largest_factor(system: System, disturbance: Mapping[str, float | sp.Expr]) -> float:
    """The largest factor that keeps a constant prescribed disturbance within its bounds."""
    bounds = section(
        system.disturbance_bounds, [d.name in disturbance for d in system.disturbances]
    )
    if bounds is None:
        return math.inf
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    bounds = bounds.at(numbers)
    expressions = [sp.sympify(disturbance[n]) for n in system.disturbance_names if n in disturbance]
    values = [float(e.xreplace(numbers)) for e in expressions]

    def allowed(factor: float) -> bool:
        return bounds.contains([factor * v for v in values], 0.0)

    low, high = 0.0, 1.0
    while allowed(high):
        low, high = high, 2 * high
        if high > WITHOUT_END:
            return math.inf
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if allowed(middle) else (low, middle)
    return low


GIVEN = "given_"
"""Before the name of a disturbance: the parameter that holds the number given for it."""

ARRIVAL_STEPS = 100
"""Default number of steps at which the new nodes of a capture basin are recorded."""


class Held(NamedTuple):
    """Of a march of high order with a filtered one beside it (`one_march.py`). above: whether its
    set is at most a rim larger than the filtered one; below: at most a rim smaller."""

    above: bool = False
    below: bool = False


@dataclass(frozen=True)
class Posed:
    """A problem ready for the march.

    system: with what is given for its disturbances, in reverse where the problem asks for it.
    Numbers are parameters, so that others need no other program; a symmetry that is to be shown
    may hold for these numbers only, and has them in the expressions. asked: the times [s] at which
    the value is wanted, the last of them the horizon; several: whether all are kept.
    arrival_steps: how often it is looked which nodes are new. beyond: what leaving the grid is
    taken for, "lost" or "won"; "" continues the value. filtered: whether its rate is held close to
    that of a monotone step (`execution/level_set/stage_leaf.py`). steps: how it is marched, if not
    as its options say.

    Time t runs from start_time to start_time + horizon. A problem is marched from its end, so that
    t = start_time + horizon - tau, or for one that runs in reverse from its start.
    """

    system: System
    problem: Problem
    grid: Grid
    horizon: float
    marching: Marching
    parameters: tuple[Parameter, ...]
    disturbance: Mapping[str, sp.Expr]
    asked: tuple[float, ...]
    several: bool = False
    arrival_steps: int = 0
    beyond: str = ""
    start_time: float = 0.0
    filtered: bool = False
    steps: Method | None = None

    @property
    def method(self) -> Method:
        return self.steps or self.marching.method

    @property
    def named(self) -> tuple[Parameter, ...]:
        """The parameters of the system and its regions, without the disturbances given."""
        return tuple(q for q in self.parameters if not q.name.startswith(GIVEN))

    @cached_property
    def varies(self) -> bool:
        """Whether anything depends on time."""
        rates = self.system.rates.values()
        return any(r.has(TIME) for r in rates) or any(r.moves for r in self.problem.regions)

    @property
    def opposed(self) -> bool:
        """Whether its set is to be reached against a disturbance."""
        problem = self.problem
        against = problem.disturbances == "min" and bool(self.system.disturbances)
        return against and problem.limit != "shrink"

    @property
    def held(self) -> Held:
        """The sides on which its set is held to that of a filtered march."""
        limit, opposed = self.problem.limit, self.opposed
        if self.marching.first_order:
            return Held()
        if limit == "shrink":
            return Held(above=True)
        both = (opposed and limit == "exact") or (self.varies and (opposed or limit == "free"))
        return Held(above=both, below=both or opposed)

    @property
    def compared(self) -> bool:
        """Whether a march of high order is to say which part of its set is disputed."""
        return self.opposed and self.marching.first_order

    @property
    def marched_twice(self) -> bool:
        """Whether another march goes beside it (`one_march.py`)."""
        return self.marching.smeared or any(self.held)

    @property
    def limit(self) -> str:
        """The sign that dW/dtau is limited to.

        A set whose problem varies need neither shrink nor grow with tau: it has obstacles instead.
        """
        return "free" if self.varies or self.problem.limit == "exact" else self.problem.limit

    @property
    def clock(self) -> tuple[float, float]:
        """t at tau = 0, and whether it runs with tau or against it."""
        if self.problem.backwards:
            return self.start_time, 1.0
        return self.start_time + self.horizon, -1.0

    def aside(self, name: str) -> Posed:
        """The same problem for its end alone, to tell what its answer is worth."""
        last = (self.horizon,)
        return replace(self.renamed(name), asked=last, several=False, arrival_steps=0)

    def renamed(self, name: str) -> Posed:
        """The same problem, whose checkpoint is named so."""
        return replace(self, marching=self.marching.aside(name, self.problem.kind))


def pose(
    system: System,
    problem: Problem,
    grid: Grid,
    horizon: float,
    marching: Marching,
    *,
    disturbance: Mapping[str, float | sp.Expr],
    parameters: Mapping[str, float],
    times: Sequence[float] | None,
    arrival_steps: int | None,
    start_time: float,
) -> Posed:
    """The problem with everything in it checked; `SimulationError` for what cannot be solved."""
    horizon = number(
        "the horizon [s] is ", horizon, "a finite number above 0", lambda v: 0 < v < math.inf
    )
    start_time = number("start_time is ", start_time, "a finite number of seconds", math.isfinite)
    asked = _times(times, horizon)
    by_name("disturbance", disturbance, '{"d": 0.1}')
    by_name("parameters", parameters, '{"mass": 3.0}')
    for region in problem.regions:
        if not isinstance(region, Region):
            raise SimulationError(f"got {region!r}", expected="a Region")
    if not isinstance(grid, Grid):
        raise SimulationError(
            f"got {grid!r}", expected="a Grid", remedy="make one: hf.grid(system, box, nodes)"
        )
    prescribed = said = {n: _expression(v) for n, v in disturbance.items()}
    if marching.symmetry is None:
        system, prescribed = _with_names(system, said)
    moved = with_disturbance(system, prescribed)
    if problem.backwards:
        moved = replace(moved, rates={n: -r for n, r in moved.rates.items()}, pfaffian=())
    for region in problem.regions:
        region.check_states(moved.name, moved.states)
    if tuple(a.name for a in grid.axes) != moved.state_names:
        raise SimulationError(
            "the grid belongs to another system, with the states "
            + ", ".join(a.name for a in grid.axes),
            expected="the states " + ", ".join(moved.state_names),
        )
    check_counts(grid, marching.scheme)
    declared = merge_parameters(moved.parameters, *(r.parameters for r in problem.regions))
    declared = _given(declared, parameters)
    numbers = {q.symbol: sp.Float(q.value) for q in declared}
    bounds = {
        f"{what}_bounds": b.at(numbers)  # refused here, where they contradict themselves
        for what in ("input", "disturbance")
        if (b := getattr(moved, f"{what}_bounds")) is not None
    }
    check_given(system, said, numbers, (start_time, start_time + horizon))
    if marching.symmetry is not None:
        moved = replace(moved, **bounds)
    posed = Posed(
        moved, problem, grid, horizon, marching, declared, said, tuple(asked),
        times is not None, 0, "", start_time,
    )  # fmt: skip
    if arrival_steps is not None:
        whole("arrival_steps: ", arrival_steps, 0)
    else:
        arrival_steps = ARRIVAL_STEPS if problem.limit == "free" and not posed.varies else 0
    if posed.varies and arrival_steps:
        raise SimulationError(
            "the least time to the goal depends on the start time",
            expected="no arrival_steps if a rate or region depends on time",
            remedy="ask for the values at times=[...]",
        )
    return replace(posed, arrival_steps=arrival_steps)


def check_counts(grid: Grid, scheme: str) -> None:
    """Refuse an axis with fewer nodes than the scheme reaches over."""
    least = 2 * schemes()[scheme].ghosts + 1
    for axis in grid.axes:
        if axis.count < least:
            raise SimulationError(
                f"{axis.count} nodes along '{axis.name}'", expected=f"at least {least} for {scheme}"
            )


Ends = frozenset[tuple[int, int]]
"""Ends of the grid: an axis, and 0 for its lower or -1 for its upper end."""


ON_END = 1e-6
"""Cells within which an end of the grid is said to lie on a constraint."""


def touched(values: npt.NDArray[np.floating], ends: tuple[bool, bool]) -> Ends:
    """The ends of the grid at which a value in some of its planes is positive.

    What is positive by less than `ON_END` of the largest change to the next plane is zero but for
    rounding, as in `beyond` of `stencils.py`. ends: whether the first and the last of these are
    ends of the grid.

    values: shape (some of the first axis, nodes of the others, ...).
    """

    def reaches(i: int, end: int) -> bool:
        inner = min(1, values.shape[i] - 1) if end == 0 else max(-2, -values.shape[i])
        edge, next_to_it = (np.take(values, k, axis=i) for k in (end, inner))
        return bool((edge > ON_END * np.abs(edge - next_to_it).max()).any())

    return frozenset(
        (i, end)
        for i in range(values.ndim)
        for end in (0, -1)
        if (i > 0 or ends[end]) and reaches(i, end)
    )


class CutOffError(SimulationError):
    """A grid that cuts off a region. beyond: a state, and how far along it the region reaches."""

    beyond: tuple[str, float]


def check_inside(posed: Posed, reached: Ends) -> None:
    """Refuse a grid that cuts off the region along a state that the region is about."""
    if posed.problem.limit != "shrink":
        return
    region = posed.problem.start
    symbols = set().union(*(c.expression.free_symbols for c in region.inequalities))
    read = {q.name for q in region.reads if q.symbol in symbols}
    for i, axis in enumerate(posed.grid.axes):
        if axis.ends != "contained" or axis.name not in read:
            continue
        for end, where in ((0, axis.low), (-1, axis.high)):
            if (i, end) in reached:
                within = f"abs({axis.name}) - {0.9 * max(-axis.low, axis.high):.3g}"
                if _endless(posed, i, where):
                    raise SimulationError(
                        f"region '{region.name}' has no end along '{axis.name}', and no grid "
                        "contains it",
                        expected="a region that ends within the grid",
                        remedy=f"add the constraint {within} <= 0 to region '{region.name}', or "
                        f'give ends = {{"{axis.name}": "extrapolated"}} and accept extrapolated '
                        "values",
                    )
                wide = _end_of_region(posed, i, where)
                far = "widen it" if wide is None else f"widen it to {axis.name} = {wide:.6g}"
                cut = CutOffError(
                    f"the grid cuts off region '{region.name}' at {axis.name} = {where:g}",
                    expected="a grid that contains the region",
                    remedy=f'{far}, or give ends = {{"{axis.name}": "limited"}} if the state '
                    'itself ends there, or "extrapolated" and accept extrapolated values',
                )
                cut.beyond = axis.name, where if wide is None else wide
                raise cut


FAR = (1e1, 1e2, 1e3)
"""Number of grid widths beyond an end that are searched before a region is called endless."""


def _endless(posed: Posed, number: int, end: float) -> bool:
    """Whether the region is still there far beyond an end of an axis, however far one looks."""
    axis = posed.grid.axes[number]
    return all(_beyond(posed, number, end, (axis.high - axis.low) * np.array(FAR)))


def _end_of_region(posed: Posed, number: int, end: float) -> float | None:
    """A place beyond an end of an axis at which nothing is left of the region, in whole cells; None
    if there is none within ten widths of the grid. The other axes are those of the grid."""
    axis = posed.grid.axes[number]
    cells = np.unique(np.geomspace(1, 10 * axis.count, 60).astype(int))
    left = _beyond(posed, number, end, axis.step * cells)
    if left.all():
        return None
    outwards = 1.0 if end == axis.high else -1.0
    return float(end + outwards * axis.step * cells[int(np.argmin(left))])


def _beyond(
    posed: Posed, number: int, end: float, far: npt.NDArray[np.float64]
) -> npt.NDArray[np.bool_]:
    """Whether the region is somewhere so far beyond an end of an axis, at increasing distances."""
    axis, region = posed.grid.axes[number], posed.problem.start
    outwards = 1.0 if end == axis.high else -1.0
    nodes = [a.nodes for a in posed.grid.axes]
    nodes[number] = np.sort(end + outwards * far)
    margin = over_grid(
        region.margin,
        [a.state.symbol for a in posed.grid.axes],
        posed.parameters,
        nodes,
        precision=posed.marching.precision,
    )
    table = margin(posed.clock[0]).reshape([len(n) for n in nodes])
    largest = np.moveaxis(table, number, 0).reshape(len(far), -1).max(axis=1)
    there = np.asarray(largest > 0)
    return there if outwards > 0 else there[::-1]


def _times(times: Sequence[float] | None, horizon: float) -> list[float]:
    if times is not None and (isinstance(times, str) or not isinstance(times, Iterable)):
        raise SimulationError(f"times: {times!r}", expected="a list of times, such as [0.5, 1]")
    asked = sorted(
        number("a value is asked for at the time ", t, "a number of seconds", lambda v: v == v)
        for t in (() if times is None else times)
    )
    if asked and not (asked[0] >= 0 and asked[-1] <= horizon):
        raise SimulationError(
            f"a value is asked for at {asked[0] if asked[0] < 0 else asked[-1]:g} s",
            expected=f"times from 0 to the horizon, {horizon:g} s",
        )
    return asked if asked and asked[-1] == horizon else [*asked, float(horizon)]


def definition(system: System) -> str:
    """A digest of what a system can do: its rates and bounds, as expressions of its parameters.

    Bounds are in the order of what they bound.
    """
    return _digest([*_able(system), system.input_names, system.disturbance_names])


def is_defined_so(system: System, said: str) -> bool:
    """Whether a digest, which may be one of former files without names, is that of a system."""
    return said in (definition(system), _digest(_able(system)))


def _able(system: System) -> list[object]:
    return [*system.rates.items(), system.input_bounds, system.disturbance_bounds]


def _digest(said: list[object]) -> str:
    return hashlib.sha256(repr(said).encode()).hexdigest()[:16]


def with_disturbance(system: System, disturbance: Mapping[str, float | sp.Expr]) -> System:
    """The system with what some of its disturbances are; those of one ball go together.

    They are numbers, or expressions of time and the system's parameters.
    """
    if not disturbance:
        return system
    allowed = {TIME, *(q.symbol for q in system.parameters)}
    for name, value in disturbance.items():
        if name not in system.disturbance_names:
            raise SimulationError(
                f"system '{system.name}' has no disturbance '{name}'",
                remedy=suggestion(name, system.disturbance_names),
            )
        if unknown := _expression(value).free_symbols - allowed:
            raise SimulationError(
                f"disturbance '{name}' uses '{min(map(str, unknown))}'",
                expected="a number, or an expression of t and parameters of the system",
            )
    values = {
        d.symbol: _expression(disturbance[d.name])
        for d in system.disturbances
        if d.name in disturbance
    }
    left = tuple(d for d in system.disturbances if d.name not in disturbance)
    return replace(
        system,
        rates={n: r.xreplace(values) for n, r in system.rates.items()},
        disturbances=left,
        disturbance_bounds=section(
            system.disturbance_bounds, [d in left for d in system.disturbances]
        ),
        pfaffian=(),
    )


def _with_names(
    system: System, disturbance: Mapping[str, sp.Expr]
) -> tuple[System, dict[str, sp.Expr]]:
    """Disturbances that are given as numbers, by parameters of the system with their values."""
    held = tuple(
        Parameter(f"{GIVEN}{d.name}", d.unit, value=float(disturbance[d.name]))
        for d in system.disturbances
        if d.name in disturbance and disturbance[d.name].is_number
    )
    names = {q.name.removeprefix(GIVEN): q.symbol for q in held}
    return replace(system, parameters=(*system.parameters, *held)), {**disturbance, **names}


def _expression(value: float | sp.Expr) -> sp.Expr:
    if isinstance(value, sp.Expr | str):
        return expression_of(value)
    return sp.Float(number("a disturbance is given as ", value, "a finite number", math.isfinite))


def _given(parameters: tuple[Parameter, ...], values: Mapping[str, float]) -> tuple[Parameter, ...]:
    names = [q.name for q in parameters]
    for name in values:
        if name not in names:
            raise SimulationError(f"no parameter '{name}'", remedy=suggestion(name, names))
    return tuple(
        replace(q, value=number(f"parameter '{q.name}' is ", v, "a finite number", math.isfinite))
        for q, v in ((q, values.get(q.name, q.value)) for q in parameters)
    )
