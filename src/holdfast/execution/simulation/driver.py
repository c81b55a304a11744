"""The simulation loop, written for Numba; it knows no program and is compiled once.

What belongs to a program are leaves (`codegen/closed_loop_program.py`), which compute all lanes of
a block at once; what may differ between the lanes, such as the mode, an exit or the length of a
step, is decided lane by lane. No value of a lane depends on another lane.
"""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.simulation.stepping import *  # noqa: F403

# -- joined from here on


@apart
def begin_lanes(s, w, numbers, starts, base, count, initial_mode):
    """The parameters and the starts of the runs of a block; lanes without a run repeat the last."""
    p, length = s[PARAMETERS], w[U(s[METHOD] + SAMPLE_TIME)]
    for lane in range(s[LANES]):
        run = base + min(lane, count - 1)
        for i in range(p):
            w[U(s[PLANT] + i * WIDTH + lane)] = numbers.plant[i]
            w[U(s[GAINS] + i * WIDTH + lane)] = numbers.gains[i]
        for j in range(len(numbers.varied_plant)):
            i = numbers.varied_plant[j]
            w[U(s[PLANT] + i * WIDTH + lane)] = numbers.own_plant[run, j]
        for j in range(len(numbers.varied_gains)):
            i = numbers.varied_gains[j]
            w[U(s[GAINS] + i * WIDTH + lane)] = numbers.own_gains[run, j]
        for i in range(s[STATES]):
            w[U(s[Q] + i * WIDTH + lane)] = starts[run, i]
        w[U(s[ALIVE] + lane)] = 1.0 if lane < count else 0.0
        w[U(s[MODE] + lane)], w[U(s[OUTCOME] + lane)] = initial_mode, STAYED
        for row in range(NOTED):
            w[U(note(s, row) + lane)] = 0.0
        for row in range(s[INPUTS] + s[ACTUATORS]):
            w[U(s[PEAKS] + row * WIDTH + lane)] = 0.0
        w[U(note(s, INSIDE_SINCE) + lane)], w[U(note(s, TRIAL) + lane)] = np.nan, length
        w[U(note(s, EXIT_TIME) + lane)] = w[U(note(s, OFF_AT) + lane)] = np.nan
        w[U(note(s, EXIT_CONSTRAINT) + lane)] = -1.0
        w[U(note(s, SHORTEST) + lane)] = np.inf
    if s[WATCHED] > 0:
        leaf(s, w, CONSTRAINED, s[T], s[Q], s[T], s[PLANT], s[C0])
    for j in range(s[WATCHED]):
        for lane in range(s[LANES]):
            c = w[U(s[C0] + j * WIDTH + lane)]
            w[U(s[WORST] + j * WIDTH + lane)] = c
            if c > w[U(s[TOLERANCE])] and w[U(s[OUTCOME] + lane)] != LEFT:
                w[U(s[OUTCOME] + lane)] = LEFT
                w[U(note(s, EXIT_TIME) + lane)] = 0.0
                w[U(note(s, EXIT_CONSTRAINT) + lane)] = j


@apart
def note_command(s, w):
    """What a sample adds to the notes of a run; a lane whose command is no number ends."""
    for lane in range(s[LANES] if s[SAFEGUARDED] else 0):
        if w[U(s[ALIVE] + lane)] != 0.0:
            slack = w[U(s[SLACK] + lane)]
            if w[U(s[OVERRULED] + lane)] > 0.0:
                w[U(note(s, OVERRULES) + lane)] += 1.0
            if slack > 0.0:
                w[U(note(s, INFEASIBLE) + lane)] += 1.0
                place = note(s, LARGEST_SLACK) + lane
                w[U(place)] = max(w[U(place)], slack)
    leaf(s, w, PEAKED, s[T], s[ACTUATION], s[T], s[PEAKS], s[BAD])
    if any_of(w, s[BAD]):
        end_flagged(s, w, s[BAD])
    leaf(s, w, GOAL, s[T], s[Q], s[T], s[PLANT], s[LEVEL])
    since = note(s, INSIDE_SINCE)
    leaf(s, w, ARRIVE, s[T], s[LEVEL], since, s[T], since)


