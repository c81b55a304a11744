"""[system]: the system, with states selected, promoted, disturbed; with actuators that lag."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from holdfast.errors import ScenarioError, suggestion
from holdfast.maths.control.unmodelled import add_unmodelled
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.extension import (
    actuator_units,
    dynamic_extension,
    input_limits,
    lagged,
    per_second,
)
from holdfast.maths.definitions.reduction import promote, steady_bounds, subsystem
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import to_si
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.validation import at

LATE = ("lag", "slew")
"""Of actuators: keys of the vehicle that moves, not of the model that laws and kernels are of."""
REDUCTIONS = ("keep", "promote", "disturb", "extend", "unmodelled", *LATE)
VEHICLE = "vehicle"
"""In place of the table of lags: those of the vehicle file, with its slews."""
STEADY = "steady"
"""Replaces an interval: the velocities that the inputs can hold in still water."""


def composed_system(composer: Composer, table: Mapping[str, Any]) -> System:
    """The system of the table, reduced as given there, and registered with the composer."""
    system = composer.system({k: v for k, v in table.items() if k not in REDUCTIONS})
    if "keep" in table:
        kept = table["keep"]
        with at(composer.file, "system.keep"):
            if not (isinstance(kept, list) and kept and all(isinstance(n, str) for n in kept)):
                raise ScenarioError(f"got {kept!r}", expected='states, such as ["u", "v", "r"]')
            system = subsystem(system, tuple(kept))
    if "promote" in table or "disturb" in table:
        inputs, box = _intervals(composer, system, table, "promote")
        felt, felt_box = _intervals(composer, system, table, "disturb")
        with at(composer.file, "system.promote"):
            if not inputs:
                raise ScenarioError("'disturb' without 'promote'", remedy="name the inputs")
            system = promote(system, inputs, box, disturbances=felt, disturbance_bounds=felt_box)
    if "extend" in table:
        names, rates = _intervals(composer, system, table, "extend")
        with at(composer.file, "system.extend"):
            composer.limits = input_limits(system, names)
            system = dynamic_extension(system, names, rates)
    if "unmodelled" in table:
        names, bounds = _intervals(composer, system, table, "unmodelled")
        assert bounds is not None
        with at(composer.file, "system.unmodelled"):
            system = add_unmodelled(system, names, bounds)
    composer.system_built = system
    return system


def plant_of(composer: Composer, system: System, table: Mapping[str, Any]) -> System:
    """The system that moves: with the lag and slew of its inputs, which the law does not know."""
    if "lag" not in table and "slew" not in table:
        return system
    units = actuator_units(system)
    late = None
    if table.get("lag") != VEHICLE:
        late = _numbers(composer, table, "lag", dict.fromkeys(units, "s"))
    slew = _numbers(composer, table, "slew", {n: per_second(u) for n, u in units.items()})
    with at(composer.file, "system"):
        plant = lagged(system, late, slew or None)
    composer.declare(plant.parameters)
    return plant


def _numbers(
    composer: Composer, table: Mapping[str, Any], key: str, units: Mapping[str, str]
) -> dict[str, float]:
    """A number for each of the inputs or actuators named under `key`."""
    given = table.get(key, {})
    with at(composer.file, f"system.{key}"):
        if not isinstance(given, Mapping):
            vehicle = " or 'vehicle'" if key == "lag" else ""
            raise ScenarioError(f"got {given!r}", expected=f"{{ input = number }}{vehicle}")
        for name in given:
            if name not in units:
                raise ScenarioError("unknown name", remedy=suggestion(name, units))
        return {name: to_si(value, units[name]) for name, value in given.items()}


def _intervals(
    composer: Composer, system: System, table: Mapping[str, Any], key: str
) -> tuple[tuple[str, ...], Box | None]:
    """The states named under `key`, and the box of their intervals."""
    if key not in table:
        return (), None
    given = table[key]
    inputs = {q.name: q.unit for q in system.inputs}
    units = {q.name: q.unit for q in system.states}
    if key == "extend":
        units = {n: per_second(unit) for n, unit in inputs.items()}
    if key == "unmodelled":
        units = {n: per_second(unit) for n, unit in units.items()} | inputs
    with at(composer.file, f"system.{key}"):
        if not isinstance(given, Mapping) or not given:
            raise ScenarioError(f"got {given!r}", expected="{ state = [lowest, highest] }")
        sides = []
        for name, interval in given.items():
            if name not in units:
                raise ScenarioError("unknown name", remedy=suggestion(name, units))
            if interval == STEADY and key == "promote":
                held = steady_bounds(system, (name,))
                sides.append([float(held.lower[0]), float(held.upper[0])])
                continue
            if not isinstance(interval, list) or len(interval) != 2:
                raise ScenarioError(
                    f"'{name}' has {interval!r}", expected=f"[lowest, highest] or '{STEADY}'"
                )
            sides.append([to_si(side, units[name]) for side in interval])
        low, high = zip(*sides, strict=True)
        return tuple(given), Box(low, high)
