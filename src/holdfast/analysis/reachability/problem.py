"""A problem of viability, checked against its system and its grid, and ready to be marched."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.reachability.given import by_name, number, whole
from holdfast.analysis.reachability.given_disturbance import check_given
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.options import Marching, Problem
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.level_set.march import Method
from holdfast.execution.level_set.over_grid import over_grid
from holdfast.execution.level_set.schemes import schemes
from holdfast.maths.control.outward_rates import check_states
from holdfast.maths.definitions.bounds import section
from holdfast.maths.definitions.quantity import TIME, Parameter, merge_parameters
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

GIVEN = "given_"
"""Before the name of a disturbance: the parameter that holds the number given for it."""

ARRIVAL_STEPS = 100
"""Default number of steps at which the new nodes of a capture basin are recorded."""


class Held(NamedTuple):
    """Of a march of high order with a filtered one beside it (`resting_set.py`). above: whether its
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
    that of a monotone step (`execution/level_set/stage_steps.py`). steps: how it is marched, if not
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

    @property
    def varies(self) -> bool:
        """Whether anything depends on time."""
        rates = self.system.rates.values()
        return any(r.has(TIME) for r in rates) or any(r.moves for r in self.problem.regions)

    @property
    def held(self) -> Held:
        """The sides on which its set is held to that of a filtered march."""
        limit = self.problem.limit
        if self.marching.first_order:
            return Held()
        opposed = self.problem.disturbances == "min" and bool(self.system.disturbances)
        if limit == "shrink":
            return Held(above=True)
        both = (opposed and limit == "exact") or (self.varies and (opposed or limit == "free"))
        return Held(above=both, below=both or opposed)

    @property
    def marched_twice(self) -> bool:
        """Whether another march goes beside it (`resting_set.py`)."""
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
    given = said = {n: _expression(v) for n, v in disturbance.items()}
    if marching.symmetry is None:
        system, given = _with_names(system, said)
    moved = with_disturbance(system, given)
    if problem.backwards:
        moved = replace(moved, rates={n: -r for n, r in moved.rates.items()}, pfaffian=())
    for region in problem.regions:
        check_states(moved, region)
    if tuple(a.name for a in grid.axes) != moved.state_names:
        raise SimulationError(
            "the grid belongs to another system, with the states "
            + ", ".join(a.name for a in grid.axes),
            expected="the states " + ", ".join(moved.state_names),
        )
    check_counts(grid, marching.scheme)
    known = merge_parameters(moved.parameters, *(r.parameters for r in problem.regions))
    known = _given(known, parameters)
    numbers = {q.symbol: sp.Float(q.value) for q in known}
    bounds = {
        f"{what}_bounds": b.at(numbers)  # refused here, where they contradict themselves
        for what in ("input", "disturbance")
        if (b := getattr(moved, f"{what}_bounds")) is not None
    }
    check_given(system, said, numbers, (start_time, start_time + horizon))
    if marching.symmetry is not None:
        moved = replace(moved, **bounds)
    posed = Posed(
        moved, problem, grid, horizon, marching, known, said, tuple(asked),
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
                        remedy=f"add the constraint {within} <= 0 (of region "
                        f"'camera_view': along_wall), or give ends = {{\"{axis.name}\": "
                        '"extrapolated"} and accept extrapolated values',
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


def with_disturbance(system: System, given: Mapping[str, float | sp.Expr]) -> System:
    """The system with what some of its disturbances are; those of one ball go together.

    They are numbers, or expressions of time and the system's parameters.
    """
    if not given:
        return system
    known = {TIME, *(q.symbol for q in system.parameters)}
    for name, value in given.items():
        if name not in system.disturbance_names:
            raise SimulationError(
                f"system '{system.name}' has no disturbance '{name}'",
                remedy=suggestion(name, system.disturbance_names),
            )
        if unknown := _expression(value).free_symbols - known:
            raise SimulationError(
                f"disturbance '{name}' uses '{min(map(str, unknown))}'",
                expected="a number, or an expression of t and parameters of the system",
            )
    values = {d.symbol: _expression(given[d.name]) for d in system.disturbances if d.name in given}
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


def _with_names(system: System, given: Mapping[str, sp.Expr]) -> tuple[System, dict[str, sp.Expr]]:
    """Disturbances that are given as numbers, by parameters of the system with their values."""
    held = tuple(
        Parameter(f"{GIVEN}{d.name}", d.unit, value=float(given[d.name]))
        for d in system.disturbances
        if d.name in given and given[d.name].is_number
    )
    names = {q.name.removeprefix(GIVEN): q.symbol for q in held}
    return replace(system, parameters=(*system.parameters, *held)), {**given, **names}


def _expression(value: float | sp.Expr) -> sp.Expr:
    if isinstance(value, sp.Expr):
        return value
    return sp.Float(number("a disturbance is given as ", value, "a finite number", math.isfinite))


def _given(known: tuple[Parameter, ...], values: Mapping[str, float]) -> tuple[Parameter, ...]:
    names = [q.name for q in known]
    for name in values:
        if name not in names:
            raise SimulationError(f"no parameter '{name}'", remedy=suggestion(name, names))
    return tuple(
        replace(q, value=number(f"parameter '{q.name}' is ", v, "a finite number", math.isfinite))
        for q, v in ((q, values.get(q.name, q.value)) for q in known)
    )
