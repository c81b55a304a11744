"""Definitions as plain data (JSON), and read from it: the same ones, or a refusal.

A record has the name of its class and its fields; an expression is the number of a step
(`maths.expressions.written`), and a float has hexadecimal digits. What is read has to be what the
annotations of the fields say, and nothing else is made of it than the classes that are named.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from numbers import Integral, Real
from typing import Any

import sympy as sp

from holdfast.arguments import for_house
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import AllocatedImage, Ball, Box, LinearImage, Product
from holdfast.maths.definitions.quantity import (
    Parameter,
    Quantity,
    may_be_left_out,
    stated,
)
from holdfast.maths.definitions.region import Circle, Cone, Footprint, Inequality, Region, Segment
from holdfast.maths.definitions.system import (
    Antiderivative,
    FlatOutput,
    Measurement,
    PfaffianRow,
    System,
)
from holdfast.maths.expressions.written import Steps, expressions

CLASSES = (
    System, PfaffianRow, Measurement, FlatOutput, Antiderivative, Quantity, Parameter, Region,
    Inequality, Segment, Cone, Footprint, Circle, Box, Ball, LinearImage, AllocatedImage, Product,
)  # fmt: skip


def written(what: Any, *more: type) -> dict[str, Any]:
    """Plain data of a definition; more: classes of records beside `CLASSES`.

    Raises `DefinitionError` or `ExpressionError` for what a file cannot have.
    """
    steps = Steps()
    classes = (*CLASSES, *more)

    def plain(value: Any) -> Any:
        if value is None or isinstance(value, bool | str):
            return value
        if isinstance(value, sp.MatrixBase):
            return {"matrix": [[plain(e) for e in value.row(i)] for i in range(value.rows)]}
        if isinstance(value, sp.Basic):
            return {"step": steps.number(value)}
        if isinstance(value, Integral):
            return int(value)
        if isinstance(value, Real):
            return {"float": float(value).hex()}
        if isinstance(value, Mapping):
            return {"table": [[plain(k), plain(v)] for k, v in value.items()]}
        if isinstance(value, tuple | list):
            return [plain(v) for v in value]
        if type(value) in classes:
            said = {name: plain(v) for name, v in stated(value).items()}
            return {"is": type(value).__name__, **said}
        raise DefinitionError(
            f"{type(value).__name__} cannot be written to a file",
            expected=", ".join(c.__name__ for c in classes),
        )

    return {"what": plain(what), "steps": steps.rows}


def read(data: Any, as_a: type, *more: type) -> Any:
    """The definition of plain data, which is of the class `as_a`.

    Raises `DefinitionError` or `ExpressionError` for what `written` did not make.
    """
    try:
        steps = expressions(data["steps"])
        reader = _Reader(steps, {c.__name__: c for c in (*CLASSES, *more)})
        with for_house():
            return reader.value(data["what"], as_a)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise DefinitionError(f"a definition that nobody wrote ({error!s:.80})") from None
    except RecursionError:
        raise DefinitionError("a definition that is nested too deep") from None


class _Reader:
    def __init__(self, steps: list[sp.Expr], classes: Mapping[str, type]) -> None:
        self.steps, self.classes = steps, classes

    def value(self, data: Any, hint: Any) -> Any:
        """The value of data that fits an annotation."""
        origin, inner = typing.get_origin(hint), typing.get_args(hint)
        if origin in (typing.Union, types.UnionType):
            return self._either(data, inner)
        if isinstance(origin, type) and issubclass(origin, Mapping):
            pairs = [(self.value(k, inner[0]), self.value(v, inner[1])) for k, v in data["table"]]
            return dict(pairs)
        if origin is tuple:
            return self._entries(data, inner)
        if origin is typing.Literal:
            return _of(data, str)
        if hint in (str, int, bool):
            return _of(data, hint)
        if hint is float:
            return self._number(data)
        if issubclass(hint, sp.MatrixBase):
            return hint([[self.value(e, sp.Expr) for e in row] for row in data["matrix"]])
        if issubclass(hint, sp.Basic):
            return _of(self._expression(data), hint)
        return self._record(data, hint)

    def _either(self, data: Any, hints: tuple[Any, ...]) -> Any:
        """Of None or one other, or of several classes."""
        if data is None and type(None) in hints:
            return None
        others = [h for h in hints if h is not type(None)]
        if len(others) == 1:
            return self.value(data, others[0])
        named = self.classes[data["is"]]
        return self._record(data, next(h for h in others if h is named))

    def _entries(self, data: Any, hints: tuple[Any, ...]) -> tuple[Any, ...]:
        entries = _of(data, list)
        if hints[-1] is Ellipsis:
            return tuple(self.value(e, hints[0]) for e in entries)
        return tuple(self.value(e, h) for e, h in zip(entries, hints, strict=True))

    def _number(self, data: Any) -> Any:
        if not isinstance(data, dict):
            return _of(data, int)
        return self._expression(data) if "step" in data else float.fromhex(_of(data["float"], str))

    def _expression(self, data: Any) -> sp.Expr:
        if not isinstance(data, dict):
            return sp.Integer(_of(data, int))
        if "float" in data:
            return sp.Float(self._number(data))
        number = _of(data["step"], int)
        if not 0 <= number < len(self.steps):
            raise ValueError(f"there is no step {number}")
        return self.steps[number]

    def _record(self, data: Any, hint: Any) -> Any:
        named = self.classes[data["is"]]
        entries = {n: v for n, v in data.items() if n != "is"}
        assert is_dataclass(named)
        names = {f.name for f in fields(named)}
        complete = names - may_be_left_out(named) <= entries.keys() <= names
        if not issubclass(named, hint) or not complete:
            raise ValueError(f"a {data['is']} with {', '.join(entries):.60}")
        hints = typing.get_type_hints(named)
        return named(**{n: self.value(v, hints[n]) for n, v in entries.items()})


def _of(value: Any, kind: Any) -> Any:
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise TypeError(f"{value!r:.40} is no {kind.__name__}")
    return value
