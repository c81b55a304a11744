"""Files of scenarios and of vehicles with other values, their comments and order kept."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit

from holdfast.errors import ScenarioError
from holdfast.maths.definitions.extension import LAG, SLEW
from holdfast.maths.definitions.vehicle_file import THRUSTERS, vehicle_text
from holdfast.scenario.files import PATHS, read_tables, read_text


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


def edited_text(name: str, overrides: Iterable[str]) -> str:
    """The text of a scenario with `key=value` overrides written into its tables.

    Paths in the tables are made absolute, so that the text may stand in any folder. Raises
    `ScenarioError` where the text would not say what the overrides say.
    """
    changes = list(overrides)
    shown, text = read_text(name)
    _, _, wanted = read_tables(name, changes)
    document = tomlkit.parse(text)
    written = tomllib.loads(text)
    _write(document, written, _absolute(wanted, written))
    edited = tomlkit.dumps(document)
    if tomllib.loads(edited) != _absolute(wanted, written):
        raise ScenarioError(f"{shown}: the file cannot be written with {'; '.join(changes)}")
    return edited


def _write(
    document: MutableMapping[str, Any], written: Mapping[str, Any], wanted: Mapping[str, Any]
) -> None:
    """Change what differs, key by key."""
    for key in [k for k in written if k not in wanted]:
        del document[key]
    for key, value in wanted.items():
        if key not in written:
            document[key] = value
        elif isinstance(value, Mapping) and isinstance(written[key], Mapping):
            _write(document[key], written[key], value)
        elif value != written[key]:
            document[key] = value


def _absolute(tables: Mapping[str, Any], written: Mapping[str, Any]) -> dict[str, Any]:
    """The tables with absolute paths, where the file has paths at all."""
    found = {**tables}
    for (table, key), endings in PATHS.items():
        there, before = tables.get(table), written.get(table)
        path = there.get(key) if isinstance(there, Mapping) else None
        if isinstance(path, str) and isinstance(before, Mapping) and path.endswith(endings):
            found[table] = {**found[table], key: str(Path(path).absolute())}
    return found
