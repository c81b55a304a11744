"""Images of cells: to which blocks of cells a held input leads from each cell of a region."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from holdfast.analysis.certificates.cells import Cells, Floats, Truths, Wholes
from holdfast.analysis.certificates.stored_images import Blocks, Store
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.execution.resources import available_cores, check_memory

BLOCK = 1 << 15

TRIED, STEPS, NEARLY = 512, (1, 2, 4, 8, 16), 0.9
"""Pairs of cells and inputs of a trial, and what part of the best is enough."""


@dataclass(frozen=True)
class Images:
    """From cells (rows) by inputs (columns) to blocks of cells.

    first, last: the blocks, shape (cells, inputs, axes). usable: whether the input keeps the
    region on the way, and the block is inside the grid.
    """

    cells: Wholes
    first: npt.NDArray[np.int32]
    last: npt.NDArray[np.int32]
    usable: Truths


def where(
    sure: Callable[[Floats, Floats], Truths], cells: Cells, among: Wholes | None = None
) -> Wholes:
    """Numbers of the cells all over which something is sure, of all or among some."""
    among = np.arange(cells.total) if among is None else among
    found = [among[:0]]
    for begin in range(0, len(among), BLOCK):
        flat = among[begin : begin + BLOCK]
        found.append(flat[sure(*cells.corners(flat))])
    return np.concatenate(found)


def images(
    flow: HeldFlow,
    cells: Cells,
    candidates: Floats,
    of: Wholes,
    tell: Callable[[str, float], None],
    store: Store | None = None,
) -> Images:
    """Of these cells by every input, shape (inputs, ...).

    tell: called with what is computed, the memory that it takes, and the finished fraction. store:
    where they are kept, and blocks of them are found that an earlier run has left.
    """
    axes, most = len(cells.counts), len(candidates)
    shape = (len(of), most, axes)
    size = len(of) * most * (8 * axes + 1)
    what = f"{len(of):,} cells in the region times {most} inputs"
    check_memory(size, what, "take fewer cells or inputs")
    label = f"{what}, {size / 2**20:,.0f} MiB"
    tell(label, 0.0)
    tasks = [(begin, k) for begin in range(0, len(of), BLOCK) for k in range(most)]
    blocks = Blocks(None, shape, len(tasks)) if store is None else store.blocks(
        flow, cells, candidates, of, tasks
    )  # fmt: skip
    first, last, usable = blocks.first, blocks.last, blocks.usable
    corners = cells.corners(of)

    def led(task: tuple[int, int]) -> None:
        begin, k = task
        part = slice(begin, begin + BLOCK)
        low, high = corners[0][part], corners[1][part]
        found = flow.held(low, high, np.tile(candidates[k], (len(low), 1)))
        a, b, stays = cells.touched(found.low, found.high)
        usable[part, k] = found.kept & stays
        fine = usable[part, k][:, None]
        first[part, k], last[part, k] = np.where(fine, a, 0), np.where(fine, b, 0)

    left = np.flatnonzero(~blocks.done).tolist()
    with ThreadPoolExecutor(available_cores()) as pool:
        try:
            found = pool.map(led, [tasks[k] for k in left])
            for done, (k, _) in enumerate(zip(left, found, strict=True), 1):
                blocks.note(k)
                tell(label, (len(tasks) - len(left) + done) / len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        finally:
            blocks.write()
    return Images(of, first, last, usable)


def in_steps(flow: HeldFlow, cells: Cells, candidates: Floats) -> HeldFlow:
    """The flow with holds divided into as many steps as pay, by a trial of some cells.

    What is gained is the mean of one part in so many cells as an input leads to, constraints on the
    way aside: the fewest steps with nearly the most of it are taken.
    """
    inside = where(flow.inside, cells)
    if not len(inside):
        return flow
    chance, trial = np.random.default_rng(0), flow.without_constraints()
    low, high = cells.corners(chance.choice(inside, TRIED))
    if flow.law is None:
        inputs = most = candidates[chance.integers(len(candidates), size=TRIED)]
    else:
        given = flow.law.given(flow.law.initial, low, high)
        low, high, inputs, most = low[given.row], high[given.row], given.low, given.high

    def gained(steps: int) -> float:
        held = trial.in_steps(steps).held(low, high, inputs, most)
        first, last, stays = cells.touched(held.low, held.high)
        blocks = np.where((held.kept & stays)[:, None], last - first + 1, np.inf).prod(axis=1)
        return float((1 / blocks).mean()) if len(blocks) else 0.0

    shares = {steps: gained(steps) for steps in STEPS}
    enough = NEARLY * max(shares.values())
    return flow.in_steps(min(steps for steps, share in shares.items() if share >= enough))


def joined(*several: Images) -> Images:
    """Those of all their cells."""
    size = sum(i.first.nbytes + i.last.nbytes + i.usable.nbytes for i in several)
    what = f"images of {sum(len(i.cells) for i in several):,} cells"
    check_memory(size, what, "take fewer cells or inputs")
    names = [f.name for f in fields(Images)]
    return Images(*(np.concatenate([getattr(i, n) for i in several]) for n in names))
