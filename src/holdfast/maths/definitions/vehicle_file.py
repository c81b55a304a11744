"""Vehicle files: published parameters, each number with its unit and its source."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from holdfast.errors import HoldfastError, ScenarioError, check_name
from holdfast.host.files import read_small_text
from holdfast.maths.definitions.quantity import Parameter, convert, to_si

if TYPE_CHECKING:
    from holdfast.maths.definitions.actuator import ActuatorKind

T = TypeVar("T")
DECLARED, OPTIONAL, ACTUATORS = "declared_parameters", "optional_parameters", "actuator_kinds"
PLAIN = ("title", "system", "note", "parameters")
"""Keys of every vehicle file. The others are tables of actuators."""


@dataclass(frozen=True)
class Vehicle:
    """A vehicle file: its title, its system, its parameters, a note, and its actuators by name."""

    name: str
    title: str
    system: str
    parameters: Mapping[str, Parameter]
    note: str = ""
    actuators: Mapping[str, tuple[ActuatorKind, Mapping[str, Parameter]]] = field(
        default_factory=dict
    )


def takes(
    parameters: Mapping[str, tuple[str, str, float]],
    optional: Collection[str] = (),
    actuators: Sequence[ActuatorKind] = (),
) -> Callable[[T], T]:
    """Mark a function that takes every number of a table as a named argument.

    parameters: name -> (unit, meaning, exclusive lower limit). optional: those that a vehicle may
    lack. actuators: the kinds of actuators that a vehicle has tables of.
    """

    def mark(function: T) -> T:
        setattr(function, DECLARED, parameters)
        setattr(function, OPTIONAL, frozenset(optional))
        setattr(function, ACTUATORS, tuple(actuators))
        return function

    return mark


def declared_parameters(
    function: Callable[..., Any],
) -> Mapping[str, tuple[str, str, float]] | None:
    """The table that the function is marked with; None without a mark."""
    return getattr(function, DECLARED, None)


def optional_parameters(function: Callable[..., Any]) -> Collection[str]:
    """The names of the table that a vehicle may lack."""
    names: Collection[str] = getattr(function, OPTIONAL, frozenset())
    return names


def actuator_kinds(function: Callable[..., Any]) -> Sequence[ActuatorKind]:
    """The kinds of actuators that a vehicle of the system has."""
    kinds: Sequence[ActuatorKind] = getattr(function, ACTUATORS, ())
    return kinds


def vehicle_names() -> tuple[str, ...]:
    """The vehicles shipped with the package."""
    files = resources.files("holdfast.vehicles").iterdir()
    return tuple(sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml")))


def is_vehicle(name: str) -> bool:
    """Whether it is a shipped vehicle, or the file of one: that names its system."""
    if not name.endswith(".toml"):
        return name in vehicle_names()
    try:
        return isinstance(tomllib.loads(read_small_text(name)).get("system"), str)
    except (ValueError, RecursionError):
        return False


def vehicle_for(
    name: str,
    units: Mapping[str, tuple[str, str, float]],
    system: str = "marine_vehicle",
    optional: Collection[str] = (),
    actuators: Sequence[ActuatorKind] = (),
) -> Vehicle:
    """The vehicle of that name, or of that file when the name ends in .toml.

    `units` maps every parameter the system needs to (unit, meaning,
    exclusive lower limit), `optional` names those that may be missing. `system` is the system that
    the file must name. Raises `ScenarioError`
    for an unknown vehicle, a missing or unknown parameter, a wrong unit or a missing source.
    """
    shown, data = read_vehicle(name)
    if data["system"] != system:
        raise ScenarioError(f"{shown}: is for system {data['system']!r}", expected=f"'{system}'")
    return checked_vehicle(name, shown, data, units, optional, actuators)


def vehicle_text(name: str) -> tuple[str, str]:
    """(name for messages, text) of a vehicle's file."""
    if not isinstance(name, str):
        raise ScenarioError(f"the vehicle is {name!r}", expected="a name or a file")
    if name.endswith(".toml"):
        try:
            return name, read_small_text(name)
        except ScenarioError as error:
            raise ScenarioError(f"vehicle file {error.cause}", expected=error.expected) from None
    check_name(name, vehicle_names(), ScenarioError, f"unknown vehicle '{name}'")
    file = resources.files("holdfast.vehicles") / f"{name}.toml"
    return f"vehicle '{name}'", file.read_text("utf-8")


