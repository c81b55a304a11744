"""Value types of scenario files: texts, names, numbers with units, arrays of two.

A file is validated; errors name the file and the key.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, ClassVar, TypeVar

import pydantic
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    WrapValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from holdfast.errors import HoldfastError, RenamedWarning, ScenarioError, suggestion

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


# TOML has arrays only, which strict checking would refuse for a tuple
_Array = Field(strict=False)
Bounds = Annotated[
    tuple[Expression, Expression], _Array, _two("numbers or expressions [low, high]")
]
Point = Annotated[tuple[Expression, Expression], _Array, _two("numbers or expressions [x, y]")]
Layer = Annotated[tuple[float, float], _Array, _two("numbers [cmax, cmin]")]
Gains = Annotated[tuple[float, float], _Array, _two("numbers [k1, k2]")]
Interval = Annotated[tuple[Value, Value], _Array, _two("numbers [low, high]")]
Plane = Annotated[tuple[Name, Name], _Array, _two('names of states, such as ["x", "y"]')]


Renamed = Mapping[str, tuple[str, Mapping[str, object]]]
"""Former key -> the key that replaced it, and its former values -> the present ones."""


class Section(BaseModel):
    """A table of the file: unknown keys are refused.

    A key that was `renamed` is accepted for one release, with a warning.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
    renamed: ClassVar[Renamed] = {}

    @model_validator(mode="before")
    @classmethod
    def _with_former_keys(cls, data: object) -> object:
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
                f"the key '{former}' is now '{key}': write {key}{shown}; the former goes with "
                "the next release",
                RenamedWarning,
                stacklevel=2,
            )
        return table


class NoiseSpec(Section):
    """[noise]: half-widths of uniform and standard deviations of normal noise, per state."""

    uniform: dict[Name, Value] = Field(default_factory=dict)
    normal: dict[Name, Value] = Field(default_factory=dict)


class DrawSpec(Section):
    """{ range = ["-180 deg", "180 deg"], unit = "rad" }"""

    range: Interval
    unit: str | None = None


class ParameterSpec(Section):
    """A parameter with its unit and source."""

    value: Value
    unit: str = "1"
    description: Text = ""
    source: Text = ""
    assumed: bool = False
    gain: bool = False


Parameters = dict[Name, ParameterSpec | Value]


class FlatOutputSpec(Section):
    """The flat output (z1, zn): { first = z1, last = [zk, ..., zn] }, expressions of the states."""

    first: Expression
    last: list[Expression]


S = TypeVar("S", bound=Section)


@contextmanager
def at(file: str, key: str) -> Iterator[None]:
    """Prefix every error raised inside with the file and the key."""
    try:
        yield
    except ScenarioError as error:
        if str(error).startswith(f"{file}: "):
            raise
        raise _placed(file, key, error) from None
    except HoldfastError as error:
        raise _placed(file, key, error) from None


def _placed(file: str, key: str, error: HoldfastError) -> ScenarioError:
    key = error.key or key
    return ScenarioError(
        f"{file}: {key}: {error.cause}", expected=error.expected, remedy=error.remedy
    )


def validated(model: type[S], data: object, file: str, prefix: str = "") -> S:
    """`data` as `model`; `ScenarioError` for the first error."""
    try:
        return model.model_validate(data)
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
    for number, part in enumerate(location):
        inside = isinstance(data, dict) and part in data
        if inside or (isinstance(data, list) and isinstance(part, int) and part < len(data)):
            data = data[part]  # type: ignore[index]
        elif number < len(location) - 1 or not isinstance(data, dict):
            continue
        keys.append(str(part))
    return keys


def _complaint(
    model: type[Section], data: object, error: Any, file: str, prefix: str
) -> ScenarioError:
    path = _keys(data, error["loc"])
    key = ".".join([prefix, *path] if prefix else path) or "the file"
    if error["type"] == "extra_forbidden":
        keys = _known_keys(model, error["loc"])
        return ScenarioError(f"{file}: {key}: unknown key", remedy=suggestion(path[-1], keys))
    if error["type"] == "missing":
        return ScenarioError(f"{file}: {key}: missing key", remedy="add it")
    shown = repr(error["input"])
    return ScenarioError(
        f"{file}: {key}: got {shown if len(shown) < 80 else shown[:77] + '...'}",
        expected=error["msg"].replace("Input should be ", ""),
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
