"""Leaves that find the time inside a step when an inequality peaks or is violated.

The peak of c_j is found by golden section along the interpolated state, so that a kink (the smaller
of two constraints, a magnitude) is found as well as a smooth peak; the violation by bisection.
"""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose
from holdfast.execution.codegen.lane_leaves import CLOCK, Results, Rows, clock, flag, made
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.simulation.outcomes import Outcome

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
    found = {
        "between": made(_between, t=len(CLOCK), q=2 * states, x=2 * states, p=1),
        "raise": made(_raise, q=len(SEARCH), x=1, p=1),
    }
    for name, results in _RESULTS.items():
        found[name] = made(results, t=len(CLOCK), q=len(SEARCH), x=1, p=1)
    return found


def _between(steps: Steps, values: Rows) -> list[Value]:
    """The state at the fraction p of a step, by Hermite's polynomial: q, dq/dt at both ends."""
    (s,), h, n = values["p"], clock(values)["h"], len(values["q"]) // 2
    a, da, b, db = values["q"][:n], values["q"][n:], values["x"][:n], values["x"][n:]
    s2 = s * s
    w = 3.0 * s2 - 2.0 * s2 * s
    rises = [(s - 2.0 * s2 + s2 * s) * u + (s2 * s - s2) * v for u, v in zip(da, db, strict=True)]
    return [(1.0 - w) * x + w * y + h * rise for x, y, rise in zip(a, b, rises, strict=True)]


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
