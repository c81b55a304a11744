"""Images of cells: to which blocks of cells a held input leads from each cell of a region.

They are in a file, so that a run that is interrupted goes on where it stopped. A folder has one
file for each set of cells whose images are found in turn: which blocks are done, then the images.
What is noted as done is on the disk before that, and a file is of one problem: a digest in its name
is that of all that decides its numbers.

Cells are halved where it pays: near those that are certified, depth by depth.

A rank says what is known of a cell: NONE, REGION in the region, BEST if nothing more is asked, and
between them the more the better. Ranks of cells of one depth stand for all that they are made of.
"""

from __future__ import annotations

import hashlib
import math
import os
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast._version import __version__
from holdfast.analysis.certificates.cells import Cells, Halvings
from holdfast.errors import CacheWarning, OutputError
from holdfast.execution.arrays import AnyArray, Array, Ranks, Truths, Wholes
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.execution.resources import available_cores, check_memory

NAME = "certificate.images"
EVERY = 1.0
"""Seconds after which what is done is written."""

PAGE = 4096


class Store:
    """The folder of a run that may be interrupted: its images, in the order they are asked for.

    Raises `OutputError` for a folder that there is not.
    """

    def __init__(self, folder: str | Path) -> None:
        if not str(folder) or not Path(folder).is_dir():
            raise OutputError(f"store: '{folder}' is no folder", remedy="make it first")
        self.folder, self._asked = Path(folder), 0

    def blocks(
        self, flow: HeldFlow, cells: Cells, candidates: Array, of: Wholes, tasks: Sequence[object]
    ) -> Blocks:
        """The blocks of these images: those of an earlier run, or none that is done.

        candidates: inputs that are tried, shape (tried, inputs). of: cells, shape (cells,).

        Warns with `CacheWarning` where an earlier run was of another problem or version.
        """
        digest = hashlib.sha256(f"{__version__} {flow.digest} {cells.periodic} {tasks}".encode())
        for part in (*cells.edges, candidates, of):
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        self._asked += 1
        path = self.folder / f"{NAME}.{self._asked}.{digest.hexdigest()[:24]}"
        others = [f for f in self.folder.glob(f"{NAME}.{self._asked}.*") if f != path]
        if others:
            warnings.warn(
                f"what an earlier run left in {self.folder} is of another problem or version: "
                "this one begins anew",
                CacheWarning,
                stacklevel=2,
            )
            _remove(others)
        return Blocks(path, (len(of), len(candidates), len(cells.counts)), len(tasks))


def forget(folder: Path) -> None:
    """Remove what runs of this folder have left, once their certificate is written."""
    _remove(folder.glob(f"{NAME}.*"))


def _remove(files: Iterable[Path]) -> None:
    for file in list(files):
        file.unlink(missing_ok=True)


