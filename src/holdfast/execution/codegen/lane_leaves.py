"""Leaves that no program decides: samples, the steps of a Runge-Kutta method, notes of a run.

They depend on the numbers of states, constraints and actuators only. Flags are 1 or 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from holdfast.execution.arithmetic.basics import greatest, least
from holdfast.execution.arithmetic.exponential import power
from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose, root
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.simulation.outcomes import Outcome

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
    found = {
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
        found[f"stage{k}"] = made(_stage(a[k], c[k], n), t=len(CLOCK), q=n, x=k * n)
    return {name: leaf for name, leaf in found.items() if leaf.results}


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
    values = {array: [steps.input(name) for name in own] for array, own in names.items()}
    return Leaf(steps, names, results(steps, values))


def clock(values: Rows) -> dict[str, Value]:
    """The rows of the clock by their names."""
    return dict(zip(CLOCK, values["t"], strict=True))


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
    found = []
    for i in range(n):
        total: Value | None = None
        for k, weight in enumerate(weights):
            if weight != 0.0:
                term = weight * stages[k * n + i]
                total = term if total is None else total + term
        found.append(stages[0].steps.constant(0.0, FLOAT) if total is None else total)
    return found


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
    found = abs(values[0]) < bound
    for value in values[1:]:
        found = found & (abs(value) < bound)
    return found


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
