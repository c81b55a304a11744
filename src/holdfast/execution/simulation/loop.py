"""The simulation loop of a closed loop: what it calls on a block of runs, and when.

A text in the part of Python that `codegen/scalar_reader.py` reads; LLVM, WebAssembly and C++ have
it from there. `shape`, `kind`, `at`, `names` are what `built_loop.py` knows of a program: branches
that depend on them alone are taken when the text is read, and what is done for each of a fixed
number is written out. Functions that a block is handed to from outside are

    holdfast_begin     the memory and the constraints at the starts
    holdfast_advance   the samples of as many records as s says, and what is recorded of them
    holdfast_finish    the last sample, which no step follows
    holdfast_end       the outcome of a run that is over
    holdfast_sample    one sample, without a clock and a record, for other simulators
    holdfast_first     the memory before the first answer of a controller
    holdfast_answer    what a controller answers to what it sees, which others write

and of a law that others hand a command: holdfast_measure, holdfast_control, holdfast_record,
holdfast_move; `simulate` is whole runs, for a device on which each has a thread of its own.

w are the numbers of a block in rows of one number for each run (a lane); s its whole numbers;
leaves the addresses of leaves and parts; stop[0] is 1 when somebody stops the loop. All arrays have
one dimension:

    w           (rows * width,)     the lanes of a row side by side: a register takes several
    s           (entries,)          as `Layout` of `built_loop.py` says
    leaves      (leaves,)
    stop        (1,)

What may differ between the lanes, such as the mode, an exit or the length of a step, is a row. No
value of a lane depends on another lane. Guards of modes are tried in order, and the turns counted;
constraints are looked at more closely inside a step for their peaks and crossings.
"""

# ruff: noqa: B007, F821
# mypy: ignore-errors

from __future__ import annotations

from holdfast.execution.codegen.lane_leaves import BISECTION_STEPS, GOLDEN_STEPS
from holdfast.execution.simulation.built_loop import (
    FORGOTTEN,
    LATE,
    LOG,
    LOG_AT,
    PITCH,
    RECORDS,
    RING,
    RINGS_AT,
    STRIDE,
)
from holdfast.execution.simulation.settings import Outcome


def goes_on(w: Floats, stop: Wholes) -> bool:
    """Whether a lane is alive and nobody stops the loop."""
    if kind.stoppable:
        return any_lane(w, at.alive, shape.width) and look(stop) == 0
    return any_lane(w, at.alive, shape.width)


def late(w: Floats, s: Wholes, ring: int, source: int, target: int, rows: int):
    """Store rows in a ring; the oldest rows of it to `target`.

    Of a ring s has the next slot, the number of slots and its first row; a row of it, and of the
    log, begins s[PITCH] numbers behind the one before.
    """
    rings = floats_at(s[RINGS_AT])
    entry, pitch = s[RING + 3 * ring :], s[PITCH]
    now, slots, first = entry[0], entry[1], entry[2]
    oldest = 0 if now + 1 == slots else now + 1
    for i in range(rows):
        copy(w, source + i * shape.width, shape.width, rings, (first + now * rows + i) * pitch)
    entry[0] = oldest
    for i in range(rows):
        copy(rings, (first + oldest * rows + i) * pitch, shape.width, w, target + i * shape.width)


def append(w: Floats, s: Wholes, source: int, rows: int):
    """Rows to the end of the log, which is s[LOG] numbers long."""
    log, pitch = floats_at(s[LOG_AT]), s[PITCH]
    for i in range(rows):
        copy(w, source + i * shape.width, shape.width, log, s[LOG] + i * pitch)
    s[LOG] = s[LOG] + rows * pitch


# -- what a law sees, and its command


def prepare(w: Floats, leaves: Wholes):
    """The rows behind the parameters."""
    if shape.prepared:
        leaf("prepared", p=at.plant, out=at.plant_prepared)
        leaf("prepared", p=at.gains, out=at.gains_prepared)


def remember_first(w: Floats, leaves: Wholes):
    if shape.remembered:
        leaf("begin", t=at.time, q=at.seen, p=at.gains, out=at.memory)


def perceive(w: Floats, leaves: Wholes):
    """What the law feels where its states are measured, and noise on the states."""
    if shape.measured:
        leaf("felt", t=at.seen_at, q=at.seen, p=at.plant, out=at.felt)
    if kind.noisy:
        copy(w, at.back, shape.width, w, at.draw)
        leaf("noise", t=at.run, x=at.seen, p=at.noise, out=at.seen)


def measure_now(w: Floats, leaves: Wholes):
    copy(w, at.q, shape.states * shape.width, w, at.seen)
    perceive(w, leaves)


