"""What the keys of a scenario file hold: texts, names, numbers with units, arrays of two."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, WrapValidator
from pydantic_core import PydanticCustomError

Value = float | str
"""A number in SI units, or text with a unit such as "30 deg"."""

Expression = str | float
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,60}$")]
Text = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x08\x0b-\x1f\x7f]*$", max_length=2000)]

PAIR = "pair"
"""The type of the error of an array that is not the two that it should be."""


def _two(what: str) -> WrapValidator:
    """Whatever is wrong with an array of two is answered by what it should be."""

    def check(given: object, handler: Callable[[object], object]) -> object:
        try:
            return handler(given)
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


class Section(BaseModel):
    """A table of the file: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
