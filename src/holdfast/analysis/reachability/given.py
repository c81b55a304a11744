"""Checks of a march's arguments: numbers, whole numbers, tables by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
import sympy as sp

from holdfast.errors import SimulationError


def as_number(value: object) -> float | None:
    """The value as a float; None if it is not a number, such as True, "3" or a list."""
    if isinstance(value, sp.Expr):
        return float(value) if value.is_number and value.is_extended_real else None
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        return float(value)
    return None


def number(what: str, value: object, expected: str, holds: Callable[[float], bool]) -> float:
    """The value as a float; refused if it is not a number or does not satisfy `holds`.

    NaN is refused, because every comparison with it is false.
    """
    found = as_number(value)
    if found is None or not holds(found):
        raise SimulationError(f"{what}{value!r}", expected=expected)
    return found


def whole(what: str, value: object, least: int, most: float = float("inf")) -> int:
    """The value as a whole number within [least, most]; True and 3.0 are refused."""
    kind = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if kind and least <= cast(int, value) <= most:
        return int(cast(int, value))
    expected = f"a whole number of at least {least}"
    if most < float("inf"):
        expected = f"a whole number from {least} to {most:g}"
    raise SimulationError(f"{what}{value!r}", expected=expected)


def by_name(what: str, value: object, example: str) -> Mapping[str, Any]:
    """The value as a table by name."""
    if not isinstance(value, Mapping):
        raise SimulationError(f"{what}: {value!r}", expected=f"a table by name, such as {example}")
    return value