class Blocks:
    """The arrays of images, in a file or, without a path, in memory; `done` are the tasks that are.

    first, last: shape (cells, inputs, axes); usable: shape (cells, inputs).
    """

    def __init__(self, path: Path | None, shape: tuple[int, int, int], tasks: int) -> None:
        sizes = [tasks, 4 * math.prod(shape), 4 * math.prod(shape), math.prod(shape[:2])]
        begins = np.cumsum([0, *(-(-size // PAGE) * PAGE for size in sizes)]).tolist()
        self._raw: npt.NDArray[np.uint8] | np.memmap[tuple[int], np.dtype[np.uint8]]
        self._raw = np.zeros(begins[-1], dtype=np.uint8) if path is None else _mapped(path, begins)
        parts = [self._raw[a : a + size] for a, size in zip(begins, sizes, strict=False)]
        self.done: Truths = parts[0].view(np.bool_)
        self.first: npt.NDArray[np.int32] = parts[1].view(np.int32).reshape(shape)
        self.last: npt.NDArray[np.int32] = parts[2].view(np.int32).reshape(shape)
        self.usable: Truths = parts[3].view(np.bool_).reshape(shape[:2])
        self._waiting: list[int] = []
        self._written = time.monotonic()

    def note(self, task: int) -> None:
        """A task is done."""
        self._waiting.append(task)
        if time.monotonic() - self._written >= EVERY:
            self.write()

    def write(self) -> None:
        """What was noted, behind its images."""
        if isinstance(self._raw, np.memmap):
            self._raw.flush()
        self.done[self._waiting] = True
        if isinstance(self._raw, np.memmap):
            self._raw.flush()
        self._waiting, self._written = [], time.monotonic()


def _mapped(path: Path, begins: list[int]) -> np.memmap[tuple[int], np.dtype[np.uint8]]:
    size = max(begins[-1], 1)
    try:
        with path.open("ab") as file:
            if file.tell() != size:  # room for all of it, so that no write to it finds none
                file.truncate(0)
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                else:
                    file.write(bytes(size))
        return np.memmap(path, dtype=np.uint8, mode="r+", shape=(size,))
    except OSError as error:
        path.unlink(missing_ok=True)
        raise OutputError(
            f"{path} of {size / 2**20:,.0f} MiB cannot be written ({error.strerror})",
            remedy="choose a folder with room for it",
        ) from None


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
    sure: Callable[[Array, Array], Truths], cells: Cells, among: Wholes | None = None
) -> Wholes:
    """Numbers of the cells all over which something is sure, of all or among some. sure: of the
    lower and upper corners of boxes, shape (boxes, states). among, as the result: shape
    (cells,)."""
    among = np.arange(cells.total) if among is None else among
    blocks = [among[:0]]
    for begin in range(0, len(among), BLOCK):
        flat = among[begin : begin + BLOCK]
        blocks.append(flat[sure(*cells.corners(flat))])
    return np.concatenate(blocks)


def images(
    flow: HeldFlow,
    cells: Cells,
    candidates: Array,
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
        ended = flow.held(low, high, np.tile(candidates[k], (len(low), 1)))
        a, b, stays = cells.touched(ended.low, ended.high)
        usable[part, k] = ended.kept & stays
        fine = usable[part, k][:, None]
        first[part, k], last[part, k] = np.where(fine, a, 0), np.where(fine, b, 0)

    left = np.flatnonzero(~blocks.done).tolist()
    with ThreadPoolExecutor(available_cores()) as pool:
        try:
            ended = pool.map(led, [tasks[k] for k in left])
            for done, (k, _) in enumerate(zip(left, ended, strict=True), 1):
                blocks.note(k)
                tell(label, (len(tasks) - len(left) + done) / len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        finally:
            blocks.write()
    return Images(of, first, last, usable)


def in_steps(flow: HeldFlow, cells: Cells, candidates: Array) -> HeldFlow:
    """The flow with holds divided into as many steps as pay, by a trial of some cells.

    What is gained is the mean of one part in so many cells as an input leads to, constraints on the
    way aside: the fewest steps with nearly the most of it are taken.

    candidates: inputs that are tried, shape (tried, inputs).
    """
    inside = where(flow.inside, cells)
    if not len(inside):
        return flow
    chance, trial = np.random.default_rng(0), flow.without_constraints()
    low, high = cells.corners(chance.choice(inside, TRIED))
    if flow.law is None:
        inputs = most = candidates[chance.integers(len(candidates), size=TRIED)]
    else:
        choices = flow.law.given(flow.law.initial, low, high)
        low, high, inputs, most = low[choices.row], high[choices.row], choices.low, choices.high

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
    candidates: Array,
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

    candidates: inputs that are tried, shape (tried, inputs).
    """
    tell = progress or (lambda what, share: None)
    _check_memory(cells, depth)
    ranks = np.full(cells.total, NONE, dtype=np.int32)
    region = np.zeros(cells.total, dtype=bool)
    by_depth: list[tuple[Wholes, Wholes]] = []
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
        by_depth.append((gained, np.stack([inputs[gained], ranks[gained]], axis=1)))
        sweeps += count
    if target:
        region &= ranks < BEST
    halvings = Halvings(cells, depth)
    rows = [
        np.column_stack([halvings.numbers(of, times), columns])
        for times, (of, columns) in enumerate(by_depth)
    ]
    return Refined(halvings, np.concatenate(rows), np.flatnonzero(region), sweeps)


def _gained(
    cells: Cells, ranks: Ranks, enough: int, halves: bool, some: Callable[[Wholes], Images],
    settle: Settle,
) -> tuple[Wholes, int]:  # fmt: skip
    """Raises the ranks of cells, all or the halves beside better ones; their inputs, and sweeps."""
    inputs, tried = np.zeros(cells.total, dtype=np.int64), np.zeros(cells.total, dtype=bool)
    all_images, sweeps = None, 0
    while True:
        fresh = (ranks < enough) & (ranks >= REGION) & ~tried
        if halves:
            fresh &= _beside_better(ranks, cells)
        if not fresh.any():
            return inputs, sweeps
        tried |= fresh
        more = some(np.flatnonzero(fresh))
        all_images = more if all_images is None else joined(all_images, more)
        reached, chosen, count = settle(all_images, cells, ranks)
        sweeps += count
        better = reached > ranks[all_images.cells]
        at = all_images.cells[better]
        ranks[at], inputs[at] = reached[better], chosen[better]
        if not halves or not better.any():
            return inputs, sweeps


def doubled(values: AnyArray, cells: Cells) -> AnyArray:
    """What is known of the cells that these are halves of, for each of these: shapes (larger
    cells,) and (cells,)."""
    finer = values.reshape([n // 2 for n in cells.counts])
    for axis in range(finer.ndim):
        finer = np.repeat(finer, 2, axis=axis)
    return finer.reshape(-1)


def sure_of(sure: Callable[[Array, Array], Truths], halvings: Halvings) -> Wholes:
    """The smallest cells all over which something is sure, or all over a cell that they are in,
    shape (cells,)."""
    certain = np.zeros(0, dtype=bool)
    for g in range(halvings.depth + 1):
        grid = halvings.grid(g)
        certain = doubled(certain, grid) if g else np.zeros(grid.total, dtype=bool)
        certain[where(sure, grid, np.flatnonzero(~certain))] = True
    return np.flatnonzero(certain)


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
        "take fewer cells, or halve less often",
    )  # fmt: skip
