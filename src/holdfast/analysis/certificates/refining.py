"""Cells that are halved where it pays: near those that are certified, depth by depth.

A rank says what is known of a cell: NONE, REGION in the region, BEST if nothing more is asked, and
between them the more the better. Ranks of cells of one depth stand for all that they are made of.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.certificates.cells import Cells, Floats, Halvings, Truths, Wholes
from holdfast.analysis.certificates.images import Images, images, joined, where
from holdfast.analysis.certificates.stored_images import Store
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.execution.resources import check_memory

Ranks = npt.NDArray[np.int32]
Settle = Callable[[Images, Cells, Ranks], tuple[Ranks, Wholes, int]]
"""From images, the cells and their ranks: the ranks of those that have images, the inputs that give
them, and how many sweeps that took."""

NONE, REGION, BEST = -1, 0, 2**31 - 1


@dataclass(frozen=True)
class Refined:
    """region: the smallest cells that lie in it. entries: rows (number, input, rank)."""

    halvings: Halvings
    entries: Wholes
    region: Wholes
    sweeps: int


def refined(
    flow: HeldFlow,
    cells: Cells,
    candidates: Floats,
    depth: int,
    settle: Settle,
    enough: int,
    *,
    target: bool = False,
    progress: Callable[[str, float], None] | None = None,
    store: Store | None = None,
    among: Callable[[Cells], Truths] | None = None,
) -> Refined:
    """What is found of the cells, of half of those that are left near it, and so on.

    At each depth those cells are halved that have less than `enough` and a better one beside them,
    again and again as long as that gains something; all of them where nothing is found yet. What
    was found of larger cells stands: an input leads from a cell to ranks that only grow. store:
    where images are kept, so that an interrupted search goes on. among: which cells are tried at
    all.
    """
    tell = progress or (lambda what, share: None)
    _check_memory(cells, depth)
    ranks = np.full(cells.total, NONE, dtype=np.int32)
    region = np.zeros(cells.total, dtype=bool)
    found: list[tuple[Wholes, Wholes]] = []
    sweeps = 0
    for times in range(depth + 1):
        if times:
            cells = cells.halved()
            ranks, region = doubled(ranks, cells), doubled(region, cells)
        region[where(flow.inside, cells, np.flatnonzero(~region))] = True
        tried = region if among is None else region & among(cells)
        ranks[tried & (ranks == NONE)] = REGION
        if target:
            ranks[where(flow.arrived, cells, np.flatnonzero(ranks < BEST))] = BEST
        before = ranks.copy()
        some = partial(images, flow, cells, candidates, tell=tell, store=store)
        inputs, count = _gained(cells, ranks, enough, times > 0, some, settle)
        gained = np.flatnonzero(ranks > before)
        found.append((gained, np.stack([inputs[gained], ranks[gained]], axis=1)))
        sweeps += count
    if target:
        region &= ranks < BEST
    halvings = Halvings(cells, depth)
    rows = [
        np.column_stack([halvings.numbers(of, times), told])
        for times, (of, told) in enumerate(found)
    ]
    return Refined(halvings, np.concatenate(rows), np.flatnonzero(region), sweeps)


def _gained(
    cells: Cells, ranks: Ranks, enough: int, halves: bool, some: Callable[[Wholes], Images],
    settle: Settle,
) -> tuple[Wholes, int]:  # fmt: skip
    """Raises the ranks of cells, all or the halves beside better ones; their inputs, and sweeps."""
    inputs, tried = np.zeros(cells.total, dtype=np.int64), np.zeros(cells.total, dtype=bool)
    found, sweeps = None, 0
    while True:
        fresh = (ranks < enough) & (ranks >= REGION) & ~tried
        if halves:
            fresh &= _beside_better(ranks, cells)
        if not fresh.any():
            return inputs, sweeps
        tried |= fresh
        more = some(np.flatnonzero(fresh))
        found = more if found is None else joined(found, more)
        reached, chosen, count = settle(found, cells, ranks)
        sweeps += count
        better = reached > ranks[found.cells]
        at = found.cells[better]
        ranks[at], inputs[at] = reached[better], chosen[better]
        if not halves or not better.any():
            return inputs, sweeps


def doubled(values: npt.NDArray[Any], cells: Cells) -> npt.NDArray[Any]:
    """What is known of the cells that these are halves of, for each of these."""
    found = values.reshape([n // 2 for n in cells.counts])
    for axis in range(found.ndim):
        found = np.repeat(found, 2, axis=axis)
    return found.reshape(-1)


def sure_of(sure: Callable[[Floats, Floats], Truths], halvings: Halvings) -> Wholes:
    """The smallest cells all over which something is sure, or all over a cell that they are in."""
    found = np.zeros(0, dtype=bool)
    for g in range(halvings.depth + 1):
        grid = halvings.grid(g)
        found = doubled(found, grid) if g else np.zeros(grid.total, dtype=bool)
        found[where(sure, grid, np.flatnonzero(~found))] = True
    return np.flatnonzero(found)


def _beside_better(ranks: Ranks, cells: Cells) -> Truths:
    """Halves of cells that have a better one beside them, or of all where nothing is found."""
    from scipy.ndimage import maximum_filter

    blocks = ranks.reshape([n for count in cells.counts for n in (count // 2, 2)])
    halves = tuple(range(1, blocks.ndim, 2))
    best, worst = blocks.max(axis=halves), blocks.min(axis=halves)
    if best.max() <= REGION:
        return np.ones(cells.total, dtype=bool)
    modes = ["wrap" if periodic else "nearest" for periodic in cells.periodic]
    near = maximum_filter(best, size=3, mode=modes) > np.maximum(worst, REGION)
    return doubled(near, cells)


def _check_memory(cells: Cells, depth: int) -> None:
    """Raises `SimulationError` where what is noted of every cell, and sums of them, do not fit."""
    total = cells.total << depth * len(cells.counts)
    check_memory(
        total * (48 + 16 * 2 ** sum(cells.periodic)), f"{total:,} cells of the smallest size",
        "take fewer cells, or refine less",
    )  # fmt: skip
