"""What the shape of a program decides: where the numbers of a block are, and its loop.

A `Layout` has the rows of w and the whole numbers of s. The loop is the text `loop.py`, read for
the shape, with leaves that are its own.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.lane_leaves import (
    CLOCK,
    DRAW,
    SEARCH,
    SWITCHES,
    TURNS,
    crossing_leaves,
    mode_leaves,
    noise_leaf,
    note_leaves,
    step_leaves,
)
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.scalar_llvm import LeafCalls, scalars_text
from holdfast.execution.codegen.scalar_reader import Fixed, read, text_of
from holdfast.execution.foreseen import CUTS, numbers_of_search
from holdfast.execution.interpolate import numbers_of_places
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from holdfast.execution.simulation.settings import Tableau
from holdfast.host.files import Stored, code_digest
from holdfast.maths.definitions.law import MOST_LEVELS

WIDTH = 16
"""Runs that advance together, the lanes of a block, on a processor with wide registers."""

LOG, LANES_OF_BLOCK, PITCH, LOG_AT, RINGS_AT, RING = 0, 1, 2, 3, 4, 5
"""Entries of s: how long the log is; the width; how far the rows of the log and of the rings are
apart; the addresses of both; from RING on three for each ring: the next slot, the number of slots,
and its first row."""
RECORDS, STRIDE = RING + 6, RING + 7
"""Entries of s behind the rings: the records of a call, and the samples of a record."""
LATE, FORGOTTEN = 0, 1
"""The rings: of late states, and of changes of mode."""
PARTS = RING + 8
"""Where the entries of the parts begin."""
AHEAD = 11 + MOST_LEVELS
"""Where the entries of a foresight begin among those of a safeguard."""
SAFEGUARD_ENTRIES, TABLE_ENTRIES = AHEAD + 6, 16
"""Entries of the parts of `parts.py`; a table has two more for each of its axes."""


class Shape(NamedTuple):
    """What the loop of a program depends on: its kinds, and the numbers of its quantities.

    of_cells: how many numbers a table of cells has beside its entries. width: how many runs advance
    together. Programs of one shape share
    the loop and its compiled functions.
    """

    stepper: Tableau
    targets: tuple[tuple[int, ...], ...]
    conditions: tuple[tuple[int, int], ...]
    foresights: tuple[tuple[int, ...], ...]
    states: int
    inputs: int
    actuators: int
    limited: int
    modes: int
    signals: int
    constraints: int
    numbers: int
    prepared: int
    measured: int
    wandering: int
    bounded: int
    handed: int
    things: int
    numbers_of_thing: int
    conditions_of_thing: int
    remembered: int
    shared: int
    places: int
    found: int
    of_cells: int
    single: bool
    safeguarded: bool
    continuous: bool
    width: int


def shape_of(program: ClosedLoopProgram, width: int = WIDTH) -> Shape:
    """The shape of a program."""
    return Shape(
        stepper=program.stepper,
        targets=program.targets,
        conditions=program.conditions_of_modes,
        foresights=program.foresight_of_modes,
        states=len(program.states),
        inputs=len(program.inputs),
        actuators=len(program.actuators),
        limited=program.limited,
        modes=len(program.modes),
        signals=len(program.signals),
        constraints=len(program.constraints),
        numbers=len(program.parameters) + len(program.given) + 1,
        prepared=program.prepared,
        measured=program.measured,
        wandering=program.wandering,
        bounded=program.bounded,
        handed=len(program.handed),
        things=program.things[0],
        numbers_of_thing=program.things[1],
        conditions_of_thing=program.things[2],
        remembered=len(program.remembered),
        shared=program.shared,
        places=program.places,
        found=program.found,
        of_cells=len(program.table[5]) if program.table and len(program.table) > 5 else 0,
        single=program.table is not None and program.table[0].dtype == "float32",
        safeguarded=program.safeguarded,
        continuous=program.continuous,
        width=width,
    )


class Layout:
    """Where the numbers of a block are.

    counts: how many rows each quantity has in w; at: the place of the first. recorded: the place
    and the number of the rows of a record; records: their numbers in it. safeguards: for each mode
    that has one the place of its entries in s; tables: those of the look-up at a sample, and of the
    other ones; whole: where the parts have whole numbers of their own.
    """

    def __init__(self, shape: Shape) -> None:
        self.width = shape.width
        self.counts = _counts(shape)
        self.at: dict[str, int] = {}
        self.size = 0
        for name, count in self.counts.items():
            self.at[name] = self.size
            self.size += count * self.width
        self.recorded = self._recorded(shape)
        self.records: dict[str, slice] = {}
        self.record = 0
        for name, (_, rows) in self.recorded.items():
            self.records[name] = slice(self.record, self.record + rows)
            self.record += rows
        guarded = [k for k, (count, _) in enumerate(shape.conditions) if count]
        self.safeguards = {k: PARTS + SAFEGUARD_ENTRIES * i for i, k in enumerate(guarded)}
        first, axes = PARTS + SAFEGUARD_ENTRIES * len(guarded), 2 * shape.places
        self.tables = first, first + TABLE_ENTRIES + axes
        self.whole = first + 2 * (TABLE_ENTRIES + axes)
        self.entries = self.whole + _whole(shape)

    def _recorded(self, shape: Shape) -> dict[str, tuple[int, int]]:
        """The place and the number of the rows of each quantity that is recorded."""
        at, m = self.at, shape.inputs
        limited, actuators = shape.limited, shape.actuators
        first = at["actuation"] + limited * self.width
        places = {
            "alive": (at["alive"], 1), "state": (at["q"], shape.states),
            "input": (first + limited * self.width, m), "actuator": (first, actuators),
            "mode": (at["mode"], 1), "signal": (at["signals"], shape.signals),
            "constraint": (at["c0"], shape.constraints),
            "wander": (at["plant"] + (shape.numbers - 1 - shape.wandering) * self.width,
                       shape.wandering),
        }  # fmt: skip
        if shape.safeguarded:
            places |= {
                "nominal": (at["nominal"], m), "nominal_actuator": (at["believed"], actuators),
                "sample_slack": (at["slack"], 1), "safeguard": (at["overruled"], 1),
            }  # fmt: skip
        return {name: rows for name, rows in places.items() if rows[1]}


def _counts(shape: Shape) -> dict[str, int]:
    """How many rows of w each quantity has; leaves write several of these at once."""
    n, m, watched = shape.states, shape.inputs, shape.constraints
    seen = n + shape.measured + shape.handed + shape.remembered + shape.shared
    parameters = shape.numbers + shape.prepared
    conditions = max(count for count, _ in shape.conditions)
    ahead = max(_ahead(counts, m) for counts in shape.foresights)
    stages, modes = len(shape.stepper.b), shape.modes
    actuation = 2 * shape.limited + m
    return {
        **dict.fromkeys(CLOCK, 1), **dict.fromkeys(DRAW, 1), "noise": 2 * n,
        "q": n, "stages": stages * n, "then": 1, "wild": 1, "new": n, "k1": n,
        "between": n, "at": 1, "c0": watched, "d0": watched, "c1": watched, "d1": watched,
        "close": 1, "unbounded": 1, "rises": watched, "worst": watched,
        **dict.fromkeys(SEARCH, 1), "inside": watched,
        "command": m, "nominal": m, "slack": 1, "overruled": 1, "overrules": 1, "infeasible": 1,
        "largest_slack": 1, "held": 1, "answer": m + conditions * (m + 1) + m + ahead,
        **dict.fromkeys(SWITCHES, 1), "in_modes": modes, **dict.fromkeys(TURNS, 1),
        "levels": max(1, *(len(of_mode) for of_mode in shape.targets)),
        "bad": 1, "peaks": m + shape.actuators, "level": 1, "inside_since": 1,
        "excess": 1 + shape.bounded, "beyond": 1 + shape.bounded,
        "off_at": 1, "seen": seen, "inner": seen, "memory": shape.remembered,
        "look_at": shape.places, "look": shape.found,
        "actuation": actuation, "believed": actuation, "signals": shape.signals,
        "plant": parameters, "gains": parameters,
        **{name: -(-count // shape.width) for name, count in _room(shape).items()},
    }  # fmt: skip


def _room(shape: Shape) -> dict[str, int]:
    """How many numbers of w the parts have for themselves."""
    _m, axes = shape.inputs, shape.places
    most = max(count for count, _ in shape.conditions)
    return {
        "room": _program_room(shape, most) if most or any(shape.foresights) else 0,
        "grid": 3 * axes + shape.found + numbers_of_places(axes)[0] if axes else 0,
        "cells": shape.of_cells,
    }


def _ahead(counts: tuple[int, ...], m: int) -> int:
    """The numbers of a foresight in the answer of a law."""
    return 3 + counts[3] + counts[0] * m if counts else 0


def _program_room(shape: Shape, most: int) -> int:
    """The numbers of the program of a safeguard: a lane's answer, the result, and its room."""
    m, axes = shape.inputs, shape.places
    room, ahead = 0, 0
    for counts in shape.foresights:
        if counts:
            rows = most + CUTS * counts[1]
            room = max(room, numbers_of_search(axes, m, most, counts[1]))
            ahead = max(ahead, _ahead(counts, m) + m + numbers_of_programs(m, rows)[0])
    return room + ahead + numbers_of_programs(m, most)[0] + 3 * m + 1 + most * (m + 1)


