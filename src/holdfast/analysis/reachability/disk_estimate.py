"""How long a step of a march from a disk takes, told before it begins.

    from the disk      computing + read / its speed + written / its speed
    in memory          computing

A stage of a few planes of the grid is timed, and a file of some hundred megabytes. Where nothing is
settled every array is read and written once in a step; what the memory holds from step to step is
not read again, so that a grid that fits is hardly slower.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.analysis.reachability.divided_march import MarchPart, layers_of
from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.problem import Posed
from holdfast.errors import OutputError, SlowWarning
from holdfast.execution.level_set.fold import halves
from holdfast.execution.level_set.schemes import schemes
from holdfast.execution.level_set.slab import Part
from holdfast.execution.level_set.sweeping import ANYWHERE, StageOrder, streams
from holdfast.execution.resources import Disk, available_cores, total_memory
from holdfast.maths.games.hamiltonian import Hamiltonian

PROBE = 256 * 2**20
"""Bytes of the file that is written and read."""

TIMED = 2_000_000
"""Nodes that are timed, at most, but for a single plane."""


@dataclass(frozen=True)
class DiskEstimate:
    """read, written: bytes of a step in which nothing is settled;
    reading, writing: bytes/s of the disk; computing: seconds of a step in memory."""

    read: int
    written: int
    reading: float
    writing: float
    computing: float

    @property
    def step(self) -> float:
        """Seconds of a step from the disk."""
        return self.computing + self.read / self.reading + self.written / self.writing

    @property
    def slowdown(self) -> float:
        """How much longer a step takes than in memory."""
        return self.step / self.computing


def check_disk(posed: Posed, h: Hamiltonian, memory: int, answer: int) -> None:
    """Refuse a march that its disk has no room for; say how slow one is that the memory has none
    for (`SlowWarning`). Of one on a cluster its answer is on the disk.

    memory, answer: what they take [bytes].
    """
    folder, divided = Path(posed.marching.on_disk or "."), posed.marching.cluster is not None
    needed = answer if divided else memory
    place = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(place).free
    if needed > free:
        raise OutputError(
            f"{posed.grid.nodes:,} nodes take {needed / 2**30:.3g} GiB, and {folder} has "
            f"{free / 2**30:.3g} GiB left",
            remedy="choose a folder of a larger disk for on_disk, or take fewer nodes",
        )
    if divided:  # it is written when the march is done
        Disk(folder).empty(1, np.uint8)
    total = total_memory()
    if divided or needed <= 0.7 * total:
        return
    estimate = disk_estimate(posed, h, place)
    warnings.warn(
        f"the arrays take {needed / 2**30:.3g} GiB of {folder}, and the memory is "
        f"{total / 2**30:.3g}: where nothing is settled a step takes about {estimate.step:.2g} s, "
        f"{estimate.slowdown:.2g} times as long as in memory (the disk reads "
        f"{estimate.reading / 1e9:.2g} GB/s and writes {estimate.writing / 1e9:.2g})",
        SlowWarning,
        stacklevel=2,
    )


def disk_estimate(posed: Posed, h: Hamiltonian, folder: Path) -> DiskEstimate:
    """Measured by a short march of a few planes, and by a file in the folder."""
    read, written = traffic(posed)
    reading, writing = disk_speed(folder)
    return DiskEstimate(read, written, reading, writing, _computing(posed, h))


def traffic(posed: Posed) -> tuple[int, int]:
    """The bytes that a step reads and writes where nothing is settled and nothing is held.

    Each array once, where the stages follow one another through the planes; otherwise each in
    every stage that has it: what goes in, what the step began with, what came out before. Of a
    symmetric grid it is the half that is computed, with what that reaches.
    """
    stages, grid = posed.method.stages, posed.grid
    bounds = (posed.problem.limit == "free" or posed.varies) * len(posed.problem.regions)
    moving = bounds * any(r.moves for r in posed.problem.regions)
    share, axis = 1.0, None
    if (signs := posed.marching.symmetry) is not None:
        axis = next(i for i, a in enumerate(grid.axes) if signs.get(a.name) == -1)
        share = _share(grid.axes[axis], schemes()[posed.marching.scheme].ghosts)
    if streams(len(grid.axes), stages, axis == 0):
        read, written = max(stages, 2) + bounds, max(stages, 2) + moving
    else:
        read, written = max(3 * stages - 2, 2) + stages * bounds, stages * (1 + moving)
    size = share * grid.nodes * np.dtype(posed.marching.precision).itemsize
    return round(read * size), round(written * size)


def _share(axis: Axis, ghosts: int) -> float:
    """Of the nodes along an axis that is reflected, those that a step reads."""
    _, reached = halves(axis.reflected, ghosts, axis.ends == "periodic")
    return float(reached.mean())


def disk_speed(folder: Path, size: int = PROBE) -> tuple[float, float]:
    """Bytes/s that a disk reads and writes, as a march does, by an array that is not left in the
    memory."""
    block = np.random.default_rng(0).random(2**17)
    count = max(1, size // block.nbytes) * len(block)
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, count * block.itemsize)
            array = np.memmap(file, dtype=block.dtype, mode="r+", shape=(count,))
            began = time.perf_counter()
            for first in range(0, count, len(block)):
                array[first : first + len(block)] = block
            array.flush()
            wrote = time.perf_counter()
            del array  # so that what the memory holds of it can be let go
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            array = np.memmap(file, dtype=block.dtype, mode="r", shape=(count,))
            for first in range(0, count, len(block)):
                array[first : first + len(block)].max()
            read = time.perf_counter()
    except OSError as error:
        raise OutputError(
            f"{folder} cannot be written ({error.strerror})",
            remedy="choose another folder for on_disk",
        ) from None
    return count * 8 / (read - wrote), count * 8 / (wrote - began)


def _computing(posed: Posed, h: Hamiltonian) -> float:
    """Seconds of a step in memory: by the stages of one of a few planes, and of few nodes of them,
    as a plane of a large grid is large. A symmetry halves it."""
    nodes = posed.grid.nodes
    half = 0.5 if posed.marching.symmetry is not None else 1.0
    posed = _with_few_nodes(posed)
    of = layers_of(posed)
    planes = max(2 * of.reach + 1, 2)
    planes = max(planes, min(of.nodes, TIMED * of.nodes // posed.grid.nodes) // of.thick)
    part = Part(of, 0, min(planes, of.count), 0, 0)
    threads = posed.marching.threads or available_cores()
    held = MarchPart(posed, part, stages=1, threads=threads, h=h)
    held.begin(held.facts())
    march, clock = held.steps, posed.clock[0]
    march.speeds[:], total = held.fastest([clock])
    dt = posed.method.cfl * march.method.steps.lengths / total if total > 0 else 1.0
    then = clock if any(r.moves for r in posed.problem.regions) else None
    held.open()
    orders = []
    for s, (weight, _) in enumerate(march.method.steps.stages):
        numbers = march.numbers(dt, weight, ANYWHERE)
        orders.append(StageOrder(s, march.u(0.0), numbers, False, then, s == 0))
    times = []
    for _ in range(3):
        began = time.perf_counter()
        held.carry_out(orders)
        times.append(time.perf_counter() - began)
    held.close()
    return half * min(times) * nodes / len(held.now())


def _with_few_nodes(posed: Posed) -> Posed:
    """Without a symmetry, and with so few nodes between the first and the last axis that as many
    planes as a stage reaches over are `TIMED` nodes, if that can be had."""
    least = 2 * schemes()[posed.marching.scheme].ghosts + 1
    axes = list(posed.grid.axes)
    for i in range(1, len(axes) - 1):
        others = math.prod(a.count for a in axes[1:]) // axes[i].count
        fewer = max(least, TIMED // (least * others))
        axes[i] = replace(axes[i], count=min(axes[i].count, fewer))
    marching = replace(posed.marching, symmetry=None)
    return replace(posed, grid=Grid(tuple(axes)), marching=marching)
