"""Certify: a proof that held inputs keep a system in a region, whatever the disturbances.

The largest set of cells is found of which each has an input that leads back into the set; or from
which inputs lead to a target, in the region until then.

The set that a march has found is an approximation, and may be the candidate. Which of its cells
held inputs keep, or lead to the target, is proved as for any others; nothing is lost by trying no
further ones than those that the set touches.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.certificates.cells import Cells, Counted, Kept
from holdfast.analysis.certificates.certificate import (
    MOST_CELLS,
    MOST_DEPTH,
    MOST_STEPS,
    Certificate,
    Range,
    check_functions,
    check_names,
)
from holdfast.analysis.certificates.images import (
    BEST,
    REGION,
    Images,
    Store,
    in_steps,
    refined,
    where,
)
from holdfast.analysis.certificates.law_cells import (
    inputs_under_way,
    kept_by_law,
    law_of_cases,
    reached_by_law,
)
from holdfast.analysis.certificates.problem import (
    INPUTS,
    candidates_of,
    check_among,
    delay_of,
    errors_of,
    parameters_of,
    parts_of,
    ranges_of,
)
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.march_report import Report
from holdfast.arguments import (
    Count,
    OfStates,
    RangesOfParameters,
    RangesOfStates,
    Seconds,
    checked,
    renamed,
)
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import AnyArray, Array, Ranks, Truths, Wholes
from holdfast.execution.intervals.enclosure import TURN
from holdfast.execution.intervals.enclosures import STANDARD, enclosures
from holdfast.execution.intervals.held_flow import HeldFlow, Sampling
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import symbols_of

KEPT, REACHED = (
    ("viability-kernel", "discriminating-kernel"),
    ("capture-basin", "backward-reachable-tube"),
)
"""Kinds of sets that are tried without, and with, a target."""


@runtime_checkable
class SetOnGrid(Protocol):
    """What is read of a value function: V at the nodes of a grid, and of which problem it is."""

    @property
    def grid(self) -> Grid:
        """One axis for each state."""

    @property
    def names(self) -> tuple[str, ...]:
        """The states, in the order of the axes."""

    @property
    def report(self) -> Report:
        """The problem, the march and its error estimates."""

    def values(self, time: float | None = None) -> AnyArray:
        """V at the nodes, with an axis for each state: (nodes of the first, nodes of the second,
        and so on)."""


def check_candidate(value: SetOnGrid, system: System, *, target: bool) -> None:
    """Refuse the set of another system or problem, and an empty one."""
    report, kinds = value.report, REACHED if target else KEPT
    if value.names != system.state_names or report.system != system.name:
        raise SimulationError(
            f"the candidate belongs to system '{report.system}' with the states "
            + ", ".join(value.names),
            expected=f"system '{system.name}' with " + ", ".join(system.state_names),
        )
    if report.kind not in kinds:
        raise SimulationError(
            f"a candidate of the kind '{report.kind}' {'with' if target else 'without'} a target",
            expected="one of " + ", ".join(kinds),
        )
    if report.depends_on_time:
        raise SimulationError("the candidate depends on time, and a certificate does not")


def touched_by(value: SetOnGrid, margin: float) -> Callable[[Cells], Truths]:
    """Which cells may have a state with V > margin: those with such a node in or around them.

    The answers have the shape (cells,).

    Raises `SimulationError` where no node has it.
    """
    from scipy.ndimage import maximum_filter

    high, axes = value.values() > margin, value.grid.axes
    if not high.any():
        raise SimulationError(
            f"no node of the candidate has V > {margin:g}", remedy="take a smaller margin"
        )
    modes = ["wrap" if a.ends == "periodic" else "nearest" for a in axes]

    def touched(cells: Cells) -> Truths:
        wide = [float(np.diff(e).max()) for e in cells.edges]
        sizes = [2 * (math.ceil(w / 2 / a.step) + 1) + 1 for w, a in zip(wide, axes, strict=True)]
        near = maximum_filter(high, size=sizes, mode=modes)
        places = []
        for edges, a in zip(cells.edges, axes, strict=True):
            middle = np.rint((0.5 * edges[:-1] + 0.5 * edges[1:] - a.low) / a.step).astype(np.int64)
            turns = a.ends == "periodic"
            places.append(middle % a.count if turns else np.clip(middle, 0, a.count - 1))
        hits: Truths = near[np.ix_(*places)].reshape(-1)
        return hits

    return touched


def kept(
    flow: HeldFlow,
    cells: Cells,
    candidates: Array,
    holds: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    halvings: int = 0,
    store: Store | None = None,
    among: Callable[[Cells], Truths] | None = None,
) -> Kept:
    """The cells in the region from which a held input leads to others of them, again and again.

    candidates: inputs that are tried, shape (inputs, ...). holds: how many sampling periods; None
    for ever. halvings: how often cells are halved that are left near those that are kept. among:
    which cells are tried; None is all of the region.
    """

    def settle(outcome: Images, cells: Cells, ranks: Ranks) -> tuple[Ranks, Wholes, int]:
        return settled_kept(outcome, cells, ranks, holds)

    enough = BEST if holds is None else holds
    outcome = refined(
        flow, cells, candidates, halvings, settle, enough,
        progress=progress, store=store, among=among,
    )  # fmt: skip
    entries = outcome.entries
    if holds is None:
        entries[:, 2] = 0
    return Kept.of(outcome.halvings, entries, holds, outcome.sweeps, outcome.region)


def settled_kept(
    images: Images, cells: Cells, ranks: Ranks, holds: int | None
) -> tuple[Ranks, Wholes, int]:
    """For how many periods inputs keep the cells of images, those inputs, and how many sweeps.

    ranks: for how many what is known keeps cells, BEST for ever. Where a cell's input leads is the
    same at every sweep, and the set only shrinks: an input that does not keep a cell will not do so
    later.

    ranks: of all cells, shape (cells,). The results have the shape (cells of the images,).
    """
    usable, most = images.usable, images.usable.shape[1]
    longest = BEST if holds is None else holds
    reached = ranks[images.cells]
    alive = reached < longest
    choice = np.zeros(len(alive), dtype=np.int64)
    chosen, sweeps, now = choice.copy(), 0, ranks >= REGION
    older = ranks[ranks < longest].max(initial=REGION)
    while sweeps < longest:
        counted = Counted(cells, now)
        waiting = np.flatnonzero(alive)
        while len(waiting):
            at = waiting, choice[waiting]
            fine = usable[at]
            some = np.flatnonzero(fine)
            at = waiting[some], choice[waiting[some]]
            blocks = images.first[at].astype(np.int64), images.last[at].astype(np.int64)
            fine[some] = counted.all_of(*blocks)
            waiting = waiting[~fine]
            choice[waiting] += 1
            lost = choice[waiting] >= most
            alive[waiting[lost]] = False
            waiting = waiting[~lost]
        sweeps += 1
        if holds is not None:
            reached[alive], chosen[alive] = np.maximum(reached[alive], sweeps), choice[alive]
        after = ranks >= sweeps
        after[images.cells[alive]] = True
        if sweeps > older and np.array_equal(after, now):
            break
        now = after
    reached[alive], chosen[alive] = longest, choice[alive]
    return reached, chosen, sweeps


NONE = -1


def reached(
    flow: HeldFlow,
    cells: Cells,
    candidates: Array,
    holds: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    halvings: int = 0,
    store: Store | None = None,
    among: Callable[[Cells], Truths] | None = None,
) -> Kept:
    """The cells from which an input leads all states to cells that are closer to the target.

    Those of the target are 0 sampling periods away from it; a cell from which an input leads to
    cells of up to n periods, in the region on the way, is n + 1 away. holds: how many periods at
    most; None is as many as there are. halvings: how often cells are halved that are left near
    those that are found. among: which cells are tried; None is all of the region. The result's
    `holds` is the largest number, its entries' levels are the numbers of each.

    candidates: inputs that are tried, shape (tried, inputs).
    """

    def settle(outcome: Images, cells: Cells, ranks: Ranks) -> tuple[Ranks, Wholes, int]:
        return settled_reaching(outcome, cells, ranks, holds)

    outcome = refined(
        flow,
        cells,
        candidates,
        halvings,
        settle,
        REGION + 1,
        target=True,
        progress=progress,
        store=store,
        among=among,
    )
    entries = outcome.entries[np.argsort(outcome.entries[:, 0], kind="stable")]
    entries[:, 2] = BEST - entries[:, 2]
    farthest = int(entries[:, 2].max(initial=1))
    return Kept.of(outcome.halvings, entries, farthest, outcome.sweeps, outcome.region, target=True)


def settled_reaching(
    images: Images, cells: Cells, ranks: Ranks, holds: int | None
) -> tuple[Ranks, Wholes, int]:
    """How far the cells of images are away, the inputs that lead there, and how many periods.

    ranks: BEST less how many periods cells are known to be away.

    ranks: of all cells, shape (cells,). The results have the shape (cells of the images,).
    """
    away = np.where(ranks > REGION, BEST - ranks.astype(np.int64), NONE)
    earlier = np.flatnonzero(away > 0)
    earlier = earlier[np.argsort(away[earlier], kind="stable")]
    far = away[earlier]
    captured = away == 0
    waiting = _Waiting(images, cells.counts, away[images.cells] >= 0)
    reached, chosen = ranks[images.cells], np.zeros(len(images.cells), dtype=np.int64)
    level, fresh = 0, np.flatnonzero(captured)
    while (len(fresh) or level < far.max(initial=0)) and (holds is None or level < holds):
        level += 1
        rows, inputs = waiting.led_into(captured, fresh)
        reached[rows], chosen[rows] = BEST - level, inputs
        older = earlier[slice(*np.searchsorted(far, (level, level + 1)))]
        fresh = np.concatenate([images.cells[rows], older])
        captured[fresh] = True
    return reached, chosen, level


class _Waiting:
    """Images that wait for a cell of theirs: each is looked at again when that one is captured.

    Lists by cell: `_head` the first image that waits for a cell, `_next` the one after an image.
    """

    def __init__(self, images: Images, counts: tuple[int, ...], done: Truths) -> None:
        self._counts = counts
        inputs = images.usable.shape[1]
        axes = len(counts)
        self._first = images.first.reshape(-1, axes)
        self._last = images.last.reshape(-1, axes)
        self._corner = self._cell(self._first)
        self._row = np.repeat(np.arange(len(images.cells)), inputs)
        self._input = np.tile(np.arange(inputs), len(images.cells))
        self._done = done
        self._head = np.full(int(np.prod(counts)), NONE, dtype=np.int64)
        self._next = np.full(len(self._row), NONE, dtype=np.int64)
        self._unseen = np.flatnonzero(images.usable.reshape(-1))

    def led_into(self, captured: Truths, fresh: Wholes) -> tuple[Wholes, Wholes]:
        """Rows of cells that an image of theirs leads into captured cells, and its input."""
        asked = np.concatenate([self._unseen, self._waiting_for(fresh)])
        self._unseen = self._unseen[:0]
        asked = asked[~self._done[self._row[asked]]]
        outside = self._outside(asked, captured)
        led = asked[outside == NONE]
        rows, at = np.unique(self._row[led], return_index=True)
        self._done[rows] = True
        self._wait(asked[outside != NONE], outside[outside != NONE])
        return rows, self._input[led][at]

    def _waiting_for(self, fresh: Wholes) -> Wholes:
        at, waiting = self._head[fresh], []
        self._head[fresh] = NONE
        while len(at := at[at != NONE]):
            waiting.append(at)
            at = self._next[at]
        return np.concatenate(waiting) if waiting else np.empty(0, dtype=np.int64)

    def _wait(self, asked: Wholes, cells: Wholes) -> None:
        order = np.argsort(cells, kind="stable")
        asked, cells = asked[order], cells[order]
        if not len(asked):
            return
        ends = np.append(cells[1:] != cells[:-1], True)
        self._next[asked] = np.where(ends, self._head[cells], np.append(asked[1:], NONE))
        begins = np.append(True, ends[:-1])
        self._head[cells[begins]] = asked[begins]

    def _cell(self, place: npt.NDArray[np.integer[Any]]) -> Wholes:
        cell = np.zeros(len(place), dtype=np.int64)
        for axis, count in enumerate(self._counts):
            cell = cell * count + place[:, axis] % count
        return cell

    def _outside(self, asked: Wholes, captured: Truths) -> Wholes:
        """For each image a cell of its block that is not captured, NONE where all are.

        Corners are looked at first: it is there that most blocks stick out.
        """
        outside = np.full(len(asked), NONE, dtype=np.int64)
        left = _noted(self._corner[asked], np.arange(len(asked)), outside, captured)
        first, last = (a[asked[left]].astype(np.int64) for a in (self._first, self._last))
        rows = np.arange(len(left))  # of these, those that are left
        for ends in itertools.product((False, True), repeat=len(self._counts)):
            cell = self._cell(np.where(ends, last[rows], first[rows]))
            _noted(cell, left[rows], outside, captured)
            rows = rows[captured[cell]]
        for steps in itertools.product(
            *(range(n + 1) for n in (last[rows] - first[rows]).max(axis=0, initial=-1))
        ):
            fits = rows[(steps <= last[rows] - first[rows]).all(axis=1)]
            _noted(self._cell(first[fits] + np.array(steps)), left[fits], outside, captured)
            rows = rows[outside[left[rows]] == NONE]
        return outside


def _noted(cell: Wholes, left: Wholes, outside: Wholes, captured: Truths) -> Wholes:
    """Notes the cells that are not captured; the images that are left."""
    out = ~captured[cell]
    outside[left[out]] = cell[out]
    return left[~out]


CELLS = 101
"""Cells along a state."""


@renamed(refine="halvings")
@checked
def certify(
    system: System,
    region: Region,
    *,
    box: RangesOfStates | None = None,
    cells: int | Mapping[str, int | Sequence[float]] | None = None,
    sample_time: Seconds = 0.1,
    horizon: Seconds | None = None,
    inputs: int | Mapping[str, int] = INPUTS,
    uncertain: RangesOfParameters | None = None,
    disturbance: Mapping[str, float] | None = None,
    target: Region | None = None,
    law: Law | Switching | None = None,
    errors: OfStates | None = None,
    delay: Seconds = 0.0,
    halvings: Count = 0,
    steps: int | None = None,
    enclosure: str = STANDARD,
    store: str | Path | None = None,
    candidate: SetOnGrid | None = None,
    margin: float = 0.0,
    progress: Callable[[str, float], None] | None = None,
) -> Certificate:
    """The largest set of cells in `region` that held inputs keep there.

    A cell belongs to it if an input leads from every state of the cell to cells of the set, and
    keeps the region at every instant between the samples, for every disturbance within its bounds
    and every number of `uncertain` within its range. Every rounding is counted: the set is a subset
    of the sampled-data viability (discriminating) kernel, and `Certificate.write` makes a file
    that `holdfast-check` checks.

    target: where the system has to arrive (reach-avoid): from a cell of the set the inputs lead to
    `target` within the whole samples of `horizon`, and keep `region` until then. law: it gives the
    inputs, limited as the system limits them, and the set is what that law keeps when it begins
    there in its first mode: with its modes, safeguard and table, in exact arithmetic. What others
    hand it may be anything, and a disturbance that it measures is any within its bounds. errors:
    state -> by how much it may be measured wrong: the cell that is measured has the input. delay
    [s]: by how long an input may come late, below `sample_time`; until it comes any other that was
    tried, or that the law may give in the region, may be under way, before the first sample too.
    halvings: how often cells are halved along each axis: those that are left beside certified ones,
    at the edge of the region too. `kept.members` are cells of the smallest size, `kept.entries`
    those that were found, of all sizes.

    candidate: a kernel of this system, or with a target a capture basin: only the cells that its
    set touches are tried, so that the search is as much shorter as the set is smaller than the
    region; box, cells and disturbance are by default those of its grid and problem. margin [unit of
    V]: its set is V > margin.

    steps: into how many parts the enclosures of a hold divide it, from 1 to 64; by default as many
    as pay, of up to 16, by a trial of some cells. enclosure: of which kind they are, "zonotope" or
    "parallelepiped", that of the checker: of another the file lets the checker halve cells until
    its own say the same.

    box: state -> (low, high), the cells of which are tried; an angle over a whole turn comes back
    to itself where rates and constraints have it in sines and cosines alone. cells: how many along
    each state (101), or their edges. horizon [s]: None is for ever. inputs: how many values of each
    input are tried between its bounds; of a law into how many parts its range is divided, where the
    input may be anything. uncertain: parameter -> range, such as a mass that is wrong by a
    fifth. disturbance: those that are known and constant; others are any within their bounds, at
    every instant. store: a folder in which what is found is kept until a certificate is written
    there: the same call goes on where it was interrupted, or its process killed, and ends with the
    same answer.

    Raises `SimulationError` for a box that lacks a state, inputs without bounds, numbers out of
    range and a law that remembers or depends on time, `DefinitionError` for functions without a
    proved enclosure, and for a law that does not fit the system.

    >>> found = hf.certify(cart, hf.both(track, slow), box=box, cells=15, sample_time=0.2, inputs=3)
    >>> len(found.kept.members), "of", found.cells.total
    (188, 'of', 225)
    """
    among = None
    if candidate is not None:
        if law is not None:
            raise SimulationError("a candidate with a law", remedy="leave one of them out")
        check_candidate(candidate, system, target=target is not None)
        among = touched_by(candidate, margin)
        axes = candidate.grid.axes
        box = {a.name: (a.low, a.high) for a in axes} if box is None else box
        even = {a.name: a.count - (a.ends != "periodic") for a in axes}
        cells = even if cells is None else cells
        if disturbance is None:
            disturbance = {n: float(v) for n, v in candidate.report.disturbance.items()}
    if box is None:
        raise SimulationError("no box", expected="state -> (low, high), or a candidate")
    cells = CELLS if cells is None else cells
    regions = (region, target) if target is not None else (region,)
    ranges = ranges_of(system, regions, dict(uncertain or {}), dict(disturbance or {}))
    constraints, arrival = (
        tuple((c.name, c.unit, c.expression) for c in r.inequalities)
        for r in (region, target or region)
    )
    arrival = arrival if target is not None else ()
    cases, sample_time = None, float(sample_time)
    if law is not None:
        parts = parts_of(system, inputs, {n: ranges[n] for n in parameters_of(system, regions)})
        cases = law_of_cases(system, law, ranges, sample_time, parts)
    rates = tuple(system.rates[q.name] for q in system.states)
    expressions = [*rates, *(e for _, _, e in (*constraints, *arrival))]
    expressions += cases.expressions if cases is not None else ()
    check_functions(expressions)
    check_names([q.name for q in (*system.states, *system.inputs, *system.disturbances)])
    parameters = parameters_of(system, regions)
    check_names(parameters)
    grid = _cells(system, box, cells, expressions)
    _check_refine(halvings, grid)
    if steps is not None and not 1 <= steps <= MOST_STEPS:
        raise SimulationError(f"steps is {steps}", expected=f"from 1 to {MOST_STEPS}")
    if enclosure not in enclosures():
        raise SimulationError(
            f"enclosure is {enclosure!r}", remedy=suggestion(str(enclosure), enclosures())
        )
    if not (math.isfinite(sample_time) and sample_time > 0):
        raise SimulationError(f"sample_time is {sample_time:g}", expected="seconds, above 0")
    holds = None
    if horizon is not None:
        if not (math.isfinite(horizon) and horizon > 0):
            raise SimulationError(f"horizon is {horizon:g}", expected="seconds, above 0")
        holds = _holds(horizon, sample_time, to_target=target is not None)
    symbols = {q.name: q.symbol for q in system.disturbances}
    used = symbols_of(expressions)
    listed = [p for p in parameters.values() if p.symbol in used]
    candidates = np.empty((0, 0))
    if cases is None:
        candidates = candidates_of(system, inputs, {n: ranges[n] for n in parameters})
    sampling = Sampling(
        sample_time,
        errors_of(system, errors or {}),
        delay_of(float(delay), sample_time),
        tuple((float(c.min()), float(c.max())) for c in candidates.T),
        cases,
        enclosure=enclosure,
        halves=enclosures()[enclosure].halves,
    )

    def flow_of(sampling: Sampling) -> HeldFlow:
        return HeldFlow(
            rates,
            [e for _, _, e in constraints],
            [q.symbol for q in system.states],
            [q.symbol for q in system.inputs],
            {symbols[q.name]: ranges[q.name] for q in system.disturbances},
            {p.symbol: ranges[p.name] for p in listed},
            sampling,
            [e for _, _, e in arrival],
        )

    if cases is not None and sampling.delay:
        late = inputs_under_way(flow_of(replace(sampling, delay=0.0)), grid)
        sampling = replace(sampling, under_way=late)
    flow = flow_of(sampling)
    flow = in_steps(flow, grid, candidates) if steps is None else flow.in_steps(steps)
    if target is not None and not any(len(where(flow.arrived, g)) for g in _halves(grid, halvings)):
        raise SimulationError(f"no cell lies in '{target.name}'", remedy="take smaller cells")
    if cases is not None:
        if halvings or store is not None:
            raise SimulationError(
                "a law with halvings or store", expected="cells as they are, judged in one go"
            )
        by_law = reached_by_law if target is not None else kept_by_law
        kept_set = by_law(flow, grid, holds, progress)
    else:
        proved = reached if target is not None else kept
        kept_in = None if store is None else Store(store)
        kept_set = proved(flow, grid, candidates, holds, progress, halvings, kept_in, among)
    title = f"{system.name} in {region.name}" + (f" to {target.name}" if target else "")
    return Certificate(
        title=title + (f", by {law.name}" if law else ""),
        states=tuple((q.name, q.unit) for q in system.states),
        inputs=tuple((q.name, q.unit) for q in system.inputs),
        disturbances=tuple((q.name, q.unit) for q in system.disturbances),
        parameters=tuple((p.name, p.unit) for p in listed),
        ranges={q.name: ranges[q.name] for q in (*system.disturbances, *listed)},
        rates=rates,
        constraints=constraints,
        sampling=flow.sampling,
        candidates=candidates,
        kept=kept_set,
        target=arrival,
    )


def _holds(horizon: float, sample_time: float, *, to_target: bool) -> int:
    """How many samples the horizon is: a set is kept for no less, and a target is reached in no
    more."""
    samples = horizon / sample_time
    if not to_target:
        return math.ceil(samples - 1e-9)
    if samples < 1 - 1e-9:
        raise SimulationError(
            f"a horizon of {horizon:g} s with a sample time of {sample_time:g} s",
            expected="at least one sample to the target",
        )
    return math.floor(samples + 1e-9)


def _cells(
    system: System,
    box: Mapping[str, Range],
    counts: int | Mapping[str, int | Sequence[float]],
    expressions: Sequence[sp.Expr],
) -> Cells:
    edges, periodic = [], []
    check_among("box", box, system.state_names, "state")
    if not isinstance(counts, int):
        check_among("cells", counts, system.state_names, "state")
    for q in system.states:
        if q.name not in box:
            raise SimulationError(f"box lacks the state '{q.name}'")
        low, high = box[q.name]
        count = counts if isinstance(counts, int) else counts.get(q.name, CELLS)
        if not isinstance(count, int):
            edges.append(_edges(q.name, np.array(count, dtype=float), low, high))
            periodic.append(False)
            continue
        if not (math.isfinite(low) and math.isfinite(high) and low < high) or count < 1:
            raise SimulationError(f"{q.name}: {count} cells from {low:g} to {high:g}")
        turns = q.unit == "rad" and abs(high - low - TURN) < 1e-9
        turns = turns and all(comes_back(e, q.symbol) for e in expressions)
        if turns:  # a turn lies between two floats: the axis has the larger
            low, high = -TURN / 2, TURN / 2
        edges.append(np.linspace(low, high, count + 1))
        periodic.append(turns)
    return Cells(tuple(edges), tuple(periodic))


def _halves(cells: Cells, halvings: int) -> Iterator[Cells]:
    """The cells, their halves, and so on."""
    yield cells
    for _ in range(halvings):
        yield (cells := cells.halved())


def _check_refine(halvings: int, cells: Cells) -> None:
    if not 0 <= halvings <= MOST_DEPTH:
        raise SimulationError(f"halvings is {halvings}", expected=f"from 0 to {MOST_DEPTH}")
    total = cells.total << halvings * len(cells.counts)
    if total * (halvings + 1) >= MOST_CELLS:
        raise SimulationError(
            f"{total:,} cells of the smallest size",
            expected=f"fewer than {MOST_CELLS // (halvings + 1):,}",
            remedy="halve less often, or take fewer cells",
        )


def _edges(name: str, edges: Array, low: float, high: float) -> Array:
    """Those that are given, of cells that need not be even."""
    grow = edges.ndim == 1 and len(edges) > 1 and bool((np.diff(edges) > 0).all())
    if not grow or not np.isfinite(edges).all():
        raise SimulationError(f"cells: the edges of {name} do not grow", expected="finite numbers")
    if edges[0] != low or edges[-1] != high:
        raise SimulationError(
            f"cells: the edges of {name} are from {edges[0]:g} to {edges[-1]:g}",
            expected=f"those of its box, {low:g} to {high:g}",
        )
    return edges


def comes_back(e: sp.Expr, angle: sp.Symbol) -> bool:
    """Whether an expression has an angle in sums inside sines and cosines alone."""
    if angle not in e.free_symbols:
        return True
    if isinstance(e, sp.sin | sp.cos):
        return e.args[0].diff(angle) in (1, -1)
    return bool(e.args) and all(comes_back(a, angle) for a in e.args)
