"""The largest set of cells that held inputs keep: each has one that leads back into the set."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.analysis.certificates.cells import Cells, Counted, Floats, Truths, Wholes
from holdfast.analysis.certificates.images import Images
from holdfast.analysis.certificates.kept_set import Kept
from holdfast.analysis.certificates.refining import BEST, REGION, Ranks, refined
from holdfast.analysis.certificates.stored_images import Store
from holdfast.execution.intervals.held_flow import HeldFlow


def kept(
    flow: HeldFlow,
    cells: Cells,
    candidates: Floats,
    holds: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    refine: int = 0,
    store: Store | None = None,
    among: Callable[[Cells], Truths] | None = None,
) -> Kept:
    """The cells in the region from which a held input leads to others of them, again and again.

    candidates: inputs that are tried, shape (inputs, ...). holds: how many sampling periods; None
    for ever. refine: how often cells are halved that are left near those that are kept. among:
    which cells are tried; None is all of the region.
    """

    def settle(found: Images, cells: Cells, ranks: Ranks) -> tuple[Ranks, Wholes, int]:
        return settled(found, cells, ranks, holds)

    enough = BEST if holds is None else holds
    found = refined(
        flow, cells, candidates, refine, settle, enough,
        progress=progress, store=store, among=among,
    )  # fmt: skip
    entries = found.entries
    if holds is None:
        entries[:, 2] = 0
    return Kept.of(found.halvings, entries, holds, found.sweeps, found.region)


def settled(
    found: Images, cells: Cells, ranks: Ranks, holds: int | None
) -> tuple[Ranks, Wholes, int]:
    """For how many periods inputs keep the cells of images, those inputs, and how many sweeps.

    ranks: for how many what is known keeps cells, BEST for ever. Where a cell's input leads is the
    same at every sweep, and the set only shrinks: an input that does not keep a cell will not do so
    later.
    """
    usable, most = found.usable, found.usable.shape[1]
    longest = BEST if holds is None else holds
    reached = ranks[found.cells]
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
            blocks = found.first[at].astype(np.int64), found.last[at].astype(np.int64)
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
        after[found.cells[alive]] = True
        if sweeps > older and np.array_equal(after, now):
            break
        now = after
    reached[alive], chosen[alive] = longest, choice[alive]
    return reached, chosen, sweeps
