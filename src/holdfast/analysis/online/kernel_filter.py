"""A kernel that a safety filter keeps: its law, what it looks up, and its promise.

It says of the kernel if its promise was not tried, or fell short. What has to do with kernels is
loaded for a filter that keeps one: a region's filter needs no value function.
"""

from __future__ import annotations

import math
import warnings
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.decomposition.parts_law import (
    default_parts_promise,
    only_part,
    parts_law,
)
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.problem import definition
from holdfast.analysis.reachability.value_function import Tried, ValueFunction
from holdfast.analysis.safety.promise import FELL_SHORT, UNCONFIRMED
from holdfast.analysis.safety.safety_filter import kept_law
from holdfast.analysis.safety.validation import default_promise
from holdfast.errors import (
    ArgumentError,
    DefinitionError,
    PromiseFellShortWarning,
    PromiseNotTriedWarning,
    SimulationError,
)
from holdfast.execution.arrays import Array
from holdfast.maths.control.prediction import Prediction
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.system import System

REMEDY = "kernel = kernel.tried(hf.check_promise(system, kernel, region))"

_warned: set[int] = set()


def kept_kernel(system: System, value: Any, count: int) -> KeptKernel:
    """The kernel that a filter of `system` keeps; count: of all that it keeps.

    Raises `ArgumentError` for what is neither a region nor a kernel.
    """
    if not isinstance(value, ValueFunction | PartsValue):
        raise ArgumentError(
            f"SafetyFilter: keep is {value!r:.60}".rstrip(),
            expected="a Region, a kernel (ValueFunction, PartsValue), or several in order",
        )
    if isinstance(value, PartsValue):
        _check_parts(system, value, count)
    return KeptKernel(value)


@dataclass(frozen=True)
class KeptKernel:
    """A value function, or one that is put together from parts."""

    value: ValueFunction | PartsValue

    @property
    def parts(self) -> PartsValue | None:
        """The kernel, if it is put together from parts."""
        return self.value if isinstance(self.value, PartsValue) else None

    @property
    def marched(self) -> Sequence[ValueFunction]:
        """What was marched: the kernel itself, or that of every part."""
        return self.value.values if isinstance(self.value, PartsValue) else (self.value,)

    @property
    def predicted(self) -> bool:
        """Whether its actuators are predicted, and kept in a share of their range."""
        return self.parts is not None and self.parts.decomposition.prediction is not None

    @property
    def table(self) -> ValueFunction:
        """The value function of the kernel, or of its part, that the law looks up."""
        return only_part(self.value).value if isinstance(self.value, PartsValue) else self.value

    @property
    def lasts(self) -> float:
        """How long its promise lasts [s]."""
        report = self.table.report
        return math.inf if report.converged else report.reached_s

    def values(self, states: Array, looked_up: Array, timed: bool) -> Array:
        """V at states (count, states), from what the law looks up there, at the remaining time."""
        if isinstance(self.value, ValueFunction):
            return looked_up
        return self.value.within(states, looked_up) if timed else self.value.at(states)

    def places(self, names: Sequence[str], states: Array) -> dict[str, Array]:
        """Where states (count, states) are looked up, along each axis by its name in a sentence."""
        if self.parts is None:
            return dict(zip(names, states.T, strict=True))
        solved = only_part(self.parts)
        shown = [
            f"predicted {n}" if n in names and str(e) != n else n
            for n, e in solved.part.coordinates.items()
        ]
        return dict(zip(shown, solved.coordinates(states).T, strict=True))

    def law(
        self, system: System, command: Law, *, predicts: bool, **options: Any
    ) -> tuple[Law, Prediction | None]:
        """The law that keeps a command in it, and what it predicts; options: of `kept_law`."""
        if isinstance(self.value, PartsValue):
            return parts_law(self.value, command, **options), None
        made = kept_law(system, self.value, command, predicts=predicts, **options)
        if not made.stays:
            warnings.warn(
                f"inputs that are held for {options['sample_time']:g} s lose trial runs from "
                "everywhere that they should keep in the kernel; take a shorter sample time, a "
                "finer grid, or give a margin",
                PromiseFellShortWarning,
                stacklevel=7,
            )
        return made.law, made.predicted

    def check_around(
        self,
        system: System,
        states: Sequence[str] | None,
        rates: Mapping[str, float] | None,
    ) -> None:
        """Refuse what takes from the parts of a kernel what their promise rests on."""
        if self.parts is None:
            return
        if states is not None:
            raise DefinitionError("parts promise nothing where not all states are measured")
        slow = [n for n in rates or {} if n in system.input_names]
        if slow and self.predicted:
            raise DefinitionError(
                f"the rate of '{slow[0]}' is limited, by which actuators would leave their share",
                expected="predicted actuators that follow their commands with a lag alone",
                remedy="leave out the rates of inputs",
            )

    def warn_of_promise(self, system: System, sample_time: float, stacklevel: int) -> None:
        """Warn once of a kernel whose promise was not tried, or fell short.

        A kernel that was computed here is tried now, with the trial by default at the filter's
        `sample_time` [s], and remembers what it came to; one from a file has been tried or not.
        `PromiseNotTriedWarning`, `PromiseFellShortWarning`.
        """
        first = self.marched[0]
        trouble = self._tried(system, sample_time) if first.report.promise_outcome is None else ""
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
                f"of {what}, which the filter keeps, {report.promise_conclusion}; take a finer "
                "grid or a shorter sample time",
                PromiseFellShortWarning,
                stacklevel=stacklevel + 1,
            )

    def _tried(self, system: System, sample_time: float) -> str:
        """Try a kernel that was computed here, and note what it came to; why it cannot be tried."""
        try:
            if isinstance(self.value, PartsValue):
                promise: Tried | None = default_parts_promise(self.value)
            else:
                promise = default_promise(system, self.value, sample_time=sample_time)
        except SimulationError as error:
            return f" ({error})"
        if promise is not None:
            for value in self.marched:
                value.dataset.attrs.update(value.tried(promise).dataset.attrs)
        return ""


def _check_parts(system: System, value: PartsValue, count: int) -> None:
    """Refuse a kernel that is put together for another system, and one beside regions."""
    whole = value.decomposition.system
    same = whole.state_names == system.state_names and definition(whole) == definition(system)
    numbers = [{q.name: float(q.value) for q in s.parameters} for s in (whole, system)]
    if not (same and numbers[0] == numbers[1]):
        raise SimulationError(
            f"the kernel of parts belongs to another system '{whole.name}'",
            expected=f"system '{system.name}' with the same rates, bounds and parameters",
        )
    if count > 1:
        raise DefinitionError(
            "a kernel that is put together from parts is kept beside something else",
            expected="it alone",
            remedy="put the inequalities into the region that is taken apart",
        )
