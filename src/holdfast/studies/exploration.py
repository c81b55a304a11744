"""A scenario as one page for a browser, in which it runs: `holdfast explore`."""

from __future__ import annotations

import base64
import math
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from holdfast.analysis.simulation.web_loop import WebLoop, web_loop
from holdfast.errors import GainWarning, HoldfastError, ModelWarning, ScenarioError
from holdfast.execution.arrays import Array
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.settings import Settings
from holdfast.host.writing import atomic_file
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.units import in_base_units
from holdfast.presentation.html.explorer import explorer_page
from holdfast.scenario.files import read_tables
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import load_scenario, scenario_of
from holdfast.scenario.overrides import substance

MOST_BYTES = 10 * 2**20
"""A page with a larger table would be slow to open."""

FAN = 200
"""Starts that a page draws at once."""

MOST_CURRENT = 0.3
"""The largest current that can be dragged [m/s], where the system has no bounds of it."""

TABLES = ("law", "system", "region", "goal", "tracking", "observer", "field")
"""Tables whose numbers are parameters of the same name."""


def explore(
    scenario: str, overrides: Iterable[str] = (), *, progress: Progress | None = None
) -> str:
    """The page of a scenario of closed loops: one self-contained HTML file, as text.

    What moves in it is the loop of `simulate`, compiled to WebAssembly; its numbers are those of
    `simulate`, bit for bit. Raises `ScenarioError` for a scenario of another kind, one without a
    plane, a law that another controller commands, and a kernel that is too large for a page.
    """
    changes = list(overrides)
    loaded = load_scenario(scenario, changes)
    if not isinstance(loaded, Scenario):
        raise ScenarioError(
            f"'{scenario}' is a {loaded.kind}", expected="a scenario of closed loops"
        )
    if loaded.plane is None:
        raise ScenarioError(
            f"'{scenario}' has no plane to draw in",
            remedy='name two states: [figures] plane = ["x", "y"]',
        )
    return explorer_page(_described(loaded.kept(progress), scenario, changes))


def write_explorer(page: str, path: Path) -> Path:
    """The page as a file."""
    with atomic_file(path) as partial:
        partial.write_text(page, "utf-8")
    return path


def _described(loaded: Scenario, scenario: str, changes: Sequence[str]) -> dict[str, Any]:
    _, _, tables = read_tables(scenario, changes)
    settings = Settings(
        **{k: v for k, v in loaded.settings.items() if k in Settings.__dataclass_fields__}
    )
    loop = web_loop(
        loaded.system, loaded.law, settings, region=loaded.region, goal=loaded.goal,
        disturbance=loaded.disturbance, varied=loaded.varied,
        stepper=loaded.settings.get("stepper", "rk4"),
    )  # fmt: skip
    if loop.table is not None and loop.table.nbytes > MOST_BYTES:
        raise ScenarioError(
            f"the kernel of '{loaded.name}' has {loop.table.nbytes / 2**20:.0f} MiB",
            expected=f"at most {MOST_BYTES / 2**20:.0f} MiB in a page",
            remedy="compute it with fewer nodes, or in single precision",
        )
    program = loop.program
    noise = settings.noise_of([q.name for q in loaded.system.states])
    assert loaded.plane is not None
    starts, draws = _starts(loaded, settings)
    return {
        "title": loaded.title, "name": loaded.name, "source": loaded.source,
        "loop": {**loop.described(), **_packed(loop), "states": len(loaded.system.states)},
        "states": [_quantity(q) | {"angle": q.angle} for q in program.states],
        "inputs": [_quantity(q) for q in program.inputs],
        "disturbances": [_quantity(q) for q in program.disturbances],
        "given": [n for n in loaded.system.disturbance_names if _is_number(loaded, n)],
        "modes": list(program.modes), "constraints": [list(c) for c in program.constraints],
        "plane": [loaded.system.state_names.index(n) for n in loaded.plane],
        "values": [p.value for p in program.parameters],
        "plant": [loaded.plant.get(p.name, p.value) for p in program.parameters],
        "disturbance": list(program.given),
        "knobs": list(_knobs(loaded, program.parameters, scenario, changes)),
        "draws": {n: list(r) for n, r in loaded.varied.draws.items()},
        "cases": list(loaded.varied.cases),
        "scene": [{"kind": type(s).__name__, "role": s.role, "at": k} for s, k in loop.scene],
        "grid": loop.grid,
        "noise": {"uniform": noise[0].tolist(), "normal": noise[1].tolist()},
        "settings": {
            "horizon": settings.horizon, "sample_time": settings.sample_time, "seed": settings.seed,
            "delay": settings.delay, "record_every": settings.record_every,
            "continuous": settings.continuous,
        },
        "most": _most(loaded), "most_current": MOST_CURRENT, "units": dict(loaded.varied.units),
        "starts": starts.tolist(), "drawn": draws.tolist(), "tables": tables,
    }  # fmt: skip