def measure(w: Floats, s: Wholes, leaves: Wholes):
    """seen = the states as the law sees them: late, with what it feels there, with noise."""
    if kind.late:
        late(w, s, LATE, at.q, at.seen, shape.states)
        perceive(w, leaves)
    else:
        measure_now(w, leaves)


def share(w: Floats, leaves: Wholes, t: int, seen: int):
    """What several leaves need of what the law sees."""
    if shape.shared:
        leaf("shared", t=t, q=seen, p=at.gains, out=seen + at.shared)


def turn(w: Floats, s: Wholes, leaves: Wholes):
    """The modes after their guards are tried in order."""
    if shape.modes > 1:
        leaf("where", t=at.length, q=at.since, x=at.time_in_mode, out=at.in_modes)
    if shape.turns:
        for k in each(shape.modes):
            if shape.guarded[k] and any_lane(w, at.in_modes + k * shape.width, shape.width):
                leaf("guards", k, t=at.time, q=at.seen, x=at.time_in_mode, p=at.gains,
                     out=at.levels)  # fmt: skip
                leaf("turn", k, t=at.mode, q=at.levels, x=at.next_mode, out=at.next_mode)
        leaf("changed", t=at.length, q=at.since, x=at.time_in_mode, out=at.changed)
        late(w, s, FORGOTTEN, at.changed, at.forgotten, 1)
        leaf("switch", t=at.length, q=at.since, x=at.time_in_mode, out=at.since)
        if any_lane(w, at.changed, shape.width):
            leaf("chatter", t=at.length, q=at.since, x=at.time_in_mode, out=at.outcome)


def command(w: Floats, s: Wholes, leaves: Wholes, t: int, seen: int):
    """The command of every lane in its mode, kept by its safeguard, and what is made of it."""
    for k in each(shape.modes):
        if shape.modes == 1 or any_lane(w, at.in_modes + k * shape.width, shape.width):
            leaf("law", k, t=t, q=seen, x=at.look, p=at.gains, out=at.answered)
            if shape.things:
                for thing in range(shape.things):
                    numbers = seen + at.things + thing * at.thing
                    if any_lane(w, numbers, shape.width):
                        place = at.answered + shape.things_at[k] + thing * at.thing_rows
                        leaf("thing", k, t=t, q=seen, x=numbers, p=at.gains, out=place)
            if shape.blended:
                leaf("blend", k, t=at.mode, q=at.command, x=at.answer, out=at.command)
            if shape.safeguards[k]:
                leaf("held", k, t=at.length, q=at.answer, x=at.mode, out=at.held)
                if any_lane(w, at.held, shape.width):
                    part(names.keep, s, w, shape.safeguards[k])
    leaf("actuate", t=t, q=at.command, x=at.gains, p=at.plant, out=at.actuation)


def answer(w: Floats, s: Wholes, leaves: Wholes):
    """The mode, the command and the memory after what the law sees."""
    if shape.remembered:
        copy(w, at.memory, shape.remembered * shape.width, w, at.remembered)
    share(w, leaves, at.time, at.seen)
    turn(w, s, leaves)
    if shape.places:
        leaf("places", t=at.time, q=at.seen, p=at.gains, out=at.look_at)
        part(names.look_up, s, w, at.table)
    command(w, s, leaves, at.time, at.seen)
    if shape.remembered:
        leaf("remember", t=at.time, q=at.seen, x=at.actuation, p=at.gains, out=at.memory)


def end_flagged(w: Floats, leaves: Wholes, flags: int):
    """The lanes with such a flag diverged."""
    if any_lane(w, flags, shape.width):
        leaf("end", t=at.length, q=flags, out=at.accepted)


def respond(w: Floats, s: Wholes, leaves: Wholes):
    """The command after what is seen, and what is noted of the sample."""
    answer(w, s, leaves)
    if shape.safeguarded:
        leaf("kept", t=at.length, q=at.slack, out=at.overrules)
    leaf("peaks", t=at.length, q=at.actuation, p=at.peaks, out=at.bad)
    end_flagged(w, leaves, at.bad)
    leaf("goal", t=at.time, q=at.q, p=at.plant, out=at.level)
    leaf("arrive", t=at.length, q=at.level, x=at.inside_since, out=at.inside_since)
    if shape.bounded:
        leaf("excess", t=at.time, q=at.q, p=at.plant, out=at.excess)
        leaf("exceed", t=at.length, q=at.excess, x=at.beyond, out=at.beyond)


def control(w: Floats, s: Wholes, leaves: Wholes):
    """The clock, what the law sees, its mode, its command, and what is noted of them."""
    leaf("clock", t=at.length, out=at.sample)
    measure(w, s, leaves)
    respond(w, s, leaves)


