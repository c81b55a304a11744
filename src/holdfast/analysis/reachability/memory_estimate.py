"""Estimate of a march's memory before it starts."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.analysis.reachability.given import whole
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.options import Marching, marching_of
from holdfast.analysis.reachability.problem import Posed
from holdfast.analysis.reachability.refinement import finer
from holdfast.arguments import checked
from holdfast.execution.level_set.layers import Part
from holdfast.execution.resources import check_memory


def check_trials(runs: int, states: int) -> None:
    """Refuse a validation with more runs, and as many near the edge, than the memory allows."""
    check_memory(8 * 8 * runs * (2 * states + 4), f"the starts of {runs:,} runs", "try fewer")


@checked
def march_memory(
    grid: Grid,
    *,
    capture: bool = False,
    moving: bool = False,
    opposed: bool = False,
    times: int = 0,
    least_times: bool | None = None,
    **options: Any,
) -> int:
    """The bytes of the arrays of a march over `grid` at its peak.

    capture: of a capture basin, with its `least_times` unless arrival_steps = 0. moving: the
    problem depends on time. opposed: a disturbance works against getting to a basin. times: the
    number of requested values. options: those of `Marching`; precision, order (or scheme),
    estimate_error and check_outside matter.

    In units of the value at every node: one for each stage of the Runge-Kutta method (two at
    least), two for obstacles, two for each of the times (one until the end of the march), one for
    the error estimate, two and 8 bytes a node for the least times, four and a byte a node for
    `check_outside`. Of what is marched twice (all but basins that nothing opposes or moves, and
    what is of first order with local-local) what the first gave: one, or one for each of the times,
    and 8 bytes a node for least times. With `refine` the nodes are those of the finer grid; of the
    stages of the method only the blocks that are marched take memory, so that this is then the most
    that it can be. The compiled march and its libraries take some 300 MB more, independent of the
    grid.

    Raises `SimulationError` for invalid options.
    """
    wanted = capture if least_times is None else least_times
    count = whole("times: ", times, 0)
    marching = marching_of(options)
    held = not marching.first_order and (opposed or moving or not capture)
    beside = marching.smeared or held
    return _bytes(grid, marching, capture or moving, count, wanted, beside)


def memory_of(posed: Posed) -> int:
    """The same for a complete problem."""
    return _bytes_of(posed, beside=posed.marched_twice)


def _bytes_of(posed: Posed, *, beside: bool) -> int:
    obstacles = posed.problem.limit == "free" or posed.varies
    times = len(posed.asked) if posed.several else 0
    return _bytes(posed.grid, posed.marching, obstacles, times, bool(posed.arrival_steps), beside)


def part_memory(posed: Posed, part: Part) -> int:
    """The same for the part of a march that is divided, with its halo, and with two times what it
    hands over, which is as much as it is handed. The workers do not hold what a first march gave.
    """
    own = part.own_nodes
    halo = (len(part.nodes) - (own.stop - own.start)) * posed.grid.nodes // part.of.nodes
    edges = 2 * halo * np.dtype(posed.marching.precision).itemsize
    return _bytes_of(posed, beside=False) * len(part.nodes) // part.of.nodes + edges


def check_fits(posed: Posed) -> None:
    """Refuse a march that exceeds the memory of this machine.

    Of one on a cluster, its answer; one on a disk needs memory for a few planes.
    """
    marching, needed, what = posed.marching, memory_of(posed), f"{_nodes(posed):,} nodes"
    if marching.on_disk is not None:
        return
    if marching.cluster is not None:
        needed, what = answer_bytes(posed), f"the answer at {what}"
    remedy = "take fewer nodes"
    if marching.precision == "float64":
        remedy += ', or precision="float32"'
    if marching.cluster is None:
        remedy += ", or march from a disk (on_disk=FOLDER), or on a cluster (cluster=...)"
    else:
        remedy += ", or have it on a disk (on_disk=FOLDER)"
    check_memory(needed, what, remedy)


def _nodes(posed: Posed) -> int:
    """Of the grid of the answer."""
    return finer(posed.grid, posed.marching.refine).nodes


def answer_bytes(posed: Posed) -> int:
    """Of the values that are brought together, with their records, of each march."""
    size = np.dtype(posed.marching.precision).itemsize
    times = 2 * len(posed.asked) if posed.several else 0
    arrivals = (8 + size) * bool(posed.arrival_steps)
    marches = 1 + posed.marched_twice
    return posed.grid.nodes * (size * (1 + times) + arrivals) * marches


def _bytes(
    grid: Grid, marching: Marching, obstacles: bool, times: int, arrivals: bool, beside: bool
) -> int:
    arrays = 1 + max(marching.method.stages - 1, 1) + 2 * obstacles + 2 * arrivals
    if marching.check_outside:
        arrays += 4
    elif marching.estimate_error:
        arrays += 1
    arrays = max(arrays + times, 2 * times + 1) + beside * max(times, 1)
    size = np.dtype(marching.precision).itemsize
    nodes = grid.nodes
    if marching.refine > 1:
        nodes += finer(grid, marching.refine).nodes
    return nodes * (size * arrays + 8 * arrivals * (1 + beside) + marching.check_outside)
