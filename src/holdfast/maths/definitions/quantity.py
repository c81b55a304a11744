"""Named quantities with units: states, inputs, disturbances, and parameters with values.

Values have units too: plain numbers are SI, text such as "30 deg" is converted.
"""

from __future__ import annotations

import keyword
import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import sympy as sp

from holdfast.arguments import InItsUnit, checked
from holdfast.errors import AngleWarning, DefinitionError, HoldfastError
from holdfast.maths.definitions.value import FrozenDict
from holdfast.maths.expressions.functions import FUNCTIONS, PROCESSES
from holdfast.maths.expressions.parser import of_names
from holdfast.maths.expressions.traversal import canonical, parts
from holdfast.maths.expressions.written import FUNCTIONS as COMPILED

if TYPE_CHECKING:
    import pint


MAX_LENGTH = 80

_TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?\Z")


_PART = re.compile(r"1|[A-Za-z%°µμΩ_]+(\^[-+]?\d{1,2}(\.\d)?)?")


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
    number, from_unit = parts[0], parts[1] or unit
    return _finite(number if from_unit == unit else convert(number, from_unit, unit), value)


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
    number, unit = parts
    if unit in _COMMON:
        return number
    if unit == "deg":
        return math.radians(number)
    if unit in _FACTORS:
        return number * _FACTORS[unit][1]
    try:
        quantity = _registry().Quantity(number, _registry().Unit(_pint_text(unit)))
        return float(quantity.to_base_units().magnitude)
    except Exception:
        raise UnitError(f"'{unit[:40]}' is not a unit", expected="a unit such as 'm/s'") from None


def convert(number: float, from_unit: str, unit: str) -> float:
    """`number` in the unit `from_unit`, expressed in `unit`; `UnitError` if they do not fit."""
    if from_unit == unit:
        return number
    if (from_unit, unit) == ("deg", "rad"):  # the common case, without loading the unit library
        return math.radians(number)
    if from_unit in _FACTORS and _FACTORS[from_unit][0] == unit:
        return number * _FACTORS[from_unit][1]
    import pint

    try:
        quantity = _registry().Quantity(number, _registry().Unit(_pint_text(from_unit)))
        converted = quantity.to(_pint_text(unit))
    except pint.DimensionalityError:
        raise UnitError(f"the unit '{from_unit}' does not fit", expected=f"'{unit}'") from None
    except Exception:
        raise UnitError(f"'{from_unit[:40]}' is not a unit", expected=f"'{unit}'") from None
    return float(converted.magnitude)


def _pint_text(unit: str) -> str:
    """The unit if it consists of names, * / and small powers only: nothing else reaches pint."""
    if len(unit) > MAX_LENGTH:
        raise ValueError(unit)
    for part in re.split(r"[\s*/()]+", unit.strip().replace("**", "^").removesuffix(")")):
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
        dimension(unit)


def is_unit(text: str) -> bool:
    """Whether the text is a unit."""
    try:
        check_unit(text)
    except UnitError:
        return False
    return True


BASE = ("kg", "m", "s", "A", "K", "mol", "cd")
"""The base units of the SI; an angle in rad has none of them."""

Dimension = tuple[float, ...]
"""Of a unit: the powers of the base units, then the logarithm of how many of their product it is.

So km is no m and deg is no rad."""

