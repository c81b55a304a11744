"""The tables of scenario files: their keys, the types of these, and errors that name file and key.

A table of a function has the function's arguments as its keys, with their types, units and
defaults: a number with a unit may be text with another one, an expression is text. What a file
cannot write, such as a system, is no key. By hand stands what differs.
"""

from __future__ import annotations

import inspect
import itertools
import math
import re
import tomllib
import types
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union

import pydantic
import sympy as sp
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    ValidationInfo,
    WrapValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from holdfast.arguments import Least, Says, Two, Unit, UnitsOf, hints_of
from holdfast.errors import HoldfastError, RenamedWarning, ScenarioError, suggestion
from holdfast.maths.definitions.quantity import (
    Parameter,
    in_base_units,
    is_unit,
    split,
    to_si,
)
from holdfast.maths.definitions.system import FlatOutput
from holdfast.maths.definitions.value import content
from holdfast.maths.expressions.parser import parse_formula

Value = float | str
"""A number in SI units, or text with a unit such as "30 deg"."""

Expression = str | float
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,60}$")]
Text = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x08\x0b-\x1f\x7f]*$", max_length=2000)]

PAIR = "pair"
"""The error type of an array without exactly the two expected entries."""


def _two(what: str) -> WrapValidator:
    """Answer every error in an array of two with its expected form."""

    def check(pair: object, handler: Callable[[object], object]) -> object:
        try:
            return handler(pair)
        except ValidationError:
            raise PydanticCustomError(PAIR, "two " + what) from None

    return WrapValidator(check)


def _text(what: str) -> BeforeValidator:
    """Answer what is no text with what the text says."""

    def check(value: object) -> object:
        if not isinstance(value, str):
            raise PydanticCustomError("text", what)
        return value

    return BeforeValidator(check)


# TOML has arrays only, which strict checking would refuse for a tuple
_Array = Field(strict=False)
Bounds = Annotated[
    tuple[Expression, Expression], _Array, _two("numbers or expressions [low, high]")
]
Point = Annotated[tuple[Expression, Expression], _Array, _two("numbers or expressions [x, y]")]
Layer = Annotated[tuple[float, float], _Array, _two("numbers [cmax, cmin]")]
Range = Annotated[tuple[float, float], _Array, _two("numbers [low, high]")]
Interval = Annotated[tuple[Value, Value], _Array, _two("numbers [low, high]")]
Plane = Annotated[tuple[Name, Name], _Array, _two('names of states, such as ["x", "y"]')]


Meaning = Unit | UnitsOf | type[sp.Expr] | None
"""Of the numbers of a key: their unit, or that they are expressions."""

Renamed = Mapping[str, tuple[str, Mapping[str, object]]]
"""Former key -> the key that replaced it, and its former values -> the present ones."""


