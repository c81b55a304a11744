"""Leaves of a controller that no program decides: its mode, its command, its safeguard's notes."""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose
from holdfast.execution.codegen.lane_leaves import (
    CLOCK,
    Results,
    Rows,
    clock,
    flag,
    made,
)
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.simulation.outcomes import Outcome

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
    kept = 2 if safeguarded else 0
    rows = {"t": len(CLOCK), "q": len(SWITCHES), "x": len(TURNS)}
    found = {}
    if modes > 1:
        found["where"] = made(_where(modes), **rows)
    if any(targets):
        found["changed"] = made(_changed, **rows)
        found["switch"] = made(_switch(modes), **rows)
        found["chatter"] = made(_chatter(switch_limit), **rows)
    for k, own in enumerate(targets):
        if own:
            found[f"turn{k}"] = made(_turn(k, own), t=1, q=len(own), x=1)
    if modes > 1 or safeguarded:
        for k in range(modes):
            found[f"blend{k}"] = made(_blend(k, inputs), t=1, q=2 * inputs + kept, x=inputs)
    if safeguarded:
        found["kept"] = made(_kept, t=len(CLOCK), q=5)
    for k, (count, _) in enumerate(conditions):
        if count:
            answer = inputs + count * (inputs + 1)
            found[f"held{k}"] = made(
                _held(k, inputs, count, bool(foresights[k])), t=len(CLOCK), q=answer, x=1
            )
    return found


def _switching(values: Rows) -> dict[str, Value]:
    named = dict(zip(SWITCHES, values["q"], strict=True))
    return clock(values) | named | dict(zip(TURNS, values["x"], strict=True))


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
        (mode,), (found,) = values["t"], values["x"]
        mine = mode.equals(float(k))
        for level, target in reversed(list(zip(values["q"], targets, strict=True))):
            found = choose(mine & (level >= 0.0), float(target), found)
        return [found]

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
