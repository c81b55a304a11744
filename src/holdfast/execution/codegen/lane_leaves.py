"""Leaves that no program decides: the steps of a Runge-Kutta method, and what is noted of lanes.

They depend on the numbers of states, constraints and actuators only. Flags are 1 or 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose
from holdfast.execution.codegen.llvm_text import Leaf

CLOCK = (
    "time", "alive", "length", "last_index", "tolerance", "h", "accepted", "last", "elapsed",
    "index", "active",
)  # fmt: skip
"""The rows of a block that every step of a method reads; the leaves write from `h` on."""

DIVERGED_AT = 1e9
LEFT = 2.0

Rows = Mapping[str, Sequence[Value]]


def lane_leaves(
    a: Sequence[Sequence[float]],
    b: Sequence[float],
    gap: Sequence[float],
    c: Sequence[float],
    *,
    states: int,
    constraints: int,
    actuation: int,
    peaks: Sequence[int],
    modes: int,
    inputs: int,
) -> dict[str, Leaf]:
    """The leaves of a method with the weights a, b and b - b_low, for so many quantities.

    actuation: rows that have to be numbers; peaks: those whose largest magnitudes are noted.
    """
    n, stages = states, len(b)
    found = {
        "start": _made(_start, t=len(CLOCK)),
        "new": _made(_new(b, n), t=len(CLOCK), q=n, x=stages * n),
        "error": _made(_slope(gap, n), x=stages * n),
        "accept": _made(_accept, t=len(CLOCK), q=2 * n, x=2 * n),
        "tick": _made(_tick, t=len(CLOCK)),
        "arrive": _made(_arrive, t=len(CLOCK), q=1, x=1),
        "peaks": _made(_peaks(peaks), t=len(CLOCK), q=actuation, p=len(peaks)),
        "between": _made(_between, t=len(CLOCK), q=2 * n, x=2 * n, p=1),
        "watch": _made(
            _watch(constraints), t=len(CLOCK), q=2 * constraints, x=2 * constraints,
            p=3 + constraints,
        ),
        "take": _made(_accept, t=len(CLOCK), q=2 * constraints, x=2 * constraints),
    }  # fmt: skip
    for k in range(1, stages):
        found[f"stage{k}"] = _made(_stage(a[k], c[k], n), t=len(CLOCK), q=n, x=k * n)
    for k in range(modes):
        found[f"blend{k}"] = _made(_blend(k, inputs), t=1, q=2 * inputs, x=inputs)
    return {name: leaf for name, leaf in found.items() if leaf.results}


def _made(results: Callable[[Steps, Rows], list[Value]], **rows: int) -> Leaf:
    steps = Steps(expanded=True)
    names = {array: [f"{array}{i}" for i in range(rows.get(array, 0))] for array in "tqxp"}
    values = {array: [steps.input(name) for name in own] for array, own in names.items()}
    return Leaf(steps, names, results(steps, values))


def _clock(values: Rows) -> dict[str, Value]:
    return dict(zip(CLOCK, values["t"], strict=True))


def _flag(condition: Value) -> Value:
    return choose(condition, 1.0, 0.0)


def _start(steps: Steps, values: Rows) -> list[Value]:
    """h, accepted, last, elapsed, index, active at the begin of a sample."""
    at, none = _clock(values), steps.constant(0.0, FLOAT)
    last = _flag(at["last_index"] <= 0.0)
    return [at["length"], at["alive"], last, none, none, at["alive"]]


def _tick(steps: Steps, values: Rows) -> list[Value]:
    """accepted, last, elapsed, index, active after a step."""
    at = _clock(values)
    index = at["index"] + at["accepted"]
    active = at["active"] - at["accepted"] * at["last"]
    elapsed = at["elapsed"] + at["accepted"] * at["h"]
    return [active, _flag(index >= at["last_index"]), elapsed, index, active]


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


def _stage(weights: Sequence[float], c: float, n: int) -> Callable[[Steps, Rows], list[Value]]:
    """The state of a stage, and its time."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        at = _clock(values)
        slopes = _sum(weights, values["x"], n)
        moved = [q + at["h"] * s for q, s in zip(values["q"], slopes, strict=True)]
        return [*moved, at["time"] + at["elapsed"] + c * at["h"]]

    return results


