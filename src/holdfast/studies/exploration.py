"""A scenario as one page for a browser, in which it runs: `holdfast explore`."""

from __future__ import annotations

import base64
import math
import tomllib
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.simulation.web_loop import WebLoop, web_loop
from holdfast.errors import GainWarning, HoldfastError, ModelWarning, ScenarioError
from holdfast.execution.arrays import Array
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import in_base_units
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.numeric import Expression
from holdfast.presentation.html.explorer import explorer_page
from holdfast.scenario.files import overridden, read_tables, read_text
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.kinds.formation import FormationScenario
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario, scenario_of
from holdfast.scenario.overrides import substance

MOST_BYTES = 10 * 2**20
"""A page with a larger table would be slow to open."""

FAN = 200
"""Starts that a page draws at once."""

MOST_CURRENT = 0.3
"""The largest current that can be dragged [m/s], where the system has no bounds of it."""

FILTERS = ("safeguard", "safety")
"""Tables of a safety filter."""

FILTERED, ALONE = "with the safety filter", "the law alone"

TABLES = ("law", "system", "region", "goal", "tracking", "observer", "field")
"""Tables whose numbers are parameters of the same name."""


@dataclass(frozen=True)
class Explored:
    """What a page shows: a closed loop with its starts, and what is drawn for each of them.

    alone: the law without its safety filter, if it has one. keys: parameter -> the key of the file
    whose number it is. tables: of a file that reproduces a run; None where no file does. note: what
    the page says of itself.
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


def explore(
    scenario: str, overrides: Iterable[str] = (), *, progress: Progress | None = None
) -> str:
    """The page of a scenario: one self-contained HTML file, as text.

    What moves in it is the loop of `simulate`, compiled to WebAssembly; its numbers are those of
    `simulate`, bit for bit. A kernel or a capture basin is shown with the law that keeps it. Raises
    `ScenarioError` for a scenario of one state or without a law, a law that another controller has,
    and a kernel that is too large.
    """
    changes = list(overrides)
    return page_of(load_scenario(scenario, changes), scenario, changes, progress)


def page_of(
    loaded: Any, scenario: str, changes: Sequence[str], progress: Progress | None = None
) -> str:
    """The page of what was loaded from the scenario with these changes; refused as by `explore`."""
    if isinstance(loaded, Scenario):
        return explorer_page(_described(_of_loop(loaded, scenario, changes, progress)))
    if isinstance(loaded, KernelScenario):
        from holdfast.studies.explored_kernel import explored_kernel

        return explorer_page(_described(explored_kernel(loaded, progress)))
    raise ScenarioError(
        f"'{scenario}' is a {loaded.kind}", expected="closed loops, a kernel or a capture basin"
    )


def _of_loop(
    loaded: Scenario, scenario: str, changes: Sequence[str], progress: Progress | None
) -> Explored:
    if loaded.plane is None:
        raise ScenarioError(f"'{scenario}' has one state", expected="two states to draw in")
    if loaded.law.handed:
        raise ScenarioError(
            f"the law of '{scenario}' is commanded by another controller, which no page has",
            remedy="name the law in the file",
        )
    kept = loaded.kept(progress)
    starts, drawn = _starts(kept)
    own = {k: v for k, v in kept.settings.items() if k in Settings.__dataclass_fields__}
    return Explored(
        name=kept.name, title=kept.title, source=kept.source, system=kept.system, law=kept.law,
        alone=_alone(loaded, scenario, changes),
        region=kept.region, goal=kept.goal, disturbance=kept.disturbance, plant=kept.plant,
        varied=kept.varied, settings=Settings(**own), stepper=kept.settings["stepper"],
        plane=loaded.plane, starts=starts, drawn=drawn, keys=_keys(loaded, scenario, changes),
        tables=_tables(loaded, scenario, changes),
    )  # fmt: skip


def _starts(loaded: Scenario) -> tuple[Array, Array]:
    """The first starts of the scenario, and what is drawn for each of these runs."""
    count, step = min(loaded.runs, FAN), loaded.settings["sample_time"]
    brief = loaded.with_settings(horizon=step, record_every=step, delay=0.0)
    found = brief.run(part=range(count) if loaded.independent_runs else None).arrays
    drawn = [*loaded.varied.draws, *loaded.varied.cases]
    return found["state"].values[:, 0], found["varied"].values[:, : len(drawn)]


def _tables(loaded: Scenario, scenario: str, changes: Sequence[str]) -> dict[str, Any] | None:
    """Those of the file that one run needs, with paths as the file has them.

    None for a formation, whose starts follow from its leader.
    """
    if isinstance(loaded, FormationScenario):
        return None
    _, text = read_text(scenario)
    _, tables = overridden(text, tomllib.loads(text), changes)
    kept = {name: table for name, table in tables.items() if name not in ("compare", "kernels")}
    named = str(tables.get("safety", ""))
    kernels = {n: k for n, k in tables.get("kernels", {}).items() if n in named}
    return kept | ({"kernels": kernels} if kernels else {})


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
        "constraints": [list(c) for c in loop.program.constraints],
        "plane": [system.state_names.index(n) for n in shown.plane],
        "disturbance": list(loop.program.given),
        "draws": {n: list(r) for n, r in varied.draws.items()}, "cases": list(varied.cases),
        "units": dict(varied.units),
        "scene": [{"kind": type(s).__name__, "role": s.role, "at": k} for s, k in loop.scene],
        "noise": {"uniform": noise[0].tolist(), "normal": noise[1].tolist()},
        "settings": {
            name: getattr(settings, name)
            for name in ("horizon", "sample_time", "delay", "record_every", "continuous")
        } | {"seed": str(settings.seed)},
        "variants": [
            {
                "label": label, "modes": list(own.program.modes), "grid": own.grid,
                "loop": {**own.described(), **_packed(own), "states": len(system.states)},
                "values": {p.name: p.value for p in own.program.parameters},
                "knobs": list(_knobs(shown, own.program.parameters)),
            }
            for label, own in loops.items()
        ],
        "plant": dict(shown.plant), "filters": FILTERS,
        "starts": shown.starts.tolist(), "drawn": shown.drawn.tolist(), "tables": shown.tables,
    }  # fmt: skip


def _loop(shown: Explored, law: Law | Switching) -> WebLoop:
    loop = web_loop(
        shown.system, law, shown.settings, region=shown.region, goal=shown.goal,
        disturbance=shown.disturbance, varied=shown.varied, stepper=shown.stepper,
    )  # fmt: skip
    if loop.table is not None and loop.table.nbytes > MOST_BYTES:
        raise ScenarioError(
            f"the kernel of '{shown.name}' has {loop.table.nbytes / 2**20:.0f} MiB",
            expected=f"at most {MOST_BYTES / 2**20:.0f} MiB in a page",
            remedy="compute it with fewer nodes",
        )
    return loop


def _packed(loop: WebLoop) -> dict[str, str]:
    table = b"" if loop.table is None else loop.table.tobytes()
    parts = {
        "exact": loop.exact, "noisy": loop.noisy or b"", "numbers": loop.numbers.tobytes(),
        "whole": loop.whole.tobytes(), "table": table,
    }  # fmt: skip
    return {name: _text(content) if content else "" for name, content in parts.items()}


def _text(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode("ascii")


def _quantity(q: Any) -> dict[str, Any]:
    return {"name": q.name, "unit": q.unit, "says": q.description}


def _given(shown: Explored) -> list[str]:
    """The disturbances that are numbers in a run: not given, or given as one."""
    found = ((n, shown.disturbance.get(n)) for n in shown.system.disturbance_names)
    return [n for n, e in found if e is None or e.is_Number]


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


def _keys(loaded: Scenario, scenario: str, changes: Sequence[str]) -> dict[str, str]:
    """Parameter -> the key of its number, where another number changes that parameter alone.

    All keys are tried at once, and each for itself where that changes more.
    """
    _, _, tables = read_tables(scenario, changes)
    own = _parameters(loaded)
    keys = {}
    for table in TABLES:
        for name, key, value in _numbers(tables.get(table, {})):
            if name not in keys and own.get(name) == value:
                keys[name] = f"{table}.{key}"

    def fits(names: Iterable[str]) -> bool:
        beside = {n: _beside(own[n]) for n in names}
        more = [f"{keys[n]}={v!r}" for n, v in beside.items()]
        try:
            with warnings.catch_warnings():
                for kind in (GainWarning, ModelWarning):
                    warnings.simplefilter("ignore", kind)
                other = scenario_of(*read_tables(scenario, [*changes, *more]))
        except HoldfastError:
            return False
        same = substance(_law_of(other)) == substance(_law_of(loaded))
        return same and _parameters(other) == own | beside

    return keys if fits(keys) else {n: k for n, k in keys.items() if fits([n])}


def _beside(value: float) -> float:
    """Another number, near the given one."""
    return value * (1 - 2.0**-10) or 2.0**-10


def _law_of(loaded: Scenario) -> tuple[object, ...]:
    """What a run depends on."""
    return (
        loaded.system, loaded.model, loaded.law, loaded.region, loaded.goal, loaded.disturbance,
        loaded.plant, loaded.varied,
    )  # fmt: skip


def _parameters(loaded: Scenario) -> dict[str, float]:
    regions = [r for r in (loaded.region, loaded.goal) if r is not None]
    groups = (p.parameters for p in (loaded.system, loaded.law, *regions))
    return {p.name: float(p.value) for group in groups for p in group}


def _numbers(table: Any) -> Iterator[tuple[str, str, float]]:
    """The numbers of a table, and of its parameters, in SI units: name, key, value."""
    own = table if isinstance(table, Mapping) else {}
    named = [(name, name, value) for name, value in own.items()]
    for name, value in own.get("parameters", {}).items():
        told = isinstance(value, Mapping)
        key = f"parameters.{name}" + (".value" if told else "")
        named.append((name, key, value.get("value") if told else value))
    for name, key, value in named:
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            try:
                yield name, key, in_base_units(value)
            except HoldfastError:
                continue
