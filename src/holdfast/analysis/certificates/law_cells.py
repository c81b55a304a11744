"""The largest set of cells that a law keeps, or leads to a target: all that it may do does so.

A place is a cell that is measured, and the mode that the law is in before the sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.analysis.certificates.cells import Cells, Counted, Floats, Truths, Wholes
from holdfast.analysis.certificates.images import BLOCK, where
from holdfast.analysis.certificates.kept_set import Kept
from holdfast.errors import SimulationError
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.execution.intervals.law_ranges import LawRanges
from holdfast.execution.resources import check_memory

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
        """Which lead into a set: of each mode whether a cell is a member."""
        found = self.usable.copy()
        for mode, own in enumerate(members):
            some = np.flatnonzero(found & (self.to == mode))
            counted = Counted(cells, own)
            at = (self.first[some].astype(np.int64), self.last[some].astype(np.int64))
            found[some] = counted.all_of(*at)
        return found


def kept_by_law(
    flow: HeldFlow, cells: Cells, holds: int | None = None, progress: Progress | None = None
) -> Kept:
    """The cells in the region that a law keeps; holds: sampling periods, None is for ever.

    The members are those from which it keeps the region when it begins there in its first mode;
    their `inputs` are the number of that mode, as in the entries (cell, mode, level).
    """
    law = _law_of(flow)
    inside = where(flow.inside, cells)
    found = leads(flow, cells, inside, progress or (lambda what, share: None))
    alive = np.ones((law.modes, len(inside)), dtype=bool)
    lasts = np.zeros(alive.shape, dtype=np.int64)
    led = np.bincount(found.place, minlength=alive.size) > 0
    sweeps, total = 0, int(np.prod(cells.counts))
    while holds is None or sweeps < holds:
        sure = found.surely(cells, [_marked(total, inside[own]) for own in alive])
        now = alive & _all_of(found, sure, led, alive.shape)
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

    As `reaching.reached` has it, of a law that begins in its first mode.
    """
    law = _law_of(flow)
    arrived = where(flow.arrived, cells)
    region = np.setdiff1d(where(flow.inside, cells), arrived)
    found = leads(flow, cells, region, progress or (lambda what, share: None))
    level = np.zeros((law.modes, len(region)), dtype=np.int64)
    led = np.bincount(found.place, minlength=level.size) > 0
    total, sweeps = int(np.prod(cells.counts)), 0
    while holds is None or sweeps < holds:
        captured = [_marked(total, arrived, region[own > 0]) for own in level]
        sure = found.surely(cells, captured)
        fresh = _all_of(found, sure, led, level.shape) & (level == 0)
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
    """All that the law may do in these cells, in every mode."""
    law, corners, found = _law_of(flow), cells.corners(of), []
    what = f"{len(of):,} cells in the region, {law.modes} modes of the law"
    tell(what, 0.0)
    size, blocks = 0, range(0, len(of), BLOCK)
    for mode in range(law.modes):
        for done, begin in enumerate(blocks, 1):
            part = slice(begin, begin + BLOCK)
            low, high = corners[0][part], corners[1][part]
            given = law.given(mode, low, high)
            held = flow.held(low[given.row], high[given.row], given.low, given.high)
            a, b, stays = cells.touched(held.low, held.high)
            usable = held.kept & stays
            size += len(usable) * (17 + 8 * a.shape[1])
            check_memory(size, "what the law may do in all cells", "take fewer cells or parts")
            fine = usable[:, None]
            place = mode * len(of) + begin + given.row
            ends = (np.where(fine, e, 0).astype(np.int32) for e in (a, b))
            found.append((place, given.to, *ends, usable))
            tell(what, (mode + done / len(blocks)) / law.modes)
    if not found:
        none, axes = np.empty(0, dtype=np.int64), len(cells.counts)
        block = np.empty((0, axes), dtype=np.int32)
        return Leads(none, none, block, block, np.empty(0, dtype=bool))
    return Leads(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def inputs_under_way(flow: HeldFlow, cells: Cells) -> tuple[tuple[float, float], ...]:
    """The least and the greatest of each input that the law may give in the region.

    Raises `SimulationError` where nothing is known of them in any cell.
    """
    law, inside = _law_of(flow), where(flow.inside, cells)
    low, high = cells.corners(inside)
    ends: list[tuple[Floats, Floats]] = []
    for mode in range(law.modes):
        for begin in range(0, len(inside), BLOCK):
            part = slice(begin, begin + BLOCK)
            given = law.given(mode, low[part], high[part])
            known = np.isfinite(given.low).all(axis=1) & np.isfinite(given.high).all(axis=1)
            if known.any():
                ends.append((given.low[known].min(axis=0), given.high[known].max(axis=0)))
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
    found = np.zeros(total, dtype=bool)
    for some in cells:
        found[some] = True
    return found


def _all_of(found: Leads, sure: Truths, led: Truths, shape: tuple[int, ...]) -> Truths:
    """The places in which all that the law may do is sure, and it does something."""
    good = led.copy()
    good[found.place[~sure]] = False
    return good.reshape(shape)
