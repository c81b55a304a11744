"""A problem taken apart: factors, states cut off, unions, and actuators that are predicted.

Where lagged actuators are predicted, what remains of them is a disturbance.

The parts are marched, each on a grid of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Unpack

import numpy as np
import sympy as sp

from holdfast.analysis.decomposition.decomposition import EXACT, INNER, Decomposition, Part
from holdfast.analysis.decomposition.guaranteed import (
    Affine,
    Guarantee,
    affine_in,
    check_tried,
    guarantees,
)
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability import solve
from holdfast.analysis.reachability.grid import TURN, by_name, grid, whole
from holdfast.analysis.reachability.problem import CutOffError, with_disturbance
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import UnitsOf, checked
from holdfast.errors import SimulationError, check_name
from holdfast.execution.leaf import Evaluator
from holdfast.execution.resources import Progress
from holdfast.maths.decomposition.grouping import Group, Grouping, alternatives, grouped
from holdfast.maths.decomposition.prediction import Prediction, predicted
from holdfast.maths.definitions.bounds import Box, product
from holdfast.maths.definitions.quantity import Quantity, merge_parameters
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import magnitude
from holdfast.maths.games.hamiltonian import without_closed_form


@checked
def solve_parts(
    decomposition: Decomposition,
    box: Mapping[str, tuple[float, float]] | None,
    nodes: int | Mapping[str, int],
    horizon: float,
    *,
    ends: Mapping[str, str] | None = None,
    progress: Progress | None = None,
    **options: Unpack[solve.PosedOptions],
) -> PartsValue:
    """The value of a problem from those of its parts, each on a grid of its own.

    decomposition: from `decompose`. box, nodes, ends: of all states of the parts, as for `grid`.
    horizon [s]: of every march. options: of every march, see `viability_kernel`.

    A symmetry counts where a part has one of its states, and samples where a part has no closed
    form. Where actuators are predicted, the grid reaches over the box of the decomposition, within
    which states are kept, by a cell at least; without a box by one cell.

    Raises `SimulationError` as the problems do.

    >>> apart = hf.decompose(gusty, track, kind="discriminating-kernel")
    >>> value = hf.solve_parts(apart, {"x": (-1.2, 1.2), "v": (-1.6, 1.6)}, 21, 4.0)
    >>> value.at([[0.0, 0.4], [0.95, 0.9]]) > 0
    array([ True, False])
    """
    box = _around(decomposition, nodes) if box is None else box
    by_name("box", box, '{"x": (0, 1)}')
    _check_room(decomposition, box, nodes, ends or {})
    for name in ("parameters", "disturbance", "disturbances"):
        if name in options:
            raise SimulationError(
                f"{name} of a march over parts",
                expected="those of the system that was taken apart",
                remedy="give them to decompose, or change the system",
            )
    names = {n for p in decomposition.parts for n in p.system.state_names}
    tables: list[Mapping[str, Any]] = [box, ends or {}]
    if isinstance(nodes, Mapping):
        tables.append(nodes)
    for table in tables:
        for name in table:
            check_name(name, names, SimulationError, f"'{name}' is not a state of a part")
    count = len(decomposition.parts)
    values = []
    for done, part in enumerate(decomposition.parts):

        def tell(fraction: float, before: int = done) -> None:
            if progress is not None:
                progress((before + fraction) / count)

        try:
            solved = _solved(part, decomposition, box, nodes, ends or {}, horizon, tell, options)
        except CutOffError as cut:
            name, far = cut.beyond
            if name in decomposition.within or name not in decomposition.box:
                raise
            raise SimulationError(
                f"a region of predicted states reaches beyond the box of '{name}'",
                remedy=f"give decompose a box in which '{name}' reaches to {far:.6g}",
            ) from cut
        values.append(solved)
    return PartsValue.of(decomposition, values)


ROOM = 1
"""Cells of a grid beyond the box that the states are kept within, on either side."""


def _count(nodes: int | Mapping[str, int], name: str) -> int:
    count = nodes.get(name) if isinstance(nodes, Mapping) else nodes
    return whole(f"nodes along '{name}': ", count, 2)


def _whole_turn(decomposition: Decomposition, name: str) -> bool:
    low, high = decomposition.box[name]
    angle = any(q.name == name and q.angle for q in decomposition.system.states)
    return angle and high - low >= TURN * (1 - 1e-9)


def _around(
    decomposition: Decomposition, nodes: int | Mapping[str, int]
) -> dict[str, tuple[float, float]]:
    """The box of the decomposition with room around it."""
    if not decomposition.box:
        raise SimulationError("no box", expected="the intervals of all states of the parts")
    intervals = {}
    names = {n for p in decomposition.parts for n in p.system.state_names}
    for name, (low, high) in decomposition.box.items():
        if name not in names:
            continue
        cells = _count(nodes, name) - 1 - 2 * ROOM
        if name not in decomposition.within or _whole_turn(decomposition, name):
            intervals[name] = (low, high)
            continue
        if cells < 1:
            raise SimulationError(
                f"{cells + 1 + 2 * ROOM} nodes along '{name}'", expected=f"at least {2 + 2 * ROOM}"
            )
        more = ROOM * (high - low) / cells
        intervals[name] = (low - more, high + more)
    return intervals


def _check_room(
    decomposition: Decomposition,
    box: Mapping[str, tuple[float, float]],
    nodes: int | Mapping[str, int],
    ends: Mapping[str, str],
) -> None:
    """Refuse a grid that is not that of the box: with room around it where it is kept, else in it.

    What the region reads ends within the grid, which is checked where the ends are "contained".
    """
    for name, (low, high) in decomposition.box.items():
        if name not in box or _whole_turn(decomposition, name):
            continue
        a, b = box[name]
        if name not in decomposition.within:
            if ends.get(name, "contained") != "contained":
                raise SimulationError(
                    f"ends of '{name}': '{ends[name]}'",
                    expected='"contained", where actuators are predicted',
                )
            if a < low * (1 - 1e-9 * np.sign(low)) or b > high * (1 + 1e-9 * np.sign(high)):
                raise SimulationError(
                    f"the grid along '{name}' is [{a:g}, {b:g}]",
                    expected=f"an interval within that of the decomposition, [{low:g}, {high:g}]",
                )
            continue
        cell = (b - a) / (_count(nodes, name) - 1) * (1 - 1e-9)
        if a > low - cell or b < high + cell:
            raise SimulationError(
                f"the grid along '{name}' is [{a:g}, {b:g}], and '{name}' is kept within "
                f"[{low:g}, {high:g}]",
                expected="a grid that reaches a cell further on either side",
                remedy="leave out the box of the grid",
            )


def _sampled(parts: Sequence[Part]) -> bool:
    """Whether the Hamiltonian of some part needs points of a set."""
    return any(without_closed_form(p.system) for p in parts)


def _solved(
    part: Part,
    whole: Decomposition,
    box: Mapping[str, tuple[float, float]],
    nodes: int | Mapping[str, int],
    ends: Mapping[str, str],
    horizon: float,
    tell: Progress,
    options: Mapping[str, Any],
) -> ValueFunction:
    names = part.system.state_names
    over = grid(
        part.system,
        {n: box[n] for n in names if n in box},
        {n: c for n, c in nodes.items() if n in names} if isinstance(nodes, Mapping) else nodes,
        {n: e for n, e in ends.items() if n in names},
    )
    chosen = dict(options)
    if (symmetry := chosen.get("symmetry")) is not None:
        mine = {n: s for n, s in symmetry.items() if n in names}
        chosen["symmetry"] = mine if -1 in mine.values() else None
    if chosen.get("samples") and _sampled(whole.parts) and not _sampled([part]):
        del chosen["samples"]
    function = getattr(solve, part.kind.replace("-", "_"))
    about: tuple[Any, ...] = (part.about,)
    if part.kind == "capture-basin":
        about = (part.goal, part.region)
        chosen.setdefault("arrival_steps", 0)
    if part.kind.startswith(("backward", "forward")):
        chosen["disturbances"] = whole.disturbances
    value: ValueFunction = function(part.system, *about, over, horizon, progress=tell, **chosen)
    return value


Interval = tuple[float, float]
REST = "rest_of_"
"""Before the name of a state: the disturbance that bounds what its rate leaves out."""
LATTICE, ON_FACE = 129, 20_000
"""Points along a state, and at an end of a box, at which it is looked whether a region goes on."""
TOUCHING = 1e-9
"""Share of the largest constraint by which a region may go on and still end there."""
NOTHING = 1e-12
"""Rests below this, in the unit of the rate, are left out."""


@dataclass(frozen=True)
class LagFree:
    """The problem in z: the actuators are disturbances within their intervals.

    coordinates: symbol of z -> z in the states of the whole. within: states that are kept in their
    intervals by inequalities of their own. domain: where the actuators begin.
    """

    system: System
    inequalities: tuple[Inequality, ...]
    coordinates: Mapping[sp.Symbol, sp.Expr]
    within: Mapping[str, Interval]
    domain: tuple[Inequality, ...]
    prediction: Prediction
    reasons: tuple[str, ...]


def lag_free(
    system: System,
    inequalities: Sequence[Inequality],
    share: float,
    box: Mapping[str, Interval],
    numbers: Mapping[sp.Symbol, sp.Expr],
) -> LagFree:
    """The problem without its lags.

    z' is affine in the actuators but for a rest that is bounded over the box, and so are the
    inequalities, which are to hold for every value of the actuators that z may stand for:

        z' = f(z, w) + G(z) a + rest,   c(z) + sum_k |dc/da_k| A_k + rest <= 0

    Raises `DefinitionError` for lags that cannot be predicted, and `SimulationError` for a box
    without an interval, or one that the inequalities do not keep.
    """
    prediction = predicted(system, share)
    names = [q.name for q in prediction.states]
    for name in names:
        if name not in box:
            raise SimulationError(
                f"the box has no interval for '{name}'",
                expected="intervals of all states but the actuators that lag",
            )
    over = {q.symbol: (float(box[q.name][0]), float(box[q.name][1])) for q in prediction.states}
    swung = dict(zip((a.symbol for a in prediction.actuators), prediction.intervals, strict=True))
    free = _ranges(system.inputs, prediction.bounds)
    felt = system.disturbance_bounds
    free |= _ranges(system.disturbances, felt.at(numbers) if felt is not None else None)
    rates = affine_in(prediction.rates, swung, free, over)
    moved = {c.name: c.expression.xreplace(dict(prediction.back)) for c in inequalities}
    fixed = {n: e.xreplace(dict(numbers)) for n, e in moved.items()}
    rows = affine_in(fixed, swung, {}, over)
    read = set().union(*(c.expression.free_symbols for c in inequalities))
    unread = [q for q in prediction.states if q.symbol not in read]
    tight = [_tightened(c, rows[c.name], swung) for c in inequalities]
    asked = [e.expression.xreplace(dict(numbers)) for e in (*tight, *_within(unread, over))]
    held = [q for q in prediction.states if q in unread or _goes_on(asked, q, over)]
    return LagFree(
        _system(system, prediction, rates, swung),
        (*tight, *_within(held, over)),
        {q.symbol: q.symbol + prediction.shift[q.name] for q in prediction.states},
        {q.name: over[q.symbol] for q in held},
        _predicted_domain(prediction),
        prediction,
        (_reason(prediction), *(_limited(q, over) for q in held if q not in unread)),
    )


def _ranges(members: Sequence[Quantity], bounds: object) -> dict[sp.Symbol, Interval]:
    ranges = bounds.ranges() if bounds is not None else []  # type: ignore[attr-defined]
    pairs = zip(members, ranges, strict=False)
    return {q.symbol: (float(low), float(high)) for q, (low, high) in pairs}


def _system(
    system: System,
    prediction: Prediction,
    rates: Mapping[str, Affine],
    swung: Mapping[sp.Symbol, Interval],
) -> System:
    """The system of z: the actuators and the rests are disturbances."""
    whole = {}
    rests: list[tuple[Quantity, float]] = []
    for q in prediction.states:
        row = rates[q.name]
        terms = [row.still]
        for (a, (low, high)), gain in zip(swung.items(), row.gains, strict=True):
            terms.append(gain * (a - sp.Float((low + high) / 2)))
        if row.rest > NOTHING:
            rest = Quantity(REST + q.name, f"{q.unit}/s", "what its rate leaves out")
            rests.append((rest, row.rest))
            terms.append(rest.symbol)
        whole[q.name] = sp.Add(*terms)
    ends = [*prediction.intervals, *((-size, size) for _, size in rests)]
    bounds = product(Box(tuple(a for a, _ in ends), tuple(b for _, b in ends)),
                     system.disturbance_bounds) if system.disturbances else Box(
        tuple(a for a, _ in ends), tuple(b for _, b in ends))  # fmt: skip
    return replace(
        system,
        name=f"{system.name}, predicted",
        states=prediction.states,
        rates=whole,
        parameters=(),
        input_bounds=prediction.bounds,
        disturbances=(*prediction.actuators, *(q for q, _ in rests), *system.disturbances),
        disturbance_bounds=bounds,
        pfaffian=(),
        measurements=(),
        flat_output=None,
    )


def _tightened(c: Inequality, row: Affine, swung: Mapping[sp.Symbol, Interval]) -> Inequality:
    """The inequality for every value of the actuators: less what they may make of it."""
    if row.rest <= NOTHING and not any(row.gains):
        return c
    widths = [(high - low) / 2 for low, high in swung.values()]
    more = [magnitude(g) * sp.Float(w) for g, w in zip(row.gains, widths, strict=True) if g != 0]
    return replace(c, expression=row.still + sp.Add(*more) + sp.Float(row.rest))


def _goes_on(
    constraints: Sequence[sp.Expr], state: Quantity, box: Mapping[sp.Symbol, Interval]
) -> bool:
    """Whether the constraints let a state beyond an end of its interval, the others in theirs.

    Those of a place read the predicted speeds too, and their region in z is sheared: it may be
    wider than that of the whole, which the box was given for.
    """
    low, high = box[state.symbol]
    if state.angle and high - low >= TURN * (1 - 1e-9):
        return False
    count = min(LATTICE, max(3, int(ON_FACE ** (1 / max(len(box) - 1, 1)))))
    sides = [(low, high) if s == state.symbol else np.linspace(*box[s], count) for s in box]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(box))
    worst = Evaluator(constraints, list(box), ()).values(points).max(axis=1)
    return bool(worst.min() < -TOUCHING * np.abs(worst).max())


def _within(states: Sequence[Quantity], box: Mapping[sp.Symbol, Interval]) -> list[Inequality]:
    """These states kept within the box that the bounds hold in, but for whole turns of an angle.

    Those of which the inequalities keep z within need no more.
    """
    rows = []
    for q in states:
        low, high = box[q.symbol]
        if not (q.angle and high - low >= TURN * (1 - 1e-9)):
            away = (
                magnitude(q.symbol - sp.Float((low + high) / 2))
                if low + high
                else magnitude(q.symbol)
            )
            rows.append(Inequality(f"{q.name}_in_box", away - sp.Float((high - low) / 2), q.unit))
    return rows


def _predicted_domain(prediction: Prediction) -> tuple[Inequality, ...]:
    rows = []
    for a, (low, high) in zip(prediction.actuators, prediction.intervals, strict=True):
        rows.append(Inequality(f"{a.name}_low", sp.Float(low) - a.symbol, a.unit))
        rows.append(Inequality(f"{a.name}_high", a.symbol - sp.Float(high), a.unit))
    return tuple(rows)


def _limited(state: Quantity, box: Mapping[sp.Symbol, Interval]) -> str:
    low, high = box[state.symbol]
    return (
        f"predicted {state.name} is kept within its box, [{low:g}, {high:g}], beyond which the "
        "constraints would let it go"
    )


def _reason(prediction: Prediction) -> str:
    names = " and ".join(a.name for a in prediction.actuators)
    is_, it, its, does = (
        ("is", "it stays", "its", "it still does")
        if len(prediction.actuators) == 1
        else ("are", "they stay", "their", "they still do")
    )
    return (
        f"{names} {is_} predicted: {it} within the share of {its} range that the law uses, and "
        f"what {does} to the predicted states is a disturbance within proved bounds"
    )


CHEN = "M. Chen et al., IEEE TAC 63(11), 2018"
STATE_DECOUPLING = "M. Chen, S. Herbert, C. Tomlin, CDC 2016"

KERNELS = ("viability-kernel", "discriminating-kernel", "invariance-kernel")
TUBES = ("backward-reachable-tube", "forward-reachable-set")
KINDS = (*KERNELS, "backward-reachable-at", *TUBES, "capture-basin")


@checked
def decompose(
    system: System,
    region: Region | None,
    *,
    kind: str = "viability-kernel",
    goal: Region | None = None,
    disturbances: str = "min",
    disturbance: Mapping[str, float] | None = None,
    cut: Annotated[Mapping[str, tuple[float, float] | None], UnitsOf("states")] | None = None,
    lag_share: float | None = None,
    box: Mapping[str, tuple[float, float]] | None = None,
) -> Decomposition:
    """The parts of a problem, found in its rates and inequalities, and what their sets make up.

    kind: of the problem, as in a scenario; region: to be kept, or the set that a tube or a set is
    of; goal: of a capture basin. disturbances: of a reachable tube or set, "max" where they help.
    disturbance: the numbers of those that are given. cut: states that become disturbances of the
    others -> their intervals; None for the interval that the region asks for, or that the state
    never leaves; the guarantee is proved. lag_share: the share of their range that actuators with a
    lag are kept within; they are predicted, and are no states any more
    (`maths.decomposition.prediction`). box: the intervals of the states left, over which what
    remains of them is bounded.

    - States that no inequality depends on are left out, and of states that matter only relative to
      each other the difference is taken.
    - Inequalities whose factors share no input are parts of their own.
    - An inequality `min(a, b) <= 0` is taken apart where that leaves smaller parts.

    Raises `SimulationError` for what would not be sound: a cut without a guarantee, or in a problem
    whose disturbances help. `DefinitionError` for lags that cannot be predicted.

    >>> print(hf.decompose(gusty, track, kind="discriminating-kernel"))
    discriminating-kernel of 'cart', 2 states
    part (x, v) by a: end
    exact: the set put together is the set itself, up to the error of the grids
    """
    check_name(kind, KINDS, SimulationError, f"kind: {kind!r}")
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
    model = with_disturbance(system, {} if disturbance is None else disturbance)
    for r in (region, goal):
        if r is not None:
            r.check_states(model.name, model.states)
    rows = {"region": _rows(region), "goal": _rows(goal)}
    numbers = _numbers(model, region, goal)
    promised: dict[str, Guarantee] = {}
    free: LagFree | None = None
    if lag_share is not None:
        if kind not in ("viability-kernel", "discriminating-kernel"):
            raise SimulationError(f"lag_share of a {kind}", expected="a kernel that inputs keep")
        table = by_name("box", {} if box is None else box, '{"x": (0, 1)}')
        free = lag_free(model, rows["region"], lag_share, table, numbers)
        model, rows = free.system, {**rows, "region": list(free.inequalities)}
    elif box is not None:
        raise SimulationError("box without lag_share", remedy="leave it out")
    if wanted:
        always = kind in KERNELS
        promised = guarantees(_with_numbers(model, numbers), wanted, rows["region"], always=always)
    intervals = {n: g.interval for n, g in promised.items()}
    made = _made(model, rows, kind, helped, intervals, relative=free is None)
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
        kind, groupings, promised, free, bool(model.disturbances) and not helped
    )
    return Decomposition(
        system=system,
        kind=kind,
        alternatives=lists,
        verdict=EXACT if exact else INNER,
        reasons=tuple(reasons),
        disturbances="max" if helped else "min",
        kept=region if kind in KERNELS else None,
        domain=(*_domain(model, promised, lists, free), *(free.domain if free else ())),
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
        groups = grouped(
            system,
            every,
            cut=cut,
            chosen=chosen,
            together=[c.name for c in together],
            relative=relative,
        )
        return groups, {c.name for c in goal}

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
    limits = []
    for q in system.states:
        if q.name in used and not promised[q.name].kept:
            low, high = promised[q.name].interval
            place = free.coordinates[q.symbol] if free else q.symbol
            limits.append(Inequality(f"{q.name}_low", low - place, q.unit))
            limits.append(Inequality(f"{q.name}_high", place - high, q.unit))
    return limits


def _reasons(
    kind: str,
    made: Sequence[Grouping],
    promised: Mapping[str, Guarantee],
    free: LagFree | None,
    opposed: bool,
) -> tuple[list[str], bool]:
    """The sentences that say why the sets of the parts make up the set, and whether exactly."""
    reasons = [r for grouping in made for r in grouping.reasons]
    exact = True
    if kind in TUBES and any(len(g.factor.inequalities) > 1 for m in made for g in m.groups):
        reasons.append(
            "the inequalities of a target that is to be reached at any time stay together: parts "
            f"might be there at different times ({CHEN})"
        )
    count = max(len(grouping.groups) for grouping in made)
    if count > 1 and kind == "capture-basin":
        exact = False
        reasons.append(
            "the part of the goal and the parts that are kept share no input; they are kept for "
            "the whole horizon, longer than until the arrival"
        )
    elif count > 1:
        what = "no choice of the inputs" if kind == "invariance-kernel" else "no input"
        reasons.append(f"the parts share {what}: each is kept by its own ({CHEN})")
    if len(made) > 1:
        tube = kind not in KERNELS
        exact &= tube and not opposed and kind != "capture-basin"
        reasons.append(
            f"one alternative is enough, and whoever acts may take any of them ({CHEN})"
            if tube and not opposed
            else "a state is in the set where one alternative alone has it; going from one to "
            "another is left out"
        )
    used = {n for m in made for g in m.groups for n in g.cut}
    if used:
        exact = False
        reasons += [promised[n].reason for n in promised if n in used]
        reasons.append(
            "a disturbance anywhere in an interval does at least what the state does that stays "
            f"in it ({STATE_DECOUPLING})"
        )
    if free is not None:
        exact = False
        reasons += free.reasons
    return reasons, exact
