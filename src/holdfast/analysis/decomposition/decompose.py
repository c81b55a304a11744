"""A problem taken apart: factors, states cut off, unions, and actuators that are predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import sympy as sp

from holdfast.analysis.decomposition.decomposition import EXACT, INNER, Decomposition, Part
from holdfast.analysis.decomposition.guaranteed import Guarantee, check_tried, guarantees
from holdfast.analysis.decomposition.lag_free import LagFree, lag_free
from holdfast.analysis.reachability.grid import by_name
from holdfast.analysis.reachability.problem import with_disturbance
from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.maths.control.outward_rates import check_states
from holdfast.maths.decomposition.alternatives import alternatives
from holdfast.maths.decomposition.grouping import Group, Grouping, grouped
from holdfast.maths.definitions.quantity import merge_parameters
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System

CHEN = "M. Chen et al., IEEE TAC 63(11), 2018"
STATE_DECOUPLING = "M. Chen, S. Herbert, C. Tomlin, CDC 2016"

KERNELS = ("viability-kernel", "discriminating-kernel", "invariance-kernel")
TUBES = ("backward-reachable-tube", "forward-reachable-set")
KINDS = (*KERNELS, "backward-reachable-at", *TUBES, "capture-basin")

Interval = tuple[float, float]


@checked
def decompose(
    system: System,
    region: Region | None,
    *,
    kind: str = "viability-kernel",
    goal: Region | None = None,
    disturbances: str = "min",
    disturbance: Mapping[str, float] | None = None,
    cut: Mapping[str, tuple[float, float] | None] | None = None,
    lag_share: float | None = None,
    box: Mapping[str, tuple[float, float]] | None = None,
) -> Decomposition:
    """The parts of a problem, found in its rates and inequalities, and what their sets make up.

    kind: of the problem, as in a scenario; region: to be kept, or the set that a tube or a set is
    of; goal: of a capture basin. disturbances: of a reachable tube or set, "max" where they help.
    disturbance: the numbers of those that are given.

    - States that no inequality depends on are left out, and of states that matter only relative to
      each other the difference is taken.
    - Inequalities whose factors share no input are parts of their own.
    - cut: states that are disturbances of the others, with their intervals; None for the interval
      that the region asks for, or that the state never leaves. The guarantee is proved.
    - lag_share: the share of their range that actuators with a lag are kept within; they are
      predicted, and are no states any more (`maths.decomposition.prediction`). box: the intervals
      of the states left, over which what remains of them is bounded.
    - An inequality `min(a, b) <= 0` is taken apart where that leaves smaller parts.

    Raises `SimulationError` for what would not be sound: a cut without a guarantee, or in a problem
    whose disturbances help. `DefinitionError` for lags that cannot be predicted.
    """
    if kind not in KINDS:
        raise SimulationError(f"kind: {kind!r}", remedy=suggestion(kind, KINDS))
    if (goal is not None) != (kind == "capture-basin"):
        raise SimulationError(f"a {kind} with goal = {goal and goal.name}", expected=_needs(kind))
    if region is None and goal is None:
        raise SimulationError("no region", expected=_needs(kind))
    if disturbances not in ("min", "max"):
        raise SimulationError(f"disturbances: {disturbances!r}", expected='"min" or "max"')
    if disturbances == "max" and kind in (*KERNELS, "capture-basin"):
        raise SimulationError(
            f"a {kind} whose disturbances help", expected='disturbances = "min", or another kind'
        )
    helped = disturbances == "max" or kind == "forward-reachable-set"
    wanted = dict(by_name("cut", {} if cut is None else cut, '{"v": (-0.4, 0.4)}'))
    if helped and (wanted or lag_share is not None):
        raise SimulationError(
            f"a {kind} whose disturbances help, with states as disturbances that do not",
            expected='disturbances = "min"',
        )
    known = with_disturbance(system, {} if disturbance is None else disturbance)
    for r in (region, goal):
        if r is not None:
            check_states(known, r)
    rows = {"region": _rows(region), "goal": _rows(goal)}
    numbers = _numbers(known, region, goal)
    promised: dict[str, Guarantee] = {}
    free: LagFree | None = None
    if lag_share is not None:
        if kind not in ("viability-kernel", "discriminating-kernel"):
            raise SimulationError(f"lag_share of a {kind}", expected="a kernel that inputs keep")
        table = by_name("box", {} if box is None else box, '{"x": (0, 1)}')
        free = lag_free(known, rows["region"], lag_share, table, numbers)
        known, rows = free.system, {**rows, "region": list(free.inequalities)}
    elif box is not None:
        raise SimulationError("box without lag_share", remedy="leave it out")
    if wanted:
        kept = kind in KERNELS
        promised = guarantees(_with_numbers(known, numbers), wanted, rows["region"], kept=kept)
    intervals = {n: g.interval for n, g in promised.items()}
    made = _made(known, rows, kind, helped, intervals, relative=free is None)
    lists = tuple(
        tuple(_part(g, kind, region, goal, aims, free) for g in grouping.groups)
        for grouping, aims in made
    )
    for part in (p for ways in lists for p in ways):
        check_tried(part)
    used = {n for ways in lists for part in ways for n in part.system.disturbance_names}
    for name in wanted:
        if name not in used:
            raise SimulationError(
                f"cut: no part has '{name}' as a disturbance",
                expected="a state that a part depends on, and whose constraints are another's",
                remedy="leave it out",
            )
    groupings = [grouping for grouping, _ in made]
    reasons, exact = _reasons(
        kind, groupings, promised, free, bool(known.disturbances) and not helped
    )
    return Decomposition(
        system=system,
        kind=kind,
        alternatives=lists,
        verdict=EXACT if exact else INNER,
        reasons=tuple(reasons),
        disturbances="max" if helped else "min",
        kept=region if kind in KERNELS else None,
        domain=(*_domain(known, promised, lists, free), *(free.domain if free else ())),
        prediction=free.prediction if free else None,
        box=dict(box) if free and box is not None else {},
        within=tuple(free.within) if free else (),
    )


def _needs(kind: str) -> str:
    return "a goal, and a region or None" if kind == "capture-basin" else "a region and no goal"


def _rows(region: Region | None) -> list[Inequality]:
    return [] if region is None else list(region.inequalities)


def _numbers(system: System, *regions: Region | None) -> dict[sp.Symbol, sp.Expr]:
    there = [r.parameters for r in regions if r is not None]
    return {q.symbol: sp.Float(q.value) for q in merge_parameters(system.parameters, *there)}


def _with_numbers(system: System, numbers: Mapping[sp.Symbol, sp.Expr]) -> System:
    """The system with the numbers in its rates and bounds."""
    return replace(
        system,
        rates={n: r.xreplace(dict(numbers)) for n, r in system.rates.items()},
        input_bounds=system.input_bounds.at(numbers) if system.input_bounds else None,
        disturbance_bounds=system.disturbance_bounds.at(numbers)
        if system.disturbance_bounds
        else None,
        pfaffian=(),
    )


def _made(
    system: System,
    rows: Mapping[str, Sequence[Inequality]],
    kind: str,
    helped: bool,
    cut: Mapping[str, Interval],
    relative: bool,
) -> list[tuple[Grouping, set[str]]]:
    """The groups of every alternative: of the whole, unless taking it apart leaves smaller ones.

    With the names of the inequalities of the goal.
    """
    chosen = () if kind == "invariance-kernel" else system.input_names
    if helped:
        chosen = (*chosen, *system.disturbance_names)

    def of(region: Sequence[Inequality], goal: Sequence[Inequality]) -> tuple[Grouping, set[str]]:
        every = [*goal, *_renamed(region, goal)]
        together = every if kind in TUBES else goal
        found = grouped(
            system,
            every,
            cut=cut,
            chosen=chosen,
            together=[c.name for c in together],
            relative=relative,
        )
        return found, {c.name for c in goal}

    whole = of(rows["region"], rows["goal"])
    apart = [
        of(region, goal)
        for region in (alternatives(rows["region"]) if rows["region"] else [()])
        for goal in (alternatives(rows["goal"]) if rows["goal"] else [()])
    ]
    if not whole[0].groups:
        raise SimulationError(
            "no state of the system matters for the region", expected="inequalities of states"
        )
    always = any(not grouping.groups for grouping, _ in apart)
    if len(apart) > 1 and not always and max(_most(g) for g, _ in apart) < _most(whole[0]):
        return apart
    return [whole]


def _renamed(region: Sequence[Inequality], goal: Sequence[Inequality]) -> list[Inequality]:
    """The inequalities of the region, apart by name from those of the goal."""
    names = {c.name for c in goal}
    return [replace(c, name=f"{c.name}_kept") if c.name in names else c for c in region]


def _most(grouping: Grouping) -> int:
    return max(len(g.factor.coordinates) for g in grouping.groups)


def _part(
    group: Group,
    kind: str,
    region: Region | None,
    goal: Region | None,
    aims: set[str],
    free: LagFree | None,
) -> Part:
    system = group.factor.system
    of_goal = [c for c in group.factor.inequalities if goal is not None and c.name in aims]
    of_region = [c for c in group.factor.inequalities if c not in of_goal]
    mine = kind
    if (kind == "capture-basin" and not of_goal) or kind in (
        "viability-kernel",
        "discriminating-kernel",
    ):
        mine = "discriminating-kernel" if system.disturbances else "viability-kernel"
    coordinates = group.factor.coordinates
    if free is not None:
        coordinates = {n: e.xreplace(dict(free.coordinates)) for n, e in coordinates.items()}
    return Part(
        kind=mine,
        system=system,
        region=_region(region, system, of_region),
        goal=_region(goal, system, of_goal),
        coordinates=coordinates,
        cut=group.cut,
    )


def _region(whole: Region | None, system: System, rows: Sequence[Inequality]) -> Region | None:
    if whole is None or not rows:
        return None
    read = set().union(*(c.expression.free_symbols for c in rows))
    return Region(
        name=whole.name,
        reads=tuple(q for q in system.states if q.symbol in read),
        inequalities=tuple(rows),
        parameters=tuple(q for q in whole.parameters if q.symbol in read),
        description=whole.description,
        source=whole.source,
    )


def _domain(
    system: System,
    promised: Mapping[str, Guarantee],
    lists: Sequence[Sequence[Part]],
    free: LagFree | None,
) -> list[Inequality]:
    """Where states that are cut off have to begin, unless a part keeps them there."""
    used = {n for parts in lists for p in parts for n in p.cut}
    found = []
    for q in system.states:
        if q.name in used and not promised[q.name].kept:
            low, high = promised[q.name].interval
            place = free.coordinates[q.symbol] if free else q.symbol
            found.append(Inequality(f"{q.name}_low", low - place, q.unit))
            found.append(Inequality(f"{q.name}_high", place - high, q.unit))
    return found


def _reasons(
    kind: str,
    made: Sequence[Grouping],
    promised: Mapping[str, Guarantee],
    free: LagFree | None,
    opposed: bool,
) -> tuple[list[str], bool]:
    """The sentences that say why the sets of the parts make up the set, and whether exactly."""
    found = [r for grouping in made for r in grouping.reasons]
    exact = True
    if kind in TUBES and any(len(g.factor.inequalities) > 1 for m in made for g in m.groups):
        found.append(
            "the inequalities of a target that is to be reached at any time stay together: parts "
            f"might be there at different times ({CHEN})"
        )
    count = max(len(grouping.groups) for grouping in made)
    if count > 1 and kind == "capture-basin":
        exact = False
        found.append(
            "the part of the goal and the parts that are kept share no input; they are kept for "
            "the whole horizon, longer than until the arrival"
        )
    elif count > 1:
        what = "no choice of the inputs" if kind == "invariance-kernel" else "no input"
        found.append(f"the parts share {what}: each is kept by its own ({CHEN})")
    if len(made) > 1:
        tube = kind not in KERNELS
        exact &= tube and not opposed and kind != "capture-basin"
        found.append(
            f"one alternative is enough, and whoever acts may take any of them ({CHEN})"
            if tube and not opposed
            else "a state is in the set where one alternative alone has it; going from one to "
            "another is left out"
        )
    used = {n for m in made for g in m.groups for n in g.cut}
    if used:
        exact = False
        found += [promised[n].reason for n in promised if n in used]
        found.append(
            "a disturbance anywhere in an interval does at least what the state does that stays "
            f"in it ({STATE_DECOUPLING})"
        )
    if free is not None:
        exact = False
        found += free.reasons
    return found, exact
