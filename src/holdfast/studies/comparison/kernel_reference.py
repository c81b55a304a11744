"""[compare] kernel: the reference kernel, whose starts some law can keep."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import decided
from holdfast.analysis.simulation.law_comparison import Reference
from holdfast.errors import HoldfastError, ScenarioError
from holdfast.execution.arrays import Array
from holdfast.execution.resources import Progress
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.numeric import Expression, Values, constant
from holdfast.scenario.build.kernel import depth_inside
from holdfast.scenario.files import scenario_title
from holdfast.scenario.kernel_reference import NamedKernel, named_kernel
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.schema.closed_loop import ScenarioSpec
from holdfast.scenario.validation import at

JUDGES = ("viability-kernel", "discriminating-kernel")


@dataclass(frozen=True)
class Judge:
    """The kernel of [compare], and the least depth of counted starts (None: one cell)."""

    name: str
    margin: float | None

    def value(
        self, tables: Mapping[str, Any], scenarios: Sequence[Scenario], progress: Progress
    ) -> tuple[ValueFunction | None, str]:
        """The kernel of a case with these tables, or the reason why it does not apply."""
        try:
            kernel = named_kernel(self.name, tables["system"], tables.get("kernels"))
        except ScenarioError as error:
            return None, error.cause
        for scenario in scenarios:
            if reason := _not_followed(kernel, scenario):
                return None, reason
        value = kernel.value(progress)
        deepest = float(value.values().max())
        if self.margin is None and 0 < deepest <= (cell := self._margin(value)):
            raise ScenarioError(
                f"no state of the kernel is inside by a cell, {cell:.3g} {value.report.value_unit}",
                expected=f"[compare] margin below {deepest:.3g}",
            )
        for scenario in scenarios:
            try:
                decided(scenario.system, value)
                kernel.check_horizon(value, float(scenario.settings["horizon"]))
            except HoldfastError as error:
                return None, error.cause
        return value, ""

    def _margin(self, value: ValueFunction) -> float:
        return value.report.cell if self.margin is None else self.margin

    def reference(self, value: ValueFunction, starts: Array) -> Reference:
        """The kernel's values at the starts."""
        report = value.report
        return Reference(
            kernel=scenario_title(self.name),
            value=value.at(starts),
            margin=self._margin(value),
            unit=report.value_unit,
            horizon=math.inf if report.converged else report.horizon_s,
        )


def composed_judge(file: str, spec: ScenarioSpec) -> Judge | None:
    """[compare] kernel and margin; `ScenarioError` if it is not a kernel of this system."""
    given = spec.compare
    if given.kernel is None:
        if given.margin is not None:
            raise ScenarioError(f"{file}: compare.margin: needs compare.kernel")
        return None
    with at(file, "compare.kernel"):
        found = named_kernel(given.kernel, spec.system, spec.kernels).scenario
        if found is None or found.kind not in JUDGES:
            raise ScenarioError(
                f"got '{given.kernel}'", expected="a scenario that is a " + " or a ".join(JUDGES)
            )
    margin = None
    if given.margin is not None:
        with at(file, "compare.margin"):
            margin = depth_inside(given.margin, found.about)
            if not margin >= 0:
                raise ScenarioError(f"got {margin:g}", expected="a number, at least 0")
    return Judge(given.kernel, margin)


def _not_followed(kernel: NamedKernel, scenario: Scenario) -> str:
    """The reason why this kernel does not apply to the scenario's plant, or an empty text.

    Measurements (noise, delay, an observer) do not matter: they do not change the viable states.
    """
    found = kernel.scenario
    assert isinstance(found, KernelScenario)
    if scenario.varied:
        return "it is varied from run to run"
    if scenario.plant:
        return "the vehicle is not that of [system], for which the kernel is computed"
    if found.system.state_names != scenario.system.state_names:
        return "the states are " + ", ".join(scenario.system.state_names)
    assert scenario.region is not None
    if _said(found.about, found.system) != _said(scenario.region, scenario.system):
        return f"the kernel belongs to another region, '{found.about.name}'"
    given: Mapping[str, float] = found.options.get("disturbance", {})
    for name, number in given.items():
        if constant(scenario.disturbance.get(name, 0)) != number:
            return f"{name} is not {number:g}, the value of the kernel"
    return ""


def _said(region: Region, system: System) -> tuple[Expression, Values]:
    """The definition of a set of states: its margin, and the numbers in it."""
    values = {q.symbol: q.value for q in (*system.parameters, *region.parameters)}
    return region.margin, {s: v for s, v in values.items() if s in region.margin.free_symbols}
