"""Parts of the loop that few programs need, each compiled when a program first needs it.

The loop calls them through their addresses, with its arrays s and w and a number.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.interpolate import *  # noqa: F403
from holdfast.execution.simulation.block import *  # noqa: F403
from holdfast.execution.simulation.quadratic_program import *  # noqa: F403

# -- joined from here on

ENTRIES = 1 << 40  # of s and w, whose sizes do not matter here


def keep_lanes(s_at, w_at, k):
    """The safeguards' programs of the lanes in mode k: ANSWER to COMMAND, SLACK and OVERRULED."""
    s, w = carray(s_at, ENTRIES), carray(w_at, ENTRIES)
    own = s[PER_MODE + s[STAGES] - 1 + k]
    scratch = np.empty(2 * s[INPUTS] + s[CONDITIONS] * (s[INPUTS] + 1))
    for lane in range(s[LANES]):
        if w[U(s[MODE] + lane)] == k and w[U(s[ALIVE] + lane)] != 0.0:
            keep_lane(s, w, lane, s[own + 4], s[own + 5], scratch)


@inlined
def keep_lane(s, w, lane, count, hard, scratch):
    """The safeguard's program of one lane."""
    m, answer = s[INPUTS], s[ANSWER] + lane
    rows = count * (m + 1)
    for i in range(m + rows + m):
        scratch[i] = w[U(answer + i * WIDTH)]
    wanted, conditions = scratch[:m], scratch[m : m + rows]
    given = keep_within(wanted, scratch[m + rows : m + rows + m], conditions, hard)
    for i in range(m):
        w[U(s[COMMAND] + i * WIDTH + lane)] = given[i]
    w[U(s[SLACK] + lane)] = given[m]
    w[U(s[OVERRULED] + lane)] = overrules(wanted, given, conditions, hard)


def look_up_lanes(s_at, w_at, noted):
    """LOOK = the values of the law's table at PLACE; when noted, the first time outside of it.

    s[TABLE] is the place in s of: the address and the number of the values, whether they are
    single, the first axis that is a state, the place in w of the lowest nodes and the steps, the
    numbers of nodes, and which axes are periodic.
    """
    s, w = carray(s_at, ENTRIES), carray(w_at, ENTRIES)
    count, table = s[PLACES], s[TABLE]
    low = s[table + 4]
    geometry = (
        w[low : low + count],
        w[low + count : low + 2 * count],
        s[table + 5 : table + 5 + count],
        s[table + 5 + count : table + 5 + 2 * count],
    )
    if s[table + 2]:
        values = carray(single_at(s[table]), s[table + 1])
        look_up_in(s, w, (values, *geometry), noted)
    else:
        values = carray(double_at(s[table]), s[table + 1])
        look_up_in(s, w, (values, *geometry), noted)


@inlined
def look_up_in(s, w, table, noted):
    count, now = s[PLACES], w[U(s[T])]
    point, found = np.empty(count), np.empty(count + 1)
    for lane in range(s[LANES]):
        if w[U(s[ALIVE] + lane)] == 0.0:
            continue
        for i in range(count):
            point[i] = w[U(s[PLACE] + i * WIDTH + lane)]
        look_up(table, point, found)
        for i in range(count + 1):
            w[U(s[LOOK] + i * WIDTH + lane)] = found[i]
        off = note(s, OFF_AT) + lane
        if noted and math.isnan(w[U(off)]) and beyond_grid(table, point, s[s[TABLE] + 3]):
            w[U(off)] = now
            if w[U(s[OUTCOME] + lane)] == STAYED:
                w[U(s[OUTCOME] + lane)] = OFF_GRID
                w[U(note(s, EXIT_TIME) + lane)] = now