def read_vehicle(name: str) -> tuple[str, dict[str, Any]]:
    """(name for messages, tables) of a vehicle; its tables are not checked."""
    shown, text = vehicle_text(name)
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{shown}: not a TOML file ({error})") from None
    for key in ("title", "system", "parameters"):
        if key not in data:
            odd = [n for n in sorted(set(data) - set(PLAIN)) if not isinstance(data[n], dict)]
            if odd:  # a misspelt one
                accepted = ", ".join(PLAIN) + " and tables of actuators"
                raise ScenarioError(f"{shown}: unknown key '{odd[0]}'", expected=accepted)
            raise ScenarioError(f"{shown}: missing key '{key}'")
    return shown, data


def checked_vehicle(
    name: str,
    shown: str,
    data: Mapping[str, Any],
    units: Mapping[str, tuple[str, str, float]],
    optional: Collection[str] = (),
    actuators: Sequence[ActuatorKind] = (),
) -> Vehicle:
    """The vehicle of these tables; its parameters are checked against those its system needs."""
    kinds = {kind.table: kind for kind in actuators}
    for key in sorted(set(data) - {*PLAIN, *kinds}):
        raise ScenarioError(f"{shown}: unknown key '{key}'", expected=", ".join((*PLAIN, *kinds)))
    parts = {key: tables for key, tables in data.items() if key in kinds}
    if kinds and not parts:
        raise ScenarioError(
            f"{shown}: system '{data['system']}' needs actuators",
            expected=" or ".join(f"[{table}.NAME]" for table in kinds),
        )
    built: dict[str, tuple[ActuatorKind, Mapping[str, Parameter]]] = {}
    for key, tables in parts.items():
        if not (isinstance(tables, dict) and tables):
            raise ScenarioError(f"{shown}: {key} is {tables!r}", expected=f"[{key}.NAME]")
        kind = kinds[key]
        for part, table in tables.items():
            if part in built:
                raise ScenarioError(
                    f"{shown}: two actuators have the name '{part}'", remedy="rename one of them"
                )
            numbers = checked_table(shown, f"{key}.{part}", table, kind.numbers, kind.optional)
            built[part] = kind, numbers
    return Vehicle(
        Path(name).stem,
        str(data["title"]),
        str(data["system"]),
        checked_table(shown, "parameters", data["parameters"], units, optional),
        str(data.get("note", "")),
        built,
    )


def checked_table(
    shown: str,
    table: str,
    entries: object,
    units: Mapping[str, tuple[str, str, float]],
    optional: Collection[str] = (),
) -> dict[str, Parameter]:
    """The parameters of one table of a vehicle file."""
    if not isinstance(entries, dict):
        raise ScenarioError(f"{shown}: {table} is {entries!r}", expected="a table")
    owner = "" if table == "parameters" else f" of {table}"
    for key in entries:
        check_name(key, units, ScenarioError, f"{shown}: unknown parameter '{key}'{owner}")
    parameters = {}
    for key, (unit, meaning, above) in units.items():
        if key not in entries:
            if key in optional:
                continue
            raise ScenarioError(f"{shown}: missing parameter '{key}' ({meaning}, {unit}){owner}")
        parameters[key] = _parameter(
            f"{shown}: {table}.{key}", key, entries[key], unit, meaning, above
        )
    return parameters


def _parameter(
    where: str, key: str, entry: object, unit: str, meaning: str, above: float
) -> Parameter:
    if not isinstance(entry, dict):
        raise ScenarioError(
            f"{where} is {entry!r}", expected=f'{{ value = ..., unit = "{unit}", source = "..." }}'
        )
    for odd in sorted(set(entry) - {"value", "unit", "source", "assumed"}):
        raise ScenarioError(
            f"{where}: unknown key '{odd}'", expected="value, unit, source, assumed"
        )
    for needed in ("value", "unit", "source"):
        if needed not in entry:
            raise ScenarioError(f"{where}: missing key '{needed}'")
    assumed = entry.get("assumed", False)
    if not isinstance(assumed, bool):
        raise ScenarioError(f"{where}.assumed is {assumed!r}", expected="true or false")
    try:
        return Parameter(
            key,
            unit,
            meaning,
            value=convert(to_si(entry["value"], str(entry["unit"])), str(entry["unit"]), unit),
            source=str(entry["source"]),
            assumed=assumed,
            above=above,
        )
    except HoldfastError as error:
        raise ScenarioError(
            f"{where}: {error.cause}", expected=error.expected, remedy=error.remedy
        ) from None


def overridden(
    parameters: Mapping[str, Parameter], overrides: Mapping[str, float], owner: str
) -> dict[str, Parameter]:
    """The parameters with some values replaced; `ScenarioError` for an unknown name."""
    result = dict(parameters)
    for key, value in overrides.items():
        check_name(key, parameters, ScenarioError, f"{owner} has no parameter '{key}'")
        result[key] = replace(parameters[key], value=float(value), source="set by the user")
    return result