def record(w: Floats, s: Wholes, leaves: Wholes):
    if shape.signals:
        leaf("signals", t=at.time, q=at.seen, x=at.look, p=at.gains, out=at.signals)
    if shape.safeguarded and shape.actuators:
        leaf("actuate", t=at.time, q=at.nominal, x=at.gains, p=at.gains, out=at.believed)
    for k in each(shape.records):
        append(w, s, shape.recorded[k], shape.rows[k])


# -- the steps of a sample


def field(w: Floats, s: Wholes, leaves: Wholes, t: int, q: int, out: int):
    """dq/dt; with continuous control the input is the law's at this very state."""
    if shape.continuous:
        copy(w, q, shape.states * shape.width, w, at.inner)
        if shape.measured:
            leaf("felt", t=t, q=q, p=at.plant, out=at.inner_felt)
        share(w, leaves, t, at.inner)
        if shape.places:
            leaf("places", t=t, q=at.inner, p=at.gains, out=at.look_at)
            part(names.look_up, s, w, at.other_table)
        command(w, s, leaves, t, at.inner)
    leaf("rates", t=t, q=q, x=at.produced, p=at.plant, out=out)


def between(w: Floats, leaves: Wholes):
    """inside = c_j of every lane at its fraction of the step."""
    leaf("between", t=at.length, q=at.q, x=at.new, p=at.fraction, out=at.between)
    leaf("constraints", t=at.at, q=at.between, p=at.plant, out=at.inside)


def look_at_one(w: Floats, leaves: Wholes, j: int):
    """The largest c_j inside the step, and when it first exceeds the tolerance."""
    inside, worst, rises = at.inside + j, at.worst + j, at.rises + j
    leaf("open", t=at.length, q=at.number, x=at.c1 + j, out=at.number)
    if any_lane(w, rises, shape.width):
        leaf("golden", t=at.length, q=at.number, out=at.lower)
        between(w, leaves)
        leaf("golden_left", t=at.length, q=at.number, x=inside, out=at.c_left)
        between(w, leaves)
        leaf("golden_right", t=at.length, q=at.number, x=inside, out=at.c_right)
        for k in range(GOLDEN_STEPS):
            leaf("golden_turn", t=at.length, q=at.number, out=at.lower)
            between(w, leaves)
            leaf("golden_take", t=at.length, q=at.number, x=inside, out=at.c_left)
        leaf("golden_end", t=at.length, q=at.number, out=at.fraction)
        between(w, leaves)
        leaf("peaked", t=at.length, q=at.number, x=inside, p=rises, out=at.top)
    leaf("raise", q=at.number, x=worst, p=at.close, out=worst)
    leaf("crosses", t=at.length, q=at.number, p=at.close, out=at.crosses)
    if any_lane(w, at.crosses, shape.width):
        leaf("bisect", t=at.length, q=at.number, out=at.lower)
        for k in range(BISECTION_STEPS):
            between(w, leaves)
            leaf("bisect_turn", t=at.length, q=at.number, x=inside, out=at.lower)
        leaf("crossed", t=at.length, q=at.number, out=at.earliest)


def watch(w: Floats, leaves: Wholes):
    """The largest c_j, which of them first exceeds the tolerance inside the step, and when."""
    leaf("constraints", t=at.then, q=at.new, p=at.plant, out=at.c1)
    leaf("constraint_rates", t=at.then, q=at.new, x=at.k1, p=at.plant, out=at.d1)
    leaf("watch", t=at.length, q=at.c0, x=at.c1, p=at.worst, out=at.close)
    end_flagged(w, leaves, at.unbounded)
    if any_lane(w, at.close, shape.width):
        leaf("search", t=at.length, q=at.number, out=at.number)
        for j in range(shape.constraints):
            look_at_one(w, leaves, j * shape.width)
        leaf("leave", t=at.length, q=at.number, out=at.outcome)
    leaf("take", t=at.length, q=at.c0, x=at.c1, out=at.c0)