def _whole(shape: Shape) -> int:
    """How many numbers of s they have."""
    programs = numbers_of_programs(shape.inputs, 0)[1]
    return programs + max(numbers_of_places(shape.places)[1], 3 * shape.places)


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
    things, row = shape.things * shape.numbers_of_thing, (shape.inputs + 1) * width
    places = at | {
        "size": layout.size, "entries": layout.entries, "felt": at["seen"] + n * width,
        "inner_felt": at["inner"] + n * width,
        "remembered": at["seen"] + (n + shape.measured + shape.handed) * width,
        "shared": (counts["seen"] - shape.shared) * width,
        "answered": at["answer" if blended else "command"],
        "things": (n + shape.measured + shape.handed - things) * width,
        "thing": shape.numbers_of_thing * width,
        "thing_rows": shape.conditions_of_thing * row,
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
        "shape.things_at": tuple(shape.inputs * width + hard * row for _, hard in shape.conditions),
        "shape.records": len(rows), "shape.recorded": tuple(place for place, _ in rows),
        "shape.rows": tuple(count for _, count in rows),
        "names.keep": f"keep_lanes{single}",
        "names.look_up": f"{'look_in_cells_lanes' if shape.of_cells else LOOK_UP}{single}",
    }  # fmt: skip
    return fixed
