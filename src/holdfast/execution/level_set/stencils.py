"""Runs of nodes of a grid: their neighbours along an axis, and what is to be computed again.

This file and the others of a sweep are scalar functions (`codegen/scalar_reader.py`), joined. All
arrays have one dimension; n is the number of axes:

    values          (size,)          nodes of the grid, the last axis is the fastest
    target          (to + count,)
    falls           (4 * n,)         of each axis at its lower, then its upper end; then `lowest` so
    shape           (n,)
    places          (n * pitch,)     for every axis, at which place of it the reflected node is
    chosen          (many_chosen,)   places along an axis
    taken           (slices,)        of every slice, whether a thread has taken it
    slices          (slices + 1,)    the places that slices begin at, and the end
    tried           (1,)             of a thread: how many slices
    counts          (3,)             of a thread; what they are is said where it counts
    marks, flags    (units,)
"""

# ruff: noqa: F821
# mypy: ignore-errors

from __future__ import annotations

EXTRAPOLATED, PERIODIC, LIMITED = range(3)
RUN = 256  # nodes computed together, at most; a multiple of VECTOR
KEPT = 16384  # nodes of a place whose slopes are kept for the next, at most
VECTOR = 16  # nodes that a leaf in single precision computes at a time
PITCH = RUN + VECTOR  # a run, and what more of it a register takes: from a row to the next

# Places of the addresses that a stage asks for, as in `stage_leaf.py`; two for each axis follow.
VALUE, BASE, BEFORE, LOWER, UPPER, OUT, REST = range(7)
CHANGED, ODD, MOVES, ALONG, OF_ROW, OUTER, NUMBERS, SLOPES = range(7, 15)

FALLS = 8  # numbers of a stage before those of axes, as in `stage_leaf.py`

SHARE = 8  # slices of a thread, at most


def next_slice(taken: Wholes, slice_count: int, thread: int, tried: Wholes) -> int:
    """The next slice that no thread has; then -1.

    A thread takes slices that follow one another, the same in every stage, and then what is left of
    the others', the last first. thread: its number. tried: 0 to begin with.
    """
    while tried[0] < slice_count:
        ahead = tried[0] if tried[0] < SHARE else slice_count + SHARE - 1 - tried[0]
        slice_ = (thread * SHARE + ahead) % slice_count
        tried[0] = tried[0] + 1
        if take(taken[slice_:]) == 0:
            return slice_
    return -1


def beyond(edge: Value, inner: Value, distance: Value, fall: Value, lowest: Value) -> Value:
    """The value `distance` nodes beyond an edge: linear, and away from zero so no sign is made.

    An edge on which the value is zero, within rounding, is one of the set, and beyond it is less: a
    grid that ends on a constraint is as good as a wider one. A millionth of a cell is rounding.
    Beyond a lost edge above `lowest` it falls by `fall` from node to node at least, as what a set
    is kept within does: where two constraints meet the value is level within the grid; it would be
    level beyond it, and never fall.
    """
    slope = abs(edge - inner)
    steep = max(slope, min(fall, max(edge - lowest, 0.0)))
    return edge + distance * (slope if edge > 1e-6 * slope else -steep)


def place_of(there: int, nodes: int, kind: int) -> int:
    """The place of an axis that stands for one beyond its ends; itself where none does."""
    if kind == PERIODIC:
        return (there + nodes) % nodes
    return min(max(there, 0), nodes - 1) if kind == LIMITED else there


def fetch(
    values: Values, first: int, place: int, there: int, nodes: int, stride: int,
    kind: int, count: int, target: Values, to: int, falls: Floats, n: int,
):  # fmt: skip
    """The run of `count` nodes at the place `there` of an axis; that at `place` is at `first`.

    falls: `fall` of `beyond` at the lower end, n places further at the upper, then both `lowest`.
    """
    there = place_of(there, nodes, kind)
    if 0 <= there < nodes:
        copy(values, first + (there - place) * stride, count, target, to)
        return
    edge = 0 if there < 0 else nodes - 1
    inner = 1 if there < 0 else nodes - 2
    distance, end = float(abs(there - edge)), 0 if there < 0 else n
    fall, lowest = falls[end], falls[end + 2 * n]
    at_edge, inside = first + (edge - place) * stride, first + (inner - place) * stride
    for j in range(count):
        target[to + j] = beyond(values[at_edge + j], values[inside + j], distance, fall, lowest)


