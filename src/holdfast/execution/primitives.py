"""Primitives of the code that Numba compiles: decorators, and counters that threads share.

Generated modules import all of them (`compile.py`). Functions called from Python are `compiled`.
Functions called from compiled code are made by `within` and have no entry from Python: such
entries, which unpack Python's objects around a copy of the function, were a quarter of the
compilation.
"""

# mypy: ignore-errors

import math  # noqa: F401

import numpy as np  # noqa: F401
from llvmlite import ir  # noqa: F401
from numba import njit, types
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

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


MOST_SLICES = 1 << 20  # the turns of a stage; the next stage has the next so many


# -- shared between threads --------------------------------------------------------------


@intrinsic
def take(typing_context, counter):
    """Atomically returns counter[0] and increments it: no two threads get the same value."""

    def generate(context, builder, signature, arguments):
        (array,) = arguments
        where = make_array(signature.args[0])(context, builder, array).data
        return builder.atomic_rmw("add", where, context.get_constant(types.int64, 1), "monotonic")

    return types.int64(counter), generate


@intrinsic
def look(typing_context, counter):
    """The present counter[0], by an atomic read."""

    def generate(context, builder, signature, arguments):
        (array,) = arguments
        where = make_array(signature.args[0])(context, builder, array).data
        return builder.load_atomic(where, "acquire", 8)

    return types.int64(counter), generate


@compiled
def watch(own, other, value, times):
    """Counts its own start; returns whether the other reaches the value within so many reads."""
    take(own)
    for _ in range(times):  # noqa: SIM110
        if look(other) >= value:
            return True
    return False
