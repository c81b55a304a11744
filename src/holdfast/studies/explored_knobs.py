"""The numbers of closed loops that a page can change, and their keys in the file."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from holdfast.errors import GainWarning, HoldfastError, ModelWarning
from holdfast.maths.definitions.units import in_base_units
from holdfast.scenario.files import read_tables
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import scenario_of
from holdfast.scenario.overrides import substance

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
    found: dict[Place, Number] = {(VALUES, n): v for n, v in _parameters(loaded).items()}
    found |= {(TRUTH, n): float(v) for n, v in loaded.plant.items()}
    for name in loaded.system.disturbance_names:
        size = loaded.disturbance.get(name)
        if size is None or size.is_Number:
            found[DISTURBANCE, name] = 0.0 if size is None else float(size)
    for kind in (UNIFORM, NORMAL):
        sizes = loaded.settings[f"noise_{kind}"]
        found |= {(kind, n): float(sizes.get(n, 0.0)) for n in loaded.system.state_names}
    found[DELAY, ""] = float(loaded.settings["delay"])
    found |= {(DRAWS, n): (low, high) for n, (low, high) in loaded.varied.draws.items()}
    return found


def rest_of(loaded: Scenario) -> object:
    """What else the runs depend on: equal where one loop serves both scenarios."""
    varied = replace(loaded.varied, draws=dict.fromkeys(loaded.varied.draws, (0.0, 1.0)))
    written = {n: e for n, e in loaded.disturbance.items() if not e.is_Number}
    own = (loaded.system, loaded.model, loaded.law, loaded.region, loaded.goal, written, varied)
    settings = {k: v for k, v in loaded.settings.items() if k not in MEASURED}
    safety = loaded.safety
    kept = None
    if safety is not None:  # the kernel is another one where it is computed for another vehicle
        kept = (safety.kernel.name, safety.kernel.digest, repr(safety.spec), safety.tracking)
    return substance(own), settings, loaded.starts, loaded.start_outside, kept


def keys_of(loaded: Scenario, scenario: str, changes: Sequence[str]) -> dict[str, str]:
    """Parameter -> the key of its number, where another number changes that parameter alone.

    All keys are tried at once, and each for itself where that changes more.
    """
    _, _, tables = read_tables(scenario, changes)
    own, rest = numbers_of(loaded), rest_of(loaded)
    runs = loaded.starts.count if loaded.independent_runs else None
    keys = {}
    for table in TABLES:
        for name, key, value in _written(tables.get(table, {})):
            if name not in keys and own.get((VALUES, name)) == value:
                keys[name] = f"{table}.{key}"

    def fits(names: Iterable[str]) -> bool:
        others = {name: beside(_number(own[VALUES, name])) for name in names}
        more = [f"{keys[n]}={v!r}" for n, v in others.items()]
        other = composed_quietly(scenario, [*changes, *more], runs)
        if not isinstance(other, Scenario) or rest_of(other) != rest:
            return False
        return numbers_of(other) == own | {(VALUES, n): v for n, v in others.items()}

    return keys if fits(keys) else {n: k for n, k in keys.items() if fits([n])}


def composed_quietly(
    scenario: str, changes: Sequence[str], runs: int | None = None
) -> Scenario | None:
    """The closed loops with these overrides, without warnings; None where they are refused."""
    try:
        with warnings.catch_warnings():
            for kind in (GainWarning, ModelWarning):
                warnings.simplefilter("ignore", kind)
            found = scenario_of(*read_tables(scenario, changes), runs)
    except HoldfastError:
        return None
    return found if isinstance(found, Scenario) else None


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


def _written(table: Any) -> Iterator[tuple[str, str, float]]:
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
