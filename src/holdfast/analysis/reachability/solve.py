"""Problems of viability by their names, from definition to answer, and what the answer is worth.

Errors of a value function are estimated by marching the problem again: on coarser grids for that of
the grid, and with other ends for values extrapolated from outside it. By bisection: the largest
admissible value of a parameter, such as a disturbance bound.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Protocol, TypeVar, Unpack

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.reachability.grid import Axis, Grid, by_name
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.one_march import (
    Progress,
    Until,
    answered,
    marched,
    marched_to_rest,
)
from holdfast.analysis.reachability.posed_march import check_refined, hamiltonian_of
from holdfast.analysis.reachability.problem import (
    MarchOptions,
    Player,
    Posed,
    Problem,
    check_counts,
    definition,
    marching_of,
    pose,
)
from holdfast.analysis.reachability.value_function import (
    Claim,
    ValueFunction,
    beside,
    to_value_function,
    with_error_in_cells,
)
from holdfast.arguments import Count, Seconds, checked
from holdfast.errors import HoldfastError, RenamedWarning, SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.march import over_grid
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.games.hamiltonian import Hamiltonian, is_sharp

TOGETHER = 1 << 20
"""Nodes that are looked at together, to save memory."""

LEAST_ORDER = 0.5
"""A lower observed order says that the grids are too coarse for one; it is taken for this."""


def coarser(posed: Posed, count: int) -> list[Posed]:
    """The same problem with half as many cells along every axis, and again half, `count` times.

    Raises `SimulationError` where the cells along an axis are not a multiple of 2 (of 4), so that
    the grids would have no nodes in common, or where a grid is too coarse for the scheme.
    """
    problems: list[Posed] = []
    for k in range(1, count + 1):
        grid = Grid(tuple(_thinned(a, 2**k) for a in posed.grid.axes))
        try:
            check_counts(grid, posed.marching.scheme)
        except HoldfastError as error:
            raise SimulationError(
                f"a grid of 1/{2**k} of the cells has {error.cause}",
                expected=error.expected,
                remedy="take more nodes, or leave out estimate_error",
            ) from None
        problems.append(replace(posed.aside(f"coarse{k}"), grid=grid))
    return problems


def _thinned(axis: Axis, factor: int) -> Axis:
    last = axis.ends != "periodic"
    cells = axis.count - last
    if cells % factor:
        nodes = cells // factor * factor + last
        raise SimulationError(
            f"{cells} cells along '{axis.name}'",
            expected=f"a multiple of {factor}, for an estimate of the error",
            remedy=f"take {nodes} or {nodes + factor} nodes",
        )
    return replace(axis, count=cells // factor + last)


def with_error(value: ValueFunction, coarse: Sequence[ValueFunction]) -> ValueFunction:
    """`value`, on cells of size h, with an estimate of its error from those of 2 h (and 4 h).

    With a scheme of order p the error of V_h is (V_h - V_2h) / (2^p - 1), to first order (L. F.
    Richardson, 1911). The boundaries of the sets have corners, where every scheme falls back: p is
    taken for 1, so that the error is the whole difference, or with a third grid it is observed,

        p = log2( |V_2h - V_4h| / |V_h - V_2h| ),   root mean squares near the boundary

    Near the boundary are the common nodes beside it, those with a neighbour in which V_h or V_2h
    has another sign; where there are none, all. Attributes:

    error_order         p: 1, or as observed; one below 0.5 is taken for 0.5
    error_largest       largest |V_h - V_2h| / (2^p - 1) near the boundary, in the value's unit
    error_rms           its root mean square
    error_cells         how far off the boundary lies, in cells: the error over the change of V
                        from cell to cell; 95 % of the nodes near the boundary are below. Where V
                        jumps, the distance of the boundaries (`inner_set`)
    volume_coarse       the volume on 2 h, to be compared with `volume`
    """
    thin = tuple(slice(None, None, 2) for _ in value.grid.axes)
    fine = value.values()
    apart = fine[thin] - coarse[0].values()
    near = _near(fine[thin], coarse[0])
    order = 1.0
    if len(coarse) > 1:
        further = coarse[0].values()[thin] - coarse[1].values()
        both = _near(coarse[0].values()[thin], coarse[1])
        small, large = _rms(apart[thin][both]), _rms(further[both])
        if small > 0 and large > 0:
            order = max(math.log2(large / small), LEAST_ORDER)
    error = np.abs(apart[near]) / (2.0**order - 1.0)
    slopes = np.zeros(apart.shape)
    for i in range(fine.ndim):  # of the rows with common nodes, to save memory
        rows = np.moveaxis(fine, i, 0)[(slice(None), *thin[1:])]
        slopes += np.moveaxis(_steeper(rows)[::2] ** 2, 0, i)
    with np.errstate(divide="ignore", invalid="ignore"):
        cells = np.where(error > 0, error / np.sqrt(slopes[near]), 0.0)
    return value.reported(
        error_order=order,
        error_largest=float(error.max()),
        error_rms=_rms(error),
        error_cells=float(np.quantile(cells, 0.95, method="higher")),
        volume_coarse=coarse[0].volume(),
    )


def _near(fine: Array, coarse: ValueFunction) -> Array:
    periodic = [a.ends == "periodic" for a in coarse.grid.axes]
    near = beside(fine, periodic) | beside(coarse.values(), periodic)
    return near if near.any() else np.ones_like(near)


def _steeper(rows: Array) -> Array:
    """The larger of the changes to both neighbours along the first axis."""
    changes = np.abs(np.diff(rows, axis=0))
    return np.maximum(
        np.concatenate([changes, changes[-1:]]), np.concatenate([changes[:1], changes])
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def with_outside(
    value: ValueFunction, posed: Posed, march: Callable[[Posed], ValueFunction]
) -> ValueFunction:
    """`value`, with the nodes whose side depends on extrapolation beyond the grid.

    There the value is continued, which is a guess. So the problem is solved twice more, as if
    whoever leaves the grid had lost, and as if they had won:

        lost    the set is what needs nothing from outside:    V <= distance to the ends
        won     what is not in the set, is not in any case:    V >= -distance to the ends

    A node in the set both times is in it, and one in neither is not, whatever is outside (but for
    the error of the scheme, and half a cell at the ends themselves). This asks about the answer
    itself, where a look at which way the characteristics cross the ends would ask about the ends
    only: what enters there may matter for none of the nodes, or for all.

    `outside` is 0 at the nodes whose side does not depend on it, 1 at those that are in the set by
    what is outside, -1 at those that are not in it, but might be if it were all won beyond.
    Attributes: nodes_from_outside and nodes_kept_outside count the two, share_from_outside is
    the part of the set's nodes.
    """
    values = value.values().ravel()
    side = np.zeros(len(values), np.int8)
    parts = [slice(k, k + TOGETHER) for k in range(0, len(values), TOGETHER)]
    for what, within, mark in (("lost", True, 1), ("won", False, -1)):
        other = march(replace(posed.aside(what), beyond=what)).values().ravel()
        for k in parts:
            side[k][((values[k] > 0) == within) & ((other[k] > 0) != within)] = mark
    inside = sum(int((values[k] > 0).sum()) for k in parts)
    gained, missed = (sum(int((side[k] == m).sum()) for k in parts) for m in (1, -1))
    text = "1 in the set by what is outside the grid, -1 not in it by what is outside, 0 sure"
    names = [a.name for a in value.grid.axes]
    marks = side.reshape(value.grid.shape)
    dataset = value.dataset.assign(outside=(names, marks, {"units": "1", "long_name": text}))
    return replace(value, dataset=dataset).reported(
        nodes_from_outside=gained,
        share_from_outside=gained / max(inside, 1),
        nodes_kept_outside=missed,
    )


class PosedOptions(MarchOptions, total=False):
    """What every problem takes; see `Marching`, and `solve`."""

    disturbance: Mapping[str, float | sp.Expr] | None
    parameters: Mapping[str, float] | None
    times: Sequence[Seconds] | None
    start_time: Seconds
    begin: ValueFunction | None
    until: Until | None


class SolveOptions(PosedOptions, total=False):
    """With what is told of the march."""

    progress: Progress | None


def solve(
    system: System,
    problem: Problem,
    grid: Grid,
    horizon: Seconds,
    *,
    disturbance: Mapping[str, float | sp.Expr] | None = None,
    parameters: Mapping[str, float] | None = None,
    times: Sequence[Seconds] | None = None,
    arrival_steps: Count | None = None,
    start_time: Seconds = 0.0,
    progress: Progress | None = None,
    begin: ValueFunction | None = None,
    until: Until | None = None,
    **options: Unpack[MarchOptions],
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
    h = hamiltonian_of(posed)
    start = _begun(posed, h, begin, until)
    keeps = problem.limit == "shrink"
    value = answered(posed, h, progress, start, until)
    if further:
        sharp = keeps and not marching.first_order
        march = marched if sharp else marched_to_rest
        rougher = [march(other, h) for other in further]
        value = with_error_in_cells(with_error(value, rougher), rougher[0])
    if marching.check_outside:
        value = with_outside(value, posed, lambda other: marched_to_rest(other, h))
    if progress is not None:
        progress(1.0)  # a march that comes to rest has not gone the whole way
    claim = Claim(problem.start) if keeps else Claim(problem.above, problem.start)
    return replace(value.reported(definition=definition(system)), claim=claim)


def _begun(
    posed: Posed, h: Hamiltonian, begin: ValueFunction | None, until: Until | None
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
    if not (marching.monotone and is_sharp(h)):
        raise SimulationError(
            f"scheme {marching.scheme}, dissipation {marching.dissipation} cannot begin with "
            "another value: its steps are not monotone",
            expected='scheme="upwind" with local-local dissipation and steps of order 1, and no '
            "input in a ball that moves several states",
        )
    report = begin.report
    here = {
        "kind": posed.problem.kind,
        "system": posed.system.name,
        "region": posed.problem.start.name,
        "converged": True,
    }
    for name, value in here.items():
        if getattr(report, name) != value:
            raise SimulationError(
                f"the value to begin with has {name} = {getattr(report, name)}", expected=str(value)
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


@checked
def viability_kernel(
    system: System, region: Region, grid: Grid, horizon: Seconds, **options: Unpack[SolveOptions]
) -> ValueFunction:
    """The states from which some input keeps the system in `region` for `horizon` seconds.

    V_t + min{0, max_u p . f} = 0, V(T) = l; the viability kernel itself once it has converged
    (`converged` of the result). The system has no disturbances, or all are given (`disturbance`).
    region: to be kept; inside it l > 0. horizon [s]: of the march, which ends before it where the
    kernel has converged. options: those of `Marching`, and times [s]: the horizons that are kept,
    ascending; disturbance: name -> its number or expression; parameters: name -> value; start_time
    [s]: for rates and regions of `TIME`; progress. Raises `SimulationError` for what cannot be
    solved, and for a march that is unstable.

    >>> safe = hf.viability_kernel(cart, hf.both(track, slow), nodes, 4.0, scheme="upwind")
    >>> safe.at([[0.0, 0.4], [0.95, 0.4]]) > 0
    array([ True, False])
    """
    if _undecided(system, options):
        raise SimulationError(
            f"system '{system.name}' has disturbances",
            remedy="give them (disturbance=...), or ask for the discriminating_kernel",
        )
    return solve(system, Problem("viability-kernel", "shrink", region), grid, horizon, **options)


def _undecided(system: System, options: Mapping[str, Any]) -> bool:
    """Whether some disturbance is left that is not given."""
    disturbance = options.get("disturbance")
    prescribed = {} if disturbance is None else by_name("disturbance", disturbance, '{"d": 0.1}')
    return bool(set(system.disturbance_names) - set(prescribed))


@checked
def discriminating_kernel(
    system: System, region: Region, grid: Grid, horizon: Seconds, **options: Unpack[SolveOptions]
) -> ValueFunction:
    """The states from which some input keeps the system in `region` whatever the disturbance does.

    V_t + min{0, max_u min_d p . f} = 0, V(T) = l (thesis (7.6)). options: as of
    `viability_kernel`, which says what is raised.

    >>> hf.discriminating_kernel(gusty, track, nodes, 4.0).fraction() < kernel.fraction()
    True
    """
    if not _undecided(system, options):
        raise SimulationError("the system has no disturbances", remedy="use viability_kernel")
    problem = Problem("discriminating-kernel", "shrink", region)
    return solve(system, problem, grid, horizon, **options)


@checked
def invariance_kernel(
    system: System, region: Region, grid: Grid, horizon: Seconds, **options: Unpack[SolveOptions]
) -> ValueFunction:
    """The states from which every input and every disturbance keeps the system in `region`.

    V_t + min{0, min_u min_d p . f} = 0, V(T) = l. options: as of `viability_kernel`, which says
    what is raised.

    >>> hf.invariance_kernel(cart, track, nodes, 0.5).fraction() < kernel.fraction()
    True
    """
    problem = Problem("invariance-kernel", "shrink", region, inputs="min")
    return solve(system, problem, grid, horizon, **options)


@checked
def backward_reachable_tube(
    system: System,
    target: Region,
    grid: Grid,
    horizon: Seconds,
    *,
    disturbances: Player = "min",
    **options: Unpack[SolveOptions],
) -> ValueFunction:
    """The states from which some input brings the system to `target` within `horizon` seconds.

    V_t + max{0, max_u opp_d p . f} = 0, V(T) = l_T. `backward_reachable_at` is the set of the
    states that are there at the horizon itself. target: a `Region`. disturbances: "min" work
    against it, "max" help. options: as of `viability_kernel`, which says what is raised.

    >>> hf.backward_reachable_tube(cart, slow, nodes, 1.0).at([[0.0, 1.4], [0.0, 1.6]]) > 0
    array([ True, False])
    """
    problem = Problem("backward-reachable-tube", "grow", target, disturbances=disturbances)
    return solve(system, problem, grid, horizon, **options)


@checked
def backward_reachable_at(
    system: System,
    target: Region,
    grid: Grid,
    horizon: Seconds,
    *,
    disturbances: Player = "min",
    **options: Unpack[SolveOptions],
) -> ValueFunction:
    """The states from which some input has the system in `target` after exactly `horizon` seconds.

    The backward reachable set, as against the tube: V_t + max_u opp_d p . f = 0, V(T) = l_T. It
    need not contain the target, and the march goes on to the horizon. target: a `Region`. horizon
    [s]: when the system is there. disturbances: "min" work against it, "max" help. options: as of
    `viability_kernel`. Raises `SimulationError` for check_outside, which is about tubes.

    >>> hf.backward_reachable_at(cart, slow, nodes, 1.0).at([[0.0, 1.4], [0.0, 1.6]]) > 0
    array([ True, False])
    """
    if options.get("check_outside"):
        raise SimulationError(
            "check_outside of a set at exactly the horizon", remedy="ask for the tube"
        )
    problem = Problem("backward-reachable-at", "exact", target, disturbances=disturbances)
    return solve(system, problem, grid, horizon, **options)


def backward_reachable_set(
    system: System,
    target: Region,
    grid: Grid,
    horizon: Seconds,
    *,
    disturbances: Player = "min",
    **options: Unpack[SolveOptions],
) -> ValueFunction:
    """The former name of `backward_reachable_tube`; it warns, and goes with the next release.

    target, disturbances, options: as there.
    """
    warnings.warn(
        "backward_reachable_set is now backward_reachable_tube; the set at exactly the horizon is "
        "backward_reachable_at",
        RenamedWarning,
        stacklevel=2,
    )
    return backward_reachable_tube(
        system, target, grid, horizon, disturbances=disturbances, **options
    )


@checked
def forward_reachable_set(
    system: System,
    start: Region,
    grid: Grid,
    horizon: Seconds,
    *,
    disturbances: Player = "max",
    **options: Unpack[SolveOptions],
) -> ValueFunction:
    """The states that some input, and some disturbance, can bring the system to from `start`.

    The forward reachable tube: the backward one of the reversed dynamics (thesis section 7.3). The
    states are those at the end of the horizon, after leaving `start` at any time within it. The set
    is an inner approximation (`report.approximation`): on a grid it leaves out what is thin.

    start: a `Region`. disturbances: "max" are at the choice of whoever wants to get there, "min"
    work against it. options: as of `viability_kernel`, which says what is raised.

    >>> hf.forward_reachable_set(cart, slow, nodes, 1.0).at([[0.0, 1.4], [0.0, 1.6]]) > 0
    array([ True, False])
    """
    problem = Problem(
        "forward-reachable-set", "grow", start, disturbances=disturbances, backwards=True
    )
    return solve(system, problem, grid, horizon, **options)


@checked
def capture_basin(
    system: System,
    goal: Region,
    region: Region | None,
    grid: Grid,
    horizon: Seconds,
    *,
    arrival_steps: Count | None = None,
    **options: Unpack[SolveOptions],
) -> ValueFunction:
    """The states from which some input reaches `goal` within `horizon` s, in `region` until then.

    The reach-avoid set. W = max_u max_tau min{ l_G(tau), min_{s <= tau} l_K(s) } solves min{ max{
    W_t + H, l_G - W }, l_K - W } = 0; disturbances work against it.

    region: None for none. arrival_steps: how many values over the horizon the least time,
    `arrival`, is taken from (100; 0: none). options: as of `viability_kernel`, which says what is
    raised.

    Where something depends on time there is none: it would hold for one start only.

    >>> basin = hf.capture_basin(cart, slow, track, nodes, 2.0)
    >>> basin.least_time([[0.0, 1.0]]).round(2)
    array([0.5])
    """
    problem = Problem("capture-basin", "free", goal, above=region)
    return solve(system, problem, grid, horizon, arrival_steps=arrival_steps, **options)


SCANNED = 9
"""Number of values tried over the interval if the answer need not be monotone."""

DOUBLED = 5
"""Largest number of doublings of the upper end while all trials succeed."""


class Answer(Enum):
    """The outcome of a trial."""

    HELD = "the set meets the requirement"
    LOST = "the set does not meet the requirement"
    UNDECIDED = "the set meets the requirement so far, but has not converged within the horizon"


class Trial(Protocol):
    """What a search asks of the result for one value."""

    @property
    def value(self) -> float: ...

    @property
    def answer(self) -> Answer: ...


T = TypeVar("T", bound=Trial)


@dataclass(frozen=True)
class Tried:
    """A trial of one value.

    least: the value that has to be above zero, either the largest V, or the least V at the states
    to keep. fraction: of the grid's box in the set; NaN if a state to keep is lost, since the march
    may have ended there. warm: started from the kernel of a smaller bound (warm start). reached:
    simulated time [s].
    """

    value: float
    answer: Answer
    least: float
    fraction: float
    converged: bool
    warm: bool
    steps: int
    reached: float
    wall_time: float

    def summary(self) -> dict[str, Any]:
        shown = {**self.__dict__, "answer": self.answer.name.lower()}
        return shown | {"fraction": None if math.isnan(self.fraction) else self.fraction}


@dataclass(frozen=True)
class Margin:
    """The trials of a search, in ascending order, and the resulting limits.

    keeps: whether the set has to contain given states, or only not to be empty. monotone: whether a
    larger value can only shrink the set, by the bounds of the disturbances themselves. settings:
    those of the scenario at `low`. end: the largest value that the bounds of the system allow.
    """

    title: str
    scenario: str
    key: str
    name: str
    unit: str
    keeps: bool
    horizon: Seconds
    forever: bool
    tolerance: float
    monotone: bool
    trials: tuple[Tried, ...]
    settings: tuple[str, ...] = ()
    end: float = math.inf

    @property
    def low(self) -> float | None:
        """The largest tried value such that it and all smaller tried ones hold."""
        return last_held(self.trials)

    @property
    def high(self) -> float | None:
        """The least value above `low` that is lost."""
        return first_lost(self.trials, self.low)

    @property
    def undecided(self) -> tuple[float, ...]:
        """The values with too short a horizon for an answer."""
        return tuple(t.value for t in self.trials if t.answer is Answer.UNDECIDED)

    @property
    def holds_again(self) -> tuple[float, ...]:
        """Values that hold above one that is lost: the answer is not monotone."""
        lost = [t.value for t in self.trials if t.answer is Answer.LOST]
        return tuple(
            t.value for t in self.trials if t.answer is Answer.HELD and lost and t.value > lost[0]
        )

    @property
    def answered(self) -> bool:
        """Whether the limit is known within the tolerance."""
        low, high = self.low, self.high
        return low is not None and high is not None and close(low, high, self.tolerance)

    def summary(self) -> dict[str, Any]:
        """The content of margin.json."""
        fields = (
            "title", "scenario", "key", "name", "unit", "keeps", "forever", "tolerance",
            "monotone", "low", "high", "answered",
        )  # fmt: skip
        return {
            **{n: getattr(self, n) for n in fields},
            "horizon_s": self.horizon,
            "undecided": list(self.undecided),
            "holds_again": list(self.holds_again),
            "trials": [t.summary() for t in self.trials],
        }


def search(
    attempt: Callable[[float, float, float], T],
    low: float,
    high: float,
    tolerance: float,
    *,
    monotone: bool,
    end: float,
) -> tuple[T, ...]:
    """Try values until the limit is known within `tolerance`, or cannot be.

    attempt: called with a value, the finished share of the work, and the share of this trial.
    monotone: only the ends are tried before the bisection, otherwise values all over the interval.
    end: the limit of doubling the upper end while all trials hold.

    If undecided values lie in between, the limit is approached from both sides, so that as few as
    possible remain.
    """
    trials: dict[float, T] = {}
    expected = (2 if monotone else SCANNED) + _halvings(
        high - low if monotone else (high - low) / (SCANNED - 1), tolerance
    )

    def ordered() -> list[T]:
        return [trials[v] for v in sorted(trials)]

    def tried(value: float) -> Answer:
        if value not in trials:
            total = max(expected, len(trials) + 1)
            trials[value] = attempt(value, len(trials) / total, 1 / total)
        return trials[value].answer

    def narrowed(below: float, above: float, alike: Callable[[Answer], bool]) -> None:
        while not close(below, above, tolerance):
            middle = 0.5 * (below + above)
            if alike(tried(middle)):
                below = middle
            else:
                above = middle

    for k in range(DOUBLED + 1):
        values = [low, high] if monotone else list(np.linspace(low, high, SCANNED))
        held = [tried(float(v)) is Answer.HELD for v in values]
        if not all(held) or high >= end or k == DOUBLED:
            break
        low, high = high, min(2 * high, end)
    last = last_held(ordered())
    if last is None or last == max(trials):
        return tuple(ordered())
    narrowed(last, min(v for v in trials if v > last), lambda a: a is Answer.HELD)
    last = last_held(ordered())
    lost = first_lost(ordered(), last)
    if last is not None and lost is not None:
        between = [v for v in trials if last < v < lost]
        if between:
            narrowed(max(between), lost, lambda a: a is not Answer.LOST)
    return tuple(ordered())


class Kept:
    """The states and regions that the set has to contain; without any it must not be empty."""

    def __init__(
        self, grid: Grid, states: npt.ArrayLike = (), regions: Sequence[Region] = ()
    ) -> None:
        """states: shape (count, states)."""
        self.states = np.asarray(states, dtype=np.float64).reshape(-1, len(grid.axes))
        self.nodes: npt.NDArray[np.bool_] = np.zeros(grid.shape, dtype=bool)
        for region in regions:
            inside = set_on_grid(region, grid).values() > 0
            if not inside.any():
                raise SimulationError(
                    f"no node of the grid is in region '{region.name}'",
                    remedy="take a finer grid, or a state",
                )
            self.nodes |= inside

    @property
    def asked(self) -> bool:
        return bool(len(self.states) or self.nodes.any())

    def least(self, value: ValueFunction) -> float:
        """A number above zero if the set contains them; NaN outside the grid."""
        values = value.values()
        if not self.asked:
            return float(values.max())
        at_asked = np.concatenate([value.at(self.states), values[self.nodes]])
        return float(at_asked.min())

    def lost(self, value: ValueFunction) -> bool:
        return not self.least(value) > 0


def last_held(trials: Sequence[Trial]) -> float | None:
    """The largest value such that it and all smaller ones hold, of trials in ascending order."""
    held = None
    for t in trials:
        if t.answer is not Answer.HELD:
            break
        held = t.value
    return held


def first_lost(trials: Sequence[Trial], above: float | None) -> float | None:
    """The least value above another that is lost."""
    lost = [t.value for t in trials if t.answer is Answer.LOST]
    return next((v for v in lost if above is None or v > above), None)


def close(below: float, above: float, tolerance: float) -> bool:
    """Whether two values are within a tolerance."""
    return above - below <= tolerance * (1 + 1e-9)


def _halvings(width: float, tolerance: float) -> int:
    return max(0, math.ceil(math.log2(width / tolerance) - 1e-9))
