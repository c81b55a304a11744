"""Slopes by a scheme that has two of every interval between nodes, in cells.

A node takes the slope at the upper end of the interval below and that at the lower end of the
interval above. The slopes of an interval belong to the nodes on both sides of it: along an outer
axis those above a place are kept for the next place.

`own` has for each axis the slopes at the upper and at the lower ends of intervals, then rows of
nodes, then the slopes of places that are kept. `kept` says of each axis where these begin, then
where the units begin that they belong to; the units follow. If `plain` is 1, and not 0, the plain
differences of intervals are next to all slopes, and those for the nodes below. All arrays have one
dimension; n is the number of axes:

    values, source     (size,)      nodes of the grid, the last axis is the fastest
    own                ((2 + 2 * plain) * ENDS * n + GATHERED + places kept,)
    ends               (2 * ENDS,)  slopes at upper ends, from ENDS on at lower ones; then plain
    rows, line         (GATHERED,)  a run of nodes of each of several places; a row of the last axis
    at                 (2 * ghosts + 1,)      where the runs around a place begin
    kept               (2 * n + 2 + units,)   beginnings in `own`; beginnings of units; units
    strides, within    (n,)         nodes and units of a place along each axis
    places             (SLOPES + 4 * n + 8,)  addresses; from SLOPES on two for each axis
    falls              (4 * n,)     as `stencils.py` says

ENDS has a run, the interval before its first node, and what a register takes beyond it, of two
places at once; GATHERED has a run and three nodes on either side of each of its places.
"""

# ruff: noqa: F403, F405
# mypy: ignore-errors

from __future__ import annotations

from holdfast.execution.level_set.stencils import *

ENDS = 2 * RUN + VECTOR  # slopes at the upper ends of intervals; the others follow
GATHERED = 7 * RUN + 2 * VECTOR  # nodes of a run and of three on either side


def begin_slopes(kept: Wholes, strides: Wholes, within: Wholes, n: int, plain: int):
    """No slopes are known yet."""
    kept[0], kept[n + 1] = (2 + 2 * plain) * ENDS * n + GATHERED, 2 * n + 2
    for i in range(n):
        keeps = i < n - 2 and strides[i] <= KEPT
        kept[i + 1] = kept[i] + ((1 + plain) * strides[i] if keeps else 0)
        kept[n + 2 + i] = kept[n + 1 + i] + (within[i] if keeps else 0)
    for k in range(2 * n + 2, kept[2 * n + 1]):
        kept[k] = -1


def reach(
    at: Wholes, first: int, place: int, tall: int, nodes: int, stride: int,
    count: int, kind: int, ghosts: int, end: int,
) -> int:  # fmt: skip
    """The places of the `count` nodes around `tall` places from `place` on, which is at `first`.

    at[k] is that of the node k - ghosts places further. 0 if they are not on the grid, or not in as
    many runs, or if whole registers of them would not stop before `end`: they are gathered then.
    """
    inside = place >= ghosts and place + tall + ghosts <= nodes
    if not inside and (kind == EXTRAPOLATED or tall > 1):
        return 0
    furthest = 0
    for k in range(2 * ghosts + 1):
        there = place + k - ghosts
        run = first + ((there if inside else place_of(there, nodes, kind)) - place) * stride
        at[k] = run
        furthest = max(furthest, run)
    return furthest + count + VECTOR <= end


def gather(
    values: Values, first: int, place: int, tall: int, nodes: int, stride: int,
    wide: int, kind: int, ghosts: int, rows: Values, at: Wholes, falls: Floats, n: int,
):  # fmt: skip
    """The `wide` nodes of each of `tall` places along an axis and those around, in `rows`."""
    for k in range(tall + 2 * ghosts):
        there = place + k - ghosts
        fetch(
            values, first, place, there, nodes, stride, kind, wide, rows, k * wide, falls, n
        )  # fmt: skip
    for k in range(2 * ghosts + 1):
        at[k] = k * wide


def gather_along(
    values: Values, first: int, start: int, nodes: int, wide: int, kind: int,
    ghosts: int, line: Values, falls: Floats, n: int,
):  # fmt: skip
    """line[j]: the nodes from `start` - ghosts on of a row of the last axis that is at `first`."""
    length = wide + 2 * ghosts
    low = min(max(0, ghosts - start), length)
    high = max(min(length, nodes - start + ghosts), low)
    copy(values, first + start - ghosts + low, high - low, line, low)
    for j in range(low):
        line[j] = value_at(values, first, 0, start - ghosts + j, nodes, 1, kind, falls, n)
    for j in range(high, length):
        line[j] = value_at(values, first, 0, start - ghosts + j, nodes, 1, kind, falls, n)


