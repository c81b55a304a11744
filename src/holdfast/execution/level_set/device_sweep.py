"""A stage of a step over the nodes of a grid, by blocks of threads of a graphics processor.

The kernels are scalar functions (`codegen/scalar_reader.py`) that follow those of `stencils.py`.
What belongs to one program stands before them: AXES; ACROSS, the last axis but one, or 0; GHOSTS;
FALLS, the place of the first of these numbers; NUMBERS_OF_ROW, how many numbers depend on a row of
the last axis or on outer axes; and MOST_ROWS, the rows of a unit. Functions without a body are its
leaves (`device_sweeping.py`).

A unit is some whole rows of the last axis, or a stretch of one. It is computed where something that
it depends on has changed, by one block of threads, which shares what depends on its rows. All
arrays have one dimension; what a leaf has of one begins at the node or the row that it is asked
for. In `node` the values are numbers, and no arrays:

    values, base, before    (size,)                     nodes, the last axis is the fastest
    lower, upper, out       (size,)
    active, marks           (units,)                    flags: computed in this stage, in the next
    later                   (later_count * units,)      flags of the stages after the next
    grid                    (4 * AXES + 4,)             as `stage_of` says
    counts                  (3,)
    axes                    (AXES * pitch,)             the nodes of every axis
    axis                    (nodes,)                    those of the last
    w                       (AXES,)                     states: of the last axis one, else of a row
    u                       (1 + parameters + AXES,)
    numbers                 (FALLS + 4 * AXES,)         in the order of `names_of_numbers`
    falls                   (4 * AXES,)                 the last of these, from an axis on
    table, along            (along * nodes,)            `nodes` apart: a row for each number
    row, of_row             (MOST_ROWS * (NUMBERS_OF_ROW + 1),)     MOST_ROWS apart, shared
    n                       (2 * GHOSTS + 1,)
    below, above            (AXES,)                     slopes, and plain differences likewise
    plain_below             (AXES,)
    plain_above             (AXES,)
    answer, verdicts        (2,)
    places                  (AXES * pitch,)             of each axis where the reflected node is
    chosen                  (many,)                     places along an axis
"""

# ruff: noqa: F403, F405
# mypy: ignore-errors

from __future__ import annotations

from holdfast.execution.level_set.stencils import *


def along_last_axis(w: Floats, u: Floats, table: Values, pitch: int):
    """What depends on the last axis alone, in rows of the table."""


def of_a_row(w: Floats, u: Floats, row: Floats):
    """What depends on the axes of a row, and on outer axes: numbers that are MOST_ROWS apart."""


def upper_slope(n: Values) -> Value:
    """At the upper end of the middle one of the intervals between 2 GHOSTS nodes.

    Of a scheme that has one slope of every interval it is the node below, and the next one that
    above.
    """


def lower_slope(n: Values) -> Value:
    """The same at the lower end."""


def node(
    numbers: Floats, along: Values, pitch: int, of_row: Floats, below: Values, above: Values,
    plain_below: Values, plain_above: Values, value: Value, base: Value, before: Value,
    lower: Value, upper: Value, answer: Values, verdicts: Wholes,
):  # fmt: skip
    """The new value and how far it has moved; whether it differs, and whether it is not finite."""


def last_axis(axis: Floats, nodes: int, u: Floats, table: Values):
    """What depends on the last axis alone."""
    for k in over_all(0, nodes):
        along_last_axis(axis[k:], u, table[k:], nodes)


def sides(
    values: Values, here: int, place: int, nodes: int, stride: int, kind: int, falls: Floats,
    below: Values, above: Values, plain_below: Values, plain_above: Values,
):  # fmt: skip
    """The slopes on both sides of a node along an axis, and its plain differences, in cells."""
    n = private_values(2 * GHOSTS + 1)
    if place >= GHOSTS and place + GHOSTS < nodes:
        for k in range(2 * GHOSTS + 1):
            n[k] = values[here + (k - GHOSTS) * stride]
    else:
        for k in range(2 * GHOSTS + 1):
            n[k] = value_at(
                values, here, place, place + k - GHOSTS, nodes, stride, kind, falls, AXES
            )
    below[0], above[0] = upper_slope(n), lower_slope(n[1:])
    plain_below[0] = n[GHOSTS] - n[GHOSTS - 1]
    plain_above[0] = n[GHOSTS + 1] - n[GHOSTS]


