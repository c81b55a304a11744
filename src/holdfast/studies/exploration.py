"""A scenario as one page for a browser, in which it runs: `holdfast explore`.

Of a start the vehicles are dragged whose places and headings are states. Numbers of closed loops
can be changed, by their keys in the file; and the file that reproduces what the page shows is made
of its tables, where there is one.

A kernel or a capture basin has the law that keeps it, from states of the set. Its value is there
for the slices of the set alone: one byte at each node, compressed.
"""

from __future__ import annotations

import base64
import json
import math
import tomllib
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.depth import inside_states
from holdfast.analysis.safety.safety_filter import LAWFUL, decided, safety_law, sampled_margin
from holdfast.analysis.simulation.web_loop import WebLoop, web_loop
from holdfast.errors import GainWarning, HoldfastError, ModelWarning, ScenarioError, SimulationError
from holdfast.execution.arrays import AnyArray, Array
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, Parameter, in_base_units
from holdfast.maths.definitions.region import Region, Shape, ZeroLevel
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.numeric import Expression
from holdfast.maths.expressions.parser import parse_expression
from holdfast.maths.nonholonomic.bodies import bodies
from holdfast.presentation.html.page import explorer_page
from holdfast.scenario.files import overridden, read_tables, read_text, scenario_names
from holdfast.scenario.kernel_reference import DECISIVE
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.kinds.formation import FormationScenario
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.kinds.parts import PartsScenario
from holdfast.scenario.load import scenario_of, substance


def poses(system: System, plane: tuple[str, str]) -> list[dict[str, Any]]:
    """The vehicles whose places are states: that of the plane, then others with names like it.

    Of each the states of its place, and its heading, an angle whose name has the same end.
    """
    names, states = list(system.state_names), system.states
    angles = [k for k, q in enumerate(states) if q.angle]
    if any(states[names.index(n)].unit != "m" for n in plane):
        angles = []
    ends = [plane[0][1:]] if plane[0][:1] == "x" and plane[1] == f"y{plane[0][1:]}" else []
    ends += [n[1:] for n in names if n[:1] == "x" and f"y{n[1:]}" in names and n not in plane]
    if not ends:
        first = angles[0] if angles else None
        return [{"place": [names.index(n) for n in plane], "heading": first, "label": "start"}]

    def heading(end: str) -> int | None:
        headings = [k for k in angles if names[k].endswith(end)]
        return headings[0] if headings else None

    return [
        {
            "place": [names.index(f"x{end}"), names.index(f"y{end}")], "heading": heading(end),
            "label": end if len(ends) > 1 else "start",
        }
        for end in ends
    ]  # fmt: skip


OF_THE_KERNEL = ("system", "region", "goal", "law", "tracking", "disturbance")
"""Tables of a kernel that its closed loops need too."""

OPTIMAL = {"alone": True, "ahead": False}
"""[safety] of the optimal inputs, as a page has them."""

COURSE = (
    "The course of a formation is planned from its start, for the vehicles of its file. No file "
    "has the same course and another start, or other vehicles. Reset them to copy the scenario."
)


@dataclass(frozen=True)
class Copy:
    """tables: of a file, with paths as the scenario's own file has them; None with the reason.

    fixed: why the start and the true vehicle have to be those of the file; empty if they need not.
    """

    tables: Mapping[str, Any] | None
    reason: str = ""
    fixed: str = ""


def copied_loop(loaded: Scenario, scenario: str, changes: Sequence[str]) -> Copy:
    """The tables of the file that one run needs."""
    _, tables = _tables_of(scenario, changes)
    copied = {name: table for name, table in tables.items() if name not in ("compare", "kernels")}
    named = str(tables.get("safety", ""))
    kernels = {n: k for n, k in tables.get("kernels", {}).items() if n in named}
    copied |= {"kernels": kernels} if kernels else {}
    return Copy(copied, fixed=COURSE if isinstance(loaded, FormationScenario) else "")


