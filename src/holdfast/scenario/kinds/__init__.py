"""Kinds of scenario: one file each, with its `KINDS`; every file here is found by itself."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from holdfast.errors import ScenarioError, suggestion
from holdfast.scenario.kinds.base import Kind

STANDARD = "closed-loop"
"""The kind of a file that does not say one."""


@cache
def kinds() -> Mapping[str, Kind]:
    """Every kind by its name."""
    modules = [m.name for m in iter_modules([str(Path(__file__).parent)])]
    found = [k for m in modules for k in getattr(import_module(f"{__name__}.{m}"), "KINDS", ())]
    return {kind.name: kind for kind in found}


def kind_of(file: str, data: Mapping[str, Any]) -> Kind:
    """The kind of these tables, not yet checked; `ScenarioError` for an unknown one."""
    header = data.get("scenario")
    name = header.get("kind", STANDARD) if isinstance(header, Mapping) else STANDARD
    if not isinstance(name, str):
        name = STANDARD  # refused with its key by the schema
    if name not in kinds():
        raise ScenarioError(
            f"{file}: scenario.kind: got '{name}'", remedy=suggestion(name, kinds())
        )
    return kinds()[name]
