"""A sweep over a grid: which nodes are computed, and where all is that a stage of them asks for.

It knows no program: `stage_leaf.py` has what belongs to one. A unit is a
number of nodes, several rows of the last axis or a stretch of one; it is computed, or skipped where
nothing that it depends on has changed since it was computed last. Units that follow one another are
a run, which is computed in one go. A block is what belongs to a place of all axes but the last two.
All arrays have one dimension; n is the number of axes, and `SweepCode.room` has the sizes of rooms:

    taken                       (slice_count,)       as `stencils.py` says
    slices                      (slice_count + 1,)   the places that they begin at, and the end
    counts                      (3,)
    values, base, out, before   (size,)              nodes, the last axis is the fastest
    active, marks               (units,)             flags: computed in this stage, in the next
    own                         (own_count * units,) flags of the stages after the next
    shape, kinds, index         (n,)
    cut                         (4,)                 of `layout`
    leaves, sizes               (4,), (6,)
    u                           (1 + parameters + n,)
    numbers                     (FALLS + 6 * n,)     in the order of `names_of_numbers`
    axes                        (n * axis_pitch,)    the nodes of every axis
    axis                        (nodes,)             those of the last
    bits                        (WORDS,)             one for each node of a run
    wholes                      (SLOPES + 2 * WORDS + 9 * n + 11 + units remembered,)
    reals                       ((n + of_row + outer) * PITCH + ...,)
    held                        ((stretches * along + of_row + ARRAYS + 1) * PITCH + slopes,)
    rows, room, work, table     (rows * PITCH,)      parts of `reals` and `held`

Rows are PITCH apart, and not RUN, since a register that begins within a run may end beyond it.
"""

# ruff: noqa: F403, F405
# mypy: ignore-errors

from __future__ import annotations

from holdfast.execution.level_set.slopes_twice import *

ARRAYS = 5  # of values at nodes, of which a run may have to be copied
WORDS = PITCH // 64 + 2  # of the bits of a run


def nodes_of_last_axis(
    leaf: int, u: Floats, axis: Floats, nodes: int, stretches: int, longest: int,
    results: int, room: Floats, table: Values,
):  # fmt: skip
    """What depends on the last axis alone: of each stretch the rows, of row after row."""
    pitch = (nodes + VECTOR - 1) // VECTOR * VECTOR
    for j in range(pitch):
        room[j] = axis[min(j, nodes - 1)]
    out = room[pitch:]
    call(leaf, address(room, 0), address(u, 0), address(out, 0), pitch, pitch)
    for s in range(stretches):
        for k in range(results):
            for j in range(PITCH):
                place = j % nodes if stretches == 1 else min(s * longest + j, nodes - 1)
                table[(s * results + k) * PITCH + j] = out[k * pitch + place]


def rows_of_run(
    leaf: int, u: Floats, axes: Floats, axis_pitch: int, index: Wholes, n: int, row: int,
    tall: int, rows: Floats, values: Floats,
):  # fmt: skip
    """What depends on the axes of the rows from `row` on; the outer axes are at `index`."""
    room = (tall + VECTOR - 1) // VECTOR * VECTOR
    for i in range(n - 1):
        for k in range(room):
            place = index[i] if i < n - 2 else row + min(k, tall - 1)
            rows[i * PITCH + k] = axes[i * axis_pitch + place]
    call(leaf, address(rows, 0), address(u, 0), address(values, 0), PITCH, room)


def spread(values: Floats, of_row: int, tall: int, wide: int, work: Values):
    """The values of every row at all of its nodes."""
    for h in range(of_row):
        for k in range(tall):
            v = values[h * PITCH + k]
            for j in range(wide):
                work[h * PITCH + k * wide + j] = v


def address_of_run(
    values: Values, size: int, here: int, count: int, room: Values
) -> int:  # fmt: skip
    """Of its nodes; of a copy, where whole registers of them would not stop before the end."""
    if here + count + VECTOR <= size:
        return address(values, here)
    copy(values, here, min(count, size - here), room, 0)
    return address(room, 0)