_NAMED: Mapping[str, Mapping[str, int]] = {
    "1": {}, "rad": {}, "m": {"m": 1}, "s": {"s": 1}, "kg": {"kg": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
}  # fmt: skip
"""The powers of units that are known without the unit library."""

_OF_LIBRARY = {
    "[length]": "m", "[mass]": "kg", "[time]": "s", "[current]": "A", "[temperature]": "K",
    "[substance]": "mol", "[luminosity]": "cd",
}  # fmt: skip

_SIMPLE = re.compile(r"(?:(?:1|[A-Za-z]+)(?:\^[-+]?\d)?(?: ?[*/] ?| |\Z))+")
_FACTOR = re.compile(r"(1|[A-Za-z]+)(?:\^([-+]?\d))?\s*([*/]?)")


@cache
def dimension(unit: str) -> Dimension:
    """That of a unit such as "kg m^2"; `UnitError` for text that is not a unit."""
    size, powers, sign = 1.0, dict.fromkeys(BASE, 0.0), 1
    if len(unit) > MAX_LENGTH or not _SIMPLE.fullmatch(unit):
        return _dimension_by_library(unit)
    for name, power, operator in _FACTOR.findall(unit):
        of, factor = _FACTORS.get(name, (name, 1.0))
        if of not in _NAMED:
            return _dimension_by_library(unit)
        exponent = sign * int(power or 1)
        size *= factor**exponent
        for base, n in _NAMED[of].items():
            powers[base] += n * exponent
        sign = -1 if operator == "/" else 1
    return (*powers.values(), math.log(size))


def _dimension_by_library(unit: str) -> Dimension:
    try:
        of = _registry().Quantity(1.0, _registry().Unit(_pint_text(unit))).to_base_units()
        powers = {_OF_LIBRARY[n]: float(str(p)) for n, p in of.dimensionality.items()}
    except Exception:
        raise UnitError(
            f"'{unit[:40]}' is not a unit", expected='an SI unit such as "m/s"'
        ) from None
    return (*(dict.fromkeys(BASE, 0.0) | powers).values(), math.log(of.magnitude))


def alike(one: Dimension, other: Dimension) -> bool:
    """Whether both are one unit, within rounding of their powers."""
    return one == other or all(abs(a - b) < 1e-9 for a, b in zip(one, other, strict=True))


class Unwritten(str):
    """The unit "1" of what no unit is written of."""


UNWRITTEN = Unwritten("1")


def has_unit(quantity: Quantity) -> bool:
    """Whether a unit is written of it."""
    return bool(quantity.unit) and not isinstance(quantity.unit, Unwritten)


TURN = 2 * math.pi
ROUNDED = 1.001
"""How much more than a turn a number may be that was rounded."""


def warn_of_turns(what: str, number: float, remedy: str, stacklevel: int = 3) -> None:
    """Warn of a number [rad] that is more than a turn, and has no unit."""
    if math.isfinite(number) and abs(number) > ROUNDED * TURN:
        warnings.warn(
            f"{what} is read as {number:g} rad (= {number / TURN:.3g} turns); "
            f"if it is in degrees, write {remedy}",
            AngleWarning,
            stacklevel=stacklevel,
        )


TIME = sp.Symbol("t", real=True)
"""Time in seconds, the only symbol that every expression may use undeclared."""

TIME_IN_MODE = sp.Symbol("time_in_mode", real=True)
"""Seconds since the last change of mode; only guards of a `Switching` may use it."""

SAMPLE_TIME = sp.Symbol("sample_time", real=True)
"""Seconds between control samples, 0 with continuous control; only gain conditions use it."""

DELAY = sp.Symbol("delay", real=True)
"""Seconds from a measurement to the law that uses it; only gain conditions use it."""

_COMPILED = (*COMPILED.values(), sp.Tuple)
"""Classes of what expressions may be made of, all of which a file of a definition can have too."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_RESERVED = frozenset(("t", "time_in_mode", "sample_time", "delay", "pi", "diff", *FUNCTIONS))


@checked
def symbol(name: str) -> sp.Symbol:
    """The symbol of a declared name; everything in holdfast is real.

    >>> hf.symbol("speed") * 2
    2*speed
    """
    return sp.Symbol(name, real=True)


Role = Literal["", "current"]
"""What a disturbance is beside a number: nothing else, or a component of the current."""


@checked
@dataclass(frozen=True)
class Quantity:
    """A scalar with a name (used in expressions), a unit (SI), and whether it is an angle.

    angle: whether it wraps after a whole turn; its unit is then rad. role: "current" of a
    disturbance that is a component of the current, in m/s over ground; laws, margins and figures
    ask for it by this role, whatever it is called.

    Raises `DefinitionError` for a name that no expression can use, an angle in another unit than
    rad, and a current in another than m/s.

    >>> hf.Quantity("psi", "rad", "heading", angle=True)
    Quantity(name='psi', unit='rad', description='heading', angle=True, role='')
    """

    name: str
    unit: str = UNWRITTEN
    description: str = ""
    angle: bool = False
    role: Role = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        if not _NAME.match(self.name) or keyword.iskeyword(self.name) or self.name in _RESERVED:
            raise DefinitionError(
                f"'{self.name}' cannot name a quantity",
                expected="a letter, then letters, digits or underscores, "
                "not a reserved word or the name of a function",
            )
        if self.angle and self.unit != "rad":
            raise DefinitionError(
                f"angle '{self.name}' has unit '{self.unit}'", expected="unit 'rad'"
            )
        if not isinstance(self.role, str) or self.role not in get_args(Role):
            roles = " or ".join(f"'{role}'" for role in get_args(Role) if role)
            raise DefinitionError(
                f"'{self.name}' has the role {self.role!r}", expected=f"{roles}, or none"
            )
        if self.role == "current" and self.unit != "m/s":
            raise DefinitionError(
                f"current '{self.name}' has unit '{self.unit}'", expected="unit 'm/s'"
            )

    @property
    def symbol(self) -> sp.Symbol:
        return symbol(self.name)


def stated(record: Any) -> dict[str, Any]:
    """The fields of a record by name, without those for keywords alone that have their default.

    A field that was added later is one of these, and what is written of an older record stays.
    """
    values = {f: getattr(record, f.name) for f in fields(record)}
    return {f.name: v for f, v in values.items() if not (f.kw_only and v == f.default)}


def may_be_left_out(record: type) -> set[str]:
    """The names of the fields that `stated` may leave out."""
    return {f.name for f in fields(record) if f.kw_only and f.default is not MISSING}


@checked
@dataclass(frozen=True)
class Parameter(Quantity):
    """A quantity whose number is known.

    value: the number, in `unit`. angle, role: as of a `Quantity`. above: a limit that it has to
    exceed. source: where the number is from. assumed: whether nobody has measured it. gain: whether
    it is a gain of a law, a number that its designer is free to choose.

    Raises `DefinitionError` as `Quantity` does, and for a value that is not finite or not above the
    limit.

    >>> hf.Parameter("mass", "kg", value=25.0, above=0.0).value
    25.0
    """

    value: InItsUnit = math.nan
    source: str = ""
    assumed: bool = False
    above: float = -math.inf
    gain: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            raise DefinitionError(
                f"parameter '{self.name}' has the value {self.value!r}", expected="a number"
            )
        if not math.isfinite(self.value):
            raise DefinitionError(
                f"parameter '{self.name}' has the value {self.value}", expected="a finite number"
            )
        if not self.value > self.above:
            raise DefinitionError(
                f"parameter '{self.name}' is {self.value:g}", expected=f"above {self.above:g}"
            )


def merge_parameters(*groups: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """All parameters, each once.

    One name is one number: two groups may share a parameter only with the same value. A definition
    merges its own when it is made, so that whoever makes one from others just lists theirs; a
    computation merges those of its definitions. Raises `DefinitionError` where they differ.
    """
    merged: dict[str, Parameter] = {}
    for group in groups:
        for parameter in group:
            first = merged.setdefault(parameter.name, parameter)
            if first.value != parameter.value or first.unit != parameter.unit:
                raise DefinitionError(
                    f"parameter '{parameter.name}' is declared twice: "
                    f"{first.value:g} {first.unit} and {parameter.value:g} {parameter.unit}",
                    remedy="give both the same value or rename one",
                )
    return tuple(merged.values())


def numbers_text(parameters: Sequence[Parameter]) -> list[str]:
    """A line with the numbers of all parameters, if there are any."""
    numbers = ", ".join(f"{q.name} = {q.value:g} {q.unit}" for q in parameters)
    return [f"parameters: {numbers}"] if parameters else []


def expression_of(value: object) -> sp.Expr:
    """What a user gives for an expression: one of SymPy, a number, or a text of names."""
    return of_names(value) if isinstance(value, str) else canonical(value)


def frozen(expressions: Mapping[str, object]) -> Mapping[str, sp.Expr]:
    """A mapping of expressions, or of their texts, in canonical form, that cannot be changed."""
    return FrozenDict({name: expression_of(e) for name, e in expressions.items()})


def whole_number(value: object, what: str, least: int, most: int) -> int:
    """`value` if it is a whole number from `least` to `most`, else `DefinitionError`."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise DefinitionError(
            f"{what} is {value!r}", expected=f"a whole number from {least} to {most}"
        )
    return value