def copied_kernel(
    loaded: KernelScenario, scenario: str, changes: Sequence[str], settings: Settings
) -> Copy:
    """Closed loops with the kernel in [safety]: its optimal inputs, or a filter around its law."""
    before, tables = _tables_of(scenario, changes)
    name = scenario if scenario in scenario_names() else Path(scenario).name
    inputs = dict.fromkeys(loaded.system.input_names, 0)
    copied: dict[str, Any] = {
        "scenario": {"title": loaded.title, "kind": "closed-loop", "source": loaded.source},
        "law": {"outputs": inputs},
        **{n: tables[n] for n in OF_THE_KERNEL if n in tables},
        "safety": {"kernel": name, **({} if loaded.law is not None else OPTIMAL)},
        "run": {
            **{n: getattr(settings, n) for n in ("horizon", "sample_time", "record_every")},
            "until_goal": settings.until_goal,
        },
    }
    others = {n: tables[n] for n in DECISIVE if tables.get(n) != before.get(n) and n in tables}
    if others:
        copied["kernels"] = {name: others}
    return Copy(copied) if (said := _refused(copied, scenario, name)) is None else Copy(None, said)


def _refused(tables: Mapping[str, Any], scenario: str, name: str) -> str | None:
    """Why no file can have these tables."""
    starts = {"states": [{}], "start_outside": True}
    here = {**tables, "starts": starts, "safety": {**tables["safety"], "kernel": scenario}}
    if name in (kernels := tables.get("kernels", {})):
        here["kernels"] = {scenario: kernels[name]}
    try:
        scenario_of(scenario, "", here)
    except HoldfastError as error:
        return f"No file of closed loops has this law: {error.cause}."
    return None


