"""Named quantities with units: states, inputs, disturbances, and parameters with values."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.expressions.canonical import FUNCTIONS, canonical
from holdfast.maths.expressions.traversal import parts
from holdfast.maths.expressions.written import FUNCTIONS as COMPILED

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
    """The symbol of a declared name; everything in holdfast is real."""
    return sp.Symbol(name, real=True)


@checked
@dataclass(frozen=True)
class Quantity:
    """A scalar with a name (used in expressions), a unit (SI), and whether it is an angle."""

    name: str
    unit: str = "1"
    description: str = ""
    angle: bool = False

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

    @property
    def symbol(self) -> sp.Symbol:
        return symbol(self.name)


@checked
@dataclass(frozen=True)
class Parameter(Quantity):
    """A quantity with a value (above a limit), its source, and whether it is only assumed.

    gain: whether it is a gain of a law, a number that its designer is free to choose.
    """

    value: float = math.nan
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
            known = merged.setdefault(parameter.name, parameter)
            if known.value != parameter.value or known.unit != parameter.unit:
                raise DefinitionError(
                    f"parameter '{parameter.name}' is declared twice: "
                    f"{known.value:g} {known.unit} and {parameter.value:g} {parameter.unit}",
                    remedy="give both the same value or rename one",
                )
    return tuple(merged.values())


def frozen(expressions: Mapping[str, object]) -> Mapping[str, sp.Expr]:
    """A mapping of expressions, in canonical form, that cannot be changed."""
    return MappingProxyType({name: canonical(e) for name, e in expressions.items()})


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
    known = set(allowed)
    for what, expression in expressions.items():
        found = list(parts([expression]))
        unknown = sorted(str(s) for s in found if isinstance(s, sp.Symbol) and s not in known)
        for part in found:
            if part.args and not isinstance(part, _COMPILED):
                raise DefinitionError(
                    f"{what} of {owner} uses '{type(part).__name__}', which cannot be compiled: "
                    f"{part!s:.60}",
                    expected="arithmetic and functions such as "
                    + ", ".join(n for n in FUNCTIONS if n != "wrap")
                    + "; wrap for an angle",
                )
        if unknown:
            raise DefinitionError(
                f"{what} of {owner} uses the undeclared name '{unknown[0]}'",
                expected="only " + ", ".join(sorted(str(s) for s in known)),
                remedy="declare it, or correct its spelling",
            )
