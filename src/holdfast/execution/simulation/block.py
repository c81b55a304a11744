"""What a block of runs consists of: entries of the array s and places in the array w.

`WIDTH` runs advance together as the lanes of a block. All numbers of a block are in one array w,
and all sizes, places in w and addresses of leaves in one array s of whole numbers: an array more
would cost every call of a function two atomic counts of its references. A quantity of lanes has
rows of `WIDTH` values at its place, such as w[s[Q]].
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.simulation.trajectory import *  # noqa: F403

# -- joined from here on


ONE_SECOND = 1.0 - 1e-9
MOST_STEPS = 1_000_000  # adaptive steps within one control sample
AWAY = 4096  # adaptive steps between two looks at an interruption

# entries of s: sizes and choices; LANES is WIDTH, but not known to the compiler, which would
# write every loop over the lanes out
SIZES = 20
(
    STATES, INPUTS, MEASURED, REMEMBERED, LIMITED, ACTUATORS, PLACES, SIGNALS, WATCHED, MODES,
    PARAMETERS, STAGES, SAFEGUARDED, CONTINUOUS, ADAPTIVE, SUBSTEPS, LEAVING,
    SWITCH_LIMIT, CONDITIONS, LANES,
) = range(SIZES)  # fmt: skip
# addresses of leaves, and of `parts.py`; those of each mode are behind the places
LEAVES = 22
(
    RATES, FELT, BEGIN, LOOKED_UP, SIGNALLED, ACTUATE, REMEMBER, CONSTRAINED, CONSTRAINT_RATES,
    GOAL, START, STEPPED, ERROR, ACCEPT, TICK, ARRIVE, PEAKED, BETWEEN_ENDS, WATCH, TAKE,
    KEEP, LOOK_UP,
) = range(SIZES, SIZES + LEAVES)  # fmt: skip
# places in w
ROWS = 54
(
    T, ALIVE, LENGTH, LAST_INDEX, TOLERANCE, H, ACCEPTED, LAST, ELAPSED, INDEX, ACTIVE, Q, STAGE,
    THEN, WILD, NEW, K1, BETWEEN, AT, C0, D0, C1, D1, COMMAND, NOMINAL, OUTCOME, CLOSE, UNBOUNDED,
    WORST, BAD, PEAKS, SEEN, INNER, PLANT, GAINS, MEMORY, PLACE, LOOK, ANSWER, ACTUATION, BELIEVED,
    LEVELS, TIME_IN_MODE, SIGNAL, LEVEL, SLACK, OVERRULED, SLOPE, INSIDE, FRACTION, NOTES, METHOD,
    MODE, TABLE,
) = range(SIZES + LEAVES, SIZES + LEAVES + ROWS)  # fmt: skip
PER_MODE = SIZES + LEAVES + ROWS
"""From here on for each stage but the first its leaf, then for each mode the place of its entries:
law, guards, blend, how many guards, conditions, hard ones, and the targets of the guards."""
OF_MODE = 6
"""Entries of a mode before its targets."""

# rows of NOTES: what else is known of a run
NOTED = 12
(
    EXIT_TIME, EXIT_CONSTRAINT, SWITCHES, SHORTEST, OVERRULES, INFEASIBLE, LARGEST_SLACK, OFF_AT,
    SINCE, INSIDE_SINCE, REJECTED, TRIAL,
) = range(NOTED)  # fmt: skip
# entries of METHOD
ABSOLUTE, RELATIVE, ORDER, SAMPLE_TIME = 0, 1, 2, 3


@inlined
def leaf(s, w, which, t, q, x, p, out):
    """Call a leaf with the places of its columns; it ignores those that it has no rows of."""
    call_leaf(s[which], w, t, q, x, p, out)


@inlined
def note(s, row):
    """The place of a row of NOTES."""
    return s[NOTES] + row * WIDTH


@inlined
def all_copied(w, count, source, target):
    for j in range(count):
        w[U(target + j)] = w[U(source + j)]


@inlined
def in_mode(s, w, k):
    """Whether some lane that goes on is in mode k."""
    found = False
    for lane in range(s[LANES]):
        found = found or (w[U(s[ALIVE] + lane)] != 0.0 and w[U(s[MODE] + lane)] == k)
    return found


# -- leaves ------------------------------------------------------------------------------


@intrinsic
def call_leaf(typing_context, address, w, t, q, x, p, out):
    """Call the leaf at an address with five places of the array w as its columns."""

    def generate(context, builder, signature, arguments):
        pointer, whole = ir.IntType(8).as_pointer(), ir.IntType(64)
        function = ir.FunctionType(ir.VoidType(), [pointer] * 5 + [whole])
        where = builder.inttoptr(arguments[0], function.as_pointer())
        start = make_array(signature.args[1])(context, builder, arguments[1]).data
        places = [builder.bitcast(builder.gep(start, [place]), pointer) for place in arguments[2:7]]
        builder.call(where, [*places, ir.Constant(whole, WIDTH)])
        return context.get_dummy_value()

    return types.void(types.int64, w, *[types.int64] * 5), generate


@intrinsic
def call_part(typing_context, address, s, w, k):
    """Call the part at an address (`compile.part`) with the arrays s, w and a number."""

    def generate(context, builder, signature, arguments):
        pointer, whole = ir.IntType(8).as_pointer(), ir.IntType(64)
        function = ir.FunctionType(ir.VoidType(), [pointer, pointer, whole])
        where = builder.inttoptr(arguments[0], function.as_pointer())
        starts = [
            builder.bitcast(make_array(kind)(context, builder, array).data, pointer)
            for kind, array in zip(signature.args[1:3], arguments[1:3], strict=True)
        ]
        builder.call(where, [*starts, arguments[3]])
        return context.get_dummy_value()

    return types.void(types.int64, s, w, types.int64), generate


def _address_of(kind):
    @intrinsic
    def pointer(typing_context, address):
        signature = types.CPointer(kind)(types.int64)

        def generate(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return signature, generate

    return pointer


double_at, single_at = _address_of(types.float64), _address_of(types.float32)


@intrinsic
def any_of(typing_context, w, place):
    """Whether the row of w at this place has a value that is not 0."""

    def generate(context, builder, signature, arguments):
        start = make_array(signature.args[0])(context, builder, arguments[0]).data
        several = ir.VectorType(ir.DoubleType(), WIDTH)
        where = builder.bitcast(builder.gep(start, [arguments[1]]), several.as_pointer())
        loaded = builder.load(where)
        loaded.align = 8
        flags = builder.fcmp_unordered("!=", loaded, ir.Constant(several, [0.0] * WIDTH))
        whole = builder.bitcast(flags, ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", whole, ir.Constant(ir.IntType(WIDTH), 0))

    return types.boolean(w, types.int64), generate