def _new(weights: Sequence[float], n: int) -> Callable[[Steps, Rows], list[Value]]:
    """The time at the end of a step, whether the state is beyond its bound, and the state."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        at = _clock(values)
        slopes = _sum(weights, values["x"], n)
        moved = [q + at["h"] * s for q, s in zip(values["q"], slopes, strict=True)]
        wild = choose(_all_below(moved, DIVERGED_AT), 0.0, at["accepted"])
        return [at["time"] + at["elapsed"] + at["h"], wild, *moved]

    return results


def _slope(weights: Sequence[float], n: int) -> Callable[[Steps, Rows], list[Value]]:
    return lambda steps, values: _sum(weights, values["x"], n)


def _all_below(values: Sequence[Value], bound: float) -> Value:
    found = abs(values[0]) < bound
    for value in values[1:]:
        found = found & (abs(value) < bound)
    return found


def _accept(steps: Steps, values: Rows) -> list[Value]:
    """The values x in place of q where the step is accepted."""
    taken = _clock(values)["accepted"].differs(0.0)
    return [choose(taken, x, q) for q, x in zip(values["q"], values["x"], strict=True)]


def _between(steps: Steps, values: Rows) -> list[Value]:
    """The state at the fraction p of a step, by Hermite's polynomial: q, dq/dt at both ends."""
    (s,), h, n = values["p"], _clock(values)["h"], len(values["q"]) // 2
    a, da, b, db = values["q"][:n], values["q"][n:], values["x"][:n], values["x"][n:]
    s2 = s * s
    w = 3.0 * s2 - 2.0 * s2 * s
    rises = [(s - 2.0 * s2 + s2 * s) * u + (s2 * s - s2) * v for u, v in zip(da, db, strict=True)]
    return [(1.0 - w) * x + w * y + h * rise for x, y, rise in zip(a, b, rises, strict=True)]


def _watch(count: int) -> Callable[[Steps, Rows], list[Value]]:
    """close, unbounded, the largest c_j: of q = (c, dc/dt) to x, with
    p = (outcome, two that are ignored, largest c_j).

    close: a constraint may have a peak inside the step, or exceeds the tolerance; then the largest
    values are left to a closer look. unbounded: some c_j is not a finite number.
    """

    def results(steps: Steps, values: Rows) -> list[Value]:
        if not count:
            return []
        at, (outcome, _, _, *worst) = _clock(values), values["p"]
        h, inside = at["h"], outcome.differs(LEFT)
        finite = _all_below(values["x"][:count], float("inf"))
        taken = at["accepted"].differs(0.0)
        close: Value | None = None
        for j in range(count):
            c0, d0, c1, d1 = (values[k][i] for k in "qx" for i in (j, count + j))
            s = (c1 - c0 - h * d1) / (h * (d0 - d1))  # where the tangents at both ends meet
            peak = (d0 > 0.0) & (d1 < 0.0) & (c0 + h * d0 * s > worst[j])
            one = peak | ((c1 > at["tolerance"]) & inside)
            close = one if close is None else close | one
        assert close is not None
        close = close & taken & finite
        usual = taken & finite & ~close
        more = [
            choose(usual & (c1 > old), c1, old)
            for c1, old in zip(values["x"][:count], worst, strict=True)
        ]
        return [_flag(close), _flag(taken & ~finite), *more]

    return results


def _arrive(steps: Steps, values: Rows) -> list[Value]:
    """Since when a lane is in the goal (NaN: it is not), from its level q and the former time x."""
    at, (level,), (since,) = _clock(values), values["q"], values["x"]
    nan = steps.constant(float("nan"), FLOAT)
    begins = since.differs(since) & at["alive"].differs(0.0)
    return [choose(level <= 0.0, choose(begins, at["time"], since), nan)]


def _peaks(rows: Sequence[int]) -> Callable[[Steps, Rows], list[Value]]:
    """Whether some value of a lane is not a finite number, and the largest magnitudes so far."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        alive = _clock(values)["alive"]
        good = _all_below(values["q"], float("inf")) & alive.differs(0.0)
        sizes = [abs(values["q"][row]) for row in rows]
        largest = [
            choose(good & (size > old), size, old)
            for size, old in zip(sizes, values["p"], strict=True)
        ]
        return [choose(good, 0.0, alive), *largest]

    return results


def _blend(k: int, inputs: int) -> Callable[[Steps, Rows], list[Value]]:
    """The command and the nominal command of q, or the answer x of mode k in its lanes."""

    def results(steps: Steps, values: Rows) -> list[Value]:
        mine = values["t"][0].equals(float(k))
        return [choose(mine, values["x"][i % inputs], value) for i, value in enumerate(values["q"])]

    return results