class Section(BaseModel):
    """A table of the file: unknown keys are refused.

    A key that was `renamed` is accepted for one release, with a warning. The keys of a table `of`
    functions are their arguments, but for those `without`, which files say elsewhere or not at all.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)
    renamed: ClassVar[Renamed] = {}
    units: ClassVar[Mapping[str, Meaning]] = {}
    """Key -> what it means, of those that are arguments."""

    def __hash__(self) -> int:
        return hash((type(self), content(self.__dict__)))

    def __init_subclass__(cls, of: Sequence[Any] = (), without: Sequence[str] = (), **more: Any):
        super().__init_subclass__(**more)
        by_hand = inspect.get_annotations(cls)
        cls.__annotations__ = dict(by_hand)  # which Pydantic reads after this
        for name, (written, default, meaning) in _keys_of(of).items():
            if name in without:
                continue
            cls.units = {**cls.units, name: meaning}
            if name not in by_hand:
                cls.__annotations__[name] = written
                if default is not ...:
                    setattr(cls, name, default)

    def read(
        self,
        file: str,
        key: str,
        units: Mapping[str, Mapping[str, str]] | None = None,
        names: Mapping[str, sp.Expr] | None = None,
        *,
        defaults: bool = False,
        alone: bool = False,
    ) -> dict[str, Any]:
        """The arguments of its functions that are written: numbers in SI units, expressions.

        units: what the names in tables by name are -> name -> unit. names: those that expressions
        may have. defaults: with those of what is not written. alone: whether the file has its one
        value in place of the table. `ScenarioError` with the key for what does not fit.
        """
        asked = self.units if defaults else [n for n in self.units if n in self.model_fields_set]
        said = {n: value for n in asked if (value := getattr(self, n)) is not None}
        read = _Reader(file, units or {}, dict(names or {}), getattr(self, "unit", ""))
        places = {n: key if alone else f"{key}.{n}" for n in said}
        return {n: read(value, self.units[n], places[n]) for n, value in said.items()}

    @model_validator(mode="before")
    @classmethod
    def _with_former_keys(cls, data: object, info: ValidationInfo) -> object:
        if not isinstance(data, Mapping):
            return data
        table = dict(data)
        for former, (key, values) in cls.renamed.items():
            if former not in table:
                continue
            value = table.pop(former)
            if key in table:
                raise ValueError(f"either '{key}' or its former name '{former}'")
            if values and value not in values:
                raise ValueError(f"{former} = {' or '.join(map(repr, values))}, now '{key}'")
            table[key] = values[value] if values else value
            shown = f" = {str(table[key]).lower()}" if values else ""
            warnings.warn(
                f"{info.context or ''}the key '{former}' is now '{key}': write {key}{shown}; "
                "the former goes with the next release",
                RenamedWarning,
                stacklevel=2,
            )
        return table


def _keys_of(functions: Sequence[Any]) -> dict[str, tuple[Any, Any, Meaning]]:
    """Argument -> the type of what is written, its default and its meaning.

    The default is `...` for a key that is needed: every one of the functions needs it.
    """
    keys: dict[str, tuple[Any, Any, Meaning]] = {}
    each = [list(arguments_of(f)) for f in functions]
    for name, hint, default in itertools.chain(*each):
        meaning = _meaning(hint)
        written = _written(hint, meaning)
        if name in keys or written is None:
            continue
        if default is ... and not all(name in [n for n, _, _ in of] for of in each):
            default = None
        keys[name] = (written | None if default is None else written, default, meaning)
    return keys


def arguments_of(of: Any) -> Iterator[tuple[str, Any, Any]]:
    """Names, types and defaults; options that have a type of their own are arguments as well."""
    if typing.is_typeddict(of):
        hints = typing.get_type_hints(of, include_extras=True)
        yield from ((name, hint, None) for name, hint in hints.items())
        return
    hints = hints_of(of, extras=True)
    made = {f.name: f.default_factory for f in fields(of)} if is_dataclass(of) else {}
    for name, parameter in inspect.signature(of).parameters.items():
        hint, default = hints.get(name, Any), parameter.default
        if typing.get_origin(hint) is typing.Unpack:
            (table,) = typing.get_args(hint)
            yield from arguments_of(table)
        elif (factory := made.get(name, MISSING)) is not MISSING:
            yield name, hint, factory()
        else:
            yield name, hint, ... if default is parameter.empty else default


def _meaning(hint: Any) -> Meaning:
    """The unit in a type, or that it contains expressions."""
    if hint is sp.Expr:
        return sp.Expr
    extras = [e for e in getattr(hint, "__metadata__", ()) if isinstance(e, Unit | UnitsOf)]
    within = map(_meaning, typing.get_args(hint))
    return next((m for m in (*extras, *within) if m is not None), None)


def _written(hint: Any, meaning: Meaning) -> Any:
    """The type of what a file writes for an argument; None where it cannot write one."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if hint is float and isinstance(meaning, Unit | UnitsOf):
        return Value
    if not inner:
        return {bool: bool, int: int, float: float, str: Text, sp.Expr: Expression}.get(hint)
    if origin is Literal:
        return hint
    if origin is Annotated:
        written = _written(inner[0], meaning)
        for extra in inner[1:]:
            if isinstance(extra, Least):
                written = Annotated[written, Field(ge=extra.value)]
            elif isinstance(extra, Two):
                written = Annotated[tuple[float, float], _Array, _two(f"numbers [{extra.names}]")]
            elif isinstance(extra, Says):
                written = Annotated[written, _text(extra.what)]
        return written
    one_of = origin in (Union, types.UnionType)
    if not one_of and not (isinstance(origin, type) and issubclass(origin, Mapping | Sequence)):
        return None
    several = [_written(p, meaning) for p in inner if p not in (Path, type(None), ...)]
    if None in several or not several:
        return None
    if one_of:
        return Union[tuple([*several, None] if type(None) in inner else several)]  # noqa: UP007
    if origin is tuple and inner[-1] is not ...:
        if several[0] is Text:
            return Plane
        return Point if meaning is sp.Expr else Range if meaning is None else Interval
    if issubclass(origin, Mapping):
        return types.GenericAlias(dict, (Name, several[1]))
    return types.GenericAlias(list, (Name if several == [Text] else several[0],))


