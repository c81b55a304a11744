"""Catalogue entries with the values of the table that names them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from holdfast.errors import DefinitionError, ScenarioError, suggestion
from holdfast.maths.catalogue import systems
from holdfast.maths.catalogue.signature import accepted_parameters, arguments, leading_argument
from holdfast.maths.catalogue.vehicles import of_vehicle
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import in_base_units, to_si
from holdfast.scenario.validation import at


def catalogue_entry(
    file: str,
    known: Mapping[str, Parameter],
    catalogue: Sequence[Callable[..., Any]],
    table: Mapping[str, Any],
    key: str,
    system: System | None,
    leading: Sequence[object] | None = None,
) -> Any:
    """The catalogue entry that the table names, built with the table's parameters.

    Arguments that are not numbers (a vehicle, a dimension, a list of poles) are passed as they
    are. A parameter `known` from elsewhere keeps its value unless given. `leading` holds what the
    entry is built on, by default the system if it takes one. Raises `ScenarioError`.
    """
    by_name = {function.__name__: function for function in catalogue}
    name = table["name"]
    if not isinstance(name, str) or name not in by_name:
        raise ScenarioError(
            f"{file}: {key}.name: unknown name {name!r}",
            remedy=suggestion(str(name), by_name),
        )
    function = by_name[name]
    given = {k: v for k, v in table.items() if k != "name"}
    if leading is None:
        leading = (system,) if leading_argument(function) == "system" else ()
    structural, numeric = arguments(function, len(leading))
    structure = {k: given.pop(k) for k in structural if k in given}
    build: Callable[..., Any] = partial(function, *leading, **structure)
    if function in systems.ALL and "vehicle" in given:
        with at(file, f"{key}.vehicle"):
            build = of_vehicle(function, given.pop("vehicle"), structure)
    # all at once: gains may be valid only together with their k1
    plain = {k: known[k].value for k in numeric if k in known}
    for parameter in [k for k in given if k in numeric]:
        with at(file, f"{key}.{parameter}"):
            plain[parameter] = in_base_units(given[parameter])
    with at(file, key):
        try:
            standard = build(**plain)
        except DefinitionError:  # or else a unit that does not fit
            plain = {k: v for k, v in plain.items() if not isinstance(given.get(k), str)}
            standard = build(**plain)
        units = {p.name: p.unit for p in standard.parameters}
        accepted = accepted_parameters(function, units)
    values: dict[str, float] = {}
    for parameter, value in given.items():
        if parameter not in accepted:
            raise ScenarioError(
                f"{file}: {key}.{parameter}: '{name}' has no such parameter",
                remedy=suggestion(parameter, [*accepted, *structural]),
            )
        with at(file, f"{key}.{parameter}"):
            values[parameter] = to_si(value, units[parameter])
    for parameter in accepted:
        if parameter in known and parameter not in values:
            values[parameter] = known[parameter].value
    built = standard
    if values != plain:
        with at(file, key):
            built = build(**values)
    return built
