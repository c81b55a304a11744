"""The largest set of cells that a law keeps, or leads to a target: all that it may do does so.

A place is a cell that is measured, and the mode that the law is in before the sample.

What a law may do at a sample is told as cases: its modes, its safeguard and its table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.certificates.cells import Cells, Counted, Kept
from holdfast.analysis.certificates.certificate import Range
from holdfast.analysis.certificates.images import BLOCK, where
from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.arrays import Array, Truths, Wholes
from holdfast.execution.codegen.closed_loop_program import ControllerProgram, controller_program
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.execution.intervals.law_ranges import MOST_SETS, LawRanges, sets_of
from holdfast.execution.resources import check_memory
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.law import (
    CellLookup,
    Conditions,
    Law,
    LawCases,
    Option,
    Program,
    Safeguard,
)
from holdfast.maths.definitions.quantity import SAMPLE_TIME, TIME, TIME_IN_MODE
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import least
from holdfast.maths.expressions.traversal import branches, exact, exchanged, symbols_of

Parts = tuple[tuple[float, ...], ...]
_Branch = tuple[Conditions, tuple[Option | Program, ...]]


def law_of_cases(
    system: System,
    law: Law | Switching,
    ranges: Mapping[str, Range],
    sample_time: float,
    parts: Parts,
) -> LawCases:
    """The cases of a law for a system whose inputs are held for `sample_time` [s].

    ranges: of parameters and disturbances. parts: see `LawCases`. At every sample the first
    transition whose guard holds is taken. What is handed to the law may be anything: then its
    inputs are any within their bounds, and within its safeguard where it has one. A guard on the
    time in the mode may hold or not.

    Raises `DefinitionError` for a law that does not fit the system, `SimulationError` for one that
    remembers, depends on time or on an uncertain parameter, or looks up what is no stationary
    value.
    """
    program = controller_program(system, law)
    _check(program, ranges)
    builder = _Cases(program, sample_time, bool(parts))
    options = tuple(builder.of_mode(k) for k in range(len(program.modes)))
    lookup = program.lookup
    if lookup is not None:
        lookup = lookup.subs(builder.numbers)
    cases = LawCases(program.modes, program.initial_mode, options, parts, lookup)
    _check_symbols(program, cases)
    return cases


class _Cases:
    def __init__(self, program: ControllerProgram, sample_time: float, bounded: bool) -> None:
        self.program, self.system, self.bounded = program, program.system, bounded
        numbers = {p.symbol: exact(p.value) for p in program.parameters}
        self.numbers = {**numbers, SAMPLE_TIME: exact(sample_time)}
        self.inputs = program.inputs
        self.handed = {q.symbol for q in program.handed}
        self._known: dict[int, list[_Branch]] = {}

    def of_mode(self, mode: int) -> tuple[Option | Program, ...]:
        """The options of a sample before which the law is in this mode."""
        passed: list[Conditions] = [()]  # the ways in which no guard before holds
        options: list[Option | Program] = []
        for guard, target in self.program.transitions.get(self.program.modes[mode], ()):
            parts = _conjuncts(guard)
            for way in passed:
                options += self._after((*way, *(-e for e in parts)), target)
            passed = [(*way, e) for way in passed for e in parts]
        return (*options, *(o for way in passed for o in self._after(way, mode)))

    def _after(self, taken: Conditions, mode: int) -> list[Option | Program]:
        """The options of the law of a mode, where these conditions hold."""
        return [
            replace(o, when=(*more, *conditions, *now, *o.when), to=mode)
            for more, now in branches(self._exact(taken))
            for conditions, options in self._law(mode)
            for o in options
        ]

    def _law(self, mode: int) -> list[_Branch]:
        """The branches of the law of a mode: conditions, and options within them."""
        if mode not in self._known:
            name, m = self.program.modes[mode], len(self.inputs)
            guard = self.program.safeguards.get(name)
            rows = guard.rows(self.system.input_names) if guard else []
            self._known[mode] = []
            for conditions, now in branches(self._exact([*self.program.commands(name), *rows])):
                wanted, numbers = now[:m], now[m:]
                options: tuple[Option | Program, ...] = self._plain(wanted)
                if guard:
                    options = (self._guarded(guard, wanted, numbers),)
                self._known[mode].append((conditions, options))
        return self._known[mode]

    def _exact(self, expressions: Sequence[Any]) -> list[sp.Expr]:
        return [exact(e) for e in exchanged(map(exact, expressions), self.numbers)]

    def _plain(self, wanted: Sequence[sp.Expr]) -> tuple[Option, ...]:
        if self.handed & symbols_of(wanted):
            return (self._free(),)
        return (Option((), self._saturated(wanted)),)

    def _free(self) -> Option:
        if not self.bounded:
            raise SimulationError(
                f"the inputs of law '{self.program.switching.name}' may be anything",
                expected="a system with bounds of its inputs",
            )
        return Option(self._within(), tuple(self.inputs))

    def _guarded(
        self, guard: Safeguard, wanted: Sequence[sp.Expr], numbers: Sequence[sp.Expr]
    ) -> Program:
        m, count = len(self.inputs), len(guard.offsets)
        free, box = bool(self.handed & symbols_of(wanted)), self._box()
        if box is None and not self.bounded:
            self._free()  # which refuses
        if len(sets := sets_of(count, m, wanted=not free)) > MOST_SETS:
            raise DefinitionError(
                f"a safeguard with {len(sets)} sets of conditions", expected=f"at most {MOST_SETS}"
            )
        rows = tuple(tuple(numbers[j * (m + 1) : (j + 1) * (m + 1)]) for j in range(count))
        return Program(
            when=(),
            wanted=None if free else tuple(wanted),
            rows=rows,
            hard=guard.hard,
            scales=tuple(numbers[count * (m + 1) :]),
            limits=self._saturated(self.inputs),
            box=None if box is None else tuple(zip(box.lower, box.upper, strict=True)),
        )

    def _box(self) -> Box | None:
        bounds = self.system.input_bounds
        if not isinstance(bounds, Box):
            return None
        return Box(tuple(self._exact(bounds.lower)), tuple(self._exact(bounds.upper)))

    def _saturated(self, values: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        """The inputs that the actuators make of those that are asked for."""
        bounds = self.system.input_bounds
        return tuple(self._exact(bounds.saturate(values) if bounds is not None else values))

    def _within(self) -> Conditions:
        """What limited inputs meet, beyond their ranges."""
        bounds = self.system.input_bounds
        if bounds is None or isinstance(bounds, Box) or len(self.inputs) < len(bounds.actuators):
            return ()
        try:
            rows = bounds.half_spaces()
        except DefinitionError:
            return ()
        left = [
            sp.Add(*(a * u for a, u in zip(normal, self.inputs, strict=True))) - most
            for normal, most in rows
        ]
        return tuple(self._exact(left))


def _conjuncts(guard: sp.Expr) -> list[sp.Expr]:
    """What all has to hold where a guard holds."""
    if isinstance(guard, least | sp.Min):
        return [e for part in guard.args for e in _conjuncts(part)]
    return [guard]


def _check(program: ControllerProgram, ranges: Mapping[str, Range]) -> None:
    law, system = program.switching, program.system
    if program.remembered:
        raise SimulationError(
            f"law '{law.name}' remembers {', '.join(q.name for q in program.remembered)}",
            expected="a law without memory, such as one without an observer or limits of rates",
        )
    if isinstance(program.lookup, CellLookup):
        raise SimulationError(
            f"law '{law.name}' is that of a certificate, which proves it",
            remedy="check the certificate: holdfast-check FILE",
        )
    if any(guard.foresight for guard in program.safeguards.values()):
        raise SimulationError(
            f"law '{law.name}' looks at a value a sample ahead, which is no half-space of inputs",
            expected="a law of the slopes of a value",
            remedy="take safety_law(..., ahead=False)",
        )
    if program.lookup is not None and program.lookup.timed:
        raise SimulationError(
            f"law '{law.name}' looks up a value that depends on the time left",
            expected="a kernel that has converged, or one that is stored at its last time only",
        )
    limits = system.input_bounds.free_symbols if system.input_bounds is not None else set()
    used = symbols_of([*program.expressions, *limits])
    for p in system.parameters:
        if p.symbol in used and ranges[p.name] != (p.value, p.value):
            raise SimulationError(
                f"law '{law.name}' or the limits of its inputs use '{p.name}', which is uncertain",
                expected="a law whose inputs do not depend on it",
            )


def _check_symbols(program: ControllerProgram, cases: LawCases) -> None:
    allowed = {q.symbol for q in (*program.measurements, *program.system.inputs)}
    allowed |= set(cases.lookup.symbols) if cases.lookup else set()
    allowed |= {TIME_IN_MODE}
    if odd := symbols_of(cases.expressions) - allowed:
        labels = {TIME: "the time"}
        handed = {q.symbol for q in program.handed}
        which = ", ".join(sorted(labels.get(s, str(s)) for s in odd))
        raise SimulationError(
            f"law '{program.switching.name}' uses {which}"
            + (", which others hand it, beyond its outputs" if odd & handed else ""),
            expected="states, and disturbances that are measured",
        )


Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Leads:
    """To which cells all that a law may do in a place leads: a row each.

    place: mode times the number of cells plus the row of the cell. to: the mode afterwards. usable:
    whether the region is kept on the way and the block of cells is inside the grid.
    """

    place: Wholes
    to: Wholes
    first: npt.NDArray[np.int32]
    last: npt.NDArray[np.int32]
    usable: Truths

    def surely(self, cells: Cells, members: list[Truths]) -> Truths:
        """Which lead into a set: of each mode whether a cell is a member. members: of each mode,
        shape (cells,). The answers have the shape (leads,)."""
        sure = self.usable.copy()
        for mode, marks in enumerate(members):
            some = np.flatnonzero(sure & (self.to == mode))
            counted = Counted(cells, marks)
            at = (self.first[some].astype(np.int64), self.last[some].astype(np.int64))
            sure[some] = counted.all_of(*at)
        return sure


def kept_by_law(
    flow: HeldFlow, cells: Cells, holds: int | None = None, progress: Progress | None = None
) -> Kept:
    """The cells in the region that a law keeps; holds: sampling periods, None is for ever.

    The members are those from which it keeps the region when it begins there in its first mode;
    their `inputs` are the number of that mode, as in the entries (cell, mode, level).
    """
    law = _law_of(flow)
    inside = where(flow.inside, cells)
    moves = leads(flow, cells, inside, progress or (lambda what, share: None))
    alive = np.ones((law.modes, len(inside)), dtype=bool)
    lasts = np.zeros(alive.shape, dtype=np.int64)
    led = np.bincount(moves.place, minlength=alive.size) > 0
    sweeps, total = 0, int(np.prod(cells.counts))
    while holds is None or sweeps < holds:
        sure = moves.surely(cells, [_marked(total, inside[flags]) for flags in alive])
        now = alive & _all_of(moves, sure, led, alive.shape)
        same = bool((now == alive).all())
        alive = now
        sweeps += 1
        lasts[alive] = sweeps
        if same:
            break
    if holds is not None:
        lasts[alive] = holds
    mode, row = np.nonzero(lasts if holds is not None else alive)
    level = lasts[mode, row] if holds is not None else np.zeros(len(row), dtype=np.int64)
    entries = np.stack([inside[row], mode, level], axis=1)
    members = inside[alive[law.initial]]
    first = np.full(len(members), law.initial)
    return Kept(cells, members, first, holds, sweeps, entries, inside)


def reached_by_law(
    flow: HeldFlow, cells: Cells, holds: int | None = None, progress: Progress | None = None
) -> Kept:
    """The cells from which a law leads to the target, closer with each sampling period.

    As `certify.reached` has it, of a law that begins in its first mode.
    """
    law = _law_of(flow)
    arrived = where(flow.arrived, cells)
    region = np.setdiff1d(where(flow.inside, cells), arrived)
    moves = leads(flow, cells, region, progress or (lambda what, share: None))
    level = np.zeros((law.modes, len(region)), dtype=np.int64)
    led = np.bincount(moves.place, minlength=level.size) > 0
    total, sweeps = int(np.prod(cells.counts)), 0
    while holds is None or sweeps < holds:
        captured = [_marked(total, arrived, region[levels > 0]) for levels in level]
        sure = moves.surely(cells, captured)
        fresh = _all_of(moves, sure, led, level.shape) & (level == 0)
        if not fresh.any():
            break
        sweeps += 1
        level[fresh] = sweeps
    mode, row = np.nonzero(level)
    entries = np.stack([region[row], mode, level[mode, row]], axis=1)
    members = region[level[law.initial] > 0]
    first = np.full(len(members), law.initial)
    farthest = int(level.max(initial=0)) or 1
    return Kept(cells, members, first, farthest, sweeps, entries, region)


def leads(flow: HeldFlow, cells: Cells, of: Wholes, tell: Progress) -> Leads:
    """All that the law may do in these cells, in every mode: `of` has the shape (cells,)."""
    law, corners, moves = _law_of(flow), cells.corners(of), []
    what = f"{len(of):,} cells in the region, {law.modes} modes of the law"
    tell(what, 0.0)
    size, blocks = 0, range(0, len(of), BLOCK)
    for mode in range(law.modes):
        for done, begin in enumerate(blocks, 1):
            part = slice(begin, begin + BLOCK)
            low, high = corners[0][part], corners[1][part]
            choices = law.given(mode, low, high)
            held = flow.held(low[choices.row], high[choices.row], choices.low, choices.high)
            a, b, stays = cells.touched(held.low, held.high)
            usable = held.kept & stays
            size += len(usable) * (17 + 8 * a.shape[1])
            check_memory(size, "what the law may do in all cells", "take fewer cells or parts")
            fine = usable[:, None]
            place = mode * len(of) + begin + choices.row
            ends = (np.where(fine, e, 0).astype(np.int32) for e in (a, b))
            moves.append((place, choices.to, *ends, usable))
            tell(what, (mode + done / len(blocks)) / law.modes)
    if not moves:
        none, axes = np.empty(0, dtype=np.int64), len(cells.counts)
        block = np.empty((0, axes), dtype=np.int32)
        return Leads(none, none, block, block, np.empty(0, dtype=bool))
    return Leads(*(np.concatenate(parts) for parts in zip(*moves, strict=True)))


def inputs_under_way(flow: HeldFlow, cells: Cells) -> tuple[tuple[float, float], ...]:
    """The least and the greatest of each input that the law may give in the region.

    Raises `SimulationError` where nothing is known of them in any cell.
    """
    law, inside = _law_of(flow), where(flow.inside, cells)
    low, high = cells.corners(inside)
    ends: list[tuple[Array, Array]] = []
    for mode in range(law.modes):
        for begin in range(0, len(inside), BLOCK):
            part = slice(begin, begin + BLOCK)
            choices = law.given(mode, low[part], high[part])
            bounded = np.isfinite(choices.low).all(axis=1) & np.isfinite(choices.high).all(axis=1)
            if bounded.any():
                ends.append((choices.low[bounded].min(axis=0), choices.high[bounded].max(axis=0)))
    if not ends:
        raise SimulationError(
            "no bounds of the law's inputs are known", expected="a system with bounds of its inputs"
        )
    least, most = (np.array(e) for e in zip(*ends, strict=True))
    return tuple(zip(least.min(axis=0).tolist(), most.max(axis=0).tolist(), strict=True))


def _law_of(flow: HeldFlow) -> LawRanges:
    assert flow.law is not None
    return flow.law


def _marked(total: int, *cells: Wholes) -> Truths:
    marks = np.zeros(total, dtype=bool)
    for some in cells:
        marks[some] = True
    return marks


def _all_of(moves: Leads, sure: Truths, led: Truths, shape: tuple[int, ...]) -> Truths:
    """The places in which all that the law may do is sure, and it does something."""
    good = led.copy()
    good[moves.place[~sure]] = False
    return good.reshape(shape)