@dataclass(frozen=True)
class _Reader:
    """Reads the values of keys: numbers to SI units, text to expressions."""

    file: str
    units: Mapping[str, Mapping[str, str]]
    names: dict[str, sp.Expr]
    unit: str

    def __call__(self, value: Any, meaning: Meaning | str, key: str) -> Any:
        if isinstance(value, list | tuple):
            places = [f"{key}.{i}" if isinstance(value, list) else key for i in range(len(value))]
            return tuple(self(v, meaning, p) for v, p in zip(value, places, strict=True))
        if meaning is None or value is None or isinstance(value, sp.Basic):
            return value
        if isinstance(value, Mapping):
            of: Mapping[str, Meaning | str] = dict.fromkeys(value, meaning)
            if isinstance(meaning, UnitsOf):
                of = self.units[meaning.what]
            for name in value:
                if name not in of:
                    raise ScenarioError(
                        f"{self.file}: {key}.{name}: unknown name", remedy=suggestion(name, of)
                    )
            return {n: self(v, of[n], f"{key}.{n}") for n, v in value.items()}
        with at(self.file, key):
            if meaning is sp.Expr:
                return parse_formula(value, self.names)
            return to_si(
                value, (meaning.name if isinstance(meaning, Unit) else str(meaning)) or self.unit
            )


class NoiseSpec(Section):
    """[noise]: half-widths of uniform and standard deviations of normal noise, per state."""

    uniform: dict[Name, Value] = Field(default_factory=dict)
    normal: dict[Name, Value] = Field(default_factory=dict)


class DrawSpec(Section):
    """{ range = ["-180 deg", "180 deg"], unit = "rad" }"""

    range: Interval
    unit: str | None = None


class ParameterSpec(Section, of=[Parameter], without=["name", "angle", "role", "above"]):
    """A parameter with its unit and source."""

    value: Value


Parameters = dict[Name, ParameterSpec | Value]


class FlatOutputSpec(Section, of=[FlatOutput]):
    """The flat output (z1, zn): { first = z1, last = [zk, ..., zn] }, expressions of the states."""


S = TypeVar("S", bound=Section)


@contextmanager
def at(file: str, key: str, text: str = "") -> Iterator[None]:
    """Prefix every error raised inside with the file and the key; text: that of the file."""
    try:
        yield
    except HoldfastError as error:
        if isinstance(error, ScenarioError) and str(error).startswith(f"{file}: "):
            raise
        raise as_written(_placed(file, key, error), tomllib.loads(text)) from None


def _placed(file: str, key: str, error: HoldfastError) -> ScenarioError:
    key = error.key or key
    return ScenarioError(
        f"{file}: {key}: {error.cause}", expected=error.expected, remedy=error.remedy
    )