def stage_of(
    measures: int, grid: Wholes, units: int, axes: Floats, pitch: int, u: Floats, numbers: Floats,
    along: Values, values: Values, base: Values, before: Values, lower: Values, upper: Values,
    out: Values, active: Flags, marks: Flags, later: Flags, later_count: int, counts: Wholes,
):  # fmt: skip
    """grid: of every axis its nodes, the nodes and the units of a place, its kind of ends; then the
    rows of a unit, the groups of rows, the stretches of a row, the nodes of a stretch. counts:
    units computed, nodes that are not finite, the largest move as the bits of a double."""
    of_row = shared_floats(MOST_ROWS * (NUMBERS_OF_ROW + 1))
    changed = shared_wholes(1)
    index = private_wholes(AXES)
    w = private_floats(AXES)
    below = private_values(AXES)
    above = private_values(AXES)
    plain_below = private_values(AXES)
    plain_above = private_values(AXES)
    answer = private_values(2)
    verdicts = private_wholes(2)
    stride, within, kinds, cut = grid[AXES:], grid[2 * AXES :], grid[3 * AXES :], grid[4 * AXES :]
    many, groups, stretches, longest = cut[0], cut[1], cut[2], cut[3]
    nodes, rows, local = grid[AXES - 1], grid[ACROSS] if AXES > 1 else 1, groups * stretches
    for unit in over_blocks(0, units):
        if active[unit] == 0:
            continue
        block, part = unit // local, unit % local
        left = block
        for i in range(AXES - 3, -1, -1):
            index[i] = left % grid[i]
            left = left // grid[i]
        row, begin = part // stretches * many, part % stretches * longest
        tall, wide = min(many, rows - row), min(longest, nodes - begin)
        first = (block * rows + row) * nodes + begin
        wait()
        for _one in over_threads(0, 1):
            changed[0] = 0
            active[unit] = 0
            add(counts, 0, 1)
        for r in over_threads(0, tall):
            for i in range(AXES - 2):
                w[i] = axes[i * pitch + index[i]]
            if AXES > 1:
                w[ACROSS] = axes[ACROSS * pitch + row + r]
            of_a_row(w, u, of_row[r:])
        wait()
        for j in over_threads(0, tall * wide):
            r, k, here = j // wide, begin + j % wide, first + j
            for i in range(AXES):
                place = k
                if i < AXES - 2:
                    place = index[i]
                elif i < AXES - 1:
                    place = row + r
                sides(
                    values, here, place, grid[i], stride[i], kinds[i], numbers[FALLS + i :],
                    below[i:], above[i:], plain_below[i:], plain_above[i:],
                )  # fmt: skip
            node(
                numbers, along[k:], nodes, of_row[r:], below, above, plain_below, plain_above,
                values[here], base[here], before[here], lower[here], upper[here], answer, verdicts,
            )  # fmt: skip
            out[here] = answer[0]
            if verdicts[0] != 0:
                changed[0] = 1
            if verdicts[1] != 0:
                add(counts, 1, 1)
            if measures != 0 and answer[1] > 0.0:
                most(counts, 2, float(answer[1]))
        wait()
        if changed[0] == 0:
            continue
        for s in over_threads(0, later_count):
            later[s * units + unit] = 1
        for m in over_threads(0, AXES * (2 * GHOSTS + 1)):
            i, k = m // (2 * GHOSTS + 1), m % (2 * GHOSTS + 1) - GHOSTS
            if i < AXES - 2:
                mark_place(marks, unit, 1, index[i], index[i] + k, grid[i], within[i], kinds[i])
            elif i == AXES - 1:
                of = part % stretches
                mark_place(marks, unit, 1, of, of + k, stretches, 1, kinds[i])
        if AXES > 1:
            base_unit = block * local + part % stretches
            for k in over_threads(row - GHOSTS, row + tall + GHOSTS):
                mark_row(marks, base_unit, k, rows, many, stretches, kinds[ACROSS])


def stage(
    grid: Wholes, units: int, axes: Floats, pitch: int, u: Floats, numbers: Floats,
    along: Values, values: Values, base: Values, before: Values, lower: Values, upper: Values,
    out: Values, active: Flags, marks: Flags, later: Flags, later_count: int, counts: Wholes,
):  # fmt: skip
    """A stage of a step."""
    stage_of(
        0, grid, units, axes, pitch, u, numbers, along, values, base, before, lower, upper, out,
        active, marks, later, later_count, counts,
    )  # fmt: skip


def measured(
    grid: Wholes, units: int, axes: Floats, pitch: int, u: Floats, numbers: Floats,
    along: Values, values: Values, base: Values, before: Values, lower: Values, upper: Values,
    out: Values, active: Flags, marks: Flags, later: Flags, later_count: int, counts: Wholes,
):  # fmt: skip
    """A stage of a step, and the largest move."""
    stage_of(
        1, grid, units, axes, pitch, u, numbers, along, values, base, before, lower, upper, out,
        active, marks, later, later_count, counts,
    )  # fmt: skip


def reflect(
    grid: Wholes, size: int, places: Wholes, pitch: int, axis: int, chosen: Wholes, many: int,
    values: Values,
):  # fmt: skip
    """Values at the chosen places along an axis, from the nodes that they reflect."""
    inner = grid[AXES + axis]
    for k in over_all(0, size // grid[axis] * many):
        place = chosen[k // inner % many]
        to = (k // inner // many * grid[axis] + place) * inner + k % inner
        values[to] = values[reflected(to, AXES, grid, places, pitch)]
