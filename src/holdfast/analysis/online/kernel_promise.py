"""What a filter says of the kernel that it keeps: its promise was not tried, or fell short."""

from __future__ import annotations

import warnings
import weakref

from holdfast.analysis.decomposition.parts_promise import default_parts_promise
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.value_function import Tried, ValueFunction
from holdfast.analysis.safety.default_promise import default_promise
from holdfast.analysis.safety.verdict import FELL_SHORT, UNCONFIRMED
from holdfast.errors import PromiseFellShortWarning, PromiseNotTriedWarning, SimulationError
from holdfast.maths.definitions.system import System

Kernel = ValueFunction | PartsValue

REMEDY = "kernel = kernel.tried(hf.check_promise(system, kernel, region))"

_warned: set[int] = set()


def warn_of_promise(system: System, kernel: Kernel, sample_time: float, stacklevel: int) -> None:
    """Warn once of a kernel whose promise was not tried, or fell short.

    A kernel that was computed here is tried now, with the trial by default at the filter's
    `sample_time` [s], and remembers what it came to; one from a file has been tried or not.
    `PromiseNotTriedWarning`, `PromiseFellShortWarning`.
    """
    first = kernel.values[0] if isinstance(kernel, PartsValue) else kernel
    trouble = _tried(system, kernel, sample_time) if first.report.promise_outcome is None else ""
    report, key = first.report, id(first.dataset)
    if report.promise_outcome not in (None, FELL_SHORT, UNCONFIRMED) or key in _warned:
        return
    _warned.add(key)
    weakref.finalize(first.dataset, _warned.discard, key)
    what = f"the {report.kind} of '{report.region}'"
    if report.promise_outcome is None:
        warnings.warn(
            f"the promise of {what} was not tried{trouble}: nothing but its march says that it "
            f"can be kept; {REMEDY} tries it in closed loop, and a file that is saved then "
            "remembers it",
            PromiseNotTriedWarning,
            stacklevel=stacklevel + 1,
        )
    else:
        warnings.warn(
            f"of {what}, which the filter keeps, {report.promise_conclusion}; take a finer grid or "
            "a shorter sample time",
            PromiseFellShortWarning,
            stacklevel=stacklevel + 1,
        )


def _tried(system: System, kernel: Kernel, sample_time: float) -> str:
    """Try a kernel that was computed here, and note what it came to; why it cannot be tried."""
    try:
        if isinstance(kernel, PartsValue):
            promise: Tried | None = default_parts_promise(kernel)
        else:
            promise = default_promise(system, kernel, sample_time=sample_time)
    except SimulationError as error:
        return f" ({error})"
    if promise is not None:
        for value in kernel.values if isinstance(kernel, PartsValue) else (kernel,):
            value.dataset.attrs.update(value.tried(promise).dataset.attrs)
    return ""