def as_written(error: ScenarioError, data: object) -> ScenarioError:
    """The error with the numbers that it shows as its place in the file has them, in other units.

    Of a table, those of the keys that the error names.
    """
    key, _, said = error.cause.partition(": ")[2].partition(": ")
    for part in key.split("."):
        if isinstance(data, list) and part.isdecimal() and int(part) < len(data):
            data = data[int(part)]
        elif isinstance(data, Mapping) and part in data:
            data = data[part]
        else:
            return error
    names = set(re.findall(r"\w+", said))
    shown = [float(n) for n in re.findall(r"(?<![\w.])-?\d+\.?\d*(?:e[-+]?\d+)?(?!\w)", said)]
    texts = [
        f"{place} = {text}" if place else text
        for place, text, numbers in _in_other_units(data, "")
        if any(math.isclose(n, s, rel_tol=PRINTED) for n in numbers for s in shown)
        and names.issuperset(re.findall(r"\w+\Z|\d+", place))
    ]
    if not texts:
        return error
    cause = f"{error.cause}, written as {' and '.join(texts)}"
    return ScenarioError(cause, expected=error.expected, remedy=error.remedy)


PRINTED = 5e-3
"""The relative error of a number with three digits."""


def _in_other_units(value: object, place: str) -> Iterator[tuple[str, str, list[float]]]:
    """Places, texts and numbers in the SI of values that have another number there."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from _in_other_units(part, f"{place}.{name}" if place else str(name))
        return
    entries = value if isinstance(value, list) else [value]
    if any(isinstance(e, list | Mapping) for e in entries):
        for number, part in enumerate(entries):
            yield from _in_other_units(part, f"{place}.{number}" if place else str(number))
        return
    written = [(e, split(e)) for e in entries if isinstance(e, str)]
    units = [(e, parts[0]) for e, parts in written if parts and parts[1] and is_unit(parts[1])]
    numbers = [n for e, as_is in units if (n := in_base_units(e)) != as_is]
    if numbers:
        texts = ", ".join(f'"{e}"' if isinstance(e, str) else str(e) for e in entries)
        yield place, f"[{texts}]" if entries is value else texts, numbers


def validated(model: type[S], data: object, file: str, prefix: str = "") -> S:
    """`data` as `model`; `ScenarioError` for the first error."""
    try:
        place = f"{file}: {prefix}: " if prefix else f"{file}: "
        return model.model_validate(data, context=place)
    except pydantic.ValidationError as error:
        # among the alternatives of a union the deepest error is the most specific
        first = max(
            error.errors(),
            key=lambda e: (e["type"] == "extra_forbidden", len(e["loc"]), e["type"] == PAIR),
        )
        raise _complaint(model, data, first, file, prefix) from None


def _keys(data: object, location: Sequence[str | int]) -> list[str]:
    """The part of pydantic's location that is in the file; it adds tags of union members."""
    keys = []
    for part in location:
        inside = isinstance(data, dict) and part in data
        if inside or (isinstance(data, list) and isinstance(part, int) and part < len(data)):
            data = data[part]  # type: ignore[index]
            keys.append(str(part))
    return keys


def _complaint(
    model: type[Section], data: object, error: Any, file: str, prefix: str
) -> ScenarioError:
    path = _keys(data, error["loc"])
    if error["type"] == "missing":
        path.append(str(error["loc"][-1]))
    key = ".".join([prefix, *path] if prefix else path) or "the file"
    if error["type"] == "extra_forbidden":
        keys = _known_keys(model, error["loc"])
        return ScenarioError(f"{file}: {key}: unknown key", remedy=suggestion(path[-1], keys))
    if error["type"] == "missing":
        return ScenarioError(f"{file}: {key}: missing key", remedy="add it")
    shown = repr(error["input"])
    return ScenarioError(
        f"{file}: {key}: got {shown if len(shown) < 80 else shown[:77] + '...'}",
        expected=error["msg"].replace("Input should be ", "").replace("a valid string", "text"),
    )


def _alternatives(annotation: Any) -> list[Any]:
    """The leaf types of a dict, list, union or annotated type, recursively."""
    parts = getattr(annotation, "__args__", ())
    return [*parts, *(a for part in parts for a in _alternatives(part))]


def _known_keys(model: type[Section], path: Sequence[Any]) -> list[str]:
    current: Any = model
    for part in path[:-1]:
        fields = getattr(current, "model_fields", {})
        if part in fields:
            current = fields[part].annotation
        nested = [a for a in _alternatives(current) if hasattr(a, "model_fields")]
        if not hasattr(current, "model_fields") and nested:
            current = nested[0]
    return list(getattr(current, "model_fields", {}))
