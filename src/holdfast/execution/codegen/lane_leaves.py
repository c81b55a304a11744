"""Leaves that no program decides: of a sample, a step, a crossing, a mode, and random numbers.

They depend on the numbers of states, constraints and actuators only. Flags are 1 or 0.

The peak of c_j inside a step is found by golden section along the interpolated state, so that a
kink (the smaller of two constraints, a magnitude) is found as well as a smooth peak; the time at
which an inequality is violated by bisection. Of a controller there are its mode, its command and
its safeguard's notes; random are measurement noise, starts, and what differs from run to run.

A random number depends on a counter and a seed only: no run depends on how many there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from holdfast.execution.arithmetic.elementary import logarithm, power, sine_and_cosine
from holdfast.execution.arithmetic.steps import (
    FLOAT,
    WHOLE,
    Steps,
    Value,
    bits,
    choose,
    from_bits,
    greatest,
    least,
    root,
)
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.simulation.settings import Outcome

UNIFORM, START, NORMAL, VARIED, WANDER = 1, 2, 3, 4, 5
"""Purposes of random numbers, so that no two uses share a counter."""

_TWO_52 = 2.0**52
_BITS_OF_TWO_52 = 0x4330000000000000
_WORD = 0xFFFFFFFF


def whole(x: Value) -> Value:
    """A float that is an integer of 0 to 2^52 - 1, as an integer."""
    return bits(x + _TWO_52) ^ _BITS_OF_TWO_52


def number(x: Value) -> Value:
    """An integer of 0 to 2^52 - 1 as a float."""
    return from_bits(x ^ _BITS_OF_TWO_52) - _TWO_52


def philox(counter: tuple[Value, ...], key: tuple[Value, Value]) -> tuple[Value, ...]:
    """Philox4x32-10 (J. Salmon et al., SC'11): four 32-bit words from a counter and a key."""
    x0, x1, x2, x3 = counter
    a, b = key
    for _ in range(10):
        first, second = x0 * 0xD2511F53, x2 * 0xCD9E8D57
        x0, x1, x2, x3 = (
            (second >> 32) ^ x1 ^ a, second & _WORD, (first >> 32) ^ x3 ^ b, first & _WORD
        )  # fmt: skip
        a, b = (a + 0x9E3779B9) & _WORD, (b + 0xBB67AE85) & _WORD
    return x0, x1, x2, x3


def two_uniforms(
    seed: tuple[Value, Value], run: Value, sample: Value, channel: int, purpose: int
) -> tuple[Value, Value]:
    """Two numbers in (0, 1) that depend on these only; seed: its lower and upper 32 bits.

    seed, run and sample are floats that are integers; 32 bits of each count.
    """
    steps: Steps = run.steps
    w = philox(
        (
            whole(sample) & _WORD, whole(run) & _WORD,
            steps.constant(channel, WHOLE), steps.constant(purpose, WHOLE),
        ),
        (whole(seed[0]), whole(seed[1])),
    )  # fmt: skip

    def uniform(high: Value, low: Value) -> Value:
        return (number(high >> 5) * 67108864.0 + number(low >> 6) + 0.5) * 2.0**-53

    return uniform(w[0], w[1]), uniform(w[2], w[3])


def normal(a: Value, b: Value) -> Value:
    """A normal number of mean 0 and variance 1, from two uniform ones (Box and Muller)."""
    deviate: Value = root(-2.0 * logarithm(a)) * sine_and_cosine(2.0 * math.pi * b)[1]
    return deviate


CLOCK = (
    "length", "last_index", "tolerance", "sample_time", "delay", "absolute", "relative",
    "sample", "back", "seen_at", "time", "h", "elapsed", "index", "last", "trial", "rejected",
    "accepted", "active", "alive", "outcome", "exit_time", "exit_constraint",
)  # fmt: skip
"""The rows of a block that every leaf here may read as `t`. A leaf that writes some of them writes
all from one row to another."""

DIVERGED_AT = 1e9
MOST_STEPS = 1_000_000
"""Adaptive steps within one control sample."""

Rows = Mapping[str, Sequence[Value]]
Results = Callable[[Steps, Rows], list[Value]]


def step_leaves(
    a: Sequence[Sequence[float]],
    b: Sequence[float],
    gap: Sequence[float],
    c: Sequence[float],
    *,
    order: int,
    states: int,
    constraints: int,
) -> dict[str, Leaf]:
    """The leaves of a method with the weights a, b and b - b_low, for so many quantities."""
    n, stages = states, len(b)
    leaves = {
        "clock": made(_sampled, t=len(CLOCK)),
        "start": made(_start, t=len(CLOCK)),
        "lengths": made(_lengths, t=len(CLOCK)),
        "new": made(_new(b, n), t=len(CLOCK), q=n, x=stages * n),
        "judge": made(_judge(gap, n, order), t=len(CLOCK), q=n, x=n, p=stages * n),
        "accept": made(_accept, t=len(CLOCK), q=2 * n, x=2 * n),
        "move": made(_accept, t=len(CLOCK), q=n, x=n),
        "tick": made(_tick, t=len(CLOCK)),
        "end": made(_end, t=len(CLOCK), q=1),
        "watch": made(
            _watch(constraints), t=len(CLOCK), q=2 * constraints, x=2 * constraints, p=constraints
        ),
        "take": made(_accept, t=len(CLOCK), q=2 * constraints, x=2 * constraints),
    }
    for k in range(1, stages):
        leaves[f"stage{k}"] = made(_stage(a[k], c[k], n), t=len(CLOCK), q=n, x=k * n)
    return {name: leaf for name, leaf in leaves.items() if leaf.results}


def note_leaves(actuation: int, peaks: Sequence[int], bounded: int = 0) -> dict[str, Leaf]:
    """The leaves that note what a sample adds to a run.

    actuation: rows that have to be numbers; peaks: those whose largest magnitudes are noted;
    bounded: how many disturbances have to stay within their bounds.
    """
    return {
        "exceed": made(_exceed, t=len(CLOCK), q=1 + bounded, x=1 + bounded),
        "arrive": made(_arrive, t=len(CLOCK), q=1, x=1),
        "rest": made(_rest, t=len(CLOCK), q=1),
        "peaks": made(_peaks(peaks), t=len(CLOCK), q=actuation, p=len(peaks)),
    }


def made(results: Results, **rows: int) -> Leaf:
    """The leaf with these results of arrays with so many rows."""
    steps = Steps(expanded=True)
    names = {array: [f"{array}{i}" for i in range(rows.get(array, 0))] for array in "tqxp"}
    values = {array: _Inputs(steps, row_names) for array, row_names in names.items()}
    return Leaf(steps, names, results(steps, values))


class _Inputs(Sequence[Value]):
    """Rows that become inputs of the steps when they are asked for: a leaf reads few of many."""

    def __init__(self, steps: Steps, names: Sequence[str]) -> None:
        self.steps, self.names = steps, names

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return _Inputs(self.steps, self.names[place])
        return self.steps.input(self.names[place])


class _Clock(dict[str, Value]):
    """The rows of the clock by their names."""

    def __init__(self, rows: Sequence[Value]) -> None:
        super().__init__()
        self.rows = rows

    def __missing__(self, name: str) -> Value:
        return self.rows[CLOCK.index(name)]


def clock(values: Rows) -> dict[str, Value]:
    """The rows of the clock by their names."""
    return _Clock(values["t"])


def flag(condition: Value) -> Value:
    return choose(condition, 1.0, 0.0)


def _sampled(steps: Steps, values: Rows) -> list[Value]:
    """sample .. elapsed: of the next sample."""
    at, none = clock(values), steps.constant(0.0, FLOAT)
    k, back = at["sample"], at["sample"] - at["delay"]
    back = choose(back > 0.0, back, 0.0)
    return [k + 1.0, back, back * at["sample_time"], k * at["sample_time"], none, none]


def _start(steps: Steps, values: Rows) -> list[Value]:
    """h .. active: before the first step of a sample."""
    at, none = clock(values), steps.constant(0.0, FLOAT)
    last = flag(at["last_index"] <= 0.0)
    return [
        at["length"], none, none, last, at["trial"], at["rejected"], at["alive"], at["alive"]
    ]  # fmt: skip


def _tick(steps: Steps, values: Rows) -> list[Value]:
    """elapsed .. active: after a step."""
    at = clock(values)
    index = at["index"] + at["accepted"]
    active = at["active"] - at["accepted"] * at["last"]
    elapsed = at["elapsed"] + at["accepted"] * at["h"]
    last = flag(index >= at["last_index"])
    return [elapsed, index, last, at["trial"], at["rejected"], active, active]


def _ended(at: Mapping[str, Value], ends: Value, accepted: Value) -> list[Value]:
    """accepted .. exit_time: those that are flagged go no further, now and in the next sample."""
    ends = ends & at["alive"].differs(0.0)
    first = ends & at["outcome"].differs(Outcome.LEFT)
    return [
        choose(ends, 0.0, accepted),
        choose(ends, 0.0, at["active"]),
        choose(ends, 0.0, at["alive"]),
        choose(ends, Outcome.DIVERGED, at["outcome"]),
        choose(first, at["time"] + at["elapsed"], at["exit_time"]),
    ]


def _end(steps: Steps, values: Rows) -> list[Value]:
    """accepted .. exit_time: the lanes with the flag q diverged."""
    at = clock(values)
    return _ended(at, values["q"][0].differs(0.0), at["accepted"])


def _lengths(steps: Steps, values: Rows) -> list[Value]:
    """h .. exit_time: how far each lane steps, and whether it is the last step of the sample."""
    at = clock(values)
    left = at["sample_time"] - at["elapsed"]
    h = least(at["trial"], left)
    last = flag(h >= left * (1.0 - 1e-12))
    many = at["active"].differs(0.0) & (at["index"] > float(MOST_STEPS))
    return [
        h, at["elapsed"], at["index"], last, at["trial"], at["rejected"],
        *_ended(at, many, at["active"]),
    ]  # fmt: skip


def _judge(gap: Sequence[float], n: int, order: int) -> Results:
    """trial .. exit_time: whether a step from q to x is accurate enough, and the next to try.

    p: the rates of the stages.
    """

    def results(steps: Steps, values: Rows) -> list[Value]:
        at = clock(values)
        h, accepted, total = at["h"], at["accepted"].differs(0.0), steps.constant(0.0, FLOAT)
        for old, new, rate in zip(values["q"], values["x"], _sum(gap, values["p"], n), strict=True):
            bound = at["absolute"] + at["relative"] * greatest(abs(old), abs(new))
            error = h * rate / bound
            total = total + error * error
        size = root(total / float(n))
        good = size <= 1.0
        factor = 0.9 * power(choose(size > 1e-10, size, 1e-10), -1.0 / order)
        shorter = choose((size < float("inf")) & (factor > 0.2), factor, 0.2)
        grown = h * choose(factor < 5.0, factor, 5.0)
        longer = choose((h >= at["trial"]) | (grown > at["trial"]), grown, at["trial"])
        trial = choose(accepted, choose(good, longer, h * shorter), at["trial"])
        refused = accepted & ~good
        wild = accepted & good & ~all_below(values["x"], DIVERGED_AT)
        tiny = refused & (trial < 1e-12 * at["sample_time"])
        rejected = at["rejected"] + flag(refused)
        return [trial, rejected, *_ended(at, wild | tiny, flag(accepted & good))]

    return results


def _sum(weights: Sequence[float], stages: Sequence[Value], n: int) -> list[Value]:
    """weights . stages, without the terms of weight 0."""
    sums = []
    for i in range(n):
        total: Value | None = None
        for k, weight in enumerate(weights):
            if weight != 0.0:
                term = weight * stages[k * n + i]
                total = term if total is None else total + term
        sums.append(stages[0].steps.constant(0.0, FLOAT) if total is None else total)
    return sums


def _stage(weights: Sequence[float], c: float, n: int) -> Results:
    """The state of a stage, and its time."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        at = clock(values)
        slopes = _sum(weights, values["x"], n)
        moved = [q + at["h"] * s for q, s in zip(values["q"], slopes, strict=True)]
        return [*moved, at["time"] + at["elapsed"] + c * at["h"]]

    return results


def _new(weights: Sequence[float], n: int) -> Results:
    """The time at the end of a step, whether the state is beyond its bound, and the state."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        at = clock(values)
        slopes = _sum(weights, values["x"], n)
        moved = [q + at["h"] * s for q, s in zip(values["q"], slopes, strict=True)]
        wild = choose(all_below(moved, DIVERGED_AT), 0.0, at["accepted"])
        return [at["time"] + at["elapsed"] + at["h"], wild, *moved]

    return results


def all_below(values: Sequence[Value], bound: float) -> Value:
    below = abs(values[0]) < bound
    for value in values[1:]:
        below = below & (abs(value) < bound)
    return below


def _accept(steps: Steps, values: Rows) -> list[Value]:
    """The values x in place of q where the step is accepted."""
    taken = clock(values)["accepted"].differs(0.0)
    return [choose(taken, x, q) for q, x in zip(values["q"], values["x"], strict=True)]


def _watch(count: int) -> Results:
    """close, unbounded, rises of each c_j, the largest c_j: of q = (c, dc/dt) to x; p: the largest.

    rises: c_j may have a peak above its largest value inside the step. close: some c_j does, or
    exceeds the tolerance; then the largest values are left to a closer look. unbounded: some c_j is
    not a finite number.
    """

    def results(steps: Steps, values: Rows) -> list[Value]:
        if not count:
            return []
        at, worst = clock(values), values["p"]
        h, inside = at["h"], at["outcome"].differs(Outcome.LEFT)
        finite = all_below(values["x"][:count], float("inf"))
        taken = at["accepted"].differs(0.0)
        close = steps.constant(0.0, FLOAT).differs(0.0)
        rises = []
        for j in range(count):
            c0, d0, c1, d1 = (values[k][i] for k in "qx" for i in (j, count + j))
            s = (c1 - c0 - h * d1) / (h * (d0 - d1))  # where the tangents at both ends meet
            rises.append((d0 > 0.0) & (d1 < 0.0) & (c0 + h * d0 * s > worst[j]))
            close = close | rises[j] | ((c1 > at["tolerance"]) & inside)
        close = close & taken & finite
        usual = taken & finite & ~close
        more = [
            choose(usual & (c1 > old), c1, old)
            for c1, old in zip(values["x"][:count], worst, strict=True)
        ]
        return [flag(close), flag(taken & ~finite), *(flag(close & one) for one in rises), *more]

    return results


def _arrive(steps: Steps, values: Rows) -> list[Value]:
    """Since when a lane is in the goal (NaN: it is not), from its level q and the former time x."""
    at, (level,), (since,) = clock(values), values["q"], values["x"]
    nan = steps.constant(float("nan"), FLOAT)
    begins = since.differs(since) & at["alive"].differs(0.0)
    return [choose(level <= 0.0, choose(begins, at["time"], since), nan)]


def _rest(steps: Steps, values: Rows) -> list[Value]:
    """alive: no longer where a lane is in the goal since the time q."""
    (since,) = values["q"]
    return [choose(since.differs(since), clock(values)["alive"], 0.0)]


def _exceed(steps: Steps, values: Rows) -> list[Value]:
    """When a disturbance first exceeded its bounds (NaN: never), and its values then.

    q: the excess, then the values now; x: what was noted before.
    """
    at, (excess, *now), (since, *then) = clock(values), values["q"], values["x"]
    begins = since.differs(since) & at["alive"].differs(0.0) & ~(excess <= 0.0)
    pairs = zip((at["time"], *now), (since, *then), strict=True)
    return [choose(begins, new, old) for new, old in pairs]


def _peaks(rows: Sequence[int]) -> Results:
    """Whether some value of a lane is not a finite number, and the largest magnitudes so far."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        alive = clock(values)["alive"]
        good = all_below(values["q"], float("inf")) & alive.differs(0.0)
        sizes = [abs(values["q"][row]) for row in rows]
        largest = [
            choose(good & (size > old), size, old)
            for size, old in zip(sizes, values["p"], strict=True)
        ]
        return [choose(good, 0.0, alive), *largest]

    return results


SEARCH = (
    "number", "earliest", "culprit", "top", "top_at", "crosses", "lower", "upper", "left", "right",
    "c_left", "c_right", "on_left", "fraction",
)  # fmt: skip
"""Rows of a search: which constraint, the first violation so far and its constraint, the largest
c_j and its place, whether it is violated; and the ends and places of a search in (0, 1)."""

GOLDEN_STEPS, BISECTION_STEPS = 40, 50
_RATIO = 0.6180339887498949


def crossing_leaves(states: int) -> dict[str, Leaf]:
    """The leaves of a search along a step of a system with so many states.

    Most read the clock as t, the rows of `SEARCH` as q, and c_j at the fraction as x.
    """
    leaves = {
        "between": made(_between, t=len(CLOCK), q=2 * states, x=2 * states, p=1),
        "raise": made(_raise, q=len(SEARCH), x=1, p=1),
    }
    for name, results in _RESULTS.items():
        leaves[name] = made(results, t=len(CLOCK), q=len(SEARCH), x=1, p=1)
    return leaves


def _between(steps: Steps, values: Rows) -> list[Value]:
    """The state at the fraction p of a step, by Hermite's polynomial: q, dq/dt at both ends; and
    the time there."""
    at = clock(values)
    (s,), h, n = values["p"], at["h"], len(values["q"]) // 2
    a, da, b, db = values["q"][:n], values["q"][n:], values["x"][:n], values["x"][n:]
    s2 = s * s
    w = 3.0 * s2 - 2.0 * s2 * s
    rises = [(s - 2.0 * s2 + s2 * s) * u + (s2 * s - s2) * v for u, v in zip(da, db, strict=True)]
    moved = [(1.0 - w) * x + w * y + h * rise for x, y, rise in zip(a, b, rises, strict=True)]
    return [*moved, at["time"] + at["elapsed"] + s * h]


def _rows(values: Rows) -> dict[str, Value]:
    return dict(zip(SEARCH, values["q"], strict=True))


def _search(steps: Steps, values: Rows) -> list[Value]:
    """number .. culprit: no constraint is tried yet."""
    return [steps.constant(value, FLOAT) for value in (-1.0, 2.0, -1.0)]


def _open(steps: Steps, values: Rows) -> list[Value]:
    """number .. top_at: the next constraint, whose value at the end of the step is x."""
    at = _rows(values)
    return [
        at["number"] + 1.0, at["earliest"], at["culprit"],
        values["x"][0], steps.constant(1.0, FLOAT),
    ]  # fmt: skip


def _golden(steps: Steps, values: Rows) -> list[Value]:
    """lower .. fraction: the whole step, to be tried on the left."""
    none, one = steps.constant(0.0, FLOAT), steps.constant(1.0, FLOAT)
    left, right = steps.constant(1.0 - _RATIO, FLOAT), steps.constant(_RATIO, FLOAT)
    return [none, one, left, right, none, none, none, left]


def _golden_left(steps: Steps, values: Rows) -> list[Value]:
    """c_left .. fraction: found on the left, to be tried on the right."""
    at = _rows(values)
    return [values["x"][0], at["c_right"], at["on_left"], at["right"]]


def _golden_right(steps: Steps, values: Rows) -> list[Value]:
    """c_right."""
    return [values["x"][0]]


def _golden_turn(steps: Steps, values: Rows) -> list[Value]:
    """lower .. fraction: the part with the larger value, and where it is tried next."""
    at = _rows(values)
    on_left = at["c_left"] > at["c_right"]
    lower, upper = (
        choose(on_left, at["lower"], at["left"]),
        choose(on_left, at["right"], at["upper"]),
    )
    width = _RATIO * (upper - lower)
    left = choose(on_left, upper - width, at["right"])
    right = choose(on_left, at["left"], lower + width)
    c = choose(on_left, at["c_left"], at["c_right"])  # of the place that is kept
    return [lower, upper, left, right, c, c, flag(on_left), choose(on_left, left, right)]


def _golden_take(steps: Steps, values: Rows) -> list[Value]:
    """c_left, c_right: the new value x in its place."""
    at, x = _rows(values), values["x"][0]
    on_left = at["on_left"].differs(0.0)
    return [choose(on_left, x, at["c_left"]), choose(on_left, at["c_right"], x)]


def _golden_end(steps: Steps, values: Rows) -> list[Value]:
    """fraction: the middle of what is left."""
    at = _rows(values)
    return [0.5 * (at["lower"] + at["upper"])]


def _peaked(steps: Steps, values: Rows) -> list[Value]:
    """top, top_at: the peak x in lanes with the flag p, if it is larger."""
    at, x = _rows(values), values["x"][0]
    higher = values["p"][0].differs(0.0) & (x > at["top"])
    return [choose(higher, x, at["top"]), choose(higher, at["fraction"], at["top_at"])]


def _raise(steps: Steps, values: Rows) -> list[Value]:
    """The largest c_j so far, x, in lanes with the flag p."""
    top, x = _rows(values)["top"], values["x"][0]
    return [choose(values["p"][0].differs(0.0) & (top > x), top, x)]


def _crosses(steps: Steps, values: Rows) -> list[Value]:
    """crosses: whether a lane with the flag p leaves its region in this step by this c_j."""
    at, now = _rows(values), clock(values)
    leaves = (at["top"] > now["tolerance"]) & now["outcome"].differs(Outcome.LEFT)
    return [flag(values["p"][0].differs(0.0) & leaves)]


def _bisect(steps: Steps, values: Rows) -> list[Value]:
    """lower .. fraction: the step up to its peak, to be tried in the middle."""
    at, none = _rows(values), steps.constant(0.0, FLOAT)
    upper = at["top_at"]
    return [none, upper, none, none, none, none, none, 0.5 * (none + upper)]


def _bisect_turn(steps: Steps, values: Rows) -> list[Value]:
    """lower .. fraction: the half in which c_j, which is x in the middle, exceeds the tolerance."""
    at = _rows(values)
    above = values["x"][0] > clock(values)["tolerance"]
    lower = choose(above, at["lower"], at["fraction"])
    upper = choose(above, at["fraction"], at["upper"])
    between = [at[name] for name in SEARCH[SEARCH.index("left") : SEARCH.index("fraction")]]
    return [lower, upper, *between, 0.5 * (lower + upper)]


def _crossed(steps: Steps, values: Rows) -> list[Value]:
    """earliest, culprit: this constraint, if it is violated first."""
    at = _rows(values)
    first = at["crosses"].differs(0.0) & (at["upper"] < at["earliest"])
    return [
        choose(first, at["upper"], at["earliest"]), choose(first, at["number"], at["culprit"])
    ]  # fmt: skip


def _leave(steps: Steps, values: Rows) -> list[Value]:
    """outcome, exit_time, exit_constraint of the clock."""
    at, now = _rows(values), clock(values)
    leaves = at["culprit"] >= 0.0
    time = now["time"] + now["elapsed"] + at["earliest"] * now["h"]
    return [
        choose(leaves, Outcome.LEFT, now["outcome"]),
        choose(leaves, time, now["exit_time"]),
        choose(leaves, at["culprit"], now["exit_constraint"]),
    ]


_RESULTS: dict[str, Results] = {
    "search": _search, "open": _open, "golden": _golden, "golden_left": _golden_left,
    "golden_right": _golden_right, "golden_turn": _golden_turn, "golden_take": _golden_take,
    "golden_end": _golden_end, "peaked": _peaked, "crosses": _crosses, "bisect": _bisect,
    "bisect_turn": _bisect_turn, "crossed": _crossed, "leave": _leave,
}  # fmt: skip


SWITCHES = ("since", "switches", "shortest", "recent", "mode")
"""Rows of a mode, followed by a flag for each mode that lanes are in, and by `TURNS`.

since: when the mode changed; recent: how often within a second.
"""
TURNS = ("time_in_mode", "next_mode", "changed", "forgotten")
"""Rows that a sample fills; forgotten: a change that is a second ago."""


def mode_leaves(
    targets: Sequence[Sequence[int]],
    conditions: Sequence[tuple[int, int]],
    foresights: Sequence[tuple[int, ...]],
    inputs: int,
    switch_limit: int,
) -> dict[str, Leaf]:
    """The leaves of modes whose guards have these targets and whose safeguards these conditions.

    switch_limit: changes of mode within a second beyond which a run chatters.
    """
    modes, safeguarded = len(targets), any(count for count, _ in conditions)
    extra = 2 if safeguarded else 0
    rows = {"t": len(CLOCK), "q": len(SWITCHES), "x": len(TURNS)}
    leaves = {}
    if modes > 1:
        leaves["where"] = made(_where(modes), **rows)
    if any(targets):
        leaves["changed"] = made(_changed, **rows)
        leaves["switch"] = made(_switch(modes), **rows)
        leaves["chatter"] = made(_chatter(switch_limit), **rows)
    for k, of_mode in enumerate(targets):
        if of_mode:
            leaves[f"turn{k}"] = made(_turn(k, of_mode), t=1, q=len(of_mode), x=1)
    if modes > 1 or safeguarded:
        for k in range(modes):
            leaves[f"blend{k}"] = made(_blend(k, inputs), t=1, q=2 * inputs + extra, x=inputs)
    if safeguarded:
        leaves["kept"] = made(_kept, t=len(CLOCK), q=5)
    for k, (count, _) in enumerate(conditions):
        if count:
            answer = inputs + count * (inputs + 1)
            leaves[f"held{k}"] = made(
                _held(k, inputs, count, bool(foresights[k])), t=len(CLOCK), q=answer, x=1
            )
    return leaves


def _switching(values: Rows) -> dict[str, Value]:
    named = dict(zip(SWITCHES, values["q"], strict=True))
    at = clock(values)
    at.update({**named, **dict(zip(TURNS, values["x"], strict=True))})
    return at


def _in_modes(mode: Value, alive: Value, modes: int) -> list[Value]:
    return [choose(mode.equals(float(k)), alive, 0.0) for k in range(modes)]


def _where(modes: int) -> Results:
    """The flags of the modes, time_in_mode and next_mode."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        at = _switching(values)
        flags = _in_modes(at["mode"], at["alive"], modes)
        return [*flags, at["time"] - at["since"], at["mode"]]

    return results


def _turn(k: int, targets: Sequence[int]) -> Results:
    """The next mode x of lanes in mode k: the target of the first level q that is not negative."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        (mode,), (next_mode,) = values["t"], values["x"]
        mine = mode.equals(float(k))
        for level, target in reversed(list(zip(values["q"], targets, strict=True))):
            next_mode = choose(mine & (level >= 0.0), float(target), next_mode)
        return [next_mode]

    return results


def _changed(steps: Steps, values: Rows) -> list[Value]:
    at = _switching(values)
    return [choose(at["next_mode"].differs(at["mode"]), at["alive"], 0.0)]


def _switch(modes: int) -> Results:
    """The rows of `SWITCHES` and the flags of the modes, after the modes changed."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        at = _switching(values)
        changes = at["changed"].differs(0.0)
        dwell = at["time"] - at["since"]
        shorter = changes & (at["switches"] > 0.0) & (dwell < at["shortest"])
        mode = choose(changes, at["next_mode"], at["mode"])
        return [
            choose(changes, at["time"], at["since"]),
            at["switches"] + at["changed"],
            choose(shorter, dwell, at["shortest"]),
            at["recent"] + at["changed"] - at["forgotten"],
            mode,
            *_in_modes(mode, at["alive"], modes),
        ]

    return results


def _chatter(limit: int) -> Results:
    """outcome, exit_time: of lanes whose mode has just changed more often than the limit."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        at = _switching(values)
        chatters = at["changed"].differs(0.0) & (at["recent"] > float(limit))
        chatters = chatters & at["outcome"].equals(Outcome.STAYED)
        return [
            choose(chatters, Outcome.CHATTERED, at["outcome"]),
            choose(chatters, at["time"], at["exit_time"]),
        ]

    return results


def _blend(k: int, inputs: int) -> Results:
    """The command, the nominal command, the slack and whether it is overruled, in lanes of mode k:
    the answer x, neither relaxed nor overruled."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        mine, none = values["t"][0].equals(float(k)), steps.constant(0.0, FLOAT)
        answer = [*values["x"], *values["x"], none, none]
        return [choose(mine, x, q) for q, x in zip(values["q"], answer, strict=False)]

    return results


def _held(k: int, inputs: int, count: int, ahead: bool) -> Results:
    """Whether the command of a lane in mode k violates a condition of its safeguard, or is NaN;
    where it looks ahead, that is not known.

    q: the command, and for each condition the entries of its normal and its offset.
    """

    def results(steps: Steps, values: Rows) -> list[Value]:
        wanted, rows = values["q"][:inputs], values["q"][inputs:]
        good = values["x"][0].differs(float(k))
        if ahead:
            return [choose(good, 0.0, clock(values)["alive"])]
        met: Value | None = None
        for j in range(count):
            *normal, offset = rows[j * (inputs + 1) : (j + 1) * (inputs + 1)]
            level = -offset
            for a, u in zip(normal, wanted, strict=True):
                level = level + a * u
            met = level <= 0.0 if met is None else met & (level <= 0.0)
        assert met is not None
        return [choose(good | met, 0.0, clock(values)["alive"])]

    return results


def _kept(steps: Steps, values: Rows) -> list[Value]:
    """How often a run was overruled, how often relaxed, and the largest slack.

    q: slack, overruled, and these three.
    """
    alive = clock(values)["alive"].differs(0.0)
    slack, overruled, overrules, infeasible, largest = values["q"]
    relaxed = alive & (slack > 0.0)
    return [
        overrules + flag(alive & (overruled > 0.0)),
        infeasible + flag(relaxed),
        choose(relaxed & (slack > largest), slack, largest),
    ]


DRAW = ("run", "draw", "seed_low", "seed_high")
"""Rows of what a number is drawn for: which run, which of its draws; the seed's two words."""


def noise_leaf(states: int) -> Leaf:
    """The states x with noise: half-widths, then standard deviations p, for `DRAW` t."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        run, sample, *seed = values["t"]
        wide, deviations = values["p"][:states], values["p"][states:]
        noisy = []
        for i, x in enumerate(values["x"]):
            a, _ = two_uniforms((seed[0], seed[1]), run, sample, i, UNIFORM)
            b, c = two_uniforms((seed[0], seed[1]), run, sample, i, NORMAL)
            noisy.append(x + wide[i] * (2.0 * a - 1.0) + deviations[i] * normal(b, c))
        return noisy

    return made(results, t=len(DRAW), x=states, p=2 * states)


def starts_leaf(count: int) -> Leaf:
    """A uniform state of the box from q to x, at the draw of `DRAW` t."""
    return made(_uniform(count, START), t=len(DRAW), q=count, x=count)


def varied_leaf(count: int) -> Leaf:
    """Uniform numbers from q to x for a run."""
    return made(_uniform(count, VARIED), t=len(DRAW), q=count, x=count)


def _uniform(count: int, purpose: int) -> Results:
    def results(steps: Steps, values: Rows) -> list[Value]:
        run, sample, *seed = values["t"]
        sample = steps.constant(0.0, FLOAT) if purpose == VARIED else sample
        drawn = []
        for i in range(count):
            a, _ = two_uniforms((seed[0], seed[1]), run, sample, i, purpose)
            low, high = values["q"][i], values["x"][i]
            drawn.append(low + a * (high - low))
        return drawn

    return results
