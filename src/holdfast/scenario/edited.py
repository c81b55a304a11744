"""A scenario file with other values, its comments and order kept."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, MutableMapping
from pathlib import Path
from typing import Any

import tomlkit

from holdfast.errors import ScenarioError
from holdfast.scenario.files import PATHS, read_tables, read_text


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
