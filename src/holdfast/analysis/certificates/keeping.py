"""The largest set of cells that held inputs keep: each has one that leads back into the set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holdfast.analysis.certificates.cells import Cells, Counted, Floats, Truths, Wholes
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.execution.resources import check_memory

BLOCK = 1 << 16


@dataclass(frozen=True)
class Kept:
    """members: numbers of the cells that are kept; inputs: for each the one that keeps it.

    region: the cells that lie in the region. holds: sampling periods, None for ever. entries: rows
    (cell, input, level): the input leads from that cell to cells of a level one lower, as many
    periods as are left at most; the level is 0 for ever.
    """

    cells: Cells
    members: Wholes
    inputs: Wholes
    holds: int | None
    sweeps: int
    entries: Wholes
    region: Wholes

    @property
    def inside(self) -> int:
        """How many cells lie in the region."""
        return len(self.region)

    @property
    def share(self) -> float:
        """Of the cells that lie in the region."""
        return len(self.members) / self.inside if self.inside else 0.0


def kept(
    flow: HeldFlow,
    cells: Cells,
    candidates: Floats,
    holds: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Kept:
    """The cells in the region from which a held input leads to others of them, again and again.

    candidates: inputs that are tried, shape (inputs, ...). holds: how many sampling periods; None
    for ever. Where a cell's input leads is the same at every sweep, and the set only shrinks: an
    input that does not keep a cell will not do so later.
    """
    tell = progress or (lambda share: None)
    inside = _inside(flow, cells)
    first, last, usable = _led(flow, cells, candidates, inside, tell)
    count, most = len(inside), len(candidates)
    choice = np.zeros(count, dtype=np.int64)
    alive = np.ones(count, dtype=bool)
    sweeps = 0
    earlier: list[Wholes] = []
    while holds is None or sweeps < holds:
        now = np.zeros(int(np.prod(cells.counts)), dtype=bool)
        now[inside[alive]] = True
        counted = Counted(cells, now)
        waiting = np.flatnonzero(alive)
        before = choice.copy()
        while len(waiting):
            choice_of = choice[waiting]
            fine = usable[waiting, choice_of]
            some = np.flatnonzero(fine)
            at = waiting[some], choice_of[some]
            fine[some] = counted.all_of(first[at].astype(np.int64), last[at].astype(np.int64))
            waiting = waiting[~fine]
            choice[waiting] += 1
            lost = choice[waiting] >= most
            alive[waiting[lost]] = False
            waiting = waiting[~lost]
        if holds is not None and sweeps:  # inputs that led far enough until now
            changed = np.flatnonzero(before != choice)
            level = np.full(len(changed), sweeps)
            earlier.append(np.stack([inside[changed], before[changed], level], axis=1))
        sweeps += 1
        if alive.sum() == now.sum():
            break
    members, inputs = inside[alive], choice[alive]
    level = np.full(len(members), 0 if holds is None else holds)
    entries = np.concatenate([np.stack([members, inputs, level], axis=1), *earlier])
    return Kept(cells, members, inputs, holds, sweeps, entries, inside)


def _inside(flow: HeldFlow, cells: Cells) -> Wholes:
    total = int(np.prod(cells.counts))
    found = []
    for begin in range(0, total, BLOCK):
        flat = np.arange(begin, min(begin + BLOCK, total))
        found.append(flat[flow.inside(*cells.corners(flat))])
    return np.concatenate(found)


def _led(
    flow: HeldFlow,
    cells: Cells,
    candidates: Floats,
    inside: Wholes,
    tell: Callable[[float], None],
) -> tuple[np.ndarray, np.ndarray, Truths]:
    """The blocks of cells to which each input leads from each cell, and whether it is usable."""
    axes, most = len(cells.counts), len(candidates)
    shape = (len(inside), most, axes)
    check_memory(
        len(inside) * most * (8 * axes + 1),
        f"{len(inside):,} cells in the region times {most} inputs",
        "take fewer cells or inputs",
    )
    first, last = np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=np.int32)
    usable = np.zeros(shape[:2], dtype=bool)
    for begin in range(0, len(inside), BLOCK):
        part = slice(begin, begin + BLOCK)
        low, high = cells.corners(inside[part])
        for k, u in enumerate(candidates):
            found = flow.held(low, high, np.tile(u, (len(low), 1)))
            a, b, stays = cells.touched(found.low, found.high)
            usable[part, k] = found.kept & stays
            fine = usable[part, k][:, None]
            first[part, k], last[part, k] = np.where(fine, a, 0), np.where(fine, b, 0)
        tell(min(begin + BLOCK, len(inside)) / len(inside))
    return first, last, usable
