"""Kinds of scenario: one file each, with its `KINDS`; every file here is found by itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from holdfast.errors import ScenarioError, suggestion
from holdfast.scenario.kinds.base import Kind

STANDARD = "closed-loop"
"""The kind of a file that does not say one."""


def kinds() -> Iterator[Kind]:
    """Every kind; a file is loaded when its turn comes."""
    for module in iter_modules([str(Path(__file__).parent)]):
        yield from getattr(import_module(f"{__name__}.{module.name}"), "KINDS", ())


def kind_of(file: str, data: Mapping[str, Any]) -> Kind:
    """The kind of these tables, not yet checked; `ScenarioError` for an unknown one."""
    header = data.get("scenario")
    name = header.get("kind", STANDARD) if isinstance(header, Mapping) else STANDARD
    if not isinstance(name, str):
        name = STANDARD  # refused with its key by the schema
    names = []
    for kind in kinds():
        if kind.name == name:
            return kind
        names.append(kind.name)
    raise ScenarioError(f"{file}: scenario.kind: got '{name}'", remedy=suggestion(name, names))
