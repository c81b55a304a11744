"""[safety]: a safety filter that keeps a scenario's law in the kernel of another scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from holdfast.analysis.online.safety_filter import SafetyFilter
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import kept_law, safety_law
from holdfast.errors import ScenarioError
from holdfast.execution.resources import Progress
from holdfast.maths.control.velocity_tracking import track_velocity
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.scenario.kernel_reference import NamedKernel, check_implies, named_kernel
from holdfast.scenario.schema.closed_loop import SafetySpec, ScenarioSpec
from holdfast.scenario.validation import at

if TYPE_CHECKING:
    from holdfast.scenario.kinds.closed_loop import Scenario


@dataclass(frozen=True)
class Safety:
    """The kernel of a safety filter, and the settings of the filter.

    tracking: the gains by which the vehicle follows velocities, where those are the inputs of the
    kernel; None where its inputs are the vehicle's own.
    """

    kernel: NamedKernel
    spec: SafetySpec
    tracking: Mapping[str, float] | None

    def kept(
        self,
        system: System,
        law: Law | Switching,
        horizon: float,
        sample_time: float,
        delay: float,
        region: Region | None = None,
        progress: Progress | None = None,
    ) -> Law | Switching:
        """The law with the safety filter, for runs of `horizon`; computes the kernel if necessary.

        region: the constraints of the runs; the kernel has to lie within it.
        """
        value = self.value(system, region, progress)
        self.kernel.check_horizon(value, horizon)
        if self.tracking is not None:
            return self._followed(system, value, delay)
        return safety_law(
            system,
            value,
            None if self.spec.alone else law,
            rate=self.spec.rate,
            margin=self.spec.margin,
            ahead=self.spec.ahead,
            sample_time=sample_time,
            delay=delay,
        )

    def value(
        self, system: System, region: Region | None = None, progress: Progress | None = None
    ) -> ValueFunction:
        """The kernel, computed if necessary, which is not empty and within the region."""
        value = self.kernel.value(progress)
        if value.report.empty:
            raise ScenarioError(f"the kernel of '{self.kernel.name}' is empty")
        check_implies(self.kernel, value, region, system)
        return value

    def _followed(self, system: System, value: ValueFunction, delay: float) -> Law:
        """The optimal velocities of the kernel, which the vehicle's own inputs follow."""
        assert self.kernel.scenario is not None
        assert self.tracking is not None
        game = self.kernel.scenario.system
        velocities: Law = kept_law(game, value, None, delay=delay, ahead=False).law
        return track_velocity(system, velocities, self.tracking)


def composed_safety(file: str, spec: ScenarioSpec, system: System) -> Safety:
    """[safety], with the kernel of this vehicle; `ScenarioError` for incompatible tables."""
    assert spec.safety is not None
    for other in ("safeguard", "observer"):
        if getattr(spec, other) is not None:
            raise ScenarioError(
                f"{file}: safety: cannot be combined with [{other}]", remedy="leave one of them out"
            )
    with at(file, "safety"):
        kernel = named_kernel(spec.safety.kernel, spec.system, spec.kernels)
        velocities = () if kernel.scenario is None else _velocities(kernel.scenario.system, system)
        if velocities and not (spec.safety.alone and spec.tracking is not None):
            raise ScenarioError(
                f"the kernel of '{kernel.name}' has the inputs {' and '.join(velocities)}, "
                "which are states here",
                expected="alone = true, and [tracking] to follow them",
            )
        return Safety(kernel, spec.safety, spec.tracking if velocities else None)


def _velocities(game: System, system: System) -> tuple[str, ...]:
    """The inputs of a kernel that are states of the vehicle."""
    return tuple(n for n in game.input_names if n in system.state_names)


def online_filter(
    scenario: Scenario, settings: Mapping[str, Any], progress: Progress | None = None
) -> SafetyFilter:
    """The filter of [safeguard] or [safety], with [observer], around the command handed to a law.

    settings: those of `SafetyFilter` in the tables but [safety]. The kernel is computed.
    """
    file, system, safety = scenario.file, scenario.model, scenario.safety
    commanded = [q.name.removeprefix("command_") for q in scenario.law.handed]
    if missing := [n for n in system.input_names if n not in commanded]:
        raise ScenarioError(
            f"{file}: law.external: the other controller does not command {', '.join(missing)}",
            expected="external = true for a filter by itself",
        )
    drawn = {*scenario.varied.draws, *scenario.varied.values}
    if varied := sorted(drawn & {p.name for p in scenario.law.parameters}):
        raise ScenarioError(
            f"{file}: varied: '{varied[0]}' of the filter differs from run to run",
            remedy="leave it out, with --set varied=",
        )
    timing: dict[str, Any] = {"sample_time": float(scenario.settings["sample_time"])}
    if safety is None:
        if "gains" not in settings or scenario.region is None:
            raise ScenarioError(
                f"{file}: nothing keeps the command of the other controller",
                expected="[safeguard] or [safety]",
            )
        with at(file, "safeguard"):
            return SafetyFilter(system, scenario.region, **settings, **timing)
    if safety.spec.alone or safety.tracking is not None:
        raise ScenarioError(
            f"{file}: safety.alone: the kernel replaces the command of the other controller",
            expected="alone = false",
        )
    with at(file, "safety"):
        value = safety.kernel.tried(safety.value(system, scenario.region, progress))
        timing["delay"] = float(scenario.settings["delay"])
        more = {n: getattr(safety.spec, n) for n in ("rate", "margin", "ahead")}
        return SafetyFilter(system, value, **more, **settings, **timing)
