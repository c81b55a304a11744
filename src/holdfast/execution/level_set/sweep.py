"""A sweep over a grid: which nodes are computed, and where all is that a stage of them asks for.

It knows no program: `rate_leaves.py` and `stage_leaf.py` have what belongs to one. A unit is a
number of nodes, several rows of the last axis or a stretch of one; it is computed, or skipped where
nothing that it depends on has changed since it was computed last. Units that follow one another are
a run, which is computed in one go. A block is what belongs to a place of all axes but the last two.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.slopes_twice import *  # noqa: F403

# -- joined from here on

ARRAYS = 5  # of values at nodes, of which a run may have to be copied
WORDS = PITCH // 64 + 2  # of the bits of a run


@called
def nodes_of_last_axis(leaf, u, axis, nodes, stretches, longest, results, table):
    """What depends on the last axis alone: of each stretch the rows, of row after row."""
    room = (nodes + VECTOR - 1) // VECTOR * VECTOR
    w, out = np.zeros(room), np.zeros(results * room + 1)
    for j in range(room):
        w[j] = axis[min(j, nodes - 1)]
    call(leaf, (address(w, 0), address(u, 0), address(out, 0), room, room))
    for s in range(stretches):
        for k in range(results):
            for j in range(PITCH):
                place = j % nodes if stretches == 1 else min(s * longest + j, nodes - 1)
                table[(s * results + k) * PITCH + j] = out[k * room + place]
    w[0] = out[0]  # which last until here


@called
def rows_of_run(leaf, u, axes, index, row, tall, rows, values):
    """What depends on the axes of the rows from `row` on; the outer axes are at `index`."""
    n = len(index)
    room = (tall + VECTOR - 1) // VECTOR * VECTOR
    for i in range(n):
        for k in range(room):
            place = index[i] if i < n - 1 else row + min(k, tall - 1)
            rows[i * PITCH + k] = axes[i, place]
    call(leaf, (address(rows, 0), address(u, 0), address(values, 0), PITCH, room))


@called
def spread(values, outer, of_row, tall, wide, work):
    """The values of every row at all of its nodes."""
    for h in range(of_row):
        for k in range(tall):
            v = values[(outer + h) * PITCH + k]
            to = np.uint64(h * PITCH + k * wide)
            for j in range(np.uint64(wide)):
                work[to + j] = v


@called
def address_of_run(values, here, count, room, to):
    """Of its nodes; of a copy, where whole registers of them would not stop before the end."""
    if here + count + VECTOR <= len(values):
        return address(values, here)
    copy(values, here, min(count, len(values) - here), room, to)
    return address(room, to)


@called
def any_of(bits, first, last):
    """Whether one of the bits from first to last is set."""
    for k in range(first >> 6, (last + 63) >> 6):
        low, high = max(first - 64 * k, 0), last - 64 * k
        mask = np.int64(-1) << low
        if high < 64:
            mask &= (np.int64(1) << high) - 1
        if bits[k] & mask != 0:
            return True
    return False


@entered
def sweep(turn, slices, u, numbers, values, base, out, before, upper, lower, active, marks, own,
          shape, cut, kinds, leaves, sizes, axes, counts):  # fmt: skip
    """One stage of a step over the blocks, or units, that the slices taken in turn end at.

    u: time, parameters, largest speeds. numbers: those of a stage. leaves: addresses; sizes: how
    many values depend on the last axis, on a row, on outer axes, how many nodes a scheme reaches,
    how many lanes a stage has. counts: units computed, nodes that are not finite, the largest move.
    """
    values, base, out, before, upper, lower, active, marks, own, shape, kinds, axes = (
        borrowed(values), borrowed(base), borrowed(out), borrowed(before), borrowed(upper),
        borrowed(lower), borrowed(active), borrowed(marks), borrowed(own), borrowed(shape),
        borrowed(kinds), borrowed(axes),
    )  # fmt: skip
    n = len(shape)
    last = n - 1
    nodes = shape[last]
    rows_of = shape[n - 2] if n > 1 else 1
    many, groups, stretches, longest = cut[0], cut[1], cut[2], cut[3]
    local = groups * stretches
    along, of_row, outer, ghosts, lanes = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4]
    unit_nodes = many * nodes
    most = max(1, RUN // unit_nodes) if stretches == 1 else 1  # units computed together
    # Three memories last until the end; their parts are borrowed.
    strides_at, within_at, bits_at = SLOPES + 2 * n, SLOPES + 3 * n, SLOPES + 4 * n
    whole = np.zeros(bits_at + 2 * WORDS + 8 + n, dtype=np.int64)
    places, strides = borrowed(whole)[:strides_at], borrowed(whole)[strides_at:within_at]
    within, changed = borrowed(whole)[within_at:bits_at], borrowed(whole)[bits_at:]
    odd, at = changed[WORDS:], changed[2 * WORDS : 2 * WORDS + 8]
    index = changed[2 * WORDS + 8 : 2 * WORDS + 8 + max(n - 1, 0)]
    rows_at, same_at = n * PITCH, (n + outer + of_row + 1) * PITCH
    real = np.zeros(same_at + outer + 1)
    in_rows, of_rows, same = borrowed(real), borrowed(real)[rows_at:], borrowed(real)[same_at:]
    row_values, room_at = stretches * along * PITCH, (stretches * along + of_row) * PITCH
    arrays_at = BUFFERS * n * PITCH  # those of axes are before
    held = np.zeros(room_at + arrays_at + (ARRAYS + 2) * PITCH, dtype=values.dtype)
    tables = aligned(borrowed(held))
    room = tables[room_at:]
    rest, moves = room[arrays_at + ARRAYS * PITCH :], room[arrays_at + ARRAYS * PITCH + VECTOR :]
    for i in range(n - 1, -1, -1):  # nodes and units of a place
        strides[i] = strides[i + 1] * shape[i + 1] if i < n - 1 else 1
        within[i] = within[i + 1] * shape[i + 1] if i < n - 3 else local
    of_slopes = shared_slopes(values, shape, strides, within)
    shared = borrowed_slopes(of_slopes)
    nodes_of_last_axis(leaves[0], u, axes[last], nodes, stretches, longest, along, tables)
    places[REST], places[MOVES] = address(rest, 0), address(moves, 0)
    places[CHANGED], places[ODD] = address(changed, 0), address(odd, 0)
    places[OF_ROW], places[OUTER] = address(tables, row_values), address(same, 0)
    places[NUMBERS] = address(numbers, 0)
    wrong, computed, of_block = 0, 0, -1
    while True:
        slice_ = take(turn) % MOST_SLICES
        if slice_ >= len(slices) - 1:
            break
        first, end = slices[slice_], slices[slice_ + 1]
        part_first, parts = (0, local) if n > 2 else (first, end)
        first_block, blocks = 0, 1
        if n > 2:
            first_block, blocks = first * (within[0] // local), end * (within[0] // local)
        for block in range(first_block, blocks):
            rest_of = block
            for i in range(n - 3, -1, -1):
                index[i] = rest_of % shape[i]
                rest_of //= shape[i]
            part = part_first
            while part < parts:
                unit = block * local + part
                if active[unit] == 0:
                    part += 1
                    continue
                several = 0
                while several < most and part + several < parts and active[unit + several] != 0:
                    active[unit + several] = 0
                    several += 1
                computed += several
                row, begin = part // stretches * many, part % stretches * longest
                tall, wide = min(several * many, rows_of - row), min(longest, nodes - begin)
                count = tall * wide
                here = (block * rows_of + row) * nodes + begin
                if of_row > 0 or of_block != block:
                    of_block = block
                    rows_of_run(leaves[1], u, axes, index, row, tall, in_rows, of_rows)
                    for k in range(outer):
                        same[k] = of_rows[k * PITCH]
                    spread(of_rows, outer, of_row, tall, wide, tables[row_values:])
                for i in range(n - 1):
                    slopes_across(
                        leaves[3], values, here, i, i < n - 2, index[i] if i < n - 2 else row,
                        tall, wide, strides[i], shape[i], kinds[i], ghosts, unit, several, count,
                        at, shared, room, places,
                    )  # fmt: skip
                slopes_along_rows(
                    leaves[3], values, here, begin, tall, wide, nodes, kinds[last], ghosts, count,
                    last, at, shared, room, places,
                )  # fmt: skip
                places[VALUE] = address_of_run(values, here, count, room, arrays_at)
                places[BASE] = address_of_run(base, here, count, room, arrays_at + PITCH)
                places[BEFORE] = address_of_run(before, here, count, room, arrays_at + 2 * PITCH)
                if len(lower) > 0:
                    places[LOWER] = address_of_run(lower, here, count, room, arrays_at + 3 * PITCH)
                if len(upper) > 0:
                    places[UPPER] = address_of_run(upper, here, count, room, arrays_at + 4 * PITCH)
                places[OUT] = address(out, here)
                places[ALONG] = address(tables, begin // longest * along * PITCH)
                call(leaves[2], (address(places, 0), count))
                done = count % lanes
                copy(rest, 0, done, out, here + count - done)
                for i in range(n - 2):
                    remember_slopes(
                        shared, i, index[i], shape[i], unit, several, here, strides[i], count
                    )
                if any_of(odd, 0, count):
                    for j in range(count):
                        wrong += (odd[j >> 6] >> (j & 63)) & 1
                low, high = several, 0
                for k in range(several):
                    if any_of(changed, k * unit_nodes, min((k + 1) * unit_nodes, count)):
                        low, high = min(low, k), k + 1
                        for s in range(own.shape[0]):
                            own[s, unit + k] = 1
                part += several
                if high > 0:
                    unit, several, row = unit + low, high - low, row + low * many
                    tall = min(several * many, rows_of - row)
                    of = (part - 1) % stretches
                    mark(marks, unit, several, of, stretches, 1, kinds[last], ghosts)
                    for i in range(n - 3, -1, -1):
                        mark(marks, unit, several, index[i], shape[i], within[i], kinds[i], ghosts)
                    if n > 1:
                        mark_rows(
                            marks, block * local + of, row, tall, rows_of, many, stretches,
                            kinds[n - 2], ghosts,
                        )  # fmt: skip
    fastest = 0.0
    for j in range(lanes):
        fastest = max(fastest, moves[j])
    counts[0] += computed + 0 * (len(whole) + len(real) + len(held) + held_slopes(of_slopes))
    counts[1] += wrong
    counts[2] = fastest
