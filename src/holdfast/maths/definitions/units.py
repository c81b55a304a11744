"""Values with units: plain numbers are SI, text such as "30 deg" is converted."""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING

from holdfast.errors import HoldfastError

if TYPE_CHECKING:
    import pint

MAX_LENGTH = 80

_TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?\Z")


_PART = re.compile(r"1|[A-Za-z%°µμΩ_]+(\^[-+]?\d{1,2})?")


class UnitError(HoldfastError):
    """A value whose unit does not fit, or text that is not a value."""


@cache
def _registry() -> pint.UnitRegistry[float]:
    import pint  # takes half a second, and only a value in another unit needs it

    return pint.UnitRegistry()


def to_si(value: object, unit: str) -> float:
    """The number in `unit` (an SI unit such as "N s/m") that `value` stands for.

    `value` is a number, already in `unit`, or text with a number and a unit. Raises
    `UnitError` for anything else and for a unit of another dimension.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise UnitError(
            f"got {_shown(value)}", expected=f'a number in {unit}, or text such as "1.5 {unit}"'
        )
    if isinstance(value, (int, float)):
        try:
            return _finite(float(value), value)
        except OverflowError:
            raise UnitError("got a number out of range", expected="a finite number") from None
    parts = split(value)
    if parts is None:
        raise UnitError(
            f"got {_shown(value)}", expected=f'a number in {unit}, or text such as "1.5 {unit}"'
        )
    number, given = parts[0], parts[1] or unit
    return _finite(number if given == unit else convert(number, given, unit), value)


def split(text: str) -> tuple[float, str] | None:
    """The number and the unit ("" without one); None if the text does not begin with a number."""
    match = _TEXT.match(text) if len(text) <= MAX_LENGTH else None
    return None if match is None else (float(match[1]), (match[2] or "").strip())


def in_base_units(value: object) -> float:
    """The number that `value` stands for, text in the base units of its own unit: "30 cm" is 0.3.

    Used where the wanted unit is known only later. `UnitError` for text that is not a value.
    """
    parts = split(value) if isinstance(value, str) else None
    if parts is None and isinstance(value, str):
        raise UnitError(f"got {value!r}", expected='a number, or text with a unit, such as "30 cm"')
    if parts is None or not parts[1]:
        return to_si(value, "1")
    number, given = parts
    if given in _COMMON:
        return number
    if given == "deg":
        return math.radians(number)
    if given in _FACTORS:
        return number * _FACTORS[given][1]
    try:
        quantity = _registry().Quantity(number, _registry().Unit(_pint_text(given)))
        return float(quantity.to_base_units().magnitude)
    except Exception:
        raise UnitError(f"'{given[:40]}' is not a unit", expected="a unit such as 'm/s'") from None


def convert(number: float, given: str, unit: str) -> float:
    """`number` in the unit `given`, expressed in `unit`; `UnitError` if they do not fit."""
    if given == unit:
        return number
    if (given, unit) == ("deg", "rad"):  # the common case, without loading the unit library
        return math.radians(number)
    if given in _FACTORS and _FACTORS[given][0] == unit:
        return number * _FACTORS[given][1]
    import pint

    try:
        quantity = _registry().Quantity(number, _registry().Unit(_pint_text(given)))
        converted = quantity.to(_pint_text(unit))
    except pint.DimensionalityError:
        raise UnitError(f"the unit '{given}' does not fit", expected=f"'{unit}'") from None
    except Exception:
        raise UnitError(f"'{given[:40]}' is not a unit", expected=f"'{unit}'") from None
    return float(converted.magnitude)


def _pint_text(unit: str) -> str:
    """The unit if it consists of names, * / and small powers only: nothing else reaches pint."""
    if len(unit) > MAX_LENGTH:
        raise ValueError(unit)
    for part in re.split(r"[\s*/]+", unit.strip().replace("**", "^")):
        if not _PART.fullmatch(part):
            raise ValueError(unit)
    return "dimensionless" if unit == "1" else unit


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= MAX_LENGTH else text[: MAX_LENGTH - 3] + "..."


def _finite(number: float, shown: object) -> float:
    if not math.isfinite(number):
        raise UnitError(f"got {shown}", expected="a finite number")
    return number


_COMMON = frozenset(
    (
        "1", "m", "s", "rad", "kg", "N", "m/s", "rad/s", "1/s", "1/m", "kg m^2", "N m", "N s/m",
        "N m s", "N s^2/m^2", "N m s^2",
    )
)  # fmt: skip
"""Units that are known without the unit library."""

_FACTORS: dict[str, tuple[str, float]] = {
    "cm": ("m", 0.01), "mm": ("m", 0.001), "km": ("m", 1000.0), "cm/s": ("m/s", 0.01),
    "ms": ("s", 0.001), "min": ("s", 60.0), "h": ("s", 3600.0), "deg/s": ("rad/s", math.pi / 180),
    "g": ("kg", 0.001), "kN": ("N", 1000.0),
}  # fmt: skip
"""Unit -> its SI unit and how many of them it is, as in the unit library, which is not loaded."""


def check_unit(unit: str) -> None:
    """Refuse text that is not a unit (`UnitError`)."""
    if unit not in _COMMON:
        try:
            _registry().Unit(_pint_text(unit))
        except Exception:
            raise UnitError(
                f"'{unit[:40]}' is not a unit", expected='an SI unit such as "m/s"'
            ) from None
