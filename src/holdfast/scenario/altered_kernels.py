"""[kernels]: tables that alter a named kernel, which has to be one that the file uses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from holdfast.errors import ScenarioError, suggestion


def check_kernels(file: str, data: Mapping[str, Any]) -> None:
    """Refuse [kernels] of a name that no key `kernel` of the file uses: it would have no effect."""
    known = set(_named(data))
    for name in _altered(data):
        if name not in known:
            raise ScenarioError(
                f"{file}: kernels.{name}: no [safety] or [compare] names this kernel",
                remedy=suggestion(name, known),
            )


def _named(data: Mapping[str, Any]) -> Iterator[str]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from _named(value)
        elif key == "kernel" and isinstance(value, str):
            yield value


def _altered(data: Mapping[str, Any]) -> Iterator[str]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from (value if key == "kernels" else _altered(value))
