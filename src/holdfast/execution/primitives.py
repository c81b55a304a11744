"""Primitives of the code that Numba compiles: decorators.

Generated modules import all of them (`compile.py`). Functions called from Python are `compiled`.
Functions called from compiled code are `inlined` and have no entry from Python: such entries, which
unpack Python's objects around a copy of the function, were a quarter of the compilation.
"""

# mypy: ignore-errors

import math  # noqa: F401

import numpy as np  # noqa: F401
from numba import carray, njit, types  # noqa: F401
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic  # noqa: F401

from holdfast.execution.numba_cache import kept

OPTIONS = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}


def compiled(function):
    """Machine code that Python may call."""
    return kept(njit(**OPTIONS)(function))


class Inlined(CPUDispatcher):
    """Machine code for compiled code; a call from Python runs the same text in Python."""

    def __call__(self, *arguments):
        return self.py_func(*arguments)


def within(**options):
    """A decorator of functions that only compiled code calls."""

    def decorate(function):
        dispatcher = kept(njit(**OPTIONS, no_cpython_wrapper=True, **options)(function))
        dispatcher.__class__ = Inlined
        return dispatcher

    return decorate


inlined = within(forceinline=True)
apart = within()  # a separate call
