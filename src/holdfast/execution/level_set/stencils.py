"""Runs of nodes of a grid: their neighbours along an axis, and what is to be computed again."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.primitives import *  # noqa: F403

# -- joined from here on

EXTRAPOLATED, PERIODIC, LIMITED = 0, 1, 2
RUN = 256  # nodes computed together, at most; a multiple of VECTOR
KEPT = 16384  # nodes of a place whose slopes are kept for the next, at most
VECTOR = 16  # nodes that a leaf in single precision computes at a time
PITCH = RUN + VECTOR  # a run, and what more of it a register takes; as in `stage_leaf.py`

# Places of the addresses that a stage asks for, as in `stage_leaf.py`; two for each axis follow.
VALUE, BASE, BEFORE, LOWER, UPPER, OUT, REST = range(7)
CHANGED, ODD, MOVES, ALONG, OF_ROW, OUTER, NUMBERS, SLOPES = range(7, 15)

FUSED = {"contract"}  # multiplications and additions: the inner loops are made of them

swept = within(forceinline=True, fastmath=FUSED)
called = within(fastmath=FUSED)


def entered(function):
    """Machine code that Python may call, for threads that sweep."""
    return kept(njit(**OPTIONS, fastmath=FUSED)(function))


@intrinsic
def call(typing_context, where, arguments):
    """Call the machine code at an address, with addresses and whole numbers."""

    def generate(context, builder, signature, given):
        whole = ir.IntType(64)
        count = len(signature.args[1])
        function = ir.FunctionType(ir.VoidType(), [whole] * count)
        at = builder.inttoptr(given[0], function.as_pointer())
        builder.call(at, [builder.extract_value(given[1], k) for k in range(count)])
        return context.get_dummy_value()

    return types.void(types.int64, arguments), generate


@intrinsic
def address(typing_context, array, place):
    """Of an entry of an array, which something else has to hold."""

    def generate(context, builder, signature, given):
        data = make_array(signature.args[0])(context, builder, given[0]).data
        return builder.ptrtoint(builder.gep(data, [given[1]]), ir.IntType(64))

    return types.int64(array, types.int64), generate


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
