"""Runs of nodes of a grid: their neighbours along an axis, what changed, what is to be computed.

`at[k]` is the place of the node k - ghosts places along an axis from the first of a run: in the
value itself, or where it has to be continued beyond an end of the axis, in a copy.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on

EXTRAPOLATED, PERIODIC, LIMITED = 0, 1, 2
RUN = 256  # nodes computed together, at most; a multiple of VECTOR
KEPT = 16384  # nodes of a place whose slopes are kept for the next, at most
VECTOR = 16  # nodes that a leaf in single precision computes at a time
PITCH = RUN + VECTOR  # a run, and what more of it a register takes

FUSED = {"contract"}  # multiplications and additions: the inner loops are made of them

swept = within(forceinline=True, fastmath=FUSED)
called = within(fastmath=FUSED)
counting = within(fastmath=FUSED | {"reassoc"})  # whole numbers: their sum has no order
ranking = within(fastmath=FUSED | {"nnan", "nsz", "reassoc"})  # a maximum has no order either


def entered(function):
    """Machine code that Python may call, for threads that sweep."""
    return kept(njit(**OPTIONS, fastmath=FUSED)(function))


@intrinsic
def call_scheme(typing_context, address, source, at, k, half, out, to, stride, count):
    """Call the leaf of a scheme: its nodes are in `source` from at[k] on, its results in `out`.

    A scheme that reads fewer nodes than others ignores the last.
    """

    def generate(context, builder, signature, arguments):
        pointer, whole = ir.IntType(8).as_pointer(), ir.IntType(64)
        function = ir.FunctionType(ir.VoidType(), [pointer] * 8 + [whole] * 2)
        where = builder.inttoptr(arguments[0], function.as_pointer())
        data = {
            i: make_array(signature.args[i])(context, builder, arguments[i]).data
            for i in (1, 2, 4, 5)
        }
        given = []
        for node in range(6):
            place = builder.add(arguments[3], ir.Constant(whole, node))
            start = builder.load(builder.gep(data[2], [place]))
            given.append(builder.bitcast(builder.gep(data[1], [start]), pointer))
        given.append(builder.bitcast(data[4], pointer))
        given.append(builder.bitcast(builder.gep(data[5], [arguments[6]]), pointer))
        builder.call(where, [*given, *arguments[7:9]])
        return context.get_dummy_value()

    whole = types.int64
    return types.void(whole, source, at, whole, half, out, whole, whole, whole), generate


@swept
def beyond(edge, inner, distance):
    """The value `distance` nodes beyond an edge: linear, and away from zero so no sign is made."""
    slope = abs(edge - inner)
    return edge + distance * (slope if edge >= 0.0 else -slope)


@swept
def place_of(there, nodes, kind):
    """The place of an axis that stands for one beyond its ends; itself where none does."""
    if kind == PERIODIC:
        return (there + nodes) % nodes
    return min(max(there, 0), nodes - 1) if kind == LIMITED else there


@swept
def reach(at, first, place, tall, nodes, stride, count, kind, ghosts, end):
    """The places of the `count` nodes around `tall` places from `place` on, which is at `first`.

    False if they are not on the grid, or not in as many runs, or if whole registers of them would
    not stop before `end`: they are gathered then.
    """
    inside = place >= ghosts and place + tall + ghosts <= nodes
    if not inside and (kind == EXTRAPOLATED or tall > 1):
        return False
    furthest = 0
    for k in range(2 * ghosts + 1):
        there = place + k - ghosts
        run = first + ((there if inside else place_of(there, nodes, kind)) - place) * stride
        at[k] = run
        furthest = max(furthest, run)
    return furthest + count + VECTOR <= end


@swept
def copy(values, first, count, target, to):
    """A run of values; places without a sign, so that vector instructions do it."""
    first, to = np.uint64(first), np.uint64(to)
    for j in range(np.uint64(count)):
        target[to + j] = values[first + j]


@swept
def fetch(values, first, place, there, nodes, stride, kind, count, target, to):
    """The run of `count` nodes at the place `there` of an axis; that at `place` is at `first`."""
    there = place_of(there, nodes, kind)
    if 0 <= there < nodes:
        copy(values, first + (there - place) * stride, count, target, to)
        return
    edge = 0 if there < 0 else nodes - 1
    inner = 1 if there < 0 else nodes - 2
    distance = float(abs(there - edge))
    at_edge = np.uint64(first + (edge - place) * stride)
    inside = np.uint64(first + (inner - place) * stride)
    to = np.uint64(to)
    for j in range(np.uint64(count)):
        target[to + j] = beyond(values[at_edge + j], values[inside + j], distance)


@called
def gather(values, first, place, tall, nodes, stride, wide, kind, ghosts, rows, at):
    """The `wide` nodes of each of `tall` places along an axis and those around, one after another.

    at[k]: where in `rows` the nodes k - ghosts places from those at `first` are.
    """
    for k in range(tall + 2 * ghosts):
        fetch(values, first, place, place + k - ghosts, nodes, stride, kind, wide, rows, k * wide)
    for k in range(2 * ghosts + 1):
        at[k] = k * wide


@called
def gather_along(values, first, start, nodes, wide, kind, ghosts, line):
    """line[j]: the nodes from `start` - ghosts on of a row of the last axis that is at `first`."""
    length = wide + 2 * ghosts
    low = min(max(0, ghosts - start), length)
    high = max(min(length, nodes - start + ghosts), low)
    copy(values, first + start - ghosts + low, high - low, line, low)
    for j in range(low):
        line[j] = ghost(values, first, start - ghosts + j, nodes, kind)
    for j in range(high, length):
        line[j] = ghost(values, first, start - ghosts + j, nodes, kind)


@swept
def ghost(values, first, there, nodes, kind):
    """The value at a place beyond the ends of a row of the last axis that is at `first`."""
    place = place_of(there, nodes, kind)
    if 0 <= place < nodes:
        return values[first + place]
    edge, inner = (0, 1) if there < 0 else (nodes - 1, nodes - 2)
    distance = float(abs(there - edge))
    return beyond(values[first + edge], values[first + inner], distance)


@intrinsic
def borrowed(typing_context, array):
    """The same array without a count of its references, each of which costs two atomic operations
    in every call; another name has to hold it."""

    def generate(context, builder, signature, arguments):
        found = make_array(signature.return_type)(context, builder, arguments[0])
        found.meminfo = context.get_constant_null(types.voidptr)
        found.parent = context.get_constant_null(types.pyobject)
        return found._getvalue()

    return array(array), generate


@swept
def aligned(numbers):
    """The array without the few numbers before the first line of the processor's cache."""
    return numbers[-(numbers.ctypes.data // numbers.itemsize) % (64 // numbers.itemsize) :]


@swept
def lanes(count):
    """The number to compute so that vector instructions leave no rest; some are not used."""
    return np.uint64((count + VECTOR - 1) & ~(VECTOR - 1))


@counting
def compare(new, was, first, last):
    """Of the nodes from first to last: how many changed, and how many are not finite."""
    changes, odd = 0.0, 0.0
    for j in range(np.uint64(first), np.uint64(last)):
        v, w = new[j], was[j]
        changes += 1.0 if v != w else 0.0
        odd += 0.0 if abs(v) < 1e300 else 1.0
    return int(changes), int(odd)


@swept
def cell_changes(work, means, gaps, steps, count, size):
    """work[size + j]: how much the value changes from a node to the next, on its flatter side.

    The largest along the axes. Of the slopes mean - gap and mean + gap on either side the smaller
    is ||mean| - |gap||.
    """
    size = np.uint64(size)
    for i in range(len(steps)):
        mean, gap, step = np.uint64(means + i * PITCH), np.uint64(gaps + i * PITCH), steps[i]
        for j in range(lanes(count)):
            change = float(step) * abs(abs(work[mean + j]) - abs(work[gap + j]))
            so_far = work[size + j] if i > 0 else 0.0
            work[size + j] = change if change > so_far else so_far


@ranking
def largest_move(new, was, work, size, count, side, nearest):
    """The largest share of a cell, or of its distance from zero if that is more, that the value of
    a node on that side of zero has moved."""
    largest = 0.0
    size = np.uint64(size)
    for j in range(np.uint64(count)):
        w, cell = side * was[j], work[size + j]
        near = w if w > cell else cell
        near = near if near > nearest else nearest
        move = abs(new[j] - was[j]) / near if w > 0.0 else 0.0
        largest = move if move > largest else largest
    return largest


@called
def mark(marks, unit, several, place, nodes, stride, kind, ghosts):
    """The units within reach of several along an outer axis have to be computed again."""
    for k in range(-ghosts, ghosts + 1):
        there = place + k
        if kind == PERIODIC:
            there = (there + nodes) % nodes
        if 0 <= there < nodes:
            of = np.uint64(unit + (there - place) * stride)
            for j in range(np.uint64(several)):
                marks[of + j] = 1


@called
def mark_rows(marks, unit, row, tall, rows_of, many, stretches, kind, ghosts):
    """The same for the groups of rows that those within reach belong to."""
    last = -1  # marked already; and so the loop is not made of vectors, which it is too short for
    for there in range(row - ghosts, row + tall + ghosts):
        if kind == PERIODIC:
            there = (there + rows_of) % rows_of
        if 0 <= there < rows_of and there // many != last:
            last = there // many
            marks[np.uint64(unit + last * stretches)] = 1


@entered
def mirror(turn, slices, values, shape, places, axis, chosen, counts):
    """Values at the chosen places along an axis, from the nodes that they reflect.

    The rows are shared like the places that `slices` end.
    """
    n = len(shape)
    nodes = shape[n - 1]
    of_row = axis < n - 1  # else all rows, and the chosen places of each
    inner = 1  # rows within a place along the axis
    for i in range(axis + 1, n - 1):
        inner *= shape[i]
    many = len(chosen) if of_row else 1
    there = shape[axis] if of_row else 1
    rows = len(values) // nodes // there * many
    while True:
        part = take(turn) % MOST_SLICES
        if part >= len(slices) - 1:
            break
        first, last, whole = slices[part], slices[part + 1], slices[-1]
        for k in range(rows * first // whole, rows * last // whole):
            row = k // inner // many * there * inner + k % inner
            if of_row:
                row += chosen[k // inner % many] * inner
            rest, other, stride = row, 0, 1
            for i in range(n - 2, -1, -1):
                other += places[i, rest % shape[i]] * stride
                rest //= shape[i]
                stride *= shape[i]
            for j in range(nodes if of_row else len(chosen)):
                place = j if of_row else chosen[j]
                values[row * nodes + place] = values[other * nodes + places[n - 1, place]]
