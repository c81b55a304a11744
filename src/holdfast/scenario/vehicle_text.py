"""A vehicle file with other numbers, its comments and order kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import tomlkit

from holdfast.errors import ScenarioError
from holdfast.maths.definitions.lag import LAG, SLEW
from holdfast.maths.definitions.vehicle_file import THRUSTERS, vehicle_text


@dataclass(frozen=True)
class Number:
    """A value in a unit, and where it is from."""

    value: float
    unit: str
    source: str


def numbered_vehicle(name: str, numbers: Mapping[str, Number], note: str) -> str:
    """The text of the vehicle's file with these numbers, by the names of parameters of its system.

    A lag or a slew NAME_lag, NAME_slew is that of thruster NAME. A number that the file does not
    have is added. note: added to that of the file. Raises `ScenarioError` for an unknown vehicle.
    """
    shown, text = vehicle_text(name)
    try:
        document: Any = tomlkit.parse(text)
    except tomlkit.exceptions.ParseError as error:
        raise ScenarioError(f"{shown}: not a TOML file ({error})") from None
    for key, number in numbers.items():
        table, entry = _place(document, key)
        table[entry] = _inline(number)
    document["note"] = f"{document['note']} {note}" if "note" in document else note
    return tomlkit.dumps(document)


def _place(document: Any, key: str) -> tuple[Any, str]:
    """The table and the key of a parameter."""
    thrusters = document.get(THRUSTERS, {})
    for ending in (LAG, SLEW):
        if key.endswith(ending) and key.removesuffix(ending) in thrusters:
            return thrusters[key.removesuffix(ending)], ending.removeprefix("_")
    return document["parameters"], key


def _inline(number: Number) -> Any:
    entry = tomlkit.inline_table()
    entry.update({"value": number.value, "unit": number.unit, "source": number.source})
    return entry
