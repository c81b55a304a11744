"""Definitions as values: compared, hashed, copied and pickled by what they have."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from functools import cached_property
from typing import Any, Self, TypeVar

import sympy as sp
from sympy.printing.str import StrPrinter

Key = TypeVar("Key")
Held = TypeVar("Held")


class FrozenDict(dict[Key, Held]):
    """A mapping that does not change."""

    __slots__ = ()

    def _refuse(self, *_: object, **__: object) -> Any:
        raise TypeError("a part of a definition cannot be changed; make another with replace()")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __eq__(self, other: object) -> bool:
        """As a dict's, but for arrays, which are equal as a whole."""
        if isinstance(other, FrozenDict):
            return bool(content(self) == content(other))
        return dict.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(content(self))

    def __copy__(self) -> FrozenDict[Key, Held]:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (picklable(dict(self)),)


class InOrder(FrozenDict[Key, Held]):
    """A mapping that does not change, and is another in another order."""

    __slots__ = ()


def unchanging(value: Any) -> Any:
    """The same, with mappings that do not change, in mappings too."""
    if type(value) is dict:
        return FrozenDict({key: unchanging(held) for key, held in value.items()})
    return value


class Value:
    """What is compared and hashed by its fields, also where these are arrays or mappings.

    Beside that of a dataclass, which does both faster where every field can be hashed, it has
    expressions pickled as they are; what is computed once and kept is computed again.
    """

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return self is other or content(self) == content(other)

    def __hash__(self) -> int:
        return hash(content(self))

    def __copy__(self) -> Self:
        return self

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: picklable(value)
            for name, value in self.__dict__.items()
            if not isinstance(getattr(type(self), name, None), cached_property)
        }


LINES, COLUMNS = 10, 100
"""Of what is printed of a definition, at most."""


class InNotebooks:
    """What a notebook shows as HTML. The page is made by a later room, which is asked by its name:
    no room imports a later one."""

    def _repr_html_(self) -> str:
        page: str = importlib.import_module("holdfast.presentation.notebook").html_of(self)
        return page


class Printed(Value, InNotebooks):
    """A value of many parts, of which `print` shows the first in a few lines."""

    def _lines(self) -> tuple[str, Sequence[str], Sequence[str]]:
        """What it is, a line for each of many things, and the lines after them."""
        raise NotImplementedError

    def __repr__(self) -> str:
        head, many, last = self._lines()
        room = LINES - 1 - len(last)
        left = len(many) - room
        if left > 0:
            many = [*many[: room - 1], f"... and {left + 1} more"]
        lines = (f"  {line}" for line in (*many, *last))
        cut = (line if len(line) <= COLUMNS else f"{line[: COLUMNS - 3]}..." for line in lines)
        return "\n".join([head, *cut])


WRITTEN = {
    "magnitude": "abs", "least": "min", "greatest": "max", "length": "hypot", "angle": "atan2",
}  # fmt: skip
"""Functions by the names that a user writes; the last two have a guard, which nobody writes."""


class _AsWritten(StrPrinter):
    def _print_Function(self, e: sp.Function) -> str:  # noqa: N802 (a name of SymPy)
        name = type(e).__name__
        shown = e.args[:2] if name in ("length", "angle") else e.args
        return f"{WRITTEN.get(name, name)}({self.stringify(shown, ', ')})"


def short_text(e: sp.Basic) -> str:
    """An expression as a reader would write it, its numbers with the digits that they need."""
    return str(_AsWritten({"full_prec": False}).doprint(e))


def content(value: Any) -> Any:
    """What can be hashed, and is equal for equal values only; NaN is equal to itself."""
    if is_dataclass(value) and not isinstance(value, type):
        return type(value), *(content(getattr(value, f.name)) for f in fields(value) if f.compare)
    match value:
        case sp.MatrixBase():
            return value.shape, *map(content, value.flat())
        case InOrder():
            return tuple((key, content(held)) for key, held in value.items())
        case Mapping():
            return frozenset((key, content(held)) for key, held in value.items())
        case list() | tuple():
            return tuple(map(content, value))
        case Set():
            return frozenset(map(content, value))
        case float() if math.isnan(value):
            return "NaN"
    if hasattr(value, "tobytes") and hasattr(value, "dtype"):  # an array
        held = tuple(map(content, value.flat)) if value.dtype.hasobject else value.tobytes()
        return value.shape, value.dtype.str, held
    if hasattr(value, "data_vars"):  # a dataset of xarray
        return content({**value.variables}), content(value.attrs)
    if hasattr(value, "dims") and hasattr(value, "values"):  # an array with names
        coordinates = {n: content(c.values) for n, c in getattr(value, "coords", {}).items()}
        return value.dims, content(value.values), content(value.attrs), content(coordinates)
    return value


def picklable(value: Any) -> Any:
    """The same, with expressions that come back as they are: SymPy would evaluate them again."""
    match value:
        case sp.Basic() if value.args:
            return _Pickled(value)
        case tuple() if type(value) is tuple:
            return tuple(map(picklable, value))
        case list() if type(value) is list:
            return list(map(picklable, value))
        case dict() if type(value) is dict:
            return {key: picklable(held) for key, held in value.items()}
    return value


class _Pickled:
    """An expression, in place of which comes its tree, every part once."""

    def __init__(self, e: sp.Basic) -> None:
        self.e = e

    def __reduce__(self) -> tuple[Callable[..., sp.Basic], tuple[Any, ...]]:
        places: dict[sp.Basic, int] = {}
        nodes: list[Any] = []
        waiting = [self.e]
        while waiting:
            part = waiting[-1]
            left = [a for a in part.args if a not in places]
            if left:
                waiting.extend(left)
                continue
            waiting.pop()
            if part not in places:
                places[part] = len(nodes)
                nodes.append((part.func, [places[a] for a in part.args]) if part.args else part)
        return _expression, (nodes,)


def _expression(nodes: list[Any]) -> sp.Basic:
    parts: list[sp.Basic] = []
    for node in nodes:
        if isinstance(node, tuple):
            function, places = node
            arguments = [parts[k] for k in places]
            try:
                node = function(*arguments, evaluate=False)
            except TypeError:  # it evaluates nothing
                node = function(*arguments)
        parts.append(node)
    return parts[-1]
