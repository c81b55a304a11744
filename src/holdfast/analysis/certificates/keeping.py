"""The largest set of cells that held inputs keep: each has one that leads back into the set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holdfast.analysis.certificates.cells import Cells, Counted, Floats, Wholes
from holdfast.analysis.certificates.images import images, where
from holdfast.analysis.certificates.stored_images import Store
from holdfast.execution.intervals.held_flow import HeldFlow


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
    progress: Callable[[str, float], None] | None = None,
    store: Store | None = None,
) -> Kept:
    """The cells in the region from which a held input leads to others of them, again and again.

    candidates: inputs that are tried, shape (inputs, ...). holds: how many sampling periods; None
    for ever. Where a cell's input leads is the same at every sweep, and the set only shrinks: an
    input that does not keep a cell will not do so later.
    """
    inside = where(flow.inside, cells)
    found = images(flow, cells, candidates, inside, progress or (lambda what, share: None), store)
    first, last, usable = found.first, found.last, found.usable
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