def any_of(bits: Wholes, first: int, last: int) -> int:
    """Whether one of the bits from first to last is set."""
    for k in range(first >> 6, (last + 63) >> 6):
        low, high = max(first - 64 * k, 0), last - 64 * k
        mask = -1 << low
        if high < 64:
            mask = mask & ((1 << high) - 1)
        if bits[k] & mask != 0:
            return 1
    return 0


def sweep(
    taken: Wholes, slices: Wholes, slice_count: int, thread: int, counts: Floats, wholes: Wholes,
    reals: Floats, held: Values, u: Floats, numbers: Floats, values: Values, base: Values,
    out: Values, before: Values, upper: int, lower: int, size: int, active: Flags, marks: Flags,
    own: Flags, own_count: int, units: int, shape: Wholes, n: int, cut: Wholes, kinds: Wholes,
    leaves: Wholes, sizes: Wholes, axes: Floats, axis_pitch: int,
):  # fmt: skip
    """One stage of a step over the blocks, or units, of the slices that this thread takes.

    counts: units computed, nodes that are not finite, the largest move. wholes, reals, held: room.
    u: time, parameters, largest speeds. numbers: those of a stage. upper, lower: addresses, or 0.
    leaves: addresses; sizes: how many values depend on the last axis, on a row, on outer axes, how
    many nodes a scheme reaches, how many lanes a stage has, whether it asks for plain differences.
    """
    last, nodes = n - 1, shape[n - 1]
    rows_of = shape[n - 2] if n > 1 else 1
    many, groups, stretches, longest = cut[0], cut[1], cut[2], cut[3]
    local = groups * stretches
    along, of_row, outer, ghosts, lanes = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4]
    plain = sizes[5]
    unit_nodes = many * nodes if stretches == 1 else longest
    most = max(1, RUN // unit_nodes)  # units computed together; stretches, of one row
    places = wholes
    changed = places[SLOPES + 4 * n + 8 :]
    odd = changed[WORDS:]
    strides = odd[WORDS:]
    within, index = strides[n:], strides[2 * n :]
    tried = strides[3 * n :]
    remembered = tried[1:]
    tried[0] = 0
    in_rows, of_rows = reals, reals[n * PITCH :]
    of_row_at = stretches * along * PITCH
    arrays = held[of_row_at + of_row * PITCH :]
    rest, moves = arrays[ARRAYS * PITCH :], arrays[ARRAYS * PITCH + VECTOR :]
    of_slopes = arrays[(ARRAYS + 1) * PITCH :]
    for j in range(lanes):
        moves[j] = 0.0
    for i in range(n - 1, -1, -1):  # nodes and units of a place
        strides[i] = strides[i + 1] * shape[i + 1] if i < n - 1 else 1
        within[i] = within[i + 1] * shape[i + 1] if i < n - 3 else local
    begin_slopes(remembered, strides, within, n, plain)
    same = of_rows[(of_row + outer) * PITCH :]
    room = same[outer:]
    nodes_of_last_axis(
        leaves[0], u, axes[last * axis_pitch :], nodes, stretches, longest, along, room, held
    )
    places[REST], places[MOVES] = address(rest, 0), address(moves, 0)
    places[CHANGED], places[ODD] = address(changed, 0), address(odd, 0)
    places[OF_ROW], places[OUTER] = address(held, of_row_at), address(same, 0)
    places[NUMBERS] = address(numbers, 0)
    falls = numbers[FALLS + 2 * n :]
    wrong, computed, of_block = 0, 0, -1
    while True:
        slice_ = next_slice(taken, slice_count, thread, tried)
        if slice_ < 0:
            break
        first, end = slices[slice_], slices[slice_ + 1]
        part_first, parts, first_block, blocks = first, end, 0, 1
        if n > 2:
            part_first, parts = 0, local
            first_block, blocks = first * (within[0] // local), end * (within[0] // local)
        for block in range(first_block, blocks):
            left = block
            for i in range(n - 3, -1, -1):
                index[i] = left % shape[i]
                left = left // shape[i]
            part = part_first
            while part < parts:
                unit = block * local + part
                if active[unit] == 0:
                    part += 1
                    continue
                several, furthest = 0, parts
                if stretches > 1:
                    furthest = min(parts, (part // stretches + 1) * stretches)
                while several < most and part + several < furthest and active[unit + several] != 0:
                    active[unit + several] = 0
                    several += 1
                computed += several
                row, begin = part // stretches * many, part % stretches * longest
                tall, wide = min(several * many, rows_of - row), nodes
                if stretches > 1:
                    tall, wide = 1, min(several * longest, nodes - begin)
                count = tall * wide
                here = (block * rows_of + row) * nodes + begin
                if of_row > 0 or of_block != block:
                    of_block = block
                    rows_of_run(
                        leaves[1], u, axes, axis_pitch, index, n, row, tall, in_rows, of_rows
                    )
                    for k in range(outer):
                        same[k] = of_rows[k * PITCH]
                    spread(of_rows[outer * PITCH :], of_row, tall, wide, held[of_row_at:])
                for i in range(n - 1):
                    slopes_across(
                        leaves[3], values, size, here, i, n, i < n - 2,
                        index[i] if i < n - 2 else row, tall, wide, strides[i], shape[i], kinds[i],
                        ghosts, unit, several, count, remembered, of_slopes, places, plain, falls,
                    )  # fmt: skip
                slopes_along_rows(
                    leaves[3], values, size, here, begin, tall, wide, nodes, kinds[last], ghosts,
                    count, last, n, of_slopes, places, plain, falls,
                )  # fmt: skip
                places[VALUE] = address_of_run(values, size, here, count, arrays)
                places[BASE] = address_of_run(base, size, here, count, arrays[PITCH:])
                places[BEFORE] = address_of_run(before, size, here, count, arrays[2 * PITCH :])
                if lower != 0:
                    bound = values_at(lower)
                    places[LOWER] = address_of_run(bound, size, here, count, arrays[3 * PITCH :])
                if upper != 0:
                    bound = values_at(upper)
                    places[UPPER] = address_of_run(bound, size, here, count, arrays[4 * PITCH :])
                places[OUT] = address(out, here)
                places[ALONG] = address(held, begin // longest * along * PITCH)
                call(leaves[2], address(places, 0), count)
                done = count % lanes
                copy(rest, 0, done, out, here + count - done)
                for i in range(n - 2):
                    remember_slopes(
                        remembered, of_slopes, i, n, unit, several, here, strides[i], count, plain
                    )
                if any_of(odd, 0, count):
                    for j in range(count):
                        wrong += (odd[j >> 6] >> (j & 63)) & 1
                low, high = several, 0
                for k in range(several):
                    if any_of(changed, k * unit_nodes, min((k + 1) * unit_nodes, count)):
                        low, high = min(low, k), k + 1
                        for s in range(own_count):
                            own[s * units + unit + k] = 1
                part += several
                if high > 0:
                    unit, several = unit + low, high - low
                    for i in range(n - 3, -1, -1):
                        mark(marks, unit, several, index[i], shape[i], within[i], kinds[i], ghosts)
                    if stretches == 1 and n > 1:
                        row += low * many
                        tall = min(several * many, rows_of - row)
                        mark_rows(
                            marks, block * local, row, tall, rows_of, many, 1, kinds[n - 2], ghosts
                        )
                    for k in range(several if stretches > 1 or n == 1 else 0):
                        of = (unit + k) % stretches
                        mark(marks, unit + k, 1, of, stretches, 1, kinds[last], ghosts)
                        if n > 1:
                            mark_rows(
                                marks, block * local + of, row, 1, rows_of, 1, stretches,
                                kinds[n - 2], ghosts,
                            )  # fmt: skip
    fastest = moves[0]
    for j in range(lanes):
        fastest = max(fastest, moves[j])
    counts[0] = counts[0] + computed
    counts[1] = counts[1] + wrong
    counts[2] = fastest
