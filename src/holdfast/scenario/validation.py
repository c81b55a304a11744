"""Validation of scenario files; errors name the file and the key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import pydantic

from holdfast.errors import HoldfastError, ScenarioError, suggestion
from holdfast.scenario.schema.values import PAIR, Section

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
        known = _known_keys(model, error["loc"])
        return ScenarioError(f"{file}: {key}: unknown key", remedy=suggestion(path[-1], known))
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
