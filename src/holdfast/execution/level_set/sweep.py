"""A sweep over a grid: slopes, Hamiltonian, dissipation and step of the value at once.

It knows no program: `rate_leaves.py` has what belongs to one. A unit is a number of nodes, several
rows of the last axis or a stretch of one; it is computed, or skipped where nothing that it depends
on has changed since it was computed last. Units that follow one another are a run, which is
computed in one go. A block is what belongs to a place of all axes but the last two.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.level_set.slopes_twice import *  # noqa: F403

# -- joined from here on


@intrinsic
def call_leaf(typing_context, address, w, u, out, at, stride, count):
    """Call the leaf at an address; the results begin at the place `at` of `out`."""

    def generate(context, builder, signature, arguments):
        pointer, whole = ir.IntType(8).as_pointer(), ir.IntType(64)
        function = ir.FunctionType(ir.VoidType(), [pointer] * 3 + [whole] * 2)
        where = builder.inttoptr(arguments[0], function.as_pointer())
        start = [
            make_array(kind)(context, builder, array).data
            for kind, array in zip(signature.args[1:4], arguments[1:4], strict=True)
        ]
        start[2] = builder.gep(start[2], [arguments[4]])
        places = [builder.bitcast(place, pointer) for place in start]
        builder.call(where, [*places, arguments[5], arguments[6]])
        return context.get_dummy_value()

    return types.void(types.int64, w, u, out, types.int64, types.int64, types.int64), generate


@called
def nodes_of_last_axis(leaves, u, axis, nodes, results, table):
    """table[k, j]: what depends on the last axis alone, at the node j of row after row."""
    room = (nodes + VECTOR - 1) // VECTOR * VECTOR
    w, out = np.zeros(room), np.zeros(results * room)
    for j in range(room):
        w[j] = axis[min(j, nodes - 1)]
    call_leaf(leaves[0], w, u, out, 0, room, room)
    for k in range(results):
        for place in range(nodes):
            for j in range(place, table.shape[1], nodes):
                table[k, j] = out[k * room + place]


@called
def rows_of_run(leaves, u, axes, index, row, tall, rows, values):
    """What depends on the axes of the rows from `row` on; the outer axes are at `index`."""
    n = len(index)
    room = (tall + VECTOR - 1) // VECTOR * VECTOR
    for i in range(n):
        for k in range(room):
            place = index[i] if i < n - 1 else row + min(k, tall - 1)
            rows[i * PITCH + k] = axes[i, place]
    call_leaf(leaves[1], rows, u, values, 0, PITCH, room)


@called
def spread(values, outer, of_row, tall, wide, work, first):
    """The values of every row at all of its nodes."""
    for h in range(of_row):
        for k in range(tall):
            v = values[(outer + h) * PITCH + k]
            to = np.uint64((first + h) * PITCH + k * wide)
            for j in range(np.uint64(wide)):
                work[to + j] = v


@called
def advance(
    rate, values, count, here, dt, weight, base, upper, lower, floor, ceiling, lowest_rate,
    highest_rate
):  # fmt: skip
    """One stage of a step of a run of nodes; `rate` becomes the new values.

    NaN passes every bound, so that it is seen.
    """
    room = min(lanes(count), np.uint64(len(values) - here))
    here = np.uint64(here)
    for j in range(room):
        r = rate[j]
        r = r if not r > highest_rate else highest_rate
        r = r if not r < lowest_rate else lowest_rate
        b = base[here + j]
        v = b + weight * ((values[here + j] - b) + dt * r)
        v = v if not v < floor else floor
        rate[j] = v if not v > ceiling else ceiling
    if len(lower) > 0:
        for j in range(room):
            lowest = lower[here + j]
            rate[j] = rate[j] if not rate[j] < lowest else lowest
    if len(upper) > 0:
        for j in range(room):
            highest = upper[here + j]
            rate[j] = rate[j] if not rate[j] > highest else highest
    if len(lower) > 0 or len(upper) > 0:
        for j in range(room):
            v = rate[j]
            v = v if not v < floor else floor
            rate[j] = v if not v > ceiling else ceiling


@entered
def sweep(turn, slices, u, dt, weight, values, base, out, before, upper, lower, floor, ceiling,
          nearest, active, marks, own, shape, cut, steps, kinds, limits, leaves, sizes, axes,
          counts):  # fmt: skip
    """One stage of a step over the blocks, or units, that the slices taken in turn end at.

    u: time, parameters, largest speeds. limits: the lowest and the highest rate, and the side of
    zero of which it is measured how fast the set moves. leaves: addresses; sizes: how many values
    depend on the last axis, on a row, on outer axes, and how many nodes a scheme reaches. counts:
    units computed, nodes that are not finite, the largest move.
    """
    values, base, out, before = (
        borrowed(values), borrowed(base), borrowed(out), borrowed(before)
    )  # fmt: skip
    upper, lower, active, marks = (
        borrowed(upper), borrowed(lower), borrowed(active), borrowed(marks)
    )  # fmt: skip
    own, shape, steps, kinds, leaves, axes = (
        borrowed(own), borrowed(shape), borrowed(steps), borrowed(kinds), borrowed(leaves),
        borrowed(axes),
    )  # fmt: skip
    n = len(shape)
    last = n - 1
    nodes = shape[last]
    rows_of = shape[n - 2] if n > 1 else 1
    many, groups, stretches, longest = cut[0], cut[1], cut[2], cut[3]
    local = groups * stretches
    along, of_row, outer, ghosts = sizes[0], sizes[1], sizes[2], sizes[3]
    mean, gap = along + of_row, along + of_row + n
    rate_at, size = (gap + n) * PITCH, (gap + n + 1) * PITCH
    strides, within = np.ones(n, dtype=np.int64), np.full(n, local)  # nodes, units of a place
    for i in range(n - 2, -1, -1):
        strides[i] = strides[i + 1] * shape[i + 1]
    for i in range(n - 4, -1, -1):
        within[i] = within[i + 1] * shape[i + 1]
    unit_nodes = many * nodes
    most = max(1, RUN // unit_nodes) if stretches == 1 else 1  # units computed together
    half = np.zeros((n, 1))
    for i in range(n):
        half[i, 0] = 0.5 / steps[i]
    kind = values.dtype
    room = (
        strides, within, half, np.zeros(max(n - 1, 0), dtype=np.int64), np.zeros(outer + 1),
        np.zeros((outer + of_row + 1) * PITCH), np.zeros(n * PITCH), np.zeros(8, dtype=np.uint64),
        np.arange(8).astype(np.uint64), np.zeros((along, most * unit_nodes), dtype=kind),
        np.zeros((gap + n + 3) * PITCH, dtype=kind),
        np.zeros((2 * ghosts + 1) * RUN + 2 * VECTOR, dtype=kind),
        np.zeros(RUN + 2 * VECTOR + 2 * ghosts, dtype=kind),
    )  # fmt: skip
    of_slopes = shared_slopes(values, shape, strides, within)
    strides, within, half, index, same = (
        borrowed(room[0]), borrowed(room[1]), borrowed(room[2]), borrowed(room[3]),
        borrowed(room[4]),
    )  # fmt: skip
    of_rows, in_rows, at = borrowed(room[5]), borrowed(room[6]), borrowed(room[7])
    of_line, table, work = borrowed(room[8]), borrowed(room[9]), aligned(borrowed(room[10]))
    rows, line = borrowed(room[11]), borrowed(room[12])
    shared = borrowed_slopes(of_slopes)
    nodes_of_last_axis(leaves, u, axes[last], nodes, along, table)
    wrong, computed, fastest = 0, 0, 0.0
    loaded, of_block = -1, -1
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
            rest = block
            for i in range(n - 3, -1, -1):
                index[i] = rest % shape[i]
                rest //= shape[i]
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
                    rows_of_run(leaves, u, axes, index, row, tall, in_rows, of_rows)
                    for k in range(outer):
                        same[k] = of_rows[k * PITCH]
                    spread(of_rows, outer, of_row, tall, wide, work, along)
                if begin != loaded:
                    loaded = begin
                    for k in range(along):
                        for j in range(min(most * unit_nodes - begin, PITCH)):
                            work[k * PITCH + j] = table[k, begin + j]
                for i in range(n - 1):
                    slopes_across(
                        leaves[3], values, here, i, i < n - 2, index[i] if i < n - 2 else row,
                        tall, wide, nodes if i == n - 2 else strides[i], shape[i], kinds[i],
                        ghosts, unit, several, count, half[i], rows, at, shared, work,
                        (mean + i) * PITCH, (gap + i) * PITCH,
                    )  # fmt: skip
                slopes_along_rows(
                    leaves[3], values, here, begin, tall, wide, nodes, kinds[last], ghosts, count,
                    half[last], line, of_line, at, shared, work,
                    (mean + last) * PITCH, (gap + last) * PITCH,
                )  # fmt: skip
                call_leaf(leaves[2], work, same, work, rate_at, PITCH, count)
                rate = work[rate_at:]
                advance(
                    rate, values, count, here, float(dt), float(weight), base, upper, lower,
                    float(floor), float(ceiling), float(limits[0]), float(limits[1]),
                )  # fmt: skip
                was = before[here:]
                if nearest > 0.0:
                    cell_changes(work, mean * PITCH, gap * PITCH, steps, count, size)
                    move = largest_move(
                        rate, was, work, size, count, float(limits[2]), float(nearest)
                    )
                    fastest = max(fastest, move)
                low, high = several, 0
                for k in range(several):
                    changes, odd = compare(
                        rate, was, min(k * unit_nodes, count), min((k + 1) * unit_nodes, count)
                    )
                    wrong += odd
                    if changes > 0:
                        low, high = min(low, k), k + 1
                        for s in range(own.shape[0]):
                            own[s, unit + k] = 1
                copy(rate, 0, count, out, here)  # which may be the same memory as was
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
    counts[0] += computed + 0 * (len(room) + held_slopes(of_slopes))  # which they last until here
    counts[1] += wrong
    counts[2] = fastest
