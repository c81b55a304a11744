"""Argument checking of public functions: name the offending argument after a failure.

All public functions share this mechanism. A function itself refuses values that are out of range
or inconsistent. A value of the wrong type makes it fail somewhere inside: its arguments are then
compared with its annotations, and the first that does not fit is named. If all fit, the fault is a
bug of holdfast. NaN is refused even where a function could ignore it. Text is read as an expression
only by what says so (`Written`).
"""

from __future__ import annotations

import builtins
import inspect
import math
import sys
import threading
import types
import typing
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, TypeVar

import sympy as sp

from holdfast.errors import ArgumentError, RenamedWarning

T = TypeVar("T", bound=Callable[..., Any])

LONGEST = 60
LARGEST = 2.0**63
SAMPLED = 1000
"""At most this many entries of a sequence are checked."""

ARRAY = TypeVar("ARRAY")
"""Stands for anything that NumPy converts to an array of numbers."""

FAILURES = (
    TypeError, AttributeError, ValueError, LookupError, ArithmeticError, AssertionError,
    NotImplementedError,
)  # fmt: skip

Fault = str | None
"""Returns what was expected of a value; None if the value fits."""

Check = Callable[[Any], Fault]


@dataclass(frozen=True)
class Unit:
    """Of an argument: the unit of its numbers; "" is that of the argument `unit` beside it."""

    name: str


@dataclass(frozen=True)
class UnitsOf:
    """Of an argument that is a table by name: what its names are, and so what units they have."""

    what: str


@dataclass(frozen=True)
class Least:
    """Of an argument: its least value."""

    value: int


@dataclass(frozen=True)
class Two:
    """Of an argument of two numbers: what they are."""

    names: str


@dataclass(frozen=True)
class Says:
    """Of an argument of text: what it says."""

    what: str


Written = Annotated[sp.Expr, str]
"""An expression, or its text in names of quantities: `expression_of`."""

InItsUnit = Annotated[float, Unit("")]
Seconds = Annotated[float, Unit("s")]
Metres = Annotated[float, Unit("m")]
MetresPerSecond = Annotated[float, Unit("m/s")]
Count = Annotated[int, Least(0)]
OfStates = Annotated[Mapping[str, float], UnitsOf("states")]
RangesOfStates = Annotated[Mapping[str, tuple[float, float]], UnitsOf("states")]
RangesOfParameters = Annotated[Mapping[str, tuple[float, float]], UnitsOf("parameters")]


def checked(of: T) -> T:
    """Decorate a function or class: a failure names the offending argument (`ArgumentError`)."""
    if isinstance(of, type):
        of.__init__ = _checked(of.__init__, of.__name__)  # type: ignore[misc]
        return of
    owner, _, bare = of.__qualname__.rpartition(".")
    name = owner.rpartition(".")[2] if bare == "__init__" else bare
    return _checked(of, name)  # type: ignore[return-value]


FORMER = "former_names"
"""The attribute of a function with the former names of its arguments."""


def renamed(**names: str) -> Callable[[T], T]:
    """Decorate a function: former names of arguments warn, and go with the next release."""

    def decorated(function: T) -> T:
        @wraps(function)
        def call(*positional: Any, **named: Any) -> Any:
            return function(*positional, **by_present_names(call, named))

        setattr(call, FORMER, names)
        return call  # type: ignore[return-value]

    return decorated


def by_present_names(
    function: Callable[..., Any], arguments: Mapping[str, Any], what: str = "the argument"
) -> dict[str, Any]:
    """Arguments of a `renamed` function by their present names; each former one warns.

    what: what the arguments are where they are written, and where that is. Raises `ArgumentError`
    for one that has both names.
    """
    present = dict(arguments)
    for former, now in getattr(function, FORMER, {}).items():
        if former not in present:
            continue
        if now in present:
            raise ArgumentError(f"both '{now}' and its former name '{former}'")
        present[now] = present.pop(former)
        warnings.warn(
            f"{what} '{former}' is now '{now}'; the former goes with the next release",
            RenamedWarning,
            stacklevel=3,
        )
    return present


class _AtWork(threading.local):
    """How many public functions and classes this thread is within."""

    depth = 0


_AT_WORK = _AtWork()


def written_by_user() -> bool:
    """Whether a public class is made by the user, and not by a public function."""
    return _AT_WORK.depth == 1


@contextmanager
def for_user() -> Iterator[None]:
    """What is made within is what a user has written, as in a file."""
    depth, _AT_WORK.depth = _AT_WORK.depth, 0
    try:
        yield
    finally:
        _AT_WORK.depth = depth


@contextmanager
def for_house() -> Iterator[None]:
    """What is made within was checked where it was made first, as in a store."""
    _AT_WORK.depth += 1
    try:
        yield
    finally:
        _AT_WORK.depth -= 1