def call_scheme(scheme: int, source: Values, at: Wholes, k: int, ends: Values, count: int):
    """Call the leaf of a scheme: its nodes are in `source` from at[k] on, its results in `ends`.

    A scheme that reads fewer nodes than others ignores the last.
    """
    call(
        scheme, address(source, at[k]), address(source, at[k + 1]), address(source, at[k + 2]),
        address(source, at[k + 3]), address(source, at[k + 4]), address(source, at[k + 5]),
        address(ends, 0), ENDS, count,
    )  # fmt: skip


def is_kept(kept: Wholes, first: int, many: int, unit: int, several: int) -> bool:
    """Whether the slopes below several units were computed with the place before.

    For each unit of a place along the axis it is known of which unit the slopes are kept.
    """
    if many == 0:
        return False
    for k in range(several):  # noqa: SIM110
        if kept[first + (unit + k) % many] != unit + k:
            return False
    return True


def slopes_across(
    scheme: int, values: Values, size: int, here: int, i: int, n: int, outer: int,
    place: int, tall: int, wide: int, stride: int, nodes: int, kind: int,
    ghosts: int, unit: int, several: int, count: int, kept: Wholes, own: Values,
    places: Wholes, plain: int, falls: Floats,
):  # fmt: skip
    """Slopes below and above the nodes of a run along an axis that is not the last."""
    each = (2 + 2 * plain) * ENDS
    ends, rows, at = own[each * i :], own[each * n :], places[SLOPES + 4 * n :]
    differences = places[SLOPES + 2 * n + 2 * i :]
    start, first = 0, kept[n + 1 + i]
    places[SLOPES + 2 * i] = address(ends, 0)
    if plain:
        differences[0] = address(ends, 2 * ENDS)
    if outer:
        tall, wide = 1, count
        if place > 0 and is_kept(kept, first, kept[n + 2 + i] - first, unit, several):
            start = 1
            places[SLOPES + 2 * i] = address(own, kept[i] + here % stride)
            if plain:
                differences[0] = address(own, kept[i] + stride + here % stride)
    places[SLOPES + 2 * i + 1] = address(ends, ENDS + wide)
    if plain:
        differences[1] = address(ends, 2 * ENDS + wide)
    source = values
    if not reach(at, here, place, tall, nodes, stride, count, kind, ghosts, size):
        gather(values, here, place, tall, nodes, stride, wide, kind, ghosts, rows, at, falls[i:], n)
        source = rows
    if tall > 1:  # the slopes above a row are those below the next
        call_scheme(scheme, source, at, 0, ends, count + wide)
        return
    for k in range(start, 2):
        call_scheme(scheme, source, at, k, ends[k * count :], count)


def slopes_along_rows(
    scheme: int, values: Values, size: int, here: int, begin: int, tall: int,
    wide: int, nodes: int, kind: int, ghosts: int, count: int, i: int, n: int,
    own: Values, places: Wholes, plain: int, falls: Floats,
):  # fmt: skip
    """The same along the last axis."""
    each = (2 + 2 * plain) * ENDS
    ends, rows, at = own[each * i :], own[each * n :], places[SLOPES + 4 * n :]
    differences = places[SLOPES + 2 * n + 2 * i :]
    places[SLOPES + 2 * i], places[SLOPES + 2 * i + 1] = address(ends, 0), address(ends, ENDS + 1)
    if plain:
        differences[0], differences[1] = address(ends, 2 * ENDS), address(ends, 3 * ENDS)
    for k in range(8):
        at[k] = k
    for k in range(tall):
        gather_along(
            values, here - begin + k * nodes, begin, nodes, wide, kind, ghosts, rows, falls[i:], n
        )
        last = ends[k * wide + ENDS]  # the slope above the row before
        call_scheme(scheme, rows, at, 0, ends[k * wide :], wide + 1)
        if k > 0:
            ends[k * wide + ENDS] = last
        if plain:
            copy(ends, k * wide + 2 * ENDS + 1, wide, ends, k * wide + 3 * ENDS)


def remember_slopes(
    kept: Wholes, own: Values, i: int, n: int, unit: int, several: int, here: int,
    stride: int, count: int, plain: int,
):  # fmt: skip
    """Keep the slopes above for the next place along an outer axis."""
    first = kept[n + 1 + i]
    many = kept[n + 2 + i] - first
    if many == 0:
        return
    for k in range(several):
        kept[first + (unit + k) % many] = unit + k + many
    ends = (2 + 2 * plain) * ENDS * i + count
    copy(own, ends, count, own, kept[i] + here % stride)
    if plain:
        copy(own, ends + 2 * ENDS, count, own, kept[i] + stride + here % stride)