def given_number(value: object, what: str, of: object) -> sp.Expr:
    """A finite real number as an expression; text is never read as one (`DefinitionError`)."""
    number = sp.sympify(value) if isinstance(value, (int, float, sp.Expr)) else sp.nan
    if isinstance(value, bool) or not (number.is_real and number.is_finite):
        raise DefinitionError(f"{what} is {of!r}", expected="finite numbers")
    return number


def check_unique(names: Iterable[str], owner: str) -> None:
    """Refuse a name that is declared twice."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise DefinitionError(f"{owner} declares '{name}' twice")
        seen.add(name)


def check_symbols(
    expressions: Mapping[str, sp.Expr], allowed: Iterable[sp.Symbol], owner: str
) -> None:
    """Refuse an expression with a symbol that its owner does not declare, or a function that
    cannot be compiled."""
    declared = set(allowed)
    for what, expression in expressions.items():
        nodes = list(parts([expression]))
        unknown = sorted(str(s) for s in nodes if isinstance(s, sp.Symbol) and s not in declared)
        for part in nodes:
            if part.args and not isinstance(part, _COMPILED):
                raise DefinitionError(
                    f"{what} of {owner} uses '{type(part).__name__}', which cannot be compiled: "
                    f"{part!s:.60}",
                    expected="arithmetic and functions such as "
                    + ", ".join(n for n in FUNCTIONS if n not in ("wrap", *PROCESSES))
                    + "; wrap for an angle",
                )
        if unknown:
            raise DefinitionError(
                f"{what} of {owner} uses the undeclared name '{unknown[0]}'",
                expected="only " + ", ".join(sorted(str(s) for s in declared)),
                remedy="declare it, or correct its spelling",
            )