@apart
def ended(s, w, count, before):
    """How many runs have ended since `before`: they diverged at T + ELAPSED."""
    found = 0
    for lane in range(count):
        if before[lane] and w[U(s[ALIVE] + lane)] == 0.0:
            if w[U(s[OUTCOME] + lane)] != LEFT:
                w[U(note(s, EXIT_TIME) + lane)] = w[U(s[T] + lane)] + w[U(s[ELAPSED] + lane)]
            w[U(s[OUTCOME] + lane)] = DIVERGED
            found += 1
        before[lane] = w[U(s[ALIVE] + lane)] != 0.0
    return found


@apart
def record(s, w, base, count, row, out):
    """A sample of every lane."""
    n, m, limited, actuators = s[STATES], s[INPUTS], s[LIMITED], s[ACTUATORS]
    first = s[ACTUATION] + limited * WIDTH
    if s[SIGNALS] > 0:
        leaf(s, w, SIGNALLED, s[T], s[SEEN], s[LOOK], s[GAINS], s[SIGNAL])
    if s[SAFEGUARDED] and actuators > 0:
        leaf(s, w, ACTUATE, s[T], s[NOMINAL], s[GAINS], s[GAINS], s[BELIEVED])
    for lane in range(count):
        if w[U(s[ALIVE] + lane)] == 0.0:
            continue
        run = base + lane
        for i in range(n):
            out.state[run, row, i] = w[U(s[Q] + i * WIDTH + lane)]
        for i in range(m):
            out.input[run, row, i] = w[U(first + (limited + i) * WIDTH + lane)]
        for i in range(actuators):
            out.actuator[run, row, i] = w[U(first + i * WIDTH + lane)]
        out.mode[run, row] = int(w[U(s[MODE] + lane)])
        if s[SAFEGUARDED]:
            slack = w[U(s[SLACK] + lane)]
            out.sample_slack[run, row] = slack
            out.safeguard[run, row] = 2 if slack > 0.0 else int(w[U(s[OVERRULED] + lane)])
            for i in range(m):
                out.nominal[run, row, i] = w[U(s[NOMINAL] + i * WIDTH + lane)]
            for i in range(actuators):
                out.nominal_actuator[run, row, i] = w[U(s[BELIEVED] + i * WIDTH + lane)]
        for i in range(s[SIGNALS]):
            out.signal[run, row, i] = w[U(s[SIGNAL] + i * WIDTH + lane)]
        for j in range(s[WATCHED]):
            out.constraint[run, row, j] = w[U(s[C0] + j * WIDTH + lane)]


@apart
def write_notes(s, w, base, count, out):
    """What is known of each run at its end."""
    watched, m = s[WATCHED], s[INPUTS]
    for lane in range(count):
        run = base + lane
        outcome, since = int(w[U(s[OUTCOME] + lane)]), w[U(note(s, INSIDE_SINCE) + lane)]
        if outcome == STAYED and not math.isnan(since):
            outcome = REACHED
        out.outcome[run] = outcome
        out.goal_time[run] = np.nan if outcome == DIVERGED else since
        out.exit_time[run] = w[U(note(s, EXIT_TIME) + lane)]
        out.exit_constraint[run] = int(w[U(note(s, EXIT_CONSTRAINT) + lane)])
        out.switches[run] = int(w[U(note(s, SWITCHES) + lane)])
        out.shortest_dwell[run] = w[U(note(s, SHORTEST) + lane)]
        out.overruled[run] = int(w[U(note(s, OVERRULES) + lane)])
        out.infeasible[run] = int(w[U(note(s, INFEASIBLE) + lane)])
        out.largest_slack[run] = w[U(note(s, LARGEST_SLACK) + lane)]
        out.rejected[run] = int(w[U(note(s, REJECTED) + lane)])
        out.off_grid[run] = w[U(note(s, OFF_AT) + lane)]
        for j in range(watched):
            out.worst[run, j] = w[U(s[WORST] + j * WIDTH + lane)]
        for i in range(m):
            out.peak_input[run, i] = w[U(s[PEAKS] + i * WIDTH + lane)]
        for i in range(s[ACTUATORS]):
            out.peak_actuator[run, i] = w[U(s[PEAKS] + (m + i) * WIDTH + lane)]


