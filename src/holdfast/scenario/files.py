"""The tables of a scenario: read from a shipped file or one of the user's, with overrides.

Files of scenarios and of vehicles are written with other values, their comments and order kept.
"""

from __future__ import annotations

import copy
import hashlib
import tomllib
from collections.abc import Iterable, Mapping, MutableMapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import tomlkit

from holdfast.errors import ScenarioError
from holdfast.host.files import read_small_text
from holdfast.maths.catalogue import fields, systems
from holdfast.maths.definitions.extension import LAG, SLEW
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.vehicle_file import PLAIN, vehicle_text
from holdfast.maths.reference_fields.field import Field
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.glossary import meant

PATHS: dict[tuple[str, str], tuple[str, ...]] = {
    ("system", "vehicle"): (".toml",),
    ("safety", "kernel"): (".toml", ".nc"),
    ("compare", "kernel"): (".toml",),
    ("march", "checkpoint"): ("",),
    ("march", "on_disk"): ("",),
    ("environment", "geojson"): ("",),
}
"""Table and key whose text is a path if it ends so (else a name)."""


def scenario_names() -> tuple[str, ...]:
    """The scenarios shipped with the package."""
    files = resources.files("holdfast.scenarios").iterdir()
    return tuple(sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml")))


def is_scenario(name: str) -> bool:
    """Whether a name stands for a shipped scenario, or for a file: NAME.toml, or NAME for it."""
    return name in scenario_names() or name.endswith(".toml") or _is_beside(name)


def _is_beside(name: str) -> bool:
    """Whether NAME.toml is a file."""
    try:
        return Path(f"{name}.toml").is_file()
    except (OSError, ValueError):  # no name of a file
        return False


def _beside() -> list[str]:
    """The names of the TOML files of the folder."""
    try:
        return [f.stem for f in Path().glob("*.toml")]
    except OSError:  # a folder that was deleted
        return []


def read_text(name: str) -> tuple[str, str]:
    """(name or path to show, text) of a shipped scenario or of a TOML file."""
    if name in scenario_names():
        file = resources.files("holdfast.scenarios") / f"{name}.toml"
        return f"{name}.toml", file.read_text("utf-8")
    if not name.endswith(".toml") and _is_beside(name):
        name = f"{name}.toml"
    if not name.endswith(".toml"):
        raise ScenarioError(
            f"unknown scenario '{name}'",
            remedy=meant(name, [*scenario_names(), *_beside()])
            + " (a file of your own ends in .toml)",
        )
    return name, read_small_text(name)


def read_tables(name: str, overrides: Overrides = ()) -> tuple[str, str, dict[str, Any]]:
    """(name to show, text, tables) of a scenario, with `key=value` overrides applied.

    Paths in the tables are those from the folder of the file; those in overrides are the caller's.
    """
    shown, text = read_text(name)
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{shown}: not a TOML file: {error}") from None
    shipped = Path(str(resources.files("holdfast.scenarios")))
    _place(data, shipped if name in scenario_names() else Path(name).parent)
    return shown, *overridden(text, data, overrides)


Overrides = Iterable[str] | Mapping[str, Any]
"""Texts "key=value", or a table of values by their keys."""


def _toml(key: str, value: Any) -> str:
    """A value of a table of overrides as a file has it, on one line."""
    value = value.item() if hasattr(value, "dtype") and not getattr(value, "ndim", 0) else value
    if isinstance(value, Mapping):
        inside = (f"{tomlkit.key(k).as_string()} = {_toml(key, v)}" for k, v in value.items())
        return f"{{ {', '.join(inside)} }}"
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        return f"[{', '.join(_toml(key, v) for v in value)}]"
    if not isinstance(value, (bool, int, float, str)):
        raise ScenarioError(
            f"overrides: {key} is {value!r}", expected="a number, a text, true or false, or a list"
        )
    return str(tomlkit.item(value).as_string())


def changes_of(overrides: Overrides) -> list[str]:
    """The overrides as texts; `ScenarioError` for one text, of which they would be letters."""
    if isinstance(overrides, str):
        expected = f'a list, such as ["{overrides}"], or a table, such as {{"law.k1": 0.2}}'
        raise ScenarioError(f"overrides is the text '{overrides}'", expected=expected)
    if not isinstance(overrides, Mapping):
        return list(overrides)
    changes: list[str] = []
    for key, value in overrides.items():
        if isinstance(value, Mapping):
            changes += [f"{key}.{change}" for change in changes_of(value)]
        else:
            changes.append(f"{key}={_toml(key, value)}")
    return changes


def overridden(text: str, data: dict[str, Any], overrides: Overrides) -> tuple[str, dict[str, Any]]:
    """Text and tables with `key=value` overrides; those given are not changed."""
    changes = changes_of(overrides)
    if not changes:
        return text, data
    data = copy.deepcopy(data)
    for change in changes:
        _override(data, change)
    return f"{text}\n# overrides: {'; '.join(changes)}\n", data


def _place(data: Mapping[str, Any], folder: Path) -> None:
    """Let the paths in the tables, and in those of [compare], begin with `folder`."""
    for (table, key), endings in PATHS.items():
        there = data.get(table)
        if isinstance(there, dict) and isinstance(path := there.get(key), str):
            there[key] = _placed(path, folder, endings)
    kernels = data.get("kernels")
    if isinstance(kernels, dict):
        for name in list(kernels):
            kernels[_placed(name, folder, (".toml",))] = kernels.pop(name)
    compared = data.get("compare")
    for kind in ("laws", "cases"):
        altered = compared.get(kind) if isinstance(compared, Mapping) else None
        for change in altered.values() if isinstance(altered, Mapping) else ():
            if isinstance(change, Mapping):
                _place(change, folder)


def _placed(path: str, folder: Path, endings: tuple[str, ...]) -> str:
    return str(folder / path) if path.endswith(endings) else path


def merged(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The tables with what is given in place of theirs, key by key; neither is changed."""
    result = copy.deepcopy(dict(data))
    for name, value in changes.items():
        mine = result.get(name)
        if isinstance(value, Mapping) and isinstance(mine, Mapping):
            result[name] = merged(mine, value)
        else:
            result[name] = copy.deepcopy(value)
    return result


def scenario_title(name: str) -> str:
    """The file's name without folder and ending."""
    return Path(name).name.removesuffix(".toml")


def load_system(name: str, overrides: Iterable[str] = ()) -> System:
    """The system of that name in the catalogue, or of the scenario or TOML file of that name.

    Of a file the table [system] alone is read. Overrides are those of the arguments of the
    catalogue's function ("trailers=2"), or of the file's keys ("system.trailers=2").
    """
    catalogue = [f.__name__ for f in systems.ALL]
    if name in catalogue:
        shown, data = name, {"system": catalogue_table(name, overrides, "system")}
    else:
        try:
            shown, _, data = read_tables(name, overrides)
        except ScenarioError as error:
            if not str(error).startswith("unknown scenario"):
                raise
            raise ScenarioError(
                f"no system, scenario or file is called '{name}'",
                remedy=meant(name, [*catalogue, *scenario_names(), *_beside()])
                + " (a file of your own ends in .toml)",
            ) from None
    table = data.get("system")
    if not isinstance(table, Mapping):
        raise ScenarioError(f"{shown}: no table [system]")
    from holdfast.scenario.build.composer import composed_system, plant_of

    composer = Composer(shown)
    return plant_of(composer, composed_system(composer, table), table)


def load_field(name: str, overrides: Iterable[str] = ()) -> Field:
    """The field of that name in the catalogue, with arguments ("lam=2", "moment=[0, 1]")."""
    table = catalogue_table(name, overrides, "field")
    built: Field = Composer(name).entry(fields.ALL, table, "field")
    return built


def catalogue_table(name: str, overrides: Iterable[str], kind: str) -> dict[str, Any]:
    """{ name, arguments } as a scenario's table would be."""
    data: dict[str, Any] = {kind: {"name": name}}
    for change in overrides:
        key, _, rest = change.partition("=")
        bare = key.strip().removeprefix(f"{kind}.")
        _override(data, f"{kind}.{bare}={rest}" if "=" in change else change)
    table: dict[str, Any] = data[kind]
    return table


def _override(data: dict[str, Any], change: str) -> None:
    key, separator, value = change.partition("=")
    path = key.strip().split(".")
    if not separator or not all(path):
        raise ScenarioError(f"--set {change}", expected="key=value, such as law.k1=0.2")
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        parsed = {"value": value.strip()}
    if len(parsed) != 1:
        raise ScenarioError(f"--set {key}: more than one value")
    table: Any = data
    for part in path[:-1]:
        if isinstance(table, list):
            table = table[_place_in(table, part, change)]
        else:
            table = table.setdefault(part, {})
        if not isinstance(table, dict | list):
            raise ScenarioError(f"--set {change}: '{part}' is not a table")
    last: Any = path[-1]
    if isinstance(table, list):
        last = _place_in(table, last, change)
    if value.strip():
        table[last] = parsed["value"]
    elif isinstance(table, list):
        del table[last]
    else:  # nothing after the sign takes the key away
        table.pop(last, None)


def _place_in(table: list[Any], part: str, change: str) -> int:
    if not (part.isdecimal() and int(part) < len(table)):
        raise ScenarioError(
            f"--set {change}: '{part}' of a list", expected=f"a place from 0 to {len(table) - 1}"
        )
    return int(part)


@cache
def files_digest() -> str:
    """A digest of the scenarios and the vehicles, any of which another may name."""
    digest = hashlib.sha256()
    for kind in ("scenarios", "vehicles"):
        for path in sorted(Path(str(resources.files("holdfast") / kind)).glob("*.toml")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class Number:
    """A value in a unit, and where it is from."""

    value: float
    unit: str
    source: str


def numbered_vehicle(name: str, numbers: Mapping[str, Number], note: str) -> str:
    """The text of the vehicle's file with these numbers, by the names of parameters of its system.

    A lag or a slew NAME_lag, NAME_slew is that of actuator NAME. A number that the file does not
    have is added. note: added to that of the file. Raises `ScenarioError` for an unknown vehicle.
    """
    shown, text = vehicle_text(name)
    try:
        document: Any = tomlkit.parse(text)
    except tomlkit.exceptions.ParseError as error:
        raise ScenarioError(f"{shown}: not a TOML file ({error})") from None
    for key, number in numbers.items():
        table, entry = _table_of(document, key)
        table[entry] = _inline(number)
    document["note"] = f"{document['note']} {note}" if "note" in document else note
    return tomlkit.dumps(document)


def _table_of(document: Any, key: str) -> tuple[Any, str]:
    """The table and the key of a parameter."""
    actuators = [table for table in document if table not in PLAIN]
    for ending in (LAG, SLEW):
        for table in actuators:
            if key.endswith(ending) and key.removesuffix(ending) in document[table]:
                return document[table][key.removesuffix(ending)], ending.removeprefix("_")
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
    absolute = {**tables}
    for (table, key), endings in PATHS.items():
        there, before = tables.get(table), written.get(table)
        path = there.get(key) if isinstance(there, Mapping) else None
        if isinstance(path, str) and isinstance(before, Mapping) and path.endswith(endings):
            absolute[table] = {**absolute[table], key: str(Path(path).absolute())}
    return absolute
