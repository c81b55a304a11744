"""Enclosures of the states of a held flow: one file each, with its `ENCLOSURE`, found by itself."""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from holdfast.execution.intervals.enclosures.base import Enclosure, Motion

__all__ = ["STANDARD", "Enclosure", "Motion", "enclosures"]

STANDARD = "parallelepiped"
"""That of the checker."""


@cache
def enclosures() -> Mapping[str, type[Enclosure]]:
    """Every enclosure by its name, which is that of its file."""
    names = [m.name for m in iter_modules([str(Path(__file__).parent)]) if m.name != "base"]
    return {name: import_module(f"{__name__}.{name}").ENCLOSURE for name in sorted(names)}
