"""Times inside a step when an inequality peaks or is violated."""

# mypy: ignore-errors
# ruff: noqa: F405

from holdfast.execution.simulation.block import *  # noqa: F403

# -- joined from here on


@inlined
def constraints_at(s, w, fraction):
    """INSIDE = c_j of every lane at its fraction of a step from Q to NEW."""
    leaf(s, w, BETWEEN_ENDS, s[T], s[Q], s[NEW], fraction, s[BETWEEN])
    leaf(s, w, CONSTRAINED, s[T], s[BETWEEN], s[T], s[PLANT], s[INSIDE])


@apart
def peak_fractions(s, w, j):
    """FRACTION = the place in (0, 1) where c_j is largest, on a step where it rises, then falls.

    By golden section along the interpolated state, so that a kink (the smaller of two
    constraints, a magnitude) is found as well as a smooth peak.
    """
    ratio = 0.6180339887498949
    lower, upper = np.zeros(WIDTH), np.ones(WIDTH)
    left, right = np.full(WIDTH, 1.0 - ratio), np.full(WIDTH, ratio)
    c_left, c_right = np.empty(WIDTH), np.empty(WIDTH)
    on_left = np.empty(WIDTH, dtype=np.bool_)
    tried, c = s[FRACTION], s[INSIDE] + j * WIDTH
    for i in range(s[LANES]):
        w[U(tried + i)] = left[i]
    constraints_at(s, w, tried)
    for i in range(s[LANES]):
        c_left[i] = w[U(c + i)]
        w[U(tried + i)] = right[i]
    constraints_at(s, w, tried)
    for i in range(s[LANES]):
        c_right[i] = w[U(c + i)]
    for _ in range(40):
        for i in range(s[LANES]):
            on_left[i] = c_left[i] > c_right[i]
            if on_left[i]:
                upper[i], right[i], c_right[i] = right[i], left[i], c_left[i]
                left[i] = upper[i] - ratio * (upper[i] - lower[i])
                w[U(tried + i)] = left[i]
            else:
                lower[i], left[i], c_left[i] = left[i], right[i], c_right[i]
                right[i] = lower[i] + ratio * (upper[i] - lower[i])
                w[U(tried + i)] = right[i]
        constraints_at(s, w, tried)
        for i in range(s[LANES]):
            if on_left[i]:
                c_left[i] = w[U(c + i)]
            else:
                c_right[i] = w[U(c + i)]
    for i in range(s[LANES]):
        w[U(tried + i)] = 0.5 * (lower[i] + upper[i])


@apart
def crossing_fractions(s, w, j, at):
    """FRACTION = where a step first has c_j above the tolerance, by bisection below `at`."""
    level, middle = w[U(s[TOLERANCE])], s[FRACTION]
    lower, upper = np.zeros(WIDTH), at.copy()
    for _ in range(50):
        for i in range(s[LANES]):
            w[U(middle + i)] = 0.5 * (lower[i] + upper[i])
        constraints_at(s, w, middle)
        for i in range(s[LANES]):
            if w[U(s[INSIDE] + j * WIDTH + i)] > level:
                upper[i] = w[U(middle + i)]
            else:
                lower[i] = w[U(middle + i)]
    for i in range(s[LANES]):
        w[U(middle + i)] = upper[i]


@inlined
def rises_above(s, w, j, lane):
    """Whether c_j may have a peak above its largest value so far, inside the step."""
    i = j * WIDTH + lane
    c0, d0, c1, d1 = w[U(s[C0] + i)], w[U(s[D0] + i)], w[U(s[C1] + i)], w[U(s[D1] + i)]
    return (
        w[U(s[CLOSE] + lane)] != 0.0
        and d0 > 0.0
        and d1 < 0.0
        and tangent_bound(w[U(s[H] + lane)], c0, d0, c1, d1) > w[U(s[WORST] + j * WIDTH + lane)]
    )


@apart
def watch_closely(s, w):
    """The largest c_j and the exits of the lanes whose step has a peak inside it, or an exit."""
    level, outcome = w[U(s[TOLERANCE])], s[OUTCOME]
    top, at, flag = np.empty(WIDTH), np.ones(WIDTH), np.empty(WIDTH, dtype=np.bool_)
    earliest, culprit = np.full(WIDTH, 2.0), np.full(WIDTH, -1)
    for j in range(s[WATCHED]):
        worst = s[WORST] + j * WIDTH
        peaks = crosses = False
        for lane in range(s[LANES]):
            top[lane], at[lane] = w[U(s[C1] + j * WIDTH + lane)], 1.0
            flag[lane] = rises_above(s, w, j, lane)
            peaks = peaks or flag[lane]
        if peaks:
            peak_fractions(s, w, j)
            constraints_at(s, w, s[FRACTION])
            for lane in range(s[LANES]):
                inner = w[U(s[INSIDE] + j * WIDTH + lane)]
                if flag[lane] and inner > top[lane]:
                    top[lane], at[lane] = inner, w[U(s[FRACTION] + lane)]
        for lane in range(s[LANES]):
            flag[lane] = False
            if w[U(s[CLOSE] + lane)] != 0.0:
                w[U(worst + lane)] = max(w[U(worst + lane)], top[lane])
                flag[lane] = top[lane] > level and w[U(outcome + lane)] != LEFT
                crosses = crosses or flag[lane]
        if crosses:
            crossing_fractions(s, w, j, at)
            for lane in range(s[LANES]):
                if flag[lane] and w[U(s[FRACTION] + lane)] < earliest[lane]:
                    earliest[lane], culprit[lane] = w[U(s[FRACTION] + lane)], j
    for lane in range(s[LANES]):
        if culprit[lane] >= 0:
            began = w[U(s[T] + lane)] + w[U(s[ELAPSED] + lane)]
            w[U(outcome + lane)] = LEFT
            w[U(note(s, EXIT_TIME) + lane)] = began + earliest[lane] * w[U(s[H] + lane)]
            w[U(note(s, EXIT_CONSTRAINT) + lane)] = culprit[lane]
