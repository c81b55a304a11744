"""The loop of a program: the text `loop.py` read for it, and leaves that are the loop's own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from holdfast.execution.cache import Stored, code_digest
from holdfast.execution.codegen.lane_leaves import (
    crossing_leaves,
    mode_leaves,
    noise_leaf,
    note_leaves,
    step_leaves,
)
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.scalar_llvm import LeafCalls, scalars_text
from holdfast.execution.codegen.scalar_reader import Fixed, read, text_of
from holdfast.execution.simulation.layout import Layout, Shape


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


KEPT = 64
"""Loops that a process keeps: runs of another program of the same shape begin at once."""

LOOK_UP = "look_up_lanes"
SINGLE = "_single"  # the end of the name of a part for a table in single precision

WHOLE_RUNS = ("begin", "advance", "finish", "end", "sample", "first", "answer")
STAGES = ("measure", "control", "record", "move")
"""The functions of a loop, and the parts of a sample of a law that others hand a command."""


@dataclass(frozen=True, eq=False)
class Loop:
    """The text of the loop in LLVM, the names of what it calls, the leaves that do not belong to
    the program, where its numbers are, and whether it has the stages of a sample."""

    text: str
    called: tuple[str, ...]
    leaves: Mapping[str, Leaf]
    layout: Layout
    staged: bool


@lru_cache(KEPT)
def built(shape: Shape, kind: Kind) -> Loop:
    """The loop of programs of this shape and kind; its text is read once, and kept on the disk."""
    layout, staged = Layout(shape), shape.handed > 0
    fixed = fixed_for(shape, layout, kind)
    stored, key = Stored("loop", code_digest("execution")), (fixed, shape.width, staged)
    data = stored.load(key)
    if data is None:
        functions = read(text_of("simulation/loop"), fixed)
        roots = [f"holdfast_{name}" for name in WHOLE_RUNS + STAGES * staged]
        names = functions.called(roots)
        calls = LeafCalls(shape.width, names, kind.direct)
        data = json.dumps([scalars_text(functions, roots, leaves=calls), names]).encode()
        stored.save(key, data)
    text, called = json.loads(data)
    return Loop(text, tuple(called), own_leaves(shape, kind), layout, staged)


def own_leaves(shape: Shape, kind: Kind) -> dict[str, Leaf]:
    """The leaves of the loop that no program decides."""
    n, m, limited = shape.states, shape.inputs, shape.limited
    weights, stages = shape.stepper.weights().tolist(), len(shape.stepper.b)
    produced = range(2 * limited, 2 * limited + m)
    peaks = [*produced, *range(limited, limited + shape.actuators)]
    return (
        step_leaves(weights[:stages], *weights[stages:], order=shape.stepper.order,
                    states=n, constraints=shape.constraints)
        | note_leaves(2 * limited + m, peaks, shape.bounded)
        | mode_leaves(shape.targets, shape.conditions, shape.foresights, m, kind.switch_limit)
        | (crossing_leaves(n) if shape.constraints else {})
        | ({"noise": noise_leaf(n)} if kind.noisy else {})
    )  # fmt: skip


def fixed_for(shape: Shape, layout: Layout, kind: Kind, stoppable: bool = True) -> dict[str, Fixed]:
    """The values of the names that `loop.py` knows of programs of this shape and kind."""
    width, n, at, counts = shape.width, shape.states, layout.at, layout.counts
    blended = shape.modes > 1 or shape.safeguarded
    single = SINGLE if shape.single else ""
    adaptive = shape.stepper.adaptive
    places = at | {
        "size": layout.size, "entries": layout.entries, "felt": at["seen"] + n * width,
        "inner_felt": at["inner"] + n * width,
        "remembered": at["seen"] + (n + shape.measured + shape.handed) * width,
        "shared": (counts["seen"] - shape.shared) * width,
        "answered": at["answer" if blended else "command"],
        "produced": at["actuation"] + 2 * shape.limited * width,
        "wander": layout.recorded.get("wander", (0, 0))[0],
        "table": layout.tables[0], "other_table": layout.tables[1],
        **{f"{name}_prepared": at[name] + (counts[name] - shape.prepared) * width
           for name in ("plant", "gains")},
    }  # fmt: skip
    rows = list(layout.recorded.values())
    fixed: dict[str, Fixed] = {f"at.{name}": place for name, place in places.items()}
    fixed |= {f"shape.{k}": v for k, v in shape._asdict().items() if isinstance(v, int)}
    fixed |= {f"kind.{k}": v for k, v in kind._asdict().items()} | {"kind.stoppable": stoppable}
    fixed |= {
        "shape.adaptive": adaptive, "shape.both_ends": adaptive or shape.constraints > 0,
        "shape.stages": len(shape.stepper.b), "shape.blended": blended,
        "shape.turns": any(shape.targets),
        "shape.guarded": tuple(len(targets) for targets in shape.targets),
        "shape.safeguards": tuple(layout.safeguards.get(k, 0) for k in range(shape.modes)),
        "shape.records": len(rows), "shape.recorded": tuple(place for place, _ in rows),
        "shape.rows": tuple(count for _, count in rows),
        "names.keep": f"keep_lanes{single}",
        "names.look_up": f"{'look_in_cells_lanes' if shape.of_cells else LOOK_UP}{single}",
    }  # fmt: skip
    return fixed
