"""Resolve the name of a scenario's parameter to `--set` overrides for a value."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from holdfast.analysis.reachability.problem import largest_factor
from holdfast.errors import HoldfastError, ScenarioError, suggestion
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import in_base_units
from holdfast.maths.expressions.numeric import Expression, constant, multiple_of_name, norm
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.kinds.kernel import KernelScenario

CURRENT = "current.speed"
DRAWS = "varied.draws."
TIMES = ("horizon", "sample_time", "record_every", "delay")

Value = float | str
"""A number in the unit of the key, or text with its own unit."""

Number = tuple[str, float | None]


@dataclass(frozen=True)
class Knob:
    """A parameter of a scenario: its key, label, unit, and value in the scenario if any.

    settings: the overrides KEY=VALUE of a value, for --set. limit: the largest value within the
    bounds of the system, for a prescribed current of a kernel.
    """

    key: str
    name: str
    unit: str
    own: float | None
    settings: Callable[[Value], tuple[str, ...]]
    limit: float = math.inf


def find_knob(scenario: Scenario | KernelScenario, data: Mapping[str, Any], name: str) -> Knob:
    """The parameter of that name: "current.speed", a key of the tables, or its last part if unique.

    current.speed is the speed of the prescribed current, in its direction, together with the value
    that a law has of it; or the number that determines the speed; or, for a kernel without a
    prescribed current, the largest speed. A draw (`varied.draws.NAME`) is replaced by the value.

    Raises `ScenarioError` for an unknown name, or one that several keys end in.
    """
    if name == CURRENT:
        return _current(scenario, data)
    numbers = dict(_numbers(data, ""))
    key = name if name in numbers or "." in name else _whole_key(scenario, numbers, name)
    last = last_part(key)
    parameters = {q.name: q for q in scenario.system.parameters}
    value = numbers.get(key)
    if value is None and key == f"system.{last}" and last in parameters:
        value = parameters[last].value
    return Knob(key, last.replace("_", " "), _unit(scenario, key), value, _setting(data, key))


def check_number(scenario: Scenario | KernelScenario, data: Mapping[str, Any], knob: Knob) -> float:
    """Its value in the scenario; `ScenarioError` if that is not a number."""
    if knob.own is not None:
        return knob.own
    table: Any = data
    for part in knob.key.split("."):
        table = table.get(part) if isinstance(table, Mapping) else None
    if table is None:
        keys = [CURRENT, *(key for key, _ in _numbers(data, ""))]
        raise ScenarioError(
            f"{scenario.file}: no key '{knob.key}'", remedy=suggestion(knob.key, keys)
        )
    raise ScenarioError(
        f"{scenario.file}: {knob.key}: {table!r} is not a number", expected="the key of a number"
    )


def _setting(data: Mapping[str, Any], key: str) -> Callable[[Value], tuple[str, ...]]:
    def shown(value: Value) -> str:
        if isinstance(value, str):
            return f'"{value}"'
        number = float(value)  # 4 and not 4.0: some keys take whole numbers
        return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)

    if key.startswith(DRAWS):
        draws = data.get("varied", {}).get("draws", {})
        drawn = draws.get(key.removeprefix(DRAWS).removesuffix(".range"))
        place = f"{key.removesuffix('.range')}.range" if isinstance(drawn, Mapping) else key
        return lambda value: (f"{place}=[{shown(value)}, {shown(value)}]",)
    return lambda value: (f"{key}={shown(value)}",)


def _whole_key(
    scenario: Scenario | KernelScenario, numbers: Mapping[str, float | None], name: str
) -> str:
    """The unique key that ends in that name, in the file or among its entries' parameters."""
    keys = {key for key in numbers if last_part(key) == name}
    for kind in ("system", "law", "region", "goal"):
        built = getattr(scenario, kind)
        if built is not None and name in {q.name for q in built.parameters}:
            keys.add(f"{kind}.{name}")
    written = {key for key in keys if key in numbers}
    if len(written or keys) == 1:
        return next(iter(written or keys))
    if not keys:
        ends = {CURRENT, *numbers, *(n for n in map(last_part, numbers) if not n.isdecimal())}
        raise ScenarioError(f"{scenario.file}: no key '{name}'", remedy=suggestion(name, ends))
    raise ScenarioError(
        f"{scenario.file}: '{name}' is the end of several keys",
        expected="one of " + ", ".join(sorted(written or keys)),
    )


def last_part(key: str) -> str:
    """The last part of a key; the number of a parameter table is one level deeper."""
    parts = [p for p in key.split(".") if p not in ("value", "range")]
    return parts[-1] if parts else key


def _unit(scenario: Scenario | KernelScenario, key: str) -> str:
    first, _, rest = key.partition(".")
    if first in ("run", "march") and rest in TIMES:
        return "s"
    kinds = (scenario.system, scenario.law, scenario.region, scenario.goal)
    units = {q.name: q.unit for part in kinds if part is not None for q in part.parameters}
    units |= {q.name: q.unit for q in (*scenario.system.states, *scenario.system.disturbances)}
    if isinstance(scenario, Scenario):
        units |= scenario.varied.units
    return units.get(last_part(key), "1")


