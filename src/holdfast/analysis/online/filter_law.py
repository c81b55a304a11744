"""The law of a safety filter: the command of another controller, kept in regions and a kernel."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.decomposition.parts_law import only_part, parts_law
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.problem import definition
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import kept_law
from holdfast.errors import (
    ArgumentError,
    DefinitionError,
    ModelWarning,
    PromiseFellShortWarning,
    SimulationError,
    suggestion,
)
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.maths.control.command import commanded
from holdfast.maths.control.parameter_box import parameter_box
from holdfast.maths.control.prediction import Prediction
from holdfast.maths.control.safety_filter import Asked, asked_of, in_order, safeguard
from holdfast.maths.definitions.extension import both
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System

Keep = ValueFunction | PartsValue | Region


@dataclass(frozen=True)
class Made:
    """The law of a filter; first: the most important of what it keeps. region: of all regions.

    asked: what it asks of the region, by `asked_of`. ahead: of a kernel whose state is seen late,
    with the memory that the law reads.
    """

    system: System
    law: Law
    first: Keep
    kernel: ValueFunction | PartsValue | None
    region: Region | None
    asked: Callable[[], list[Asked]]
    ahead: Prediction | None = None

    @property
    def whole_law(self) -> Law | Switching:
        """The law, with what it remembers."""
        return self.ahead.remembered(self.law) if self.ahead else self.law

    @property
    def gains(self) -> tuple[float, float] | None:
        """k1 and k2 of the conditions of regions [1/s]; None without a region."""
        numbers = {p.name: float(p.value) for p in self.law.parameters}
        return (numbers["kappa1"], numbers["kappa2"]) if "kappa1" in numbers else None

    @property
    def parts(self) -> PartsValue | None:
        """The kernel, if it is put together from parts."""
        return self.kernel if isinstance(self.kernel, PartsValue) else None

    @property
    def predicted(self) -> bool:
        """Whether its actuators are predicted, and kept in a share of their range."""
        return self.parts is not None and self.parts.decomposition.prediction is not None

    @property
    def table(self) -> ValueFunction | None:
        """The value function of the kernel, or of its part, that the law looks up."""
        return only_part(self.kernel).value if isinstance(self.kernel, PartsValue) else self.kernel

    @property
    def lasts(self) -> float:
        """How long the promise of the kernel lasts [s]."""
        if self.table is None or self.table.report.converged:
            return math.inf
        return self.table.report.reached_s

    def values(self, states: Array, looked_up: Array) -> Array:
        """The value at states (count, states): V, or -max_j c_j of a region.

        looked_up: what the law looks up there, at the remaining time.
        """
        if isinstance(self.first, Region):
            return -self._levels.values(states).max(axis=1)
        if isinstance(self.first, ValueFunction):
            return looked_up
        if self.law.lookup is not None and self.law.lookup.timed:
            return self.first.within(states, looked_up)
        return self.first.at(states)

    @cached_property
    def _levels(self) -> Evaluator:
        assert isinstance(self.first, Region)
        states = [q.symbol for q in self.system.states]
        return Evaluator(
            [c.expression for c in self.first.inequalities], states, self.first.parameters
        )

    def places(self, states: Array) -> dict[str, Array]:
        """Where states (count, states) are looked up, along each axis by its name in a sentence."""
        names = self.system.state_names
        if self.parts is None:
            return dict(zip(names, states.T, strict=True))
        solved = only_part(self.parts)
        shown = [
            f"predicted {n}" if n in names and str(e) != n else n
            for n, e in solved.part.coordinates.items()
        ]
        return dict(zip(shown, solved.coordinates(states).T, strict=True))


def filter_of(
    system: System,
    keep: Keep | Sequence[Keep],
    *,
    sample_time: float,
    delay: float,
    ahead: bool | float,
    rate: float | None,
    margin: float | None,
    gains: tuple[float, float] | None,
    margins: Mapping[str, float] | None,
    constraints: Region | None,
    measured: bool,
    worst: Sequence[str],
    uncertain: Mapping[str, Sequence[float]] | None,
    scales: Mapping[str, float] | None,
    predicts: bool,
) -> Made:
    """The law that hands on a command within what is kept; the options are of `SafetyFilter`.

    predicts: whether it may predict the state over a delay.
    """
    kept: list[Any] = list(keep) if isinstance(keep, list | tuple) else [keep]
    for part in kept:
        if not isinstance(part, ValueFunction | PartsValue | Region):
            raise ArgumentError(
                f"SafetyFilter: keep is {part!r:.60}".rstrip(),
                expected="a Region, a kernel (ValueFunction, PartsValue), or several in order",
            )
    kernels = [part for part in kept if not isinstance(part, Region)]
    for part in kernels:
        if isinstance(part, PartsValue):
            _check_parts(system, part, len(kept))
    _check_options(
        bool(kernels), len(kernels) < len(kept), rate=rate, margin=margin, delay=delay, ahead=ahead,
        gains=gains, margins=margins, constraints=constraints, measured=measured,
        worst=worst, uncertain=uncertain,
    )  # fmt: skip
    if constraints is not None:
        place, first = next((k, x) for k, x in enumerate(kept) if isinstance(x, Region))
        kept[place] = both(first, constraints)
    regions = [part for part in kept if isinstance(part, Region)]
    known = [name for region in regions for name in region.inequality_names]
    for name in margins or {}:
        if name not in known:
            raise DefinitionError(
                f"margin of '{name}', which is not an inequality of what is kept",
                remedy=suggestion(str(name), known),
            )
    command = commanded(system)

    memories: list[Prediction] = []

    def kept_in(part: Keep) -> Law:
        if not isinstance(part, Region):
            options: dict[str, Any] = {
                "rate": rate, "margin": margin, "sample_time": sample_time, "delay": delay,
                "scales": scales, "ahead": ahead,
            }  # fmt: skip
            if isinstance(part, PartsValue):
                return parts_law(part, command, **options)
            made = kept_law(system, part, command, predicts=predicts, **options)
            memories.extend([made.predicted] if made.predicted else [])
            if not made.stays:
                warnings.warn(
                    f"inputs that are held for {sample_time:g} s lose trial runs from everywhere "
                    "that they should keep in the kernel; take a shorter sample time, a finer "
                    "grid, or give a margin",
                    PromiseFellShortWarning,
                    stacklevel=6,
                )
            law: Law = made.law
            return law
        inside = {n: v for n, v in (margins or {}).items() if n in part.inequality_names}
        return safeguard(
            system,
            command,
            part,
            gains=gains,
            margins=inside,
            scales=scales,
            measured=measured,
            worst=worst,
            uncertain=uncertain,
            sample_time=sample_time,
        )

    filters = [kept_in(part) for part in kept]
    law = in_order(filters) if len(filters) > 1 else filters[0]
    region = reduce(both, regions) if regions else None
    return Made(
        system,
        law,
        kept[0],
        kernels[0] if kernels else None,
        region,
        partial(
            asked_of,
            system,
            region,
            tuple(margins or ()),
            tuple(worst),
            measured,
            parameter_box(uncertain, system, region),
        )
        if region is not None
        else list,
        memories[0] if memories else None,
    )


def fallback_of(system: System, given: Sequence[float] | None) -> tuple[Array, Array]:
    """The input, within its bounds, that is applied where nothing is known; its actuators."""
    names = system.input_names
    wanted = np.zeros(len(names)) if given is None else np.asarray(given, dtype=np.float64)
    if wanted.shape != (len(names),) or not np.isfinite(wanted).all():
        raise SimulationError(
            f"fallback is {given!r}", expected=f"{len(names)} numbers: {', '.join(names)}"
        )
    values = {p.symbol: p.value for p in system.parameters}
    asked = system.allocated([sp.Float(v) for v in wanted])
    limited = [sp.sympify(e).xreplace(values) for e in system.limited(asked)]
    made = [sp.sympify(e).xreplace(values) for e in system.produced(limited)]
    return np.array(made, dtype=np.float64), np.array(limited, dtype=np.float64)


def _check_parts(system: System, value: PartsValue, kept: int) -> None:
    """Refuse a kernel that is put together for another system, and one beside regions."""
    own = value.decomposition.system
    same = own.state_names == system.state_names and definition(own) == definition(system)
    numbers = [{q.name: float(q.value) for q in s.parameters} for s in (own, system)]
    if not (same and numbers[0] == numbers[1]):
        raise SimulationError(
            f"the kernel of parts belongs to another system '{own.name}'",
            expected=f"system '{system.name}' with the same rates, bounds and parameters",
        )
    if kept > 1:
        raise DefinitionError(
            "a kernel that is put together from parts is kept beside something else",
            expected="it alone",
            remedy="put the inequalities into the region that is taken apart",
        )


def check_around_parts(
    made: Made, states: Sequence[str] | None, rates: Mapping[str, float] | None
) -> None:
    """Refuse what takes from the parts of a kernel what their promise rests on."""
    if made.parts is None:
        return
    if states is not None:
        raise DefinitionError("parts promise nothing where not all states are measured")
    slow = [n for n in rates or {} if n in made.system.input_names]
    if slow and made.predicted:
        raise DefinitionError(
            f"the rate of '{slow[0]}' is limited, by which actuators would leave their share",
            expected="predicted actuators that follow their commands with a lag alone",
            remedy="leave out the rates of inputs",
        )


def _check_options(kernel: bool, region: bool, **given: Any) -> None:
    """Refuse options that nothing of what is kept has."""
    if not kernel and not region:
        raise DefinitionError("there is nothing to keep", expected="a region or a kernel")
    if region and not kernel and given["delay"]:
        raise DefinitionError(
            f"a delay of {given['delay']:g} s, for which a region's filter has no margin",
            remedy="give margins for what may happen meanwhile, or a kernel",
        )
    of_kernels = {"rate": None, "margin": None, "delay": 0.0, "ahead": True}
    of_regions = {
        "gains": None,
        "margins": None,
        "constraints": None,
        "measured": False,
        "worst": (),
        "uncertain": None,
    }
    for usual, has, whose in ((of_kernels, kernel, "region"), (of_regions, region, "kernel")):
        for name, value in usual.items():
            if not has and given[name] != value:
                raise DefinitionError(f"{name} is given, which a {whose}'s filter has not")


def warn_of_reduction(own: System, around: System | None) -> None:
    """A filter of a reduced model cannot keep its promise around the whole vehicle."""
    if around is None:
        missing, whole = own.promoted, "the vehicle itself"
        remedy = f"around=system says that you command {_and(own.input_names)} at once"
    else:
        if unknown := [n for n in own.state_names if n not in around.state_names]:
            raise DefinitionError(
                f"system '{own.name}' has the state '{unknown[0]}', and '{around.name}' has "
                "none of that name"
            )
        missing = tuple(n for n in around.state_names if n not in own.state_names)
        whole, remedy = f"'{around.name}'", "compute a kernel of it, or keep a region"
    if missing:
        warnings.warn(
            f"the filter is computed for '{own.name}', which leaves out how {_and(missing)} "
            f"{'change' if len(missing) > 1 else 'changes'}; around {whole} its promise does not "
            f"hold; {remedy}",
            ModelWarning,
            stacklevel=4,
        )


def _and(names: Sequence[str]) -> str:
    return " and ".join(names)
