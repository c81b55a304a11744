"""Error estimates of a value function: of its grid, and of values extrapolated from outside it.

Both march the problem again, on coarser grids and with other ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.inner_set import beside
from holdfast.analysis.reachability.problem import Posed, check_counts
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import HoldfastError, SimulationError
from holdfast.execution.arrays import AnyArray as Array

TOGETHER = 1 << 20
"""Nodes that are looked at together, to save memory."""

LEAST_ORDER = 0.5
"""A lower observed order says that the grids are too coarse for one; it is taken for this."""


def coarser(posed: Posed, count: int) -> list[Posed]:
    """The same problem with half as many cells along every axis, and again half, `count` times.

    Raises `SimulationError` where the cells along an axis are not a multiple of 2 (of 4), so that
    the grids would have no nodes in common, or where a grid is too coarse for the scheme.
    """
    found: list[Posed] = []
    for k in range(1, count + 1):
        grid = Grid(tuple(_thinned(a, 2**k) for a in posed.grid.axes))
        try:
            check_counts(grid, posed.marching.scheme)
        except HoldfastError as error:
            raise SimulationError(
                f"a grid of 1/{2**k} of the cells has {error.cause}",
                expected=error.expected,
                remedy="take more nodes, or leave out estimate_error",
            ) from None
        found.append(replace(posed.aside(f"coarse{k}"), grid=grid))
    return found


def _thinned(axis: Axis, factor: int) -> Axis:
    last = axis.ends != "periodic"
    cells = axis.count - last
    if cells % factor:
        nodes = cells // factor * factor + last
        raise SimulationError(
            f"{cells} cells along '{axis.name}'",
            expected=f"a multiple of {factor}, for an estimate of the error",
            remedy=f"take {nodes} or {nodes + factor} nodes",
        )
    return replace(axis, count=cells // factor + last)


def with_error(found: ValueFunction, coarse: Sequence[ValueFunction]) -> ValueFunction:
    """`found`, on cells of size h, with an estimate of its error from those of 2 h (and 4 h).

    With a scheme of order p the error of V_h is (V_h - V_2h) / (2^p - 1), to first order (L. F.
    Richardson, 1911). The boundaries of the sets have corners, where every scheme falls back: p is
    taken for 1, so that the error is the whole difference, or with a third grid it is observed,

        p = log2( |V_2h - V_4h| / |V_h - V_2h| ),   root mean squares near the boundary

    Near the boundary are the common nodes beside it, those with a neighbour in which V_h or V_2h
    has another sign; where there are none, all. Attributes:

    error_order         p: 1, or as observed; one below 0.5 is taken for 0.5
    error_largest       largest |V_h - V_2h| / (2^p - 1) near the boundary, in the value's unit
    error_rms           its root mean square
    error_cells         how far off the boundary lies, in cells: the error over the change of V
                        from cell to cell; 95 % of the nodes near the boundary are below. Where V
                        jumps, the distance of the boundaries (`inner_set`)
    volume_coarse       the volume on 2 h, to be compared with `volume`
    """
    thin = tuple(slice(None, None, 2) for _ in found.grid.axes)
    fine = found.values()
    apart = fine[thin] - coarse[0].values()
    near = _near(fine[thin], coarse[0])
    order = 1.0
    if len(coarse) > 1:
        further = coarse[0].values()[thin] - coarse[1].values()
        both = _near(coarse[0].values()[thin], coarse[1])
        small, large = _rms(apart[thin][both]), _rms(further[both])
        if small > 0 and large > 0:
            order = max(math.log2(large / small), LEAST_ORDER)
    error = np.abs(apart[near]) / (2.0**order - 1.0)
    slopes = np.zeros(apart.shape)
    for i in range(fine.ndim):  # of the rows with common nodes, to save memory
        rows = np.moveaxis(fine, i, 0)[(slice(None), *thin[1:])]
        slopes += np.moveaxis(_steeper(rows)[::2] ** 2, 0, i)
    with np.errstate(divide="ignore", invalid="ignore"):
        cells = np.where(error > 0, error / np.sqrt(slopes[near]), 0.0)
    return found.reported(
        error_order=order,
        error_largest=float(error.max()),
        error_rms=_rms(error),
        error_cells=float(np.quantile(cells, 0.95, method="higher")),
        volume_coarse=coarse[0].volume(),
    )


def _near(fine: Array, coarse: ValueFunction) -> Array:
    periodic = [a.ends == "periodic" for a in coarse.grid.axes]
    near = beside(fine, periodic) | beside(coarse.values(), periodic)
    return near if near.any() else np.ones_like(near)


def _steeper(rows: Array) -> Array:
    """The larger of the changes to both neighbours along the first axis."""
    changes = np.abs(np.diff(rows, axis=0))
    return np.maximum(
        np.concatenate([changes, changes[-1:]]), np.concatenate([changes[:1], changes])
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def with_outside(
    found: ValueFunction, posed: Posed, march: Callable[[Posed], ValueFunction]
) -> ValueFunction:
    """`found`, with the nodes whose side depends on extrapolation beyond the grid.

    There the value is continued, which is a guess. So the problem is solved twice more, as if
    whoever leaves the grid had lost, and as if they had won:

        lost    the set is what needs nothing from outside:    V <= distance to the ends
        won     what is not in the set, is not in any case:    V >= -distance to the ends

    A node in the set both times is in it, and one in neither is not, whatever is outside (but for
    the error of the scheme, and half a cell at the ends themselves). This asks about the answer
    itself, where a look at which way the characteristics cross the ends would ask about the ends
    only: what enters there may matter for none of the nodes, or for all.

    `outside` is 0 at the nodes whose side does not depend on it, 1 at those that are in the set by
    what is outside, -1 at those that are not in it, but might be if it were all won beyond.
    Attributes: nodes_from_outside and nodes_kept_outside count the two, share_from_outside is
    the part of the set's nodes.
    """
    values = found.values().ravel()
    side = np.zeros(len(values), np.int8)
    parts = [slice(k, k + TOGETHER) for k in range(0, len(values), TOGETHER)]
    for what, within, mark in (("lost", True, 1), ("won", False, -1)):
        other = march(replace(posed.aside(what), beyond=what)).values().ravel()
        for k in parts:
            side[k][((values[k] > 0) == within) & ((other[k] > 0) != within)] = mark
    inside = sum(int((values[k] > 0).sum()) for k in parts)
    gained, missed = (sum(int((side[k] == m).sum()) for k in parts) for m in (1, -1))
    text = "1 in the set by what is outside the grid, -1 not in it by what is outside, 0 sure"
    names = [a.name for a in found.grid.axes]
    marks = side.reshape(found.grid.shape)
    dataset = found.dataset.assign(outside=(names, marks, {"units": "1", "long_name": text}))
    return replace(found, dataset=dataset).reported(
        nodes_from_outside=gained,
        share_from_outside=gained / max(inside, 1),
        nodes_kept_outside=missed,
    )
