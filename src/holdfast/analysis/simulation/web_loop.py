"""A closed loop for a browser: the compiled loop of `simulate`, and its numbers before a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import sympy as sp

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram, closed_loop_program
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import leaf_of
from holdfast.execution.simulation.blocks import BlockNumbers, Whole
from holdfast.execution.simulation.built_loop import (
    LATE,
    LOG_AT,
    RECORDS,
    RING,
    RINGS_AT,
    Kind,
    Layout,
    built,
    shape_of,
)
from holdfast.execution.simulation.settings import BY_NAME, Outcome, Settings
from holdfast.execution.table_in_parts import in_memory
from holdfast.execution.web_assembly import LANES, STACK, web_module
from holdfast.maths.definitions.law import CellLookup, Law
from holdfast.maths.definitions.quantity import TIME, expression_of
from holdfast.maths.definitions.region import (
    Circle,
    Cone,
    Footprint,
    Region,
    Segment,
    Shape,
    ZeroLevel,
    drawn_shapes,
)
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.variation import Varied

SCENE = "scene"
"""The leaf of the numbers of the scene, of a state and the parameters of the plant."""

LATEST = 1.0
"""How late a law may see in a browser [s], if its scenario has no longer delay."""


@dataclass(frozen=True)
class WebLoop:
    """exact, noisy: modules of WebAssembly (`execution/web_assembly.py`) for measurements that are
    exact and in time, and for others (None with continuous control). numbers, whole: w and s of a
    block of `LANES` runs before they begin, without parameters and starts. records: of a run.

    scene: shapes with the place of their first number in the results of the leaf `scene`.
    """

    exact: bytes
    noisy: bytes | None
    program: ClosedLoopProgram
    layout: Layout
    numbers: Array
    whole: Whole
    table: Array | None
    records: int
    latest: int
    scene: tuple[tuple[Shape, int], ...]
    width_of_scene: int
    grid: Mapping[str, Any] | None

    def described(self) -> dict[str, Any]:
        """Where the numbers are, as plain data."""
        layout, program = self.layout, self.program
        rows = {name: [layout.at[name], count] for name, count in layout.counts.items() if count}
        records = {
            name: [part.start, part.stop - part.start] for name, part in layout.records.items()
        }
        return {
            "lanes": LANES,
            "stack": STACK,
            "rows": rows,
            "record": records,
            "record_rows": layout.record,
            "log": len(self.numbers),
            "rings": layout.size,
            "entry_of_log_at": LOG_AT,
            "entry_of_rings_at": RINGS_AT,
            "records": self.records,
            "late": RING + 3 * LATE,
            "latest": self.latest,
            "entry_of_records": RECORDS,
            "tables": list(layout.tables) if self.table is not None else [],
            "outcomes": [outcome.name for outcome in Outcome],
            "parameters": [p.name for p in program.parameters],
            "varied": [*program.varied.names, *program.varied.plant],
            "varied_known": len(program.varied.names),
            "drawn": len(program.varied.draws) + len(program.varied.cases),
            "scene": self.width_of_scene,
        }


def web_loop(
    system: System,
    law: Law | Switching,
    settings: Settings,
    *,
    region: Region | None = None,
    goal: Region | None = None,
    disturbance: Mapping[str, Any] | None = None,
    varied: Varied | None = None,
    stepper: str = "rk4",
    shapes: Iterable[Shape] = (),
) -> WebLoop:
    """The loop that `simulate` runs with these arguments, for a browser.

    Noise, a delay up to `LATEST` and every parameter can be changed there; disturbances that are
    not given are numbers too. shapes: others to draw than those of `region` and `goal`. Raises what
    `simulate` raises for laws and disturbances that do not fit, and `SimulationError` for a law
    that is handed its command by another controller.
    """
    expressions = {name: sp.Float(0) for name in system.disturbance_names} | {
        name: expression_of(e) for name, e in (disturbance or {}).items()
    }
    program = closed_loop_program(
        system, law, region=region, goal=goal, disturbance=expressions, stepper=BY_NAME[stepper],
        continuous=settings.continuous, varied=varied,
    )  # fmt: skip
    program.check_alone()
    program.check_sample_time(settings.sample_time)
    still = settings.continuous
    latest = max(settings.delay_samples, int(LATEST / settings.sample_time))
    latest = 0 if still or program.measures_process else min(latest, settings.samples)
    roomy = replace(settings, delay=latest * settings.sample_time)
    limit = settings.switch_limit if any(program.targets) else 1
    kind = Kind(False, False, limit, settings.until_goal, direct=True)
    exact, noisy = (
        built(shape_of(program, LANES), kind._replace(noisy=some, late=some))
        for some in (False, True)
    )
    scene, leaf = _scene(program, (*drawn_shapes(region, goal), *shapes))
    leaves = {**program.leaves, **({SCENE: leaf} if leaf is not None else {})}
    exported = [n for n in (SCENE, "varied") if n in leaves]
    block = BlockNumbers(exact.layout, program, roomy, LANES)
    table = None
    if program.table is not None:
        table = in_memory(program.table[0])
        for k in exact.layout.tables:
            block.s[:, k] = 0  # the browser has it elsewhere
    return WebLoop(
        web_module(exact, leaves, exported),
        None if still else web_module(noisy, leaves, exported),
        program, exact.layout, block.w[0, : block.log_at], block.s[0], table, block.records,
        latest, scene, 0 if leaf is None else len(leaf.results), _grid(program, law),
    )  # fmt: skip


def _grid(program: ClosedLoopProgram, law: Law | Switching) -> dict[str, Any] | None:
    """The grid of the law's value, where it is of states (and of the time to go) themselves.

    states: which state each of its last axes is.
    """
    lookup = law.lookup
    if lookup is None or isinstance(lookup, CellLookup):
        return None
    names = [q.symbol for q in program.states]
    places = lookup.places[int(lookup.timed) :]
    if any(place not in names for place in places):
        return None
    values, low, steps, shape, periodic = program.table[:5]
    return {
        "type": values.dtype.name, "states": [names.index(place) for place in places],
        "low": [float(v) for v in low], "steps": [float(v) for v in steps],
        "shape": [int(v) for v in shape], "periodic": [bool(v) for v in periodic],
    }  # fmt: skip


def _scene(
    program: ClosedLoopProgram, shapes: Iterable[Shape]
) -> tuple[tuple[tuple[Shape, int], ...], Leaf | None]:
    """The shapes with the place of their first number, and the leaf of all numbers."""
    placed: list[tuple[Shape, int]] = []
    numbers: list[sp.Expr] = []
    for shape in shapes:
        placed.append((shape, len(numbers)))
        numbers += [sp.sympify(e) for e in numbers_of(shape)]
    if not numbers:
        return (), None
    arrays = {
        "t": (TIME,), "q": [q.symbol for q in program.states], "x": (),
        "p": [p.symbol for p in program.parameters],
    }  # fmt: skip
    return tuple(placed), leaf_of(arrays, numbers)


def numbers_of(shape: Shape) -> tuple[sp.Expr, ...]:
    """The numbers of a shape in order: points, then angles (heading first) and lengths, corners."""
    match shape:
        case Segment():
            return (*shape.start, *shape.end)
        case Circle():
            return (*shape.centre, shape.radius)
        case Cone():
            return (*shape.apex, shape.heading, shape.half_angle, shape.range)
        case Footprint():
            corners = (e for corner in shape.corners for e in corner)
            return (*shape.apex, shape.heading, *corners)
        case ZeroLevel():
            return (shape.expression,)
