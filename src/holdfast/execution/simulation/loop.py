"""The simulation loop of a closed loop: its leaves, and the order in which it calls them.

The text of six functions of a block of runs (`codegen/loop_text.py`):

    begin     the memory and the constraints at the starts
    advance   the samples of as many records as s says, and what is recorded of them
    finish    the last sample, which no step follows
    sample    one sample, without a clock and a record, for other simulators
    first     the memory before the first answer of a controller
    answer    what a controller answers to what it sees, which others write

and of a law that others hand a command: measure, control, record, move.

What may differ between the lanes, such as the mode, an exit or the length of a step, is a row of
each lane. No value of a lane depends on another lane.
Guards of modes are tried in order, and the turns counted; constraints are looked at more closely
inside a step for their peaks and crossings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from holdfast.execution.codegen.lane_leaves import (
    BISECTION_STEPS,
    GOLDEN_STEPS,
    crossing_leaves,
    mode_leaves,
    noise_leaf,
    note_leaves,
    step_leaves,
)
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.loop_text import Instructions, LoopText
from holdfast.execution.simulation.layout import FORGOTTEN, LATE, RECORDS, STRIDE, Layout, Shape


class Kind(NamedTuple):
    """noisy, late: how the states are measured. switch_limit: changes of mode within a second
    beyond which a run chatters. until_goal: whether a run ends in its goal. direct: whether leaves
    and parts are called by their names, as functions of the same module.
    """

    noisy: bool = False
    late: bool = False
    switch_limit: int = 1
    until_goal: bool = False
    direct: bool = False


Places = Mapping[str, int]
"""Where the rows of a block are."""


def look_closely(body: Instructions, at: Places, constraints: int) -> None:
    """The largest c_j inside the step, and which of them first exceeds the tolerance, and when."""
    _search(body, at, "search", "number")
    for j in range(constraints):
        _look_at(body, at, j * body.width)
    _search(body, at, "leave", "outcome")


def _search(body: Instructions, at: Places, leaf: str, out: str, x: int = 0, p: int = 0) -> None:
    body.call(leaf, t=at["length"], q=at["number"], x=x, p=p, out=at[out])


def _constraints_inside(body: Instructions, at: Places) -> None:
    """inside = c_j of every lane at its fraction of the step."""
    body.call(
        "between", t=at["length"], q=at["q"], x=at["new"], p=at["fraction"], out=at["between"]
    )
    body.call("constraints", t=at["time"], q=at["between"], p=at["plant"], out=at["inside"])


def _look_at(body: Instructions, at: Places, j: int) -> None:
    """The largest c_j inside the step, and when it first exceeds the tolerance."""
    inside, worst, rises = at["inside"] + j, at["worst"] + j, at["rises"] + j
    _search(body, at, "open", "number", at["c1"] + j)
    with body.if_any(rises):
        _search(body, at, "golden", "lower")
        _constraints_inside(body, at)
        _search(body, at, "golden_left", "c_left", inside)
        _constraints_inside(body, at)
        _search(body, at, "golden_right", "c_right", inside)
        with body.repeat(GOLDEN_STEPS):
            _search(body, at, "golden_turn", "lower")
            _constraints_inside(body, at)
            _search(body, at, "golden_take", "c_left", inside)
        _search(body, at, "golden_end", "fraction")
        _constraints_inside(body, at)
        _search(body, at, "peaked", "top", inside, rises)
    body.call("raise", q=at["number"], x=worst, p=at["close"], out=worst)
    _search(body, at, "crosses", "crosses", p=at["close"])
    with body.if_any(at["crosses"]):
        _search(body, at, "bisect", "lower")
        with body.repeat(BISECTION_STEPS):
            _constraints_inside(body, at)
            _search(body, at, "bisect_turn", "lower", inside)
        _search(body, at, "crossed", "earliest")


def turn(body: Instructions, at: Mapping[str, int], shape: Shape) -> None:
    """The modes after their guards are tried in order."""
    rows = {"t": at["length"], "q": at["since"]}
    rows["x"] = at["time_in_mode"]
    if shape.modes > 1:
        body.call("where", **rows, out=at["in_modes"])
    if not any(shape.targets):
        return
    for k, targets in enumerate(shape.targets):
        if targets:
            with body.if_any(at["in_modes"] + k * body.width):
                body.call(
                    f"guards{k}", t=at["time"], q=at["seen"], x=at["time_in_mode"],
                    p=at["gains"], out=at["levels"],
                )  # fmt: skip
                body.call(
                    f"turn{k}", t=at["mode"], q=at["levels"], x=at["next_mode"],
                    out=at["next_mode"],
                )  # fmt: skip
    body.call("changed", **rows, out=at["changed"])
    body.late(FORGOTTEN, at["changed"], at["forgotten"], 1)
    body.call("switch", **rows, out=at["since"])
    with body.if_any(at["changed"]):
        body.call("chatter", **rows, out=at["outcome"])


KEPT = 64
"""Loops that a process keeps: runs of another program of the same shape begin at once."""

LOOK_UP = "look_up_lanes"
SINGLE = "_single"  # the end of the name of a part for a table in single precision


@dataclass(frozen=True, eq=False)
class Loop:
    """The text of the loop, the names of what it calls, the leaves that do not belong to the
    program, where its numbers are, and whether it has the stages of a sample."""

    text: str
    called: tuple[str, ...]
    leaves: Mapping[str, Leaf]
    layout: Layout
    staged: bool


@lru_cache(KEPT)
def built(shape: Shape, kind: Kind) -> Loop:
    """The loop of programs of this shape and kind."""
    return built_as(LoopText(shape.width, direct=kind.direct), shape, kind)


def built_as(text: LoopText, shape: Shape, kind: Kind) -> Loop:
    """The same in the language of a text that is still empty."""
    return _Builder(shape, kind).loop(text)


class _Builder:
    def __init__(self, shape: Shape, kind: Kind) -> None:
        self.shape, self.kind = shape, kind
        self.layout = Layout(shape)
        self.at = self.layout.at
        n, m, limited = shape.states, shape.inputs, shape.limited
        weights, stages = shape.stepper.weights().tolist(), len(shape.stepper.b)
        produced = range(2 * limited, 2 * limited + m)
        peaks = [*produced, *range(limited, limited + shape.actuators)]
        self.leaves = (
            step_leaves(weights[:stages], *weights[stages:], order=shape.stepper.order,
                        states=n, constraints=shape.constraints)
            | note_leaves(2 * limited + m, peaks, shape.bounded)
            | mode_leaves(shape.targets, shape.conditions, shape.foresights, m, kind.switch_limit)
            | (crossing_leaves(n) if shape.constraints else {})
            | ({"noise": noise_leaf(n)} if kind.noisy else {})
        )  # fmt: skip

    def loop(self, text: LoopText) -> Loop:
        with text.function("holdfast_begin") as body:
            self._prepare(body)
            if self.shape.remembered:
                self._measure(body, late=False)
                self._remember_first(body)
            if self.shape.constraints:
                body.call("constraints", q=self.at["q"], p=self.at["plant"], out=self.at["c0"])
        with text.function("control", internal=True) as body:
            self._control(body)
        with text.function("record", internal=True) as body:
            self._record(body)
        with text.function("advance", internal=True) as body:
            self._advance(body)
        with text.function("holdfast_advance") as body, body.repeat(body.entry(RECORDS)):
            body.return_unless_any(self.at["alive"])
            body.function("control")
            body.function("record")
            body.function("advance")
            rest = body.one_less(body.entry(STRIDE))
            with body.if_positive(rest), body.repeat(rest):
                body.return_unless_any(self.at["alive"])
                body.function("control")
                body.function("advance")
        with text.function("holdfast_finish") as body:
            body.function("control")
            body.function("record")
        with text.function("holdfast_sample") as body:
            self._control(body, begins=False)
            body.function("advance")
        with text.function("holdfast_first") as body:
            self._prepare(body)
            if self.shape.remembered:
                self._remember_first(body)
        with text.function("holdfast_answer") as body:
            self._answer(body)
        if self.shape.handed:
            self._stages(text)
        return Loop(text.text, tuple(text.called), self.leaves, self.layout, self.shape.handed > 0)

    def _stages(self, text: LoopText) -> None:
        """What `holdfast_advance` does, in parts between which others hand a command."""
        with text.function("holdfast_measure") as body:
            body.call("clock", t=self.at["length"], out=self.at["sample"])
            self._measure(body, late=self.kind.late)
        with text.function("holdfast_control") as body:
            self._respond(body)
        with text.function("holdfast_record") as body:
            body.function("record")
        with text.function("holdfast_move") as body:
            body.function("advance")

    def _prepare(self, body: Instructions) -> None:
        """The rows behind the parameters."""
        for numbers in ("plant", "gains") if self.shape.prepared else ():
            rows = self.layout.counts[numbers] - self.shape.prepared
            body.call(
                "prepared", p=self.at[numbers], out=self.at[numbers] + rows * self.shape.width
            )

    def _remember_first(self, body: Instructions) -> None:
        at = self.at
        body.call("begin", t=at["time"], q=at["seen"], p=at["gains"], out=at["memory"])

    # -- a sample ------------------------------------------------------------------------

    def _control(self, body: Instructions, begins: bool = True) -> None:
        """The clock, what the law sees, its mode, its command, and what is noted of them."""
        if begins:
            body.call("clock", t=self.at["length"], out=self.at["sample"])
        self._measure(body, late=begins and self.kind.late)
        self._respond(body)

    def _respond(self, body: Instructions) -> None:
        """The command after what is seen, and what is noted of the sample."""
        shape, at, t = self.shape, self.at, self.at["length"]
        self._answer(body)
        if shape.safeguarded:
            body.call("kept", t=t, q=at["slack"], out=at["overrules"])
        body.call("peaks", t=t, q=at["actuation"], p=at["peaks"], out=at["bad"])
        self._end(body, "bad")
        body.call("goal", t=at["time"], q=at["q"], p=at["plant"], out=at["level"])
        body.call("arrive", t=t, q=at["level"], x=at["inside_since"], out=at["inside_since"])
        if shape.bounded:
            body.call("excess", t=at["time"], q=at["q"], p=at["plant"], out=at["excess"])
            body.call("exceed", t=t, q=at["excess"], x=at["beyond"], out=at["beyond"])

    def _answer(self, body: Instructions) -> None:
        """The mode, the command and the memory after what the law sees."""
        shape, at = self.shape, self.at
        if shape.remembered:
            behind = (shape.states + shape.measured + shape.handed) * self.shape.width
            body.copy(at["memory"], at["seen"] + behind, shape.remembered)
        self._share(body, at["time"], at["seen"])
        turn(body, self.at, self.shape)
        self._look(body, at["time"], at["seen"], noted=True)
        self._command(body, at["time"], at["seen"])
        if shape.remembered:
            body.call(
                "remember", t=at["time"], q=at["seen"], x=at["actuation"], p=at["gains"],
                out=at["memory"],
            )  # fmt: skip

    def _measure(self, body: Instructions, late: bool) -> None:
        """seen = the states as the law sees them: late, with what it feels there, with noise."""
        at, n = self.at, self.shape.states
        if late:
            body.late(LATE, at["q"], at["seen"], n)
        else:
            body.copy(at["q"], at["seen"], n)
        if self.shape.measured:
            felt = at["seen"] + n * self.shape.width
            body.call("felt", t=at["seen_at"], q=at["seen"], p=at["plant"], out=felt)
        if self.kind.noisy:
            body.copy(at["back"], at["draw"], 1)
            body.call("noise", t=at["run"], x=at["seen"], p=at["noise"], out=at["seen"])

    def _share(self, body: Instructions, t: int, seen: int) -> None:
        """What several leaves need of what the law sees."""
        if self.shape.shared:
            rows = self.layout.counts["seen"] - self.shape.shared
            body.call("shared", t=t, q=seen, p=self.at["gains"], out=seen + rows * self.shape.width)

    def _look(self, body: Instructions, t: int, seen: int, *, noted: bool) -> None:
        """What the law's table says."""
        if self.shape.places:
            body.call("places", t=t, q=seen, p=self.at["gains"], out=self.at["look_at"])
            part = "look_in_cells_lanes" if self.shape.of_cells else LOOK_UP
            self._reads(body, part, self.layout.tables[0 if noted else 1])

    def _reads(self, body: Instructions, part: str, at: int) -> None:
        """A part that reads the law's table, in the precision of the table."""
        body.part(f"{part}{SINGLE if self.shape.single else ''}", at)

    def _command(self, body: Instructions, t: int, seen: int) -> None:
        """The command of every lane in its mode, kept by its safeguard, and what is made of it."""
        shape, at, modes = self.shape, self.at, self.shape.modes
        answer = at["command" if modes == 1 and not shape.safeguarded else "answer"]
        for k in range(modes):
            if modes > 1:
                with body.if_any(at["in_modes"] + k * self.shape.width):
                    self._law(body, k, t, seen, answer)
            else:
                self._law(body, k, t, seen, answer)
        body.call(
            "actuate", t=t, q=at["command"], x=at["gains"], p=at["plant"], out=at["actuation"]
        )

    def _law(self, body: Instructions, k: int, t: int, seen: int, answer: int) -> None:
        at = self.at
        body.call(f"law{k}", t=t, q=seen, x=at["look"], p=at["gains"], out=answer)
        if answer == at["command"]:
            return
        body.call(f"blend{k}", t=at["mode"], q=at["command"], x=answer, out=at["command"])
        if k in self.layout.safeguards:
            body.call(f"held{k}", t=at["length"], q=answer, x=at["mode"], out=at["held"])
            with body.if_any(at["held"]):
                self._reads(body, "keep_lanes", self.layout.safeguards[k])

    def _end(self, body: Instructions, flags: str) -> None:
        """End the lanes with such a flag."""
        at = self.at
        with body.if_any(at[flags]):
            body.call("end", t=at["length"], q=at[flags], out=at["accepted"])

    # -- the steps of a sample -----------------------------------------------------------

    def _field(self, body: Instructions, t: int, q: int, out: int) -> None:
        """dq/dt; with continuous control the input is the law's at this very state."""
        shape, at, n = self.shape, self.at, self.shape.states
        if shape.continuous:
            inner = at["inner"]
            body.copy(q, inner, n)
            if shape.measured:
                body.call("felt", t=t, q=q, p=at["plant"], out=inner + n * self.shape.width)
            self._share(body, t, inner)
            self._look(body, t, inner, noted=False)
            self._command(body, t, inner)
        inputs = at["actuation"] + 2 * shape.limited * self.shape.width
        body.call("rates", t=t, q=q, x=inputs, p=at["plant"], out=out)

    def _constraint_rates(self, body: Instructions, t: int, q: int, rates: int, out: int) -> None:
        body.call("constraint_rates", t=t, q=q, x=rates, p=self.at["plant"], out=out)

    def _advance(self, body: Instructions) -> None:
        """All lanes by one sample time; those that diverge are no longer alive."""
        shape, at, n = self.shape, self.at, self.shape.states
        t, adaptive, watched = at["length"], shape.stepper.adaptive, shape.constraints
        time, q, k0, new, k1 = (at[name] for name in ("time", "q", "stages", "new", "k1"))
        if self.kind.until_goal:
            body.call("rest", t=t, q=at["inside_since"], out=at["alive"])
        rates_at_both_ends = adaptive or watched
        body.call("start", t=t, out=at["h"])
        if rates_at_both_ends:
            self._field(body, time, q, k0)
        else:
            body.copy(time, at["then"], 1)
        if watched:
            self._constraint_rates(body, time, q, k0, at["d0"])
        with body.while_any(at["active"]):
            if not rates_at_both_ends:
                self._field(body, at["then"], q, k0)
            if adaptive:
                body.call("lengths", t=t, out=at["h"])
            for stage in range(1, len(shape.stepper.b)):
                body.call(f"stage{stage}", t=t, q=q, x=k0, out=at["between"])
                self._field(body, at["at"], at["between"], k0 + stage * n * self.shape.width)
            body.call("new", t=t, q=q, x=k0, out=at["then"])
            if adaptive:
                body.call("judge", t=t, q=q, x=new, p=k0, out=at["trial"])
            else:
                self._end(body, "wild")
            if rates_at_both_ends:
                self._field(body, at["then"], new, k1)
            if watched:
                self._watch(body)
            body.call("accept" if rates_at_both_ends else "move", t=t, q=q, x=new, out=q)
            body.call("tick", t=t, out=at["elapsed"])

    def _watch(self, body: Instructions) -> None:
        """The largest c_j, and exits inside the step."""
        at = self.at
        t, then, new = at["length"], at["then"], at["new"]
        body.call("constraints", t=then, q=new, p=at["plant"], out=at["c1"])
        self._constraint_rates(body, then, new, at["k1"], at["d1"])
        body.call("watch", t=t, q=at["c0"], x=at["c1"], p=at["worst"], out=at["close"])
        self._end(body, "unbounded")
        with body.if_any(at["close"]):
            look_closely(body, self.at, self.shape.constraints)
        body.call("take", t=t, q=at["c0"], x=at["c1"], out=at["c0"])

    # -- records -------------------------------------------------------------------------

    def _record(self, body: Instructions) -> None:
        shape, at = self.shape, self.at
        if shape.signals:
            body.call("signals", t=at["time"], q=at["seen"], x=at["look"], p=at["gains"],
                      out=at["signals"])  # fmt: skip
        if shape.safeguarded and shape.actuators:
            body.call("actuate", t=at["time"], q=at["nominal"], x=at["gains"], p=at["gains"],
                      out=at["believed"])  # fmt: skip
        for place, rows in self.layout.recorded.values():
            body.append(place, rows)