def advance(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    """All lanes by one sample time; those that diverge are no longer alive."""
    if kind.until_goal:
        leaf("rest", t=at.length, q=at.inside_since, out=at.alive)
    leaf("start", t=at.length, out=at.h)
    if shape.both_ends:
        field(w, s, leaves, at.time, at.q, at.stages)
    else:
        copy(w, at.time, shape.width, w, at.then)
    if shape.constraints:
        leaf("constraint_rates", t=at.time, q=at.q, x=at.stages, p=at.plant, out=at.d0)
    while any_lane(w, at.active, shape.width):
        if kind.stoppable and look(stop) != 0:
            break
        if not shape.both_ends:
            field(w, s, leaves, at.then, at.q, at.stages)
        if shape.adaptive:
            leaf("lengths", t=at.length, out=at.h)
        for stage in each(1, shape.stages):
            leaf("stage", stage, t=at.length, q=at.q, x=at.stages, out=at.between)
            field(w, s, leaves, at.at, at.between, at.stages + stage * shape.states * shape.width)
        leaf("new", t=at.length, q=at.q, x=at.stages, out=at.then)
        if shape.adaptive:
            leaf("judge", t=at.length, q=at.q, x=at.new, p=at.stages, out=at.trial)
        else:
            end_flagged(w, leaves, at.wild)
        if shape.both_ends:
            field(w, s, leaves, at.then, at.new, at.k1)
        if shape.constraints:
            watch(w, leaves)
        if shape.both_ends:
            leaf("accept", t=at.length, q=at.q, x=at.new, out=at.q)
        else:
            leaf("move", t=at.length, q=at.q, x=at.new, out=at.q)
        leaf("tick", t=at.length, out=at.elapsed)
    if shape.wandering:
        copy(w, at.sample, shape.width, w, at.draw)
        leaf("wander", t=at.run, x=at.wander, p=at.plant, out=at.wander)


# -- what is called from outside


def holdfast_begin(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    """The memory at the starts, and who begins outside."""
    prepare(w, leaves)
    if shape.remembered:
        measure_now(w, leaves)
    remember_first(w, leaves)
    if shape.constraints:
        leaf("constraints", t=at.time, q=at.q, p=at.plant, out=at.c0)
        for lane in range(shape.width):
            for j in range(shape.constraints - 1, -1, -1):
                c = w[at.c0 + j * shape.width + lane]
                w[at.worst + j * shape.width + lane] = c
                if c > w[at.tolerance + lane]:
                    w[at.outcome + lane] = Outcome.LEFT
                    w[at.exit_time + lane] = 0.0
                    w[at.exit_constraint + lane] = j


def holdfast_advance(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    for k in range(s[RECORDS]):
        if not goes_on(w, stop):
            return
        control(w, s, leaves)
        record(w, s, leaves)
        advance(w, s, leaves, stop)
        for more in range(s[STRIDE] - 1):
            if not goes_on(w, stop):
                return
            control(w, s, leaves)
            advance(w, s, leaves, stop)


def holdfast_finish(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    control(w, s, leaves)
    record(w, s, leaves)


def holdfast_end(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    """Who stayed and is in the goal reached it; who diverged is nowhere."""
    for lane in range(shape.width):
        if w[at.outcome + lane] == Outcome.DIVERGED:
            w[at.inside_since + lane] = math.nan
        elif w[at.outcome + lane] == Outcome.STAYED and not math.isnan(w[at.inside_since + lane]):
            w[at.outcome + lane] = Outcome.REACHED


def holdfast_sample(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    measure_now(w, leaves)
    respond(w, s, leaves)
    advance(w, s, leaves, stop)


def holdfast_first(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    prepare(w, leaves)
    remember_first(w, leaves)


def holdfast_answer(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    answer(w, s, leaves)


def holdfast_measure(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    leaf("clock", t=at.length, out=at.sample)
    measure(w, s, leaves)


def holdfast_control(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    respond(w, s, leaves)


def holdfast_record(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    record(w, s, leaves)


def holdfast_move(w: Floats, s: Wholes, leaves: Wholes, stop: Wholes):
    advance(w, s, leaves, stop)


def simulate(
    runs: int, first: Floats, entries: Wholes, varied: Floats, varied_at: Wholes,
    varied_count: int, records: int, log: Floats, rings: Floats, in_rings: int,
    noted: Floats, noted_at: Wholes, noted_count: int,
):  # fmt: skip
    """Runs of one lane, each by a thread, whose log, rings and numbers are columns of arrays.

    first, entries: w and s before a run begins. varied, noted: numbers that differ between the
    runs, and those that are asked for at the end, shape (count, runs), with their places in w.
    """
    w = private_floats(at.size)
    s = private_wholes(at.entries)
    for run in over_all(0, runs):
        copy(first, 0, at.size, w, 0)
        for k in range(at.entries):
            s[k] = entries[k]
        s[LOG], s[PITCH], s[RECORDS] = 0, runs, records - 1
        s[LOG_AT], s[RINGS_AT] = address(log, run), address(rings, run)
        for k in range(varied_count):
            w[varied_at[k]] = varied[k * runs + run]
        for k in range(in_rings):
            rings[k * runs + run] = 0.0
        for k in range(s[RING + 3 * LATE + 1] * shape.states):
            rings[(s[RING + 3 * LATE + 2] + k) * runs + run] = w[at.q + k % shape.states]
        holdfast_begin(w, s, s, s)
        holdfast_advance(w, s, s, s)
        holdfast_finish(w, s, s, s)
        holdfast_end(w, s, s, s)
        for k in range(noted_count):
            noted[k * runs + run] = w[noted_at[k]]
