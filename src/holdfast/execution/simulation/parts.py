"""Parts of the simulation loop that are scalar: each is compiled when a program first needs it.

The loop calls them through their addresses with its arrays s and w, and the place in s of their
entries, which `blocks.py` fills.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.interpolate import *  # noqa: F403
from holdfast.execution.simulation.quadratic_program import *  # noqa: F403

# -- joined from here on

WIDTH = 16  # runs that advance together, the lanes of a block
ENTRIES = 1 << 40  # of s and w, whose sizes do not matter here


def keep_lanes(s_at, w_at, k):
    """The program of a safeguard for the lanes that need it: from the answer of the law and its
    conditions to the command, the slack, and whether the law was overruled."""
    s, w = carray(s_at, ENTRIES), carray(w_at, ENTRIES)
    m, count, hard, answer, command = s[k], s[k + 1], s[k + 2], s[k + 3], s[k + 4]
    rows = count * (m + 1)
    scratch = np.empty(m + rows + m)
    wanted, conditions = scratch[:m], scratch[m : m + rows]
    for lane in range(WIDTH):
        if w[s[k + 7] + lane] == 0.0:
            continue
        for i in range(m + rows + m):
            scratch[i] = w[answer + i * WIDTH + lane]
        given = keep_within(wanted, scratch[m + rows :], conditions, hard)
        for i in range(m):
            w[command + i * WIDTH + lane] = given[i]
        w[s[k + 5] + lane] = given[m]
        w[s[k + 6] + lane] = overrules(wanted, given, conditions, hard)


def look_up_lanes(s_at, w_at, k):
    """The value of the law's table and its slopes at a place of each lane.

    When the entry `noted` is set, also the first time outside of the table.
    """
    s, w = carray(s_at, ENTRIES), carray(w_at, ENTRIES)
    low, count = s[k + 4], s[k + 6]
    geometry = (
        w[low : low + count],
        w[low + count : low + 2 * count],
        s[k + 14 : k + 14 + count],
        s[k + 14 + count : k + 14 + 2 * count],
    )
    if s[k + 2]:
        values = carray(single_at(s[k]), s[k + 1])
        look_up_in(s, w, k, (values, *geometry))
    else:
        values = carray(double_at(s[k]), s[k + 1])
        look_up_in(s, w, k, (values, *geometry))


@inlined
def look_up_in(s, w, k, table):
    first, noted, count, look_at, look = s[k + 3], s[k + 5], s[k + 6], s[k + 7], s[k + 8]
    point, found = np.empty(count), np.empty(count + 1)
    for lane in range(WIDTH):
        if w[s[k + 9] + lane] == 0.0:
            continue
        for i in range(count):
            point[i] = w[look_at + i * WIDTH + lane]
        look_up(table, point, found)
        for i in range(count + 1):
            w[look + i * WIDTH + lane] = found[i]
        now, off, outcome = w[s[k + 10] + lane], s[k + 11] + lane, s[k + 12] + lane
        if noted and math.isnan(w[off]) and beyond_grid(table, point, first):
            w[off] = now
            if w[outcome] == STAYED:
                w[outcome] = OFF_GRID
                w[s[k + 13] + lane] = now


STAYED, OFF_GRID = 0.0, 5.0  # of `outcomes.py`


def _address_of(kind):
    @intrinsic
    def pointer(typing_context, address):
        signature = types.CPointer(kind)(types.int64)

        def generate(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return signature, generate

    return pointer


double_at, single_at = _address_of(types.float64), _address_of(types.float32)
