"""Vehicle files: the published numbers of a vehicle, for any system of the catalogue."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from holdfast.arguments import checked
from holdfast.errors import ScenarioError, suggestion
from holdfast.maths.catalogue import systems
from holdfast.maths.catalogue.signature import arguments
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.vehicle_file import (
    Vehicle,
    actuator_kinds,
    checked_vehicle,
    declared_parameters,
    optional_parameters,
    overridden,
    read_vehicle,
    vehicle_for,
)


@checked
def load_vehicle(name: str, **overrides: float) -> System:
    """The system of a vehicle, built with the numbers of the vehicle's file.

    name: a shipped vehicle, or a file that ends in .toml:

        title = "my robot"
        system = "unicycle"                  # a system of the catalogue
        [parameters]
        speed_limit = { value = 0.22, unit = "m/s", source = "data sheet" }
        turn_limit = { value = 2.84, unit = "rad/s", source = "data sheet" }

    overrides: numbers by name, in SI units, in place of those of the file. Raises `ScenarioError`
    for an unknown vehicle, system or name, a missing number, a wrong unit and a missing source.

    >>> hf.load_vehicle("bluerov2", thrust_limit=20.0).input_names
    ('tau_u', 'tau_r')
    """
    vehicle = vehicle_of(name)
    function = _system(vehicle.system, name)
    if "vehicle" in arguments(function, 0)[0]:
        return function(vehicle=name, **overrides)
    return with_vehicle(function, vehicle, overrides)


def vehicle_of(name: str) -> Vehicle:
    """The file of that vehicle, checked against the system that it names."""
    shown, data = read_vehicle(name)
    function = _system(data["system"], shown)
    return checked_vehicle(
        name, shown, data, needed(function), optional_parameters(function), actuator_kinds(function)
    )


def needed(
    function: Callable[..., System], **structure: Any
) -> Mapping[str, tuple[str, str, float]]:
    """Name -> (unit, meaning, exclusive lower limit) of the numbers of a system."""
    declared = declared_parameters(function)
    if declared is not None:
        return declared
    _, numeric = arguments(function, 0)
    by_name = {p.name: p for p in function(**structure).parameters}
    return {
        n: (p.unit, p.description, p.above) for n in numeric if (p := by_name.get(n)) is not None
    }


def of_vehicle(
    function: Callable[..., System], name: str, structure: Mapping[str, Any]
) -> Callable[..., System]:
    """A function that builds the system of that vehicle, with some of its numbers replaced."""
    vehicle = vehicle_for(name, needed(function, **structure), function.__name__)

    def build(**overrides: float) -> System:
        return with_vehicle(function, vehicle, overrides, **structure)

    return build


def with_vehicle(
    function: Callable[..., System],
    vehicle: Vehicle,
    overrides: Mapping[str, float],
    **structure: Any,
) -> System:
    """The system with the numbers of the vehicle, and their sources."""
    numbers = overridden(vehicle.parameters, overrides, vehicle.name)
    system = function(**structure, **{name: p.value for name, p in numbers.items()})
    return replace(system, parameters=tuple(numbers.get(p.name, p) for p in system.parameters))


def _system(name: object, shown: str) -> Callable[..., System]:
    by_name = {f.__name__: f for f in systems.ALL}
    if not isinstance(name, str) or name not in by_name:
        raise ScenarioError(
            f"{shown}: is for system {name!r}", remedy=suggestion(str(name), by_name)
        )
    return by_name[name]