@apart
def measure(s, w, k, past, before, base, count, sampling):
    """SEEN = the states as the law sees them at sample k: late, with noise, with what it feels."""
    n, delay = s[STATES], sampling.delay
    back = k - min(delay, k)
    mine, seen = past[k % (delay + 1)], past[back % (delay + 1)]
    for j in range(n * WIDTH):
        mine[j] = w[U(s[Q] + j)]
    for j in range(n * WIDTH):
        w[U(s[SEEN] + j)] = seen[j]
    if sampling.noisy:
        scratch = np.empty(n)
        for lane in range(count):
            for i in range(n):
                scratch[i] = w[U(s[SEEN] + i * WIDTH + lane)]
            add_noise(sampling.noise, sampling.seed, before + base + lane, back, scratch)
            for i in range(n):
                w[U(s[SEEN] + i * WIDTH + lane)] = scratch[i]
    if s[MEASURED] > 0:
        for lane in range(s[LANES]):
            w[U(s[AT] + lane)] = back * sampling.sample_time
        leaf(s, w, FELT, s[AT], s[Q], s[AT], s[PLANT], s[SEEN] + n * WIDTH)


@apart
def simulate_block(s, w, base, count, before, starts, numbers, sampling, out, stop, progress):
    """The runs base..base+count-1 as the lanes of a block."""
    samples = sampling.samples
    memory_at = s[SEEN] + (s[STATES] + s[MEASURED]) * WIDTH
    past = np.empty((sampling.delay + 1, s[STATES] * WIDTH))  # the last samples, in turn
    recent = np.full((s[SWITCH_LIMIT], WIDTH), -np.inf)  # when the mode changed, in turn
    going, stiff_at = np.ones(WIDTH, dtype=np.bool_), np.empty(WIDTH)
    begin_lanes(s, w, numbers, starts, base, count, sampling.initial_mode)
    left = count
    for k in range(samples + 1):
        if stop[0] != 0 or left == 0:
            break
        t = k * sampling.sample_time
        for lane in range(s[LANES]):
            w[U(s[T] + lane)] = t
            w[U(s[ELAPSED] + lane)] = 0.0
        measure(s, w, k, past, before, base, count, sampling)
        if s[REMEMBERED] > 0:
            if k == 0:
                leaf(s, w, BEGIN, s[T], s[SEEN], s[T], s[GAINS], s[MEMORY])
            all_copied(w, s[REMEMBERED] * WIDTH, s[MEMORY], memory_at)
        if s[LEAVING] > 0:
            change_modes(s, w, recent)
        if s[PLACES] > 0:
            leaf(s, w, LOOKED_UP, s[T], s[SEEN], s[T], s[GAINS], s[PLACE])
            call_part(s[LOOK_UP], s, w, 1)
        command_of(s, w, s[T], s[SEEN])
        leaf(s, w, ACTUATE, s[T], s[COMMAND], s[GAINS], s[PLANT], s[ACTUATION])
        if s[REMEMBERED] > 0:
            leaf(s, w, REMEMBER, s[T], s[SEEN], s[ACTUATION], s[GAINS], s[MEMORY])
        note_command(s, w)
        fewer = ended(s, w, count, going)
        progress[0] += fewer * (samples + 1 - k)
        left -= fewer
        if k % sampling.stride == 0:
            record(s, w, base, count, k // sampling.stride, out)
        progress[0] += left
        if k == samples:
            break
        advance(s, w, stiff_at, stop)
        fewer = ended(s, w, count, going)
        progress[0] += fewer * (samples - k)
        left -= fewer
    write_notes(s, w, base, count, out)


@compiled
def simulate_runs(first, last, before, starts, s, w, numbers, sampling, out, stop, progress):
    """Simulate the runs first..last-1; every array of `out` is indexed by run.

    s, w: the program and room for one block (`loop_arguments.block`). numbers, sampling, out: the
    named tuples of `loop_arguments`. The runs are `before` + first and so on of those that share
    the seed: a run draws its random numbers by that place.

    The first time at which c_j exceeds the tolerance is located inside the step in which it
    happens. `stop[0]` set from outside ends the call early; `progress[0]` counts control samples.
    """
    for base in range(first, last, WIDTH):
        count = min(WIDTH, last - base)
        simulate_block(s, w, base, count, before, starts, numbers, sampling, out, stop, progress)