def _tables_of(scenario: str, changes: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The tables of the file, and those with the overrides."""
    _, text = read_text(scenario)
    before = tomllib.loads(text)
    return before, overridden(text, before, changes)[1]


TABLES = ("law", "system", "region", "goal", "tracking", "observer", "field")
"""Tables whose numbers are parameters of the same name."""

MEASURED = ("delay", "noise_uniform", "noise_normal")
"""Settings of [run] and [noise] that a page can change."""

VALUES, TRUTH, DISTURBANCE, DRAWS = "values", "truth", "disturbance", "draws"
UNIFORM, NORMAL, DELAY = "uniform", "normal", "delay"

Place = tuple[str, str]
"""Of a number in a page: what it is a number of, and its name there."""

Number = float | tuple[float, float]
"""A draw is the range that it is drawn from."""


def numbers_of(loaded: Scenario) -> dict[Place, Number]:
    """All numbers of the closed loops that a page can change, in SI units."""
    numbers: dict[Place, Number] = {(VALUES, n): v for n, v in _parameters(loaded).items()}
    numbers |= {(TRUTH, n): float(v) for n, v in loaded.plant.items()}
    for name in loaded.system.disturbance_names:
        size = loaded.disturbance.get(name)
        if size is None or size.is_Number:
            numbers[DISTURBANCE, name] = 0.0 if size is None else float(size)
    for kind in (UNIFORM, NORMAL):
        sizes = loaded.settings[f"noise_{kind}"]
        numbers |= {(kind, n): float(sizes.get(n, 0.0)) for n in loaded.system.state_names}
    numbers[DELAY, ""] = float(loaded.settings["delay"])
    numbers |= {(DRAWS, n): (low, high) for n, (low, high) in loaded.varied.draws.items()}
    return numbers


def rest_of(loaded: Scenario) -> object:
    """What else the runs depend on: equal where one loop serves both scenarios."""
    varied = replace(loaded.varied, draws=dict.fromkeys(loaded.varied.draws, (0.0, 1.0)))
    written = {n: e for n, e in loaded.disturbance.items() if not e.is_Number}
    parts = (loaded.system, loaded.model, loaded.law, loaded.region, loaded.goal, written, varied)
    settings = {k: v for k, v in loaded.settings.items() if k not in MEASURED}
    safety = loaded.safety
    identity = None
    if safety is not None:  # the kernel is another one where it is computed for another vehicle
        kernel, how = safety.kernel, repr((safety.alone, dict(safety.settings)))
        identity = (kernel.name, kernel.digest, how, safety.tracking)
    return substance(parts), settings, loaded.starts, loaded.start_outside, identity


def keys_of(loaded: Scenario, scenario: str, changes: Sequence[str]) -> dict[str, str]:
    """Parameter -> the key of its number, where another number changes that parameter alone.

    All keys are tried at once, and each for itself where that changes more.
    """
    _, _, tables = read_tables(scenario, changes)
    numbers, rest = numbers_of(loaded), rest_of(loaded)
    runs = loaded.starts.count if loaded.independent_runs else None
    keys = {}
    for table in TABLES:
        for name, key, value in _numbers_in(tables.get(table, {})):
            if name not in keys and numbers.get((VALUES, name)) == value:
                keys[name] = f"{table}.{key}"

    def fits(names: Iterable[str]) -> bool:
        others = {name: beside(_number(numbers[VALUES, name])) for name in names}
        more = [f"{keys[n]}={v!r}" for n, v in others.items()]
        other = composed_quietly(scenario, [*changes, *more], runs)
        if not isinstance(other, Scenario) or rest_of(other) != rest:
            return False
        return numbers_of(other) == numbers | {(VALUES, n): v for n, v in others.items()}

    return keys if fits(keys) else {n: k for n, k in keys.items() if fits([n])}


def composed_quietly(
    scenario: str, changes: Sequence[str], runs: int | None = None
) -> Scenario | None:
    """The closed loops with these overrides, without warnings; None where they are refused."""
    try:
        with warnings.catch_warnings():
            for kind in (GainWarning, ModelWarning):
                warnings.simplefilter("ignore", kind)
            composed = scenario_of(*read_tables(scenario, changes), runs)
    except HoldfastError:
        return None
    return composed if isinstance(composed, Scenario) else None


def beside(value: float) -> float:
    """Another number, near the given one."""
    return value * (1 - 2.0**-10) or 2.0**-10


def _number(value: Number) -> float:
    assert isinstance(value, float)
    return value


def _parameters(loaded: Scenario) -> dict[str, float]:
    regions = [r for r in (loaded.region, loaded.goal) if r is not None]
    groups = (p.parameters for p in (loaded.system, loaded.law, *regions))
    return {p.name: float(p.value) for group in groups for p in group}


def _numbers_in(table: Any) -> Iterator[tuple[str, str, float]]:
    """The numbers of a table, and of its parameters, in SI units: name, key, value."""
    entries = table if isinstance(table, Mapping) else {}
    named = [(name, name, value) for name, value in entries.items()]
    for name, value in entries.get("parameters", {}).items():
        is_table = isinstance(value, Mapping)
        key = f"parameters.{name}" + (".value" if is_table else "")
        named.append((name, key, value.get("value") if is_table else value))
    for name, key, value in named:
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            try:
                yield name, key, in_base_units(value)
            except HoldfastError:
                continue


MOST_BYTES = 10 * 2**20
"""A page with a larger table would be slow to open."""

FAN = 200
"""Starts that a page draws at once."""

MOST_CURRENT = 0.3
"""The largest current that can be dragged [m/s], where the system has no bounds of it."""

FILTERS = ("safeguard", "safety")
"""Tables of a safety filter."""

FILTERED, ALONE = "with the safety filter", "the law alone"


@dataclass(frozen=True)
class Explored:
    """What a page shows: a closed loop with its starts, and what is drawn for each of them.

    alone: the law without its safety filter, if it has one. keys: parameter -> the key of the file
    whose number it is. tables: of a file that reproduces a run; where no file does they are None,
    and `uncopied` is the reason. fixed: why a copy has the start of the file. note: what the page
    says of itself. latest: the longest delay that has to fit [s]. sweep: the table of a sweep of
    these loops, as `explored_sweep` has it. slices: of a set that is shown without a law, its grid
    and its values (`packed_slices`).
    """

    name: str
    title: str
    source: str
    system: System
    law: Law | Switching
    alone: Law | Switching | None
    region: Region | None
    goal: Region | None
    disturbance: Mapping[str, Expression]
    plant: Mapping[str, float]
    varied: Varied
    settings: Settings
    stepper: str
    plane: tuple[str, str]
    starts: Array
    drawn: Array
    keys: Mapping[str, str]
    tables: Mapping[str, Any] | None
    note: str = ""
    slices: tuple[Mapping[str, Any], Sequence[bytes]] | None = None
    uncopied: str = ""
    fixed: str = ""
    latest: float = 0.0
    sweep: Mapping[str, Any] | None = None


def page_of(
    loaded: Any, scenario: str, changes: Sequence[str], progress: Progress | None = None
) -> str:
    """The page of what was loaded from the scenario with these changes; refused as by `explore`."""
    if isinstance(loaded, Scenario):
        return page(of_loop(loaded, scenario, changes, progress))
    if isinstance(loaded, KernelScenario):
        return page(_with_copy(explored_kernel(loaded, progress), loaded, scenario, changes))
    if isinstance(loaded, PartsScenario):
        raise ScenarioError(
            f"'{scenario}' is put together from parts and has no grid of all its states",
            expected="closed loops, a kernel or a capture basin on one grid",
        )
    raise ScenarioError(
        f"'{scenario}' is a {loaded.kind}", expected="closed loops, a kernel or a capture basin"
    )


def _with_copy(
    shown: Explored, loaded: KernelScenario, scenario: str, changes: Sequence[str]
) -> Explored:
    """The page of a kernel with the file of its closed loops, if the kernel is as in that file.

    The disturbances that the kernel knows are those of the file, numbers beside the equations: put
    into the equations they would be rounded elsewhere.
    """
    if shown.slices is not None:
        return shown
    disturbance = {name: parse_expression(v, {}) for name, v in loaded.given.items()}
    shown = replace(shown, system=loaded.system, disturbance=disturbance)
    if shown.note:
        return replace(shown, uncopied="No file has the kernel as it is rounded here.")
    copy = copied_kernel(loaded, scenario, changes, shown.settings)
    return replace(shown, tables=copy.tables, uncopied=copy.reason)


def of_loop(
    loaded: Scenario, scenario: str, changes: Sequence[str], progress: Progress | None
) -> Explored:
    """Closed loops with their first starts; `ScenarioError` where no page can have them."""
    if loaded.plane is None:
        raise ScenarioError(f"'{scenario}' has one state", expected="two states to draw in")
    if loaded.surroundings is not None:
        raise ScenarioError(f"'{scenario}' has obstacles that move, which no page has")
    if loaded.law.handed:
        raise ScenarioError(
            f"the law of '{scenario}' is commanded by another controller, which no page has",
            remedy="name the law in the file",
        )
    ready = loaded.kept(progress)
    starts, drawn = first_starts(ready)
    copy = copied_loop(loaded, scenario, changes)
    settings = {k: v for k, v in ready.settings.items() if k in Settings.__dataclass_fields__}
    return Explored(
        name=ready.name, title=ready.title, source=ready.source, system=ready.system, law=ready.law,
        alone=_alone(loaded, scenario, changes),
        region=ready.region, goal=ready.goal, disturbance=ready.disturbance, plant=ready.plant,
        varied=ready.varied, settings=Settings(**settings), stepper=ready.settings["stepper"],
        plane=loaded.plane, starts=starts, drawn=drawn, keys=keys_of(loaded, scenario, changes),
        tables=copy.tables, fixed=copy.fixed,
    )  # fmt: skip


def first_starts(loaded: Scenario) -> tuple[Array, Array]:
    """The first starts of the scenario, and what is drawn for each of these runs. The shapes are
    (runs, states) and (runs, draws)."""
    count, step = min(loaded.runs, FAN), loaded.settings["sample_time"]
    brief = loaded.with_settings(horizon=step, record_every=step, delay=0.0)
    arrays = brief.run(part=range(count) if loaded.independent_runs else None).arrays
    drawn = [*loaded.varied.draws, *loaded.varied.cases]
    return arrays["state"].values[:, 0], arrays["varied"].values[:, : len(drawn)]


def _alone(loaded: Scenario, scenario: str, changes: Sequence[str]) -> Law | Switching | None:
    """The law of the file without its tables of a safety filter; None where it has none."""
    shown, text, tables = read_tables(scenario, changes)
    bare = {name: table for name, table in tables.items() if name not in FILTERS}
    if len(bare) == len(tables):
        return None
    try:
        other = scenario_of(shown, text, bare)
    except HoldfastError:  # a law that others command has to have a filter
        return None
    alone: Law | Switching = other.law
    return alone


def page(shown: Explored) -> str:
    """The file, as text."""
    return explorer_page(_described(shown))


def _described(shown: Explored) -> dict[str, Any]:
    """The data of the page."""
    system, settings, varied = shown.system, shown.settings, shown.varied
    laws = {FILTERED: shown.law, ALONE: shown.alone} if shown.alone is not None else {"": shown.law}
    loops = {label: _loop(shown, law) for label, law in laws.items() if law is not None}
    loop = next(iter(loops.values()))
    noise = settings.noise_of(system.state_names)
    return {
        "title": shown.title, "name": shown.name, "source": shown.source, "note": shown.note,
        "states": [_quantity(q) | {"angle": q.angle} for q in system.states],
        "inputs": [_quantity(q) for q in system.inputs],
        "disturbances": [_quantity(q) for q in system.disturbances],
        "given": _given(shown), "most": _most(shown), "most_current": MOST_CURRENT,
        "current": [q.name for q in system.current_along(*shown.plane) or ()],
        "constraints": [list(c) for c in loop.program.constraints],
        "plane": [system.state_names.index(n) for n in shown.plane],
        "disturbance": list(loop.program.given),
        "draws": {n: list(r) for n, r in varied.draws.items()}, "cases": list(varied.cases),
        "units": dict(varied.units),
        "scene": [_shape(shown, s) | {"at": k} for s, k in loop.scene],
        "noise": {"uniform": noise[0].tolist(), "normal": noise[1].tolist()},
        "settings": {
            name: getattr(settings, name)
            for name in ("horizon", "sample_time", "delay", "record_every", "continuous")
        } | {"seed": str(settings.seed)},
        "variants": [
            {
                "label": label, "modes": list(variant.program.modes), "grid": variant.grid,
                "loop": {**variant.described(), **_packed(variant), "states": len(system.states)},
                "values": {p.name: p.value for p in variant.program.parameters},
                "knobs": list(_knobs(shown, variant.program.parameters)),
            }
            for label, variant in loops.items()
        ],
        "plant": dict(shown.plant), "filters": FILTERS, "slices": _slices(shown),
        "starts": shown.starts.tolist(), "drawn": shown.drawn.tolist(), "tables": shown.tables,
        "uncopied": shown.uncopied, "fixed": shown.fixed,
        "poses": poses(shown.system, shown.plane),
        "sweep": None if shown.sweep is None else _table(shown),
    }  # fmt: skip


def _loop(shown: Explored, law: Law | Switching) -> WebLoop:
    latest = max(shown.settings.delay, shown.latest)
    loop = web_loop(
        shown.system, law, replace(shown.settings, delay=latest),
        region=shown.region, goal=shown.goal, disturbance=shown.disturbance, varied=shown.varied,
        stepper=shown.stepper, shapes=bodies(shown.system, shown.plane),
    )  # fmt: skip
    if loop.table is not None and loop.table.nbytes > MOST_BYTES:
        raise ScenarioError(
            f"the kernel of '{shown.name}' has {loop.table.nbytes / 2**20:.0f} MiB",
            expected=f"at most {MOST_BYTES / 2**20:.0f} MiB in a page",
            remedy="compute it with fewer nodes",
        )
    return loop


def _shape(shown: Explored, shape: Shape) -> dict[str, Any]:
    """What a shape is. Of a zero level the states that it depends on, and whether it moves."""
    about = {"kind": type(shape).__name__, "role": shape.role}
    if not isinstance(shape, ZeroLevel):
        return about
    free = shape.expression.free_symbols
    reads = [k for k, q in enumerate(shown.system.states) if q.symbol in free]
    return {**about, "name": shape.name, "reads": reads, "timed": TIME in free}


def _slices(shown: Explored) -> dict[str, Any] | None:
    if shown.slices is None:
        return None
    grid, parts = shown.slices
    return {**grid, "values": [base64.b64encode(part).decode("ascii") for part in parts]}


def _packed(loop: WebLoop) -> dict[str, str]:
    table = b"" if loop.table is None else loop.table.tobytes()
    parts = {
        "exact": loop.exact, "noisy": loop.noisy or b"", "numbers": loop.numbers.tobytes(),
        "whole": loop.whole.tobytes(), "table": table,
    }  # fmt: skip
    return {name: _text(content) if content else "" for name, content in parts.items()}


def _table(shown: Explored) -> str:
    """The table of the sweep, compressed."""
    text = _text(json.dumps(shown.sweep, allow_nan=False).encode())
    if len(text) > MOST_BYTES:
        raise ScenarioError(
            f"the table of the sweep has {len(text) / 2**20:.0f} MiB, compressed",
            expected=f"at most {MOST_BYTES / 2**20:.0f} MiB in a page",
            remedy="sweep fewer cells",
        )
    return text


def _text(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")


def _quantity(q: Any) -> dict[str, Any]:
    return {"name": q.name, "unit": q.unit, "says": q.description}


def _given(shown: Explored) -> list[str]:
    """The disturbances that are numbers in a run: not given, or given as one."""
    pairs = ((n, shown.disturbance.get(n)) for n in shown.system.disturbance_names)
    return [n for n, e in pairs if e is None or e.is_Number]


def _most(shown: Explored) -> list[float | None]:
    """The largest size of each disturbance that is a number; None where the system has no bound."""
    bounds, names = shown.system.disturbance_bounds, shown.system.disturbance_names
    if bounds is None:
        return [None for _ in _given(shown)]
    ends = bounds.at({p.symbol: p.value for p in shown.system.parameters}).ranges()
    sizes = {n: max(abs(float(a)), abs(float(b))) for n, (a, b) in zip(names, ends, strict=True)}
    return [sizes[n] if math.isfinite(sizes[n]) else None for n in _given(shown)]


def _knobs(shown: Explored, parameters: Sequence[Parameter]) -> Iterator[dict[str, Any]]:
    """Numbers that can be changed in the page, with the key of the file that says the same.

    Those that have a key; and for every number of the vehicle, what it is in truth while the law
    believes another.
    """
    varied = {*shown.varied.names, *shown.varied.plant}
    of_vehicle = {p.name for p in shown.system.parameters}
    for p in parameters:
        if p.name in varied:
            continue
        about = {**_quantity(p), "above": p.above if math.isfinite(p.above) else None}
        if p.name in shown.keys:
            key = shown.keys[p.name]
            yield {**about, "key": key, "of": "both", "group": key.partition(".")[0]}
        if p.name in of_vehicle and p.value:
            yield {**about, "key": f"plant.{p.name}", "of": "plant", "group": "plant"}


MOST_BYTES_PACKED = 7 * 2**20
"""Of the compressed values: a page holds them as text, which is a third longer."""

MOST_NODES = 2**27
"""Nodes at one time; the browser needs a byte for each."""

LEVELS = 127
"""The values go from -LEVELS to LEVELS, and are 0 or less outside the set."""


def check_size(name: str, nodes: int) -> None:
    """Raises `ScenarioError` for a grid that no page can hold, before its march."""
    if nodes > MOST_NODES:
        raise ScenarioError(
            f"the grid of '{name}' has {nodes / 1e6:.0f} million nodes",
            expected=f"at most {MOST_NODES / 1e6:.0f} million for a page",
            remedy="take fewer: --set grid.nodes=...",
        )


def packed_slices(value: ValueFunction) -> tuple[dict[str, Any], list[bytes], str]:
    """The grid of the values, the values at as many times as fit, and what the page says of them.

    A value is rounded to 1/`LEVELS` of the largest beside the set's boundary, and values beyond
    that are cut: a slice needs the sign, and near the boundary the ratio. Nodes keep their side.
    Raises `ScenarioError` for values that are too many even at one time.
    """
    axes, data = value.grid.axes, value.dataset["value"]
    periodic = [a.ends == "periodic" for a in axes]
    times = [float(t) for t in data["time"].values] if "time" in data.dims else []
    parts: list[bytes] = []
    nodes = size = 0
    asked: list[float | None] = [*times] or [None]
    for time in reversed(asked):  # the last one is the answer
        levels = _levels(value.values(time), periodic)
        part = zlib.compress(levels.tobytes(), 9)
        nodes, size = nodes + levels.size, size + len(part)
        if nodes > MOST_NODES or size > MOST_BYTES_PACKED:
            break
        parts.insert(0, part)
    if not parts:
        raise ScenarioError(
            f"the values have {size / 2**20:.0f} MiB, compressed",
            expected=f"at most {MOST_BYTES_PACKED / 2**20:.0f} MiB", remedy="take fewer nodes",
        )  # fmt: skip
    grid = {
        "low": [a.low for a in axes], "steps": [a.step for a in axes],
        "shape": [a.count for a in axes], "periodic": periodic, "times": times[-len(parts) :],
    }  # fmt: skip
    fewer = f", at {len(parts)} of their {len(times)} times" if len(parts) < len(times) else ""
    return grid, parts, f"its values have one byte each{fewer}"


def _levels(values: AnyArray, periodic: list[bool]) -> npt.NDArray[np.int8]:
    inside = values > 0
    largest = 0.0
    for axis, closed in enumerate(periodic):
        first, second = (np.moveaxis(a, axis, 0) for a in (inside, values))
        ends = [(slice(1, None), slice(None, -1))]
        if closed:
            ends.append((slice(0, 1), slice(-1, None)))
        for one, other in ends:
            crossed = first[one] != first[other]
            for part in (one, other):
                beside = np.abs(second[part][crossed])
                largest = max(largest, float(beside.max(initial=0.0)))
    scaled = values * (LEVELS / (largest or 1.0))
    levels = np.rint(np.clip(scaled, -LEVELS, LEVELS, out=scaled), out=scaled).astype(np.int8)
    np.maximum(levels, 1, out=levels, where=inside)
    np.minimum(levels, 0, out=levels, where=~inside)
    return levels


SAMPLE_TIME, RECORDED = 0.02, 0.1
"""Of a kernel whose scenario tries no promise [s]."""


def explored_kernel(loaded: KernelScenario, progress: Progress | None = None) -> Explored:
    """The set with its law: the optimal inputs, or the least change of those of its [law].

    A set that no law keeps, and one whose law is too large for a page, has its slices alone. Raises
    `ScenarioError` for a set that is empty, one of a single state, and one that is too large for
    slices too.
    """
    if len(loaded.system.state_names) < 2:
        raise ScenarioError(f"'{loaded.name}' has one state", expected="two states to draw in")
    check_size(loaded.name, math.prod(a.count for a in loaded.grid.axes))
    value = loaded.solve(progress)
    if value.values().max() <= 0:
        raise ScenarioError(f"the set of '{loaded.name}' is empty", remedy="take a smaller bound")
    if loaded.kind not in LAWFUL:
        return _kernel_alone(loaded, value, f"no law decides in a {loaded.kind.replace('-', ' ')}")
    try:
        return _with_law(loaded, value)
    except SimulationError as error:
        return _kernel_alone(loaded, value, error.cause)


def _with_law(loaded: KernelScenario, value: ValueFunction) -> Explored:
    system = decided(loaded.system, value)
    shown, note = _thinned(value)
    step = float((loaded.promised or {}).get("sample_time", SAMPLE_TIME))
    drawn = loaded.law is None  # the table of the optimal inputs is the set's own
    law = safety_law(loaded.system, shown, loaded.law, sample_time=step, ahead=not drawn)
    loss = sampled_margin(loaded.system, shown, step) if loaded.system.inputs else 0.0
    starts, _ = inside_states(shown, np.random.default_rng(loaded.seed), FAN, None, loss)
    stride = max(round(RECORDED / step), 1)
    records = max(round(loaded.horizon / (stride * step)), 1)
    settings = Settings(
        horizon=records * stride * step, sample_time=step, record_every=stride * step,
        until_goal=loaded.goal is not None,
    )  # fmt: skip
    return _explored(
        loaded,
        system=system,
        law=law,
        alone=loaded.law,
        settings=settings,
        starts=starts,
        note=note,
    )


def _kernel_alone(loaded: KernelScenario, value: ValueFunction, reason: str) -> Explored:
    """The slices of the set, and the scene in the state that is deepest in it."""
    grid, packed, note = packed_slices(value)
    values = value.values()
    deepest = np.unravel_index(int(values.argmax()), values.shape)
    start = [a.nodes[k] for a, k in zip(value.grid.axes, deepest, strict=True)]
    horizon = max(grid["times"], default=1.0)
    still = Law("still", (), {q.name: 0 * q.symbol for q in loaded.system.inputs})
    return _explored(
        loaded, system=loaded.system, law=still, alone=None,
        settings=Settings(horizon=horizon, sample_time=horizon, record_every=horizon),
        starts=np.array([start]), note=f"The set alone: {reason}; {note}.",
        slices=(grid, packed),
    )  # fmt: skip


def _explored(loaded: KernelScenario, starts: Array, **rest: Any) -> Explored:
    names = loaded.system.state_names
    return Explored(
        name=loaded.name, title=loaded.title, source=loaded.source,
        region=loaded.region, goal=loaded.goal, disturbance={}, plant={}, varied=Varied(),
        stepper="rk4", plane=loaded.figures.plane or (names[0], names[1]), starts=starts,
        drawn=np.empty((len(starts), 0)), keys={}, tables=None, **rest,
    )  # fmt: skip


def _thinned(value: ValueFunction) -> tuple[ValueFunction, str]:
    """The value at as many times as fit into a page, in single precision; what was left out."""
    data = value.dataset
    times = data["value"].sizes.get("time", 1)
    if data["value"].nbytes <= MOST_BYTES:
        return value, ""
    single = data.assign(value=data["value"].astype(np.float32))
    for step in (k for k in range(1, max(times, 2)) if (times - 1) % k == 0):
        some = single if step == 1 else single.isel(time=slice(None, None, step))
        if some["value"].nbytes <= MOST_BYTES:
            left = some["value"].sizes.get("time", 1)
            fewer = f", at {left} of its {times} times" if step > 1 else ""
            return ValueFunction(
                some, value.grid
            ), f"The kernel is in single precision here{fewer}."
    raise SimulationError(
        f"its law needs {single['value'].nbytes / times / 2**20:.0f} MiB at one time, "
        f"and a page has at most {MOST_BYTES / 2**20:.0f}"
    )
