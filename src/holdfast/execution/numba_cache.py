"""Numba's machine code in this project's cache; apart, so that a simulation need not load Numba."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.serialize import dumps

from holdfast.execution.cache import Stored, cache_directory


def kept(function: Callable[..., Any]) -> Callable[..., Any]:
    """The Numba function, with its machine code in this cache."""
    own = getattr(function, "py_func", None) or function.__wrapped__  # type: ignore[attr-defined]
    function._cache = _Cache(own)  # type: ignore[attr-defined]
    return function


class _Place:
    """Numba's interface of a cache location."""

    def __init__(self, source: str) -> None:
        self._py_file = source

    def ensure_cache_path(self) -> None:
        """The folder exists already."""


class _Impl(CompileResultCacheImpl):
    def __init__(self, function: Any) -> None:
        self._lineno = function.__code__.co_firstlineno
        self._locator = _Place(function.__code__.co_filename)
        self._filename_base = f"{function.__module__}.{function.__qualname__}-{self._lineno}"


class _Cache(FunctionCache):
    """As Numba's, but with one file for each signature, checked before it is read."""

    _impl_class = _Impl

    def __init__(self, function: Any) -> None:
        self._name = repr(function)
        self._py_func = function
        self._impl = _Impl(function)
        stamp = _stamp(function.__code__.co_filename)
        self._cache_file: Any = _Code(self._impl.filename_base, stamp)
        self._enabled = True

    @property
    def cache_path(self) -> str:
        return str(cache_directory())


@cache
def _stamp(source: str) -> str:
    """Numba's version, and the digest of a module's text."""
    try:
        text = hashlib.sha256(Path(source).read_bytes()).hexdigest()
    except OSError:
        text = source
    return f"{numba.__version__} {text}"


class _Code(Stored):
    def pickled(self, data: object) -> bytes:
        found: bytes = dumps(data)  # type: ignore[no-untyped-call]
        return found

    def flush(self) -> None:
        """Numba's method that clears an index; this cache has none."""
