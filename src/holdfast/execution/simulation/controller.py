"""What the controller of a block does at a sample: modes, commands, and the rates that follow."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.simulation.block import *  # noqa: F403

# -- joined from here on


@apart
def command_of(s, w, t, seen):
    """The COMMAND of every lane in its mode; with a safeguard also NOMINAL, SLACK, OVERRULED."""
    modes = s[MODES]
    alone = modes == 1 and not s[SAFEGUARDED]
    for k in range(modes):
        own = s[PER_MODE + s[STAGES] - 1 + k]
        if modes > 1 and not in_mode(s, w, k):
            continue
        answer = s[COMMAND] if alone else s[ANSWER]
        call_leaf(s[own], w, t, seen, s[LOOK], s[GAINS], answer)
        if alone:
            return
        call_leaf(s[own + 2], w, s[MODE], s[COMMAND], answer, answer, s[COMMAND])
        for lane in range(s[LANES] if s[SAFEGUARDED] else 0):
            if w[U(s[MODE] + lane)] == k:
                w[U(s[SLACK] + lane)] = w[U(s[OVERRULED] + lane)] = 0.0
        if s[own + 4] > 0:
            call_part(s[KEEP], s, w, k)


@apart
def change_modes(s, w, recent):
    """The modes after their guards are tried in order; how often, and whether they chatter."""
    t, mode, alive = s[T], s[MODE], s[ALIVE]
    now = w[U(t)]
    new = np.empty(WIDTH)
    for lane in range(s[LANES]):
        new[lane] = w[U(mode + lane)]
        w[U(s[TIME_IN_MODE] + lane)] = now - w[U(note(s, SINCE) + lane)]
    for k in range(s[MODES]):
        own = s[PER_MODE + s[STAGES] - 1 + k]
        count = s[own + 3]
        if count == 0 or not in_mode(s, w, k):
            continue
        call_leaf(s[own + 1], w, t, s[SEEN], s[TIME_IN_MODE], s[GAINS], s[LEVELS])
        for lane in range(s[LANES]):
            if w[U(mode + lane)] == k:
                for i in range(count):
                    if w[U(s[LEVELS] + i * WIDTH + lane)] >= 0.0:
                        new[lane] = s[own + OF_MODE + i]
                        break
    for lane in range(s[LANES]):
        if w[U(alive + lane)] == 0.0 or new[lane] == w[U(mode + lane)]:
            continue
        switches, shortest = note(s, SWITCHES) + lane, note(s, SHORTEST) + lane
        if w[U(switches)] > 0.0:
            w[U(shortest)] = min(w[U(shortest)], now - w[U(note(s, SINCE) + lane)])
        place = int(w[U(switches)]) % s[SWITCH_LIMIT]
        if now - recent[place, lane] < ONE_SECOND and w[U(s[OUTCOME] + lane)] == STAYED:
            w[U(s[OUTCOME] + lane)] = CHATTERED
            w[U(note(s, EXIT_TIME) + lane)] = now
        recent[place, lane] = now
        w[U(switches)] += 1.0
        w[U(note(s, SINCE) + lane)] = now
        w[U(mode + lane)] = new[lane]


@inlined
def field(s, w, t, q, out):
    """qdot; with continuous control the input is the law's at this very state."""
    if s[CONTINUOUS]:
        n, inner = s[STATES] * WIDTH, s[INNER]
        all_copied(w, n, q, inner)
        if s[MEASURED] > 0:
            leaf(s, w, FELT, t, q, q, s[PLANT], inner + n)
        if s[PLACES] > 0:
            leaf(s, w, LOOKED_UP, t, inner, t, s[GAINS], s[PLACE])
            call_part(s[LOOK_UP], s, w, 0)
        command_of(s, w, t, inner)
        leaf(s, w, ACTUATE, t, s[COMMAND], s[GAINS], s[PLANT], s[ACTUATION])
    leaf(s, w, RATES, t, q, s[ACTUATION] + 2 * s[LIMITED] * WIDTH, s[PLANT], out)
