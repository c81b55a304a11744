"""Outer sets of what is reached: all cells that ways from the cells of a start may touch."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping

import numpy as np

from holdfast.analysis.certificates.candidate_cells import SetOnGrid
from holdfast.analysis.certificates.cells import Cells, Floats, Truths, Wholes
from holdfast.analysis.certificates.certify import comes_back
from holdfast.analysis.certificates.images import where
from holdfast.analysis.certificates.outer_cells import (
    BACK,
    OuterSet,
    even_cells,
    free_flow,
    states_of,
)
from holdfast.analysis.certificates.problem import parameters_of
from holdfast.errors import SimulationError
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact

LEGS = (1, 2, 4, 8, 16)
"""Numbers of legs into which a horizon is divided, of which all are tried."""

STEPS = (1, 4, 16, 64)
"""Numbers of steps of a leg: more of them as long as that makes the set smaller."""


def _possible(system: System, region: Region) -> Callable[[Floats, Floats], Truths]:
    """Whether a box may have a state of the region: no constraint is violated all over it."""
    parameters = list(parameters_of(system, (region,)).values())
    names = [*(q.symbol for q in system.states), *(p.symbol for p in parameters)]
    enclosure = Enclosure([exact(c.expression) for c in region.inequalities], names)
    numbers = [float(p.value) for p in parameters]

    def possible(low: Floats, high: Floats) -> Truths:
        fixed = np.tile(numbers, (len(low), 1)).reshape(len(low), len(numbers))
        smallest, _ = enclosure.over(np.hstack([low, fixed]), np.hstack([high, fixed]))
        allowed: Truths = np.logical_not((smallest > 0).any(axis=1))
        return allowed

    return possible


def reached_within(
    value: SetOnGrid,
    system: System,
    start: Region,
    within: Region | None,
    counts: Mapping[str, int],
    sample_time: float | None,
) -> OuterSet:
    """The cells that ways from the start may touch; the smallest set of several times."""
    seconds = math.inf if value.report.converged else value.report.horizon_s
    tries = [float(sample_time)] if sample_time is not None else [
        value.report.horizon_s / k for k in LEGS
    ]  # fmt: skip
    cells = even_cells(value, counts)
    regions = (start,) if within is None else (start, within)
    _check_within(system, regions, cells)
    begun = where(_possible(system, start), cells)
    room = np.ones(cells.total, dtype=bool)
    if within is not None:
        room[:] = False
        room[where(_possible(system, within), cells)] = True
    best: OuterSet | None = None
    trouble = ""
    for hold in tries:
        legs = math.inf if math.isinf(seconds) else math.ceil(seconds / hold - 1e-9)
        last = math.inf
        for steps in STEPS:
            flow, _ = free_flow(system, regions, hold / steps, back=value.report.kind in BACK)
            members, why = _spread(flow, steps, cells, begun, room, legs)
            trouble = why or trouble
            if members is None:
                continue
            outer = OuterSet(value.report.kind, states_of(value), cells, members, hold)
            if best is None or outer.volume < best.volume:
                best = outer
            if outer.volume >= last:
                break
            last = outer.volume
    if best is None:
        raise SimulationError(
            f"no outer set is found: {trouble}",
            remedy="take a wider grid, smaller cells, or another sample_time",
        )
    return best


def _check_within(system: System, regions: tuple[Region, ...], cells: Cells) -> None:
    """Refuse where ways may begin beyond the grid, and angles that do not come back."""
    possible = [_possible(system, r) for r in regions]
    expressions = [*system.rates.values(), *(c.expression for r in regions for c in r.inequalities)]
    for k, (q, periodic) in enumerate(zip(system.states, cells.periodic, strict=True)):
        if periodic and not all(comes_back(e, q.symbol) for e in expressions):
            raise SimulationError(
                f"'{q.name}' is periodic, and does not stand in sines and cosines alone",
                remedy="take other ends",
            )
        for end in (0, -1) if not periodic else ():
            low, high = (np.full((1, len(cells.edges)), s * math.inf) for s in (-1, 1))
            for i, turns in enumerate(cells.periodic):
                if turns:
                    low[0, i], high[0, i] = cells.edges[i][0], cells.edges[i][-1]
            (high if end == 0 else low)[0, k] = cells.edges[k][end]
            if all(there(low, high)[0] for there in possible):
                raise SimulationError(
                    f"'{regions[0].name}' may reach beyond the grid at {q.name} = "
                    f"{cells.edges[k][end]:g}",
                    remedy="bound it by a constraint, or take a wider grid",
                )


def _spread(
    flow: HeldFlow, steps: int, cells: Cells, begun: Wholes, room: Truths, legs: float
) -> tuple[Wholes | None, str]:
    """All cells that ways of so many legs from these may touch, in turn; or what is not known.

    A leg is so many steps of the flow from each cell; only then is what it leads to cells again.
    """
    touched = np.zeros(cells.total, dtype=bool)
    started = np.zeros(cells.total, dtype=bool)
    fresh = begun[room[begun]]
    touched[fresh] = started[fresh] = True
    open_sides = _open_sides(cells, room)
    leg = 0
    while len(fresh) and leg < legs:
        low, high = cells.corners(fresh)
        for _ in range(steps):
            held = flow.held(low, high, np.empty((len(low), 0)))
            if not held.kept.all():
                return None, f"no enclosure of the way for {flow.sampling.hold:g} s"
            way = _clipped(cells, held.way_low, held.way_high, open_sides)
            end = _clipped(cells, held.low, held.high, open_sides)
            if left := way[2]:
                return None, f"a way leaves the grid at '{flow.states[left - 1]}'"
            _note(touched, cells, way[0], way[1])
            low, high = end[0], end[1]
        before = started.copy()
        _note(started, cells, low, high)
        started &= room
        fresh = np.flatnonzero(started & ~before)
        leg += 1
    return np.flatnonzero((touched | started) & room), ""


def _open_sides(cells: Cells, room: Truths) -> list[tuple[bool, bool]]:
    """At which ends of each axis a way may leave the grid: where a cell there is possible."""
    grid = room.reshape(cells.counts)
    sides = []
    for axis, periodic in enumerate(cells.periodic):
        ends = tuple(bool(np.take(grid, k, axis=axis).any()) and not periodic for k in (0, -1))
        sides.append((ends[0], ends[1]))
    return sides


def _clipped(
    cells: Cells, low: Floats, high: Floats, open_sides: list[tuple[bool, bool]]
) -> tuple[Floats, Floats, int]:
    """Boxes within the grid, and one more than the axis at which a way may leave it, or 0.

    A way in the region never passes the impossible cells at a closed end.
    """
    low, high = low.copy(), high.copy()
    for k, ((at_low, at_high), periodic) in enumerate(zip(open_sides, cells.periodic, strict=True)):
        if periodic:
            turn = cells.edges[k][-1] - cells.edges[k][0]
            whole = ~(high[:, k] - low[:, k] < 0.99 * turn)
            low[whole, k] = 0.5 * (cells.edges[k][0] + cells.edges[k][1])
            high[whole, k] = 0.5 * (cells.edges[k][-2] + cells.edges[k][-1])
            continue
        first, last = cells.edges[k][0], cells.edges[k][-1]
        if (at_low and (low[:, k] < first).any()) or (at_high and (high[:, k] > last).any()):
            return low, high, k + 1
        low[:, k], high[:, k] = np.clip(low[:, k], first, last), np.clip(high[:, k], first, last)
    return low, high, 0


def _note(noted: Truths, cells: Cells, low: Floats, high: Floats) -> None:
    """Note all cells that boxes within the grid touch: sums of one at each corner of the blocks."""
    first, last, inside = cells.touched(low, high)
    assert inside.all()
    shape = [n * (1 + p) for n, p in zip(cells.counts, cells.periodic, strict=True)]
    sums = np.zeros([n + 1 for n in shape], dtype=np.int32)
    for corner in itertools.product((0, 1), repeat=len(shape)):
        ends = [last[:, k] + 1 if c else first[:, k] for k, c in enumerate(corner)]
        np.add.at(sums, tuple(ends), (-1) ** sum(corner))
    for axis, (count, periodic) in enumerate(zip(cells.counts, cells.periodic, strict=True)):
        sums = np.cumsum(sums, axis=axis)
        covered = np.moveaxis(sums, axis, 0)[:-1]
        if periodic:  # blocks may go on beyond the last cell
            covered = covered[:count] + covered[count:]
        sums = np.moveaxis(covered, 0, axis)
    noted |= (sums > 0).reshape(-1)