def _starts(loaded: Scenario, settings: Settings) -> tuple[Array, Array]:
    """The first starts of the scenario, and what is drawn for each of these runs."""
    count = min(loaded.runs, FAN)
    step = settings.sample_time
    brief = loaded.with_settings(horizon=step, record_every=step, delay=0.0)
    found = brief.run(part=range(count) if loaded.independent_runs else None).arrays
    drawn = [*loaded.varied.draws, *loaded.varied.cases]
    return found["state"].values[:, 0], found["varied"].values[:, : len(drawn)]


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


def _is_number(loaded: Scenario, disturbance: str) -> bool:
    """Whether it is a number in a run: not given, or given as one."""
    given = loaded.disturbance.get(disturbance)
    return given is None or bool(given.is_Number)


def _most(loaded: Scenario) -> list[float | None]:
    """The largest size of each disturbance that is a number; None where the system has no bound."""
    bounds, names = loaded.system.disturbance_bounds, loaded.system.disturbance_names
    given = [n for n in names if _is_number(loaded, n)]
    if bounds is None:
        return [None for _ in given]
    ends = bounds.at({p.symbol: p.value for p in loaded.system.parameters}).ranges()
    sizes = {n: max(abs(float(a)), abs(float(b))) for n, (a, b) in zip(names, ends, strict=True)}
    return [sizes[n] if sizes[n] < float("inf") else None for n in given]


def _knobs(
    loaded: Scenario, parameters: Sequence[Parameter], scenario: str, changes: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """Numbers that can be changed in the page, with the key of the file that says the same.

    A number of a table of the file that is the value of the parameter of its name; and for every
    number of the vehicle, what it is in truth while the law believes another.
    """
    varied = {*loaded.varied.names, *loaded.varied.plant}
    found = {n: k for n, k in _keys(loaded, scenario, changes).items() if n not in varied}
    of_vehicle = {p.name for p in loaded.system.parameters}
    for row, p in enumerate(parameters):
        about = {**_quantity(p), "row": row, "above": p.above if math.isfinite(p.above) else None}
        if p.name in found:
            key = found[p.name]
            yield {**about, "key": key, "of": "both", "group": key.partition(".")[0]}
        if p.name in of_vehicle and p.name not in varied and p.value:
            yield {**about, "key": f"plant.{p.name}", "of": "plant", "group": "plant"}


def _keys(loaded: Scenario, scenario: str, changes: Sequence[str]) -> dict[str, str]:
    """Parameter -> the key of its number, where another number changes that parameter alone.

    All keys are tried at once, and each for itself where that changes more.
    """
    _, _, tables = read_tables(scenario, changes)
    own = _parameters(loaded)
    keys = {}
    for table in TABLES:
        for name, value in _numbers(tables.get(table, {})):
            if name not in keys and own.get(name) == value:
                keys[name] = f"{table}.{name}"

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


def _numbers(table: Any) -> Iterator[tuple[str, float]]:
    """The numbers of a table, in SI units."""
    for name, value in table.items() if isinstance(table, Mapping) else ():
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            try:
                yield name, in_base_units(value)
            except HoldfastError:
                continue
