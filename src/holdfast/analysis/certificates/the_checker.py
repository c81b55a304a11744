"""The other program: what `holdfast-check` consists of, for those who ask it."""

from __future__ import annotations

import importlib
from types import ModuleType

from holdfast.errors import SimulationError


def part_of_checker(name: str) -> ModuleType:
    """A module of the checker, which is a program of its own and shares no code with this one.

    Raises `SimulationError` where the library of its numbers is missing.
    """
    try:
        return importlib.import_module(f"holdfast_check.{name}")
    except ImportError as error:
        if error.name != "flint":
            raise
        raise SimulationError(
            "the checker of certificates needs python-flint",
            remedy="python -m pip install 'holdfast[check]'",
        ) from error
