"""All lanes of a block by one sample time: fixed or adaptive Runge-Kutta steps."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.simulation.controller import *  # noqa: F403
from holdfast.execution.simulation.crossings import *  # noqa: F403

# -- joined from here on


@apart
def next_lengths(s, w, stiff_at, stop):
    """How far each lane steps, and whether it is the last step of the sample: adaptive steps."""
    length = w[U(s[METHOD] + SAMPLE_TIME)]
    for lane in range(s[LANES]):
        index, rejected = w[U(s[INDEX] + lane)], w[U(note(s, REJECTED) + lane)]
        if w[U(s[ACTIVE] + lane)] != 0.0 and index + rejected > stiff_at[lane]:
            if stop[0] != 0 or index > MOST_STEPS:
                end_lane(s, w, lane)
            stiff_at[lane] += AWAY
        left = length - w[U(s[ELAPSED] + lane)]
        h = min(w[U(note(s, TRIAL) + lane)], left)
        w[U(s[H] + lane)] = h
        w[U(s[LAST] + lane)] = 1.0 if h >= left * (1.0 - 1e-12) else 0.0
        w[U(s[ACCEPTED] + lane)] = w[U(s[ACTIVE] + lane)]


@inlined
def end_lane(s, w, lane):
    """A lane goes no further: not in this sample, and not in the next."""
    w[U(s[ALIVE] + lane)] = w[U(s[ACTIVE] + lane)] = w[U(s[ACCEPTED] + lane)] = 0.0


@apart
def end_flagged(s, w, flags):
    """End the lanes with such a flag."""
    for lane in range(s[LANES]):
        if w[U(flags + lane)] != 0.0:
            end_lane(s, w, lane)


@apart
def accept_steps(s, w):
    """Whether the step of each lane is accurate enough, and the length that it tries next.

    SLOPE is the rate of the error.
    """
    n, method = s[STATES], s[METHOD]
    absolute, relative = w[U(method + ABSOLUTE)], w[U(method + RELATIVE)]
    order = w[U(method + ORDER)]
    for lane in range(s[LANES]):
        if w[U(s[ACCEPTED] + lane)] == 0.0:
            continue
        h, trial = w[U(s[H] + lane)], note(s, TRIAL) + lane
        total = 0.0
        for i in range(n):
            j = i * WIDTH + lane
            size = max(abs(w[U(s[Q] + j)]), abs(w[U(s[NEW] + j)]))
            total += (h * w[U(s[SLOPE] + j)] / (absolute + relative * size)) ** 2
        size = math.sqrt(total / n)
        if not size <= 1.0:
            w[U(note(s, REJECTED) + lane)] += 1.0
            factor = 0.2
            if math.isfinite(size):
                factor = max(0.2, 0.9 * size ** (-1.0 / order))
            w[U(trial)] = h * factor
            w[U(s[ACCEPTED] + lane)] = 0.0
            if w[U(trial)] < 1e-12 * w[U(method + SAMPLE_TIME)]:
                end_lane(s, w, lane)
            continue
        grown = h * min(5.0, 0.9 * max(size, 1e-10) ** (-1.0 / order))
        if h >= w[U(trial)] or grown > w[U(trial)]:
            w[U(trial)] = grown


@apart
def advance(s, w, stiff_at, stop):
    """All lanes by one sample time from T; those that diverge are no longer ALIVE.

    ELAPSED is the time within the sample when a lane diverged.
    """
    n, watched, stages, adaptive = s[STATES] * WIDTH, s[WATCHED], s[STAGES], s[ADAPTIVE]
    t, q, k0, k1, new, plant = s[T], s[Q], s[STAGE], s[K1], s[NEW], s[PLANT]
    leaf(s, w, START, t, t, t, t, s[H])
    field(s, w, t, q, k0)
    if watched > 0:
        leaf(s, w, CONSTRAINT_RATES, t, q, k0, plant, s[D0])
    if adaptive:
        for lane in range(s[LANES]):
            stiff_at[lane] = w[U(note(s, REJECTED) + lane)] + AWAY
    done = 0
    while any_of(w, s[ACTIVE]):
        if adaptive:
            next_lengths(s, w, stiff_at, stop)
        for stage in range(1, stages):
            call_leaf(s[PER_MODE + stage - 1], w, t, q, k0, t, s[BETWEEN])
            field(s, w, s[AT], s[BETWEEN], k0 + stage * n)
        leaf(s, w, STEPPED, t, q, k0, t, s[THEN])
        if adaptive:
            leaf(s, w, ERROR, t, q, k0, t, s[SLOPE])
            accept_steps(s, w)
        if any_of(w, s[WILD]):
            for lane in range(s[LANES]):
                if w[U(s[ACCEPTED] + lane)] == 0.0:
                    w[U(s[WILD] + lane)] = 0.0  # the step is refused anyway
            end_flagged(s, w, s[WILD])
        done += 1
        if watched > 0 or adaptive or done < s[SUBSTEPS]:
            field(s, w, s[THEN], new, k1)
        if watched > 0:
            leaf(s, w, CONSTRAINED, s[THEN], new, new, plant, s[C1])
            leaf(s, w, CONSTRAINT_RATES, s[THEN], new, k1, plant, s[D1])
            leaf(s, w, WATCH, t, s[C0], s[C1], s[OUTCOME], s[CLOSE])
            if any_of(w, s[UNBOUNDED]):
                end_flagged(s, w, s[UNBOUNDED])
            if any_of(w, s[CLOSE]):
                watch_closely(s, w)
            leaf(s, w, TAKE, t, s[C0], s[C1], t, s[C0])
        leaf(s, w, ACCEPT, t, q, new, t, q)
        leaf(s, w, TICK, t, t, t, t, s[ACCEPTED])