def _current(scenario: Scenario | KernelScenario, data: Mapping[str, Any]) -> Knob:
    names = [q.name for q in scenario.system.current]
    felt = {n: scenario.given[n] for n in names if n in scenario.given}
    if not felt:
        return _largest_current(scenario, data)
    size = norm(felt.values())
    named = multiple_of_name(size)
    if named is not None:
        factor, name = named
        return _made_of(find_knob(scenario, data, _owner(data, name)), factor)
    speed = constant(size)
    if speed is None:
        raise ScenarioError(
            f"{scenario.file}: disturbance: the speed of the current is {size}",
            expected="a number, or the name of one",
            remedy="name the key of a number",
        )
    if not speed:
        raise ScenarioError(
            f"{scenario.file}: disturbance: the prescribed current is zero and has no direction",
            remedy=f"give it a speed: --set disturbance.{names[-1]}=0.1",
        )
    shares = {f"disturbance.{n}": float(e) / speed for n, e in felt.items()}
    law = data.get("law", {})
    for n, parameter in _believed(scenario).items():
        value = law.get(parameter)
        if isinstance(value, int | float) and value == felt.get(n, 0):
            shares[f"law.{parameter}"] = float(value) / speed

    def settings(value: Value) -> tuple[str, ...]:
        wanted = in_base_units(value)
        return tuple(f"{key}={wanted * share!r}" for key, share in shares.items())

    return Knob(CURRENT, "current", "m/s", speed, settings, _limit(scenario, felt, speed))


def _believed(scenario: Scenario | KernelScenario) -> dict[str, str]:
    """Component of the current -> the parameter of the law that is what it believes of it."""
    if scenario.law is None:
        return {}
    modes = (scenario.law,) if isinstance(scenario.law, Law) else scenario.law.modes.values()
    pairs = {n: e for mode in modes for n, e in mode.believed.items()}
    names = {q.name for q in scenario.system.current}
    return {n: e.name for n, e in pairs.items() if n in names and e.is_Symbol}


def _limit(
    scenario: Scenario | KernelScenario, felt: Mapping[str, Expression], speed: float
) -> float:
    """The largest speed in that direction that the bounds of the system allow a kernel."""
    if isinstance(scenario, KernelScenario):
        return speed * largest_factor(scenario.system, felt)
    return math.inf


def _made_of(number: Knob, factor: float) -> Knob:
    """The speed of a current that is `factor` times a number."""
    if math.isclose(factor, 1.0):
        return replace(number, key=CURRENT, name="current", unit="m/s")
    speed = None if number.own is None else number.own * factor
    return Knob(
        CURRENT, "current", "m/s", speed, lambda v: number.settings(in_base_units(v) / factor)
    )


def _owner(data: Mapping[str, Any], name: str) -> str:
    """The meaning of a name in an expression: a draw of every run, or a number of that name."""
    return f"{DRAWS}{name}" if f"{DRAWS}{name}" in dict(_numbers(data, "")) else name


def _largest_current(scenario: Scenario | KernelScenario, data: Mapping[str, Any]) -> Knob:
    """The bound of an unknown current of a kernel."""
    names = [q.name for q in scenario.system.current]
    fastest = scenario.system.largest_current
    bound = None if fastest is None else multiple_of_name(fastest)
    if bound is None or not isinstance(scenario, KernelScenario):
        raise ScenarioError(
            f"{scenario.file}: system '{scenario.system.name}' has no "
            + ("current whose speed is a number" if names else "current")
            + ("" if scenario.system.disturbances else ", and no other disturbance"),
            expected=f"{' and '.join(names)} in [disturbance], or a kernel's current whose bounds "
            "are a multiple of one parameter"
            if names
            else 'disturbances of the role "current"',
            remedy=f"prescribe one: --set disturbance.{names[-1]}=0.1"
            if names
            else "give it a disturbance, or name the key of the number to vary with --of",
        )
    factor, name = bound
    return _made_of(find_knob(scenario, data, _key_of_parameter(data, name)), factor)


def _key_of_parameter(data: Mapping[str, Any], name: str) -> str:
    """The key of a parameter of the system: of one that is written by expressions, or of an entry
    of the catalogue."""
    written = dict(_numbers(data, ""))
    keys = (f"system.parameters.{name}", f"system.parameters.{name}.value")
    return next((key for key in keys if key in written), f"system.{name}")


UNUSED = ("scenario", "figures", "compare", "kernels")
"""Tables that do not affect the computation, or belong to other scenarios."""


def _numbers(data: Mapping[str, Any] | Sequence[Any], prefix: str) -> Iterator[Number]:
    """Every key of a number, entries of lists by their place, with it; of a draw with None."""
    pairs = data.items() if isinstance(data, Mapping) else enumerate(data)
    for name, value in pairs:
        key = f"{prefix}{name}"
        if key in UNUSED:
            continue
        if prefix == DRAWS:
            yield key, None
        elif isinstance(value, Mapping | list):
            yield from _numbers(value, f"{key}.")
        elif isinstance(value, int | float | str) and not isinstance(value, bool):
            try:
                yield key, in_base_units(value)
            except HoldfastError:
                continue
