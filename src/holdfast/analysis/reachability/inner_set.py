"""Inner sets: a set less its error, as estimated from a coarser grid.

No scheme on a grid, of first or higher order, guarantees that a lost state is never called safe:
V is linear between nodes, and if it jumps at the boundary, the zero of the numerical jump may lie
on the wrong side, by more cells the finer the grid is. The error of the set is therefore estimated
in cells, which a jump of V does not disturb, and the set is eroded by as many.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.analysis.reachability.obstacles import largest_change
from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array

if TYPE_CHECKING:
    from holdfast.analysis.reachability.value_function import ValueFunction

MOST_CELLS = 20
"""A set with an error of more cells than this counts as unknown."""

SHARE = 0.95
"""Share of the nodes near the boundary; at a crease of V a single one may be off arbitrarily."""


def with_error_in_cells(found: ValueFunction, coarse: ValueFunction) -> ValueFunction:
    """`found`, on cells of size h, with `error_reach`: the error of its level sets in cells.

    The least whole number k of cells, at least 1, for which at 95 % of the common nodes near the
    boundary

        min V_h over k cells around <= V_2h <= max V_h over k cells around

    The level sets of V_2h near zero are then within k cells of those of V_h. For a scheme
    that converges with order 1 or more the error of V_2h is at least twice that of V_h, and the
    difference of the two at least the error of V_h. 0 means that `MOST_CELLS` are not enough.
    """
    thin = tuple(slice(None, None, 2) for _ in found.grid.axes)
    fine, other = found.values(), coarse.values()
    cell = max(largest_change(fine), largest_change(other))
    near = (np.abs(fine[thin]) <= cell) | (np.abs(other) <= cell)
    near = near if near.any() else np.ones_like(near)  # an empty set has no boundary
    periodic = [a.ends == "periodic" for a in found.grid.axes]
    low = high = fine
    reach = 0
    for cells in range(1, MOST_CELLS + 1):
        low, high = _spread(low, periodic, np.minimum), _spread(high, periodic, np.maximum)
        if float(((low[thin] <= other) & (other <= high[thin]))[near].mean()) >= SHARE:
            reach = cells
            break
    return found.reported(error_reach=reach)


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


def _worn(numbers: Array, periodic: Iterable[bool], cells: int) -> Array:
    for _ in range(cells):
        numbers = _spread(numbers, periodic, np.minimum)
    return numbers


def _spread(numbers: Array, periodic: Iterable[bool], choose: Any) -> Array:
    """The least, or the largest, over every node and its neighbours, including diagonal ones."""
    for i, around in enumerate(periodic):
        rows = np.moveaxis(numbers, i, 0)
        above, below = np.roll(rows, -1, axis=0), np.roll(rows, 1, axis=0)
        if not around:
            above[-1], below[0] = rows[-1], rows[0]
        numbers = np.moveaxis(choose(rows, choose(above, below)), 0, i)
    return numbers
