"""The law of a safety filter: the command of another controller, kept in regions and a kernel."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import safety_law
from holdfast.errors import ArgumentError, DefinitionError, ModelWarning, suggestion
from holdfast.maths.control.command import commanded
from holdfast.maths.control.priority import in_order
from holdfast.maths.control.safety_filter import safeguard
from holdfast.maths.definitions.extension import both
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

Keep = ValueFunction | Region


class Made(NamedTuple):
    """The law of a filter; first: the most important of what it keeps. region: of all regions."""

    law: Law
    first: Keep
    kernel: ValueFunction | None
    region: Region | None

    @property
    def lasts(self) -> float:
        """How long the promise of the kernel lasts [s]."""
        if self.kernel is None or self.kernel.report.converged:
            return math.inf
        return self.kernel.report.reached_s

    @property
    def by_value(self) -> bool:
        """Whether the value of a decision is that of the kernel."""
        return isinstance(self.first, ValueFunction)


def filter_of(
    system: System,
    keep: Keep | Sequence[Keep],
    *,
    sample_time: float,
    delay: float,
    rate: float,
    margin: float | None,
    gains: tuple[float, float],
    margins: Mapping[str, float] | None,
    constraints: Region | None,
    measured: bool,
    worst: Sequence[str],
    scales: Mapping[str, float] | None,
) -> Made:
    """The law that hands on a command within what is kept; the options are of `SafetyFilter`."""
    kept: list[Any] = list(keep) if isinstance(keep, list | tuple) else [keep]
    for part in kept:
        if not isinstance(part, ValueFunction | Region):
            raise ArgumentError(
                f"SafetyFilter: keep is {part!r:.60}".rstrip(),
                expected="a Region, a kernel (ValueFunction), or several in order",
            )
    kernels = [part for part in kept if isinstance(part, ValueFunction)]
    _check_options(
        bool(kernels), len(kernels) < len(kept), rate=rate, margin=margin, delay=delay,
        gains=gains, margins=margins, constraints=constraints, measured=measured,
        worst=worst,
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

    def kept_in(part: Keep) -> Law:
        if isinstance(part, ValueFunction):
            return safety_law(
                system, part, command, rate=rate, margin=margin, sample_time=sample_time,
                delay=delay, scales=scales,
            )  # fmt: skip
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
        )

    filters = [kept_in(part) for part in kept]
    return Made(
        in_order(filters) if len(filters) > 1 else filters[0],
        kept[0],
        kernels[0] if kernels else None,
        reduce(both, regions) if regions else None,
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
    of_kernels = {"rate": 2.0, "margin": None, "delay": 0.0}
    of_regions = {
        "gains": (1.0, 4.0),
        "margins": None,
        "constraints": None,
        "measured": False,
        "worst": (),
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