def _of_user(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that a user has written, and that public functions call."""

    @wraps(function)
    def call(*positional: Any, **named: Any) -> Any:
        with for_user():
            return function(*positional, **named)

    return call


def _checked(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    signature = inspect.signature(function)
    hints: dict[str, Any] = {}
    before: dict[str, Check] = {}
    after: dict[str, Check] = {}
    called: set[str] = set()

    def refuse(checks: Mapping[str, Check], arguments: Mapping[str, Any]) -> None:
        for argument, check in checks.items():
            if argument in arguments and (expected := check(arguments[argument])):
                shown = f"{name}: {argument} is {_shown(arguments[argument])}"
                raise ArgumentError(shown, expected=expected)

    @wraps(function)
    def call(*positional: Any, **named: Any) -> Any:
        if not hints:  # resolved late: an annotation may name something defined further down
            hints.update(_hints(function, signature))
            before.update({n: _check(h) for n, h in hints.items() if _takes_expressions(h)})
            after.update({n: _check(h) for n, h in hints.items() if _is_number(h)})
            called.update(n for n, h in hints.items() if _is_called(h))
        try:
            bound = signature.bind(*positional, **named)
            arguments = dict(bound.arguments)
        except TypeError as error:
            allowed = ", ".join(n for n in signature.parameters if n != "self")
            raise ArgumentError(f"{name}: {error}", expected=f"({allowed})") from None
        refuse(before, arguments)
        if _AT_WORK.depth == 0 and not called.isdisjoint(arguments):
            for argument in called & arguments.keys():
                value = arguments[argument]
                if callable(value) and not isinstance(value, type):
                    bound.arguments[argument] = _of_user(value)
            positional, named = bound.args, bound.kwargs
        _AT_WORK.depth += 1
        try:
            answer = function(*positional, **named)
        except FAILURES:
            refuse({n: _check(hint) for n, hint in hints.items()}, arguments)
            raise
        finally:
            _AT_WORK.depth -= 1
        refuse(after, arguments)
        return answer

    return call


def hints_of(of: Any, *, extras: bool = False) -> dict[str, Any]:
    """The annotated types of a function or of a class; extras: with what is `Annotated`."""
    whole = inspect.unwrap(of)
    namespace = getattr(whole, "__globals__", None) or vars(sys.modules[whole.__module__])
    return typing.get_type_hints(of, namespace, _Unknown(namespace), include_extras=extras)


def _hints(function: Callable[..., Any], signature: inspect.Signature) -> dict[str, Any]:
    """The annotated type of every argument; *args are a list, **kwargs a table."""
    annotated = hints_of(function, extras=True)
    annotated |= {n: ARRAY for n, raw in function.__annotations__.items() if raw == "npt.ArrayLike"}
    hints: dict[str, Any] = {"return": Any}
    for name, parameter in signature.parameters.items():
        hint = annotated.get(name, Any)
        if parameter.kind is parameter.VAR_KEYWORD:
            hint = Any if typing.get_origin(hint) is typing.Unpack else hint
            hint = Mapping[str, hint]  # type: ignore[valid-type]
        elif parameter.kind is parameter.VAR_POSITIONAL:
            hint = Sequence[hint]  # type: ignore[valid-type]
        hints[name] = hint
    return hints


def _is_number(hint: Any) -> bool:
    """Whether the annotation is a number, or a number or None."""
    hint = typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    parts = typing.get_args(hint) if union else (hint,)
    return all(part in (float, int, type(None)) for part in parts)


def _is_called(hint: Any) -> bool:
    """Whether the annotation is a function, or a function or something else."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return any(map(_is_called, typing.get_args(hint)))
    return typing.get_origin(hint) is Callable


def _takes_expressions(hint: Any) -> bool:
    """Whether the annotation is an expression, or a list of expressions."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType, tuple, Sequence):
        return any(map(_takes_expressions, inner))
    if origin is Annotated:
        return _takes_expressions(inner[0])
    return hint is sp.Expr


class _Unknown(dict[str, Any]):
    """Names that a module imports only for its annotations; any value is allowed for them."""

    def __missing__(self, name: str) -> Any:
        if hasattr(builtins, name):
            raise KeyError(name)
        return Any


def _check(hint: Any) -> Check:
    """The check that belongs to an annotation."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        check = _check(inner[0])
        return check if hint != Written else lambda v: None if isinstance(v, str) else check(v)
    if origin in (typing.Union, types.UnionType):
        return _either([_check(part) for part in inner])
    if origin is typing.Literal:
        shown = ", ".join(map(repr, inner))

        def one(value: Any) -> Fault:  # an array compares by its entries
            same = any(isinstance(value, type(v)) and value == v for v in inner)
            return None if same else f"one of {shown}"

        return one
    if hint is ARRAY:
        return _array
    if isinstance(hint, TypeVar):
        parts = hint.__constraints__ or (hint.__bound__ or Any,)
        return _either([_check(part) for part in parts])
    if hint is None or hint is type(None):
        return lambda value: None if value is None else "nothing"
    if origin in (Callable, types.FunctionType) or hint is Callable:
        return lambda value: None if callable(value) else "a function"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _table(inner)
    if origin is tuple and inner and inner[-1] is not Ellipsis:
        return _pair([_check(part) for part in inner])
    if origin is tuple and inner:
        return _several(_check(inner[0]), kind=tuple)
    if isinstance(origin, type) and issubclass(origin, Iterable) and inner:
        return _several(_check(inner[0]), kind=origin)
    return _kind(hint if isinstance(hint, type) else origin)


def _kind(kind: Any) -> Check:
    if kind is float:
        return _number
    if kind is int:
        return _whole
    if kind is bool:
        return lambda value: None if type(value).__name__ in ("bool", "bool_") else "true or false"
    if kind is sp.Expr:
        return _expression
    if kind is Path:
        return lambda value: None if isinstance(value, str | PathLike) else "a path"
    is_class = isinstance(kind, type) and kind not in (object, Any)
    if is_class and getattr(kind, "_is_runtime_protocol", not getattr(kind, "_is_protocol", False)):
        article = "text" if kind is str else f"a {kind.__name__}"
        return lambda value: None if isinstance(value, kind) else article
    return _anything


def _anything(value: Any) -> Fault:
    return None


def _as_float(value: Any) -> float:
    """The value as a float; NaN if it is not a real number or is out of range."""
    if isinstance(value, sp.Expr):
        is_real = value.is_number and value.is_extended_real
    else:
        is_real = isinstance(value, Real) and not isinstance(value, bool)
        is_real = is_real or (getattr(value, "shape", None) == () and value.dtype.kind in "fiu")
    try:
        return float(value) if is_real else math.nan
    except OverflowError:
        return math.nan


def _number(value: Any) -> Fault:
    return "a number" if math.isnan(_as_float(value)) else None


def _whole(value: Any) -> Fault:
    """3.0 passes here and the function decides about it; True is refused."""
    size = abs(_as_float(value))
    if size < LARGEST:
        return None
    beyond = isinstance(value, int) or LARGEST <= size < math.inf
    return (
        "a whole number below 2^63" if beyond and not isinstance(value, bool) else "a whole number"
    )


def _expression(value: Any) -> Fault:
    if isinstance(value, sp.Basic) or type(value).__name__.endswith("Matrix"):
        return "an expression, not NaN" if value is sp.nan else None
    if isinstance(value, str):
        return f"an expression, such as hf.parse_expression({value[:40]!r}, names)"
    return "an expression, or a number" if math.isnan(_as_float(value)) else None


def _array(value: Any) -> Fault:
    import numpy as np  # imported only after a failure

    try:
        np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return "numbers"
    return None


NUMERIC = (_number, _whole, _expression)


def _either(checks: Sequence[Check]) -> Check:
    if _anything in checks:
        return _anything

    def check(value: Any) -> Fault:
        faults = [c(value) for c in checks]
        return None if None in faults else " or ".join(f for f in faults if f and f != "nothing")

    return check


def _table(inner: Sequence[Any]) -> Check:
    entry = _check(inner[1]) if len(inner) == 2 else _anything
    key = _check(inner[0]) if len(inner) == 2 else _anything

    def check(value: Any) -> Fault:
        if not isinstance(value, Mapping):
            return "a table by name"
        for name, one in value.items():
            if fault := key(name) or entry(one):
                return f"a table by name, of which every entry is {fault}"
        return None

    return check


def _pair(checks: Sequence[Check]) -> Check:
    def check(value: Any) -> Fault:
        entries = _entries(value)
        if entries is None or len(entries) != len(checks):
            return f"{len(checks)} of them"
        faults = (one(v) for one, v in zip(checks, entries, strict=True))
        fault = next((f for f in faults if f), None)
        return fault and f"{len(checks)} of them, each {fault}"

    return check


def _several(entry: Check, kind: type) -> Check:
    def check(value: Any) -> Fault:
        if kind is tuple and entry not in NUMERIC and not isinstance(value, tuple):
            return "a tuple"
        entries = _entries(value)
        if entries is None:
            iterable = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
            return "a list" if issubclass(kind, Sequence) or not iterable else None
        fault = next((f for v in entries[:SAMPLED] if (f := entry(v))), None)
        return fault and f"a list, each {fault}"

    return check


def _entries(value: Any) -> Sequence[Any] | None:
    """The entries of a list, a tuple or an array with at least one axis."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Collection):
        return None
    if getattr(value, "shape", (1,)) == () or not hasattr(value, "__getitem__"):
        return None
    return value  # type: ignore[return-value]


def _shown(value: Any) -> str:
    text = repr(value).split("\n")[0]
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."