def value_at(
    values: Values, here: int, place: int, there: int, nodes: int, stride: int, kind: int,
    falls: Floats, n: int,
) -> Value:  # fmt: skip
    """The value at the place `there` of an axis, from the node at `place`, which is at `here`."""
    there = place_of(there, nodes, kind)
    if 0 <= there < nodes:
        return values[here + (there - place) * stride]
    edge = 0 if there < 0 else nodes - 1
    inner = 1 if there < 0 else nodes - 2
    distance, end = float(abs(there - edge)), 0 if there < 0 else n
    fall, lowest = falls[end], falls[end + 2 * n]
    at_edge, inside = here + (edge - place) * stride, here + (inner - place) * stride
    return beyond(values[at_edge], values[inside], distance, fall, lowest)


def mark_place(
    marks: Flags, unit: int, several: int, place: int, there: int, nodes: int, stride: int,
    kind: int,
):  # fmt: skip
    """The units at the place `there` of an outer axis; several from `unit` on are at `place`."""
    if kind == PERIODIC:
        there = (there + nodes) % nodes
    if 0 <= there < nodes:
        of = unit + (there - place) * stride
        for j in range(several):
            marks[of + j] = 1


def mark(
    marks: Flags, unit: int, several: int, place: int, nodes: int, stride: int,
    kind: int, ghosts: int,
):  # fmt: skip
    """The units within reach of several along an outer axis have to be computed again."""
    for k in range(-ghosts, ghosts + 1):
        mark_place(marks, unit, several, place, place + k, nodes, stride, kind)


def mark_row(
    marks: Flags, unit: int, there: int, rows_of: int, many: int, stretches: int, kind: int
):
    """The group of rows that a row belongs to; that of the first row is `unit`."""
    if kind == PERIODIC:
        there = (there + rows_of) % rows_of
    if 0 <= there < rows_of:
        marks[unit + there // many * stretches] = 1


def mark_rows(
    marks: Flags, unit: int, row: int, tall: int, rows_of: int, many: int,
    stretches: int, kind: int, ghosts: int,
):  # fmt: skip
    """The same for all rows within reach."""
    for k in range(row - ghosts, row + tall + ghosts):
        mark_row(marks, unit, k, rows_of, many, stretches, kind)


def reflected(place: int, n: int, shape: Wholes, places: Wholes, pitch: int) -> int:
    """The place that one on a grid of `n` axes reflects."""
    rest, other, stride = place, 0, 1
    for i in range(n - 1, -1, -1):
        other += places[i * pitch + rest % shape[i]] * stride
        rest = rest // shape[i]
        stride *= shape[i]
    return other


def mirror(
    taken: Wholes, slices: Wholes, slice_count: int, thread: int, counts: Floats, tried: Wholes,
    values: Values, size: int, shape: Wholes, n: int, places: Wholes, pitch: int, axis: int,
    chosen: Wholes, many_chosen: int,
):  # fmt: skip
    """Values at the chosen places along an axis, from the nodes that they reflect.

    The rows are shared like the places that `slices` end. It counts nothing.
    """
    tried[0] = 0
    nodes = shape[n - 1]
    of_row = axis < n - 1  # else all rows, and the chosen places of each
    inner = 1  # rows within a place along the axis
    for i in range(axis + 1, n - 1):
        inner *= shape[i]
    many = many_chosen if of_row else 1
    there = shape[axis] if of_row else 1
    rows = size // nodes // there * many
    while True:
        part = next_slice(taken, slice_count, thread, tried)
        if part < 0:
            break
        first, last, whole = slices[part], slices[part + 1], slices[slice_count]
        for k in range(rows * first // whole, rows * last // whole):
            row = k // inner // many * there * inner + k % inner
            if of_row:
                row += chosen[k // inner % many] * inner
            other = reflected(row, n - 1, shape, places, pitch)
            for j in range(nodes if of_row else many_chosen):
                place = j if of_row else chosen[j]
                from_ = places[(n - 1) * pitch + place]
                values[row * nodes + place] = values[other * nodes + from_]
