"""What is known of the cell that a state is in: scalar functions.

The closed loop, exported laws and Python run the same text (`codegen/scalar_reader.py`), as they
do that of `interpolate.py`. Cells lie between two of the edges along each axis, both included. The
numbers are the edges of every axis in turn, then the rows that cells refer to, `rows` rows of
`found` - 1 numbers, then how long a cell lasts. An entry is the row of a cell; of one that is not
known it is the row that stands in for it, plus `rows`. Where a cell lasts a finite time its count
stands behind the entries, and the time is that of one. All arrays have one dimension:

    entries           (cells + cells,)    the second half only where a cell lasts a finite time
    place             (axes,)             in the units of the axes
    points            (number * axes,)    one point after the other
    numbers           (edges + rows * (found - 1) + 1,)
    edges             (count + 1,)        of one axis
    shape, periodic   (axes,)             cells along each axis; whether it is periodic
    out               (number * found,)   of each how long its cell lasts, and its row
    whole             (2 * axes,)         of a place the cell below, and that on an edge or -1
"""

from __future__ import annotations

import math

from holdfast.execution.arrays import Floats, Table, Wholes


def cell_along(edges: Floats, count: int, x: float) -> int:
    """The first cell of an axis that a number between its edges is in."""
    below, above = 0, count
    while above - below > 1:
        middle = (below + above) // 2
        if edges[middle] < x:
            below = middle
        else:
            above = middle
    return below


def look_in_cells(
    entries: Table, place: Floats, numbers: Floats, shape: Wholes, periodic: Wholes, axes: int,
    rows: int, found: int, out: Floats, whole: Wholes,
) -> bool:  # fmt: skip
    """Fill `out` with how long the cell of a place lasts and its row; whether it is known.

    A place on an edge is in the cells on both sides, of which one that is known is taken. Beyond
    the axes, and in cells that are not known, it is the row that stands in, which lasts 0. NaN
    where the place is NaN or infinite.
    """
    near, far = whole, whole[axes:]
    edges, total, inside = numbers, 1, True
    for i in range(axes):
        x, count = place[i], shape[i]
        least, most = edges[0], edges[count]
        if not math.isfinite(x):
            for j in range(found):
                out[j] = math.nan
            return False
        if periodic[i] != 0 and not least <= x <= most:
            turn = most - least
            x = min(max(x - turn * math.floor((x - least) / turn), least), most)
        if not least <= x <= most:
            inside = False
            x = min(max(x, least), most)
        k = cell_along(edges, count, x)
        near[i] = k
        far[i] = -1
        if x == edges[k + 1] and k + 1 < count:
            far[i] = k + 1
        elif x == edges[k + 1] and periodic[i] != 0:
            far[i] = 0
        elif x == edges[k] and k == 0 and periodic[i] != 0:
            far[i] = count - 1
        edges = edges[count + 1 :]
        total = total * count
    last = edges[rows * (found - 1)]
    entry, cell = 2 * rows, 0
    for corner in range(1 << axes):
        at, some = 0, True
        for i in range(axes):
            k = near[i]
            if (corner >> i) & 1:
                k = far[i]
            some = some and k >= 0
            at = at * shape[i] + k
        if some and entry >= rows and entries[at] < entry:
            entry = int(entries[at])
            cell = at
    known = inside and entry < rows
    if not known:
        last = 0.0
    elif math.isfinite(last):
        last = last * entries[total + cell]
    row = entry
    if row >= rows:
        row -= rows
    out[0] = last
    for j in range(found - 1):
        out[1 + j] = edges[row * (found - 1) + j]
    return known


def look_in_cells_many(
    number: int, entries: Table, points: Floats, numbers: Floats, shape: Wholes, periodic: Wholes,
    axes: int, rows: int, found: int, out: Floats, whole: Wholes,
) -> None:  # fmt: skip
    """`look_in_cells` at many points; a cell that is not known lasts -1."""
    for k in range(number):
        known = look_in_cells(
            entries, points[k * axes :], numbers, shape, periodic, axes, rows, found,
            out[k * found :], whole,
        )  # fmt: skip
        if not known:
            out[k * found] = -1.0
