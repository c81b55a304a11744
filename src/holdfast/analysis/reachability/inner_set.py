"""Inner sets: a set less its error, as estimated from a coarser grid.

No scheme on a grid, of first or higher order, guarantees that a lost state is never called safe:
V is linear between nodes, and if it jumps at the boundary, the zero of the numerical jump may lie
on the wrong side, by more cells the finer the grid is. The error of the set is therefore estimated
in cells, from the boundaries alone, and the set is eroded by as many.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.obstacles import largest_change
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array

if TYPE_CHECKING:
    from holdfast.analysis.reachability.value_function import ValueFunction

MOST_CELLS = 20
"""A set with an error of more cells than this counts as unknown."""

MOST = 0.95
"""Part of the nodes beside the boundary; at a crease of V a single one may be off arbitrarily."""

STEEP, SHARE = 0.6, 0.05
"""V jumps where its change across the boundary, on cells of half the size, is more than this part
of what it was (half of it where V is smooth, all of it where it jumps), on this share of it."""

STEEPER = 4.0
"""V jumps where it changes over a cell by so many times the largest change of its start."""

ORDERS = {"upwind": 1, "eno2": 2, "eno3": 3, "weno5": 5}
"""Orders of the schemes where V is smooth."""

Truths = npt.NDArray[np.bool_]


def with_error_in_cells(found: ValueFunction, coarse: ValueFunction) -> ValueFunction:
    """`found`, on cells of size h, with the error of its boundary, from the set on cells of 2 h.

    The distance of the two boundaries is, in cells,

        d = max | r_h - r_2h |   over 95 % of the nodes beside either boundary

    (the nodes that have a neighbour on the other side of it), with r the distance of a node to the
    boundary, above 0 inside: the largest box around it (as many cells along every axis) that does
    not reach the boundary; V is linear between nodes. Where V is continuous at the boundary, a
    scheme that converges with order 1 or more has an error of at most d. A scheme of order p smears
    a jump over h^q, with q = p / (p + 1) (A. Harten, J. Comput. Phys. 83, 1989, for contact
    discontinuities): there the error is d / (2^q - 1), and up to one cell more, since V is linear
    across the jump.

    jumps: whether V jumps on a part of the boundary. error_reach: the error in whole cells, at
    least 1, by which `inner` erodes the set; 0 says that it is not known: `MOST_CELLS` are not
    enough.
    boundary_error: the same along every axis, in its unit. error_cells is `error_reach` where V
    jumps: there the difference of two values says nothing about places.
    """
    periodic = [a.ends == "periodic" for a in found.grid.axes]
    fine, rough = found.values(), between(coarse.values(), periodic)
    jumps = _jumps(fine, coarse.values(), periodic)
    apart = _distance(fine, rough, periodic)
    if jumps:
        order = ORDERS[found.report.scheme]
        apart = apart / (2.0 ** (order / (order + 1)) - 1.0) + 1.0
    reach = max(1, math.ceil(apart)) if apart <= MOST_CELLS else 0
    lengths = {a.name: reach * a.step for a in found.grid.axes} if reach else {}
    if jumps:
        found = found.reported(error_cells=float(reach) if reach else None)
    return found.reported(error_reach=reach, jumps=jumps, boundary_error=lengths)


def _distance(values: Array, other: Array, periodic: Sequence[bool]) -> float:
    """Of the boundaries of two sets, in cells; infinite where it is more than `MOST_CELLS`."""
    near = beside(values, periodic) | beside(other, periodic)
    apart = np.abs(_depths(values, periodic, near) - _depths(other, periodic, near))
    if not len(apart):
        return 0.0
    return float(np.quantile(np.nan_to_num(apart, nan=math.inf), MOST, method="higher"))


def _depths(values: Array, periodic: Sequence[bool], near: Truths) -> Array:
    """How many cells these nodes are inside, below 0 outside; NaN beyond `MOST_CELLS`."""
    found = np.full(int(near.sum()), np.nan)
    low = high = values
    for cells in range(MOST_CELLS + 1):
        lower, higher = _spread(low, periodic, np.minimum), _spread(high, periodic, np.maximum)
        for side, inner, outer in ((1.0, low, lower), (-1.0, high, higher)):
            a, b = inner[near], outer[near]
            crossed = np.isnan(found) & ((a > 0) != (b > 0))
            found[crossed] = side * (cells + a[crossed] / (a[crossed] - b[crossed]))
        if not np.isnan(found).any():
            break
        low, high = lower, higher
    return found


def between(rough: Array, periodic: Sequence[bool]) -> Array:
    """Values on a grid at the nodes of one with half the cells, linear between its nodes."""
    for i, around in enumerate(periodic):
        rows = np.moveaxis(rough, i, 0)
        after = np.roll(rows, -1, axis=0) if around else rows[1:]
        found = np.empty((len(rows) + len(after), *rows.shape[1:]), dtype=rows.dtype)
        found[::2], found[1::2] = rows, (rows[: len(after)] + after) / 2
        rough = np.moveaxis(found, 0, i)
    return rough


def beside(values: Array, periodic: Sequence[bool]) -> Truths:
    """The nodes that have one of the other side among themselves and their neighbours."""
    inside = values > 0
    other: Truths = _spread(inside, periodic, np.minimum) != _spread(inside, periodic, np.maximum)
    return other


def _jumps(fine: Array, rough: Array, periodic: Sequence[bool]) -> bool:
    """Whether V jumps on a part of the boundary.

    Looked at are the edges of the coarse grid that the boundary crosses, and the steeper of the two
    that each is made of on the fine one.
    """
    steep = crossed = 0
    thin = tuple(slice(None, None, 2) for _ in periodic)
    for i, around in enumerate(periodic):
        rows = np.moveaxis(fine[(*thin[:i], slice(None), *thin[i + 1 :])], i, 0)
        ends = np.moveaxis(rough, i, 0)
        if around:
            rows, ends = np.concatenate([rows, rows[:1]]), np.concatenate([ends, ends[:1]])
        changes = np.abs(np.diff(rows, axis=0))
        steeper = np.maximum(changes[::2], changes[1::2])
        whole = np.abs(np.diff(ends, axis=0))
        across = (ends[1:] > 0) != (ends[:-1] > 0)
        steep += int((steeper > STEEP * whole)[across].sum())
        crossed += int(across.sum())
    return steep > SHARE * crossed


def steeper_than_its_start(value: ValueFunction) -> bool:
    """Whether V jumps, as one grid shows it: it changes over a cell by far more than its start."""
    return largest_change(value.values()) > STEEPER * value.report.cell > 0


def inner(value: ValueFunction) -> ValueFunction:
    """The value function of the set of `value`, eroded by `error_reach` cells on all sides."""
    cells = value.report.error_reach
    if cells is None:
        raise SimulationError(
            "an inner set of a value function without an estimate of its error",
            remedy="compute it with estimate_error=True",
        )
    if not cells:
        raise SimulationError(
            f"the estimated error of the set exceeds {MOST_CELLS} cells",
            remedy="take a finer grid",
        )
    data = value.dataset["value"]
    periodic = [a.ends == "periodic" for a in value.grid.axes]
    numbers = data.values
    if "time" in data.dims:
        worn = np.stack([_worn(one, periodic, cells) for one in numbers])
    else:
        worn = _worn(numbers, periodic, cells)
    last = worn[-1] if "time" in data.dims else worn
    dataset = value.dataset.assign(value=data.copy(data=worn))
    dataset = dataset.drop_vars([n for n in ("arrival", "outside") if n in dataset])
    worn_value = replace(value, dataset=dataset)
    return worn_value.reported(
        inner_cells=cells,
        empty=not float(last.max()) > 0,
        promise_outcome=None,
        promise_conclusion=None,
        promise_share=None,
    )


def _worn(numbers: Array, periodic: Sequence[bool], cells: int) -> Array:
    for _ in range(cells):
        numbers = _spread(numbers, periodic, np.minimum)
    return numbers


def _spread(numbers: Array, periodic: Sequence[bool], choose: Any) -> Array:
    """The least, or the largest, over every node and its neighbours, including diagonal ones."""
    for i, around in enumerate(periodic):
        rows = np.moveaxis(numbers, i, 0)
        above, below = np.roll(rows, -1, axis=0), np.roll(rows, 1, axis=0)
        if not around:
            above[-1], below[0] = rows[-1], rows[0]
        numbers = np.moveaxis(choose(rows, choose(above, below)), 0, i)
    return numbers
