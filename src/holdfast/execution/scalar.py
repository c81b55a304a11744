"""Scalar functions as machine code, called from Python or through their addresses."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from holdfast.execution.codegen.scalar_llvm import scalars_text
from holdfast.execution.codegen.scalar_reader import (
    ARRAYS,
    BOOL,
    FLOAT,
    FLOATS,
    INT,
    NONE,
    TABLE,
    WHOLES,
    scalars,
)
from holdfast.execution.leaf import Machine, compiled_text

_TYPES = {INT: ctypes.c_int64, FLOAT: ctypes.c_double, BOOL: ctypes.c_bool, NONE: None}
_DTYPES = {FLOATS: (np.float64,), WHOLES: (np.int64,), TABLE: (np.float64, np.float32)}


def called(file: str, name: str, *arguments: Any) -> Any:
    """The result of a function of a file of `holdfast.execution`, such as "interpolate".

    Arrays are contiguous, of doubles or of 64-bit integers; a `Table` may be of floats.
    """
    function = scalars(file).functions[name]
    single, given = False, []
    for (parameter, kind), argument in zip(function.parameters.items(), arguments, strict=True):
        if kind not in ARRAYS:
            given.append(argument)
            continue
        if argument.dtype not in _DTYPES[kind] or not argument.flags.c_contiguous:
            raise TypeError(f"'{parameter}' of '{name}' is {argument.dtype}, not {kind}")
        single |= kind == TABLE and argument.dtype == np.float32
        given.append(argument.ctypes.data)
    return _function(file, name, single)(*given)


def address(file: str, name: str, *, single: bool = False) -> int:
    """The address of its machine code, for tables in double or single precision."""
    return _machine(file, name, single).address(name)


@cache
def _function(file: str, name: str, single: bool) -> Callable[..., Any]:
    function = scalars(file).functions[name]
    kinds: list[Any] = [_TYPES.get(kind, ctypes.c_void_p) for kind in function.parameters.values()]
    return ctypes.CFUNCTYPE(_TYPES[function.result], *kinds)(address(file, name, single=single))


@cache
def _machine(file: str, name: str, single: bool) -> Machine:
    return compiled_text(scalars_text(scalars(file), [name], single=single), optimised=True)
