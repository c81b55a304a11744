"""The largest set of cells from which held inputs lead to a target, in a region until then."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.certificates.cells import Cells, Floats, Truths, Wholes
from holdfast.analysis.certificates.images import Images
from holdfast.analysis.certificates.kept_set import Kept
from holdfast.analysis.certificates.refining import BEST, REGION, Ranks, refined
from holdfast.analysis.certificates.stored_images import Store
from holdfast.execution.intervals.held_flow import HeldFlow

NONE = -1


def reached(
    flow: HeldFlow,
    cells: Cells,
    candidates: Floats,
    holds: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    refine: int = 0,
    store: Store | None = None,
    among: Callable[[Cells], Truths] | None = None,
) -> Kept:
    """The cells from which an input leads all states to cells that are closer to the target.

    Those of the target are 0 sampling periods away from it; a cell from which an input leads to
    cells of up to n periods, in the region on the way, is n + 1 away. holds: how many periods at
    most; None is as many as there are. refine: how often cells are halved that are left near those
    that are found. among: which cells are tried; None is all of the region. The result's `holds` is
    the largest number, its entries' levels are the numbers
    of each.
    """

    def settle(found: Images, cells: Cells, ranks: Ranks) -> tuple[Ranks, Wholes, int]:
        return settled(found, cells, ranks, holds)

    found = refined(
        flow,
        cells,
        candidates,
        refine,
        settle,
        REGION + 1,
        target=True,
        progress=progress,
        store=store,
        among=among,
    )
    entries = found.entries[np.argsort(found.entries[:, 0], kind="stable")]
    entries[:, 2] = BEST - entries[:, 2]
    farthest = int(entries[:, 2].max(initial=1))
    return Kept.of(found.halvings, entries, farthest, found.sweeps, found.region, target=True)


def settled(
    found: Images, cells: Cells, ranks: Ranks, holds: int | None
) -> tuple[Ranks, Wholes, int]:
    """How far the cells of images are away, the inputs that lead there, and how many periods.

    ranks: BEST less how many periods cells are known to be away.
    """
    away = np.where(ranks > REGION, BEST - ranks.astype(np.int64), NONE)
    known = np.flatnonzero(away > 0)
    known = known[np.argsort(away[known], kind="stable")]
    far = away[known]
    captured = away == 0
    waiting = _Waiting(found, cells.counts, away[found.cells] >= 0)
    reached, chosen = ranks[found.cells], np.zeros(len(found.cells), dtype=np.int64)
    level, fresh = 0, np.flatnonzero(captured)
    while (len(fresh) or level < far.max(initial=0)) and (holds is None or level < holds):
        level += 1
        rows, inputs = waiting.led_into(captured, fresh)
        reached[rows], chosen[rows] = BEST - level, inputs
        older = known[slice(*np.searchsorted(far, (level, level + 1)))]
        fresh = np.concatenate([found.cells[rows], older])
        captured[fresh] = True
    return reached, chosen, level


class _Waiting:
    """Images that wait for a cell of theirs: each is looked at again when that one is captured.

    Lists by cell: `_head` the first image that waits for a cell, `_next` the one after an image.
    """

    def __init__(self, found: Images, counts: tuple[int, ...], done: Truths) -> None:
        self._counts = counts
        inputs = found.usable.shape[1]
        axes = len(counts)
        self._first = found.first.reshape(-1, axes)
        self._last = found.last.reshape(-1, axes)
        self._corner = self._cell(self._first)
        self._row = np.repeat(np.arange(len(found.cells)), inputs)
        self._input = np.tile(np.arange(inputs), len(found.cells))
        self._done = done
        self._head = np.full(int(np.prod(counts)), NONE, dtype=np.int64)
        self._next = np.full(len(self._row), NONE, dtype=np.int64)
        self._unseen = np.flatnonzero(found.usable.reshape(-1))

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
        at, found = self._head[fresh], []
        self._head[fresh] = NONE
        while len(at := at[at != NONE]):
            found.append(at)
            at = self._next[at]
        return np.concatenate(found) if found else np.empty(0, dtype=np.int64)

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
        found = np.full(len(asked), NONE, dtype=np.int64)
        left = _noted(self._corner[asked], np.arange(len(asked)), found, captured)
        first, last = (a[asked[left]].astype(np.int64) for a in (self._first, self._last))
        rows = np.arange(len(left))  # of these, those that are left
        for ends in itertools.product((False, True), repeat=len(self._counts)):
            cell = self._cell(np.where(ends, last[rows], first[rows]))
            _noted(cell, left[rows], found, captured)
            rows = rows[captured[cell]]
        for steps in itertools.product(
            *(range(n + 1) for n in (last[rows] - first[rows]).max(axis=0, initial=-1))
        ):
            fits = rows[(steps <= last[rows] - first[rows]).all(axis=1)]
            _noted(self._cell(first[fits] + np.array(steps)), left[fits], found, captured)
            rows = rows[found[left[rows]] == NONE]
        return found


def _noted(cell: Wholes, left: Wholes, found: Wholes, captured: Truths) -> Wholes:
    """Notes the cells that are not captured; the images that are left."""
    out = ~captured[cell]
    found[left[out]] = cell[out]
    return left[~out]
