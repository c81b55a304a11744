"""Kernels of other scenarios, computed once for the vehicle of the scenario that names them.

[safety] is a safety filter that keeps a scenario's law in the kernel of another scenario.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.kernel_store import WEB, is_reference
from holdfast.analysis.load import load
from holdfast.analysis.reachability.value_function import Claim, ValueFunction
from holdfast.analysis.safety.safety_filter import kept_law, safety_law
from holdfast.analysis.safety.validation import default_promise
from holdfast.errors import OutputError, ScenarioError, SimulationError
from holdfast.execution.arrays import AnyArray, Array
from holdfast.execution.leaf import Evaluator
from holdfast.execution.resources import Progress
from holdfast.host.files import FETCH_VARIABLE, cache_directory, code_digest, scenarios_may_fetch
from holdfast.maths.control.velocity_tracking import track_velocity
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.scenario.build.composer import LATE
from holdfast.scenario.files import merged, read_tables
from holdfast.scenario.kinds.kernel import KernelScenario, composed_kernel, is_kernel
from holdfast.scenario.schema.closed_loop import ScenarioSpec
from holdfast.scenario.schema.kernel import PROBLEMS
from holdfast.scenario.schema.values import Section, Text, at, validated

DECISIVE = ("system", "region", "goal", "origin", "disturbance", "grid", "march")
"""The tables that determine a value function, in addition to the kind."""


class SafetySpec(Section, of=[safety_law], without=["sample_time", "delay", "scales", "errors"]):
    """[safety], a safety filter: the least change of the inputs that keeps the state in a kernel.

    kernel: a scenario that computes it, for the [system] of this one, or a file of a value
    function. alone: the optimal inputs replace the law's; if they are velocities of this system,
    [tracking] follows them. ahead: the seconds that the sampled game may take, or false for none.
    Times are in [run], scales in [safeguard], and errors are of the parts of a kernel.
    """

    kernel: Text
    alone: bool = False


@dataclass(frozen=True)
class NamedKernel:
    """A kernel that a scenario names.

    scenario: the scenario that computes it, None for the file of a value function. digest: of
    everything that the value depends on, so that equal problems are solved once.
    """

    name: str
    scenario: KernelScenario | None
    digest: str = ""

    def value(self, progress: Progress | None = None) -> ValueFunction:
        """The value function of the file, or computed once and kept in the cache."""
        if self.scenario is None:
            return _loaded(self.name)
        with suppress(OutputError):  # a truncated file, as after a full disk, is computed again
            if self._file.exists():
                return self._stored(self.scenario)
        value = self.scenario.solve(progress)
        value.save(self._file)
        return value

    def tried(self, value: ValueFunction) -> ValueFunction:
        """The kernel of a scenario with what its promise came to, tried once and kept too."""
        if self.scenario is None or value.report.promise_outcome is not None:
            return value
        with suppress(SimulationError):  # what cannot be tried is said by its filter
            promise = default_promise(self.scenario.system, value)
            if promise is not None:
                value.tried(promise).save(self._file)
                return self._stored(self.scenario)
        return value

    def _stored(self, scenario: KernelScenario) -> ValueFunction:
        claim = Claim(scenario.region, scenario.goal)
        return replace(_loaded(str(self._file)), claim=claim)

    @property
    def _file(self) -> Path:
        return cache_directory() / f"value_{self.digest}.nc"

    def check_horizon(self, value: ValueFunction, horizon: float) -> None:
        """Refuse runs longer than the horizon of a kernel that has not converged."""
        report = value.report
        if not report.converged and horizon > report.horizon_s * (1 + 1e-9):
            raise ScenarioError(
                f"the kernel of '{self.name}' is valid for {report.horizon_s:g} s, but the run "
                f"takes {horizon:g} s",
                remedy="raise its march.horizon until it converges, or shorten the run",
            )


def named_kernel(
    name: str,
    system: Mapping[str, Any] | None = None,
    altered: Mapping[str, Mapping[str, Any]] | None = None,
) -> NamedKernel:
    """The kernel of the scenario, or of the value function, of that name or file.

    system: the table of the vehicle, whose keys replace those of the scenario, but for the lag of
    its actuators. altered: name ->
    tables, [kernels], which replace both.

    Raises `ScenarioError` for a scenario that computes no set or cannot be composed, for the file
    of a value function with alterations, and for one of the web where scenarios may not fetch.
    """
    changes = dict((altered or {}).get(name, {}))
    if name.startswith(WEB) and not scenarios_may_fetch():
        raise ScenarioError(
            f"the scenario names a kernel of the web, {name}, and fetches nothing unless it may",
            remedy=f"holdfast --fetch, or {FETCH_VARIABLE}=1; or holdfast store add {name}, and "
            "name it store:NAME",
        )
    if name.endswith(".nc") or is_reference(name):
        if changes:
            raise ScenarioError(
                f"kernels.{name}: the file of a value function cannot be altered",
                remedy="name the scenario that computes it",
            )
        return NamedKernel(name, None)
    file, text, tables = read_tables(name)
    if not is_kernel(file, tables):
        raise ScenarioError(
            f"'{name}' does not compute a kernel", expected="one of " + ", ".join(PROBLEMS)
        )
    vehicle = {k: v for k, v in (system or {}).items() if k not in LATE}
    data = merged(merged(tables, {"system": vehicle}), changes)
    if data != tables:
        text += f"\n# with: {json.dumps({n: t for n, t in data.items() if t != tables.get(n)})}\n"
    scenario = composed_kernel(file, text, data)
    numbers = [(q.name, q.value) for q in scenario.system.parameters]  # those of a vehicle's file
    decisive = [scenario.kind, {n: data[n] for n in DECISIVE if n in data}, numbers]
    posed = json.dumps(decisive, sort_keys=True, default=str)
    digest = hashlib.sha256(f"{code_digest()}{posed}".encode()).hexdigest()[:24]
    return NamedKernel(name, scenario, digest)


def check_implies(
    kernel: NamedKernel, value: ValueFunction, region: Region | None, system: System
) -> None:
    """Refuse a kernel with states that violate the region of the scenario that is kept in it.

    A kernel whose region has the same inequalities, or more, needs no check. For any other, all
    nodes are checked that are in the set at the last time or at an earlier one.
    """
    if region is None or _has_all(kernel.scenario, region, system):
        return
    names = value.names
    for c in region.inequalities:
        unknown = c.expression.free_symbols & {symbol(n) for n in system.state_names}
        for name in sorted(str(s) for s in unknown):
            if name not in names:
                raise ScenarioError(
                    f"the kernel of '{kernel.name}' has no state '{name}', on which "
                    f"'{c.name}' of region '{region.name}' depends",
                    remedy="compute a kernel with that state, or use the kernel's region",
                )
    rows = Evaluator(
        [c.expression for c in region.inequalities],
        [a.state.symbol for a in value.grid.axes],
        region.parameters,
    )
    nodes = [a.nodes for a in value.grid.axes]
    data = value.dataset["value"]
    for time in data["time"].values if "time" in data.dims else (None,):
        layers = value.layers(time)
        for k in range(layers.shape[0]):
            columns = _inside(layers[k], k, nodes)
            if not len(columns):
                continue
            excess = rows.values(columns)
            row, j = np.unravel_index(int(excess.argmax()), excess.shape)
            if not excess[row, j] <= 1e-9:  # nor is what is not a number within
                c = region.inequalities[j]
                shown = ", ".join(
                    f"{n} = {v:.3g}" for n, v in zip(names, columns[row], strict=True)
                )
                amount = f"{excess[row, j]:.3g}" + ("" if c.unit == "1" else f" {c.unit}")
                raise ScenarioError(
                    f"the kernel of '{kernel.name}' is not within region '{region.name}': at "
                    f"{shown} it violates '{c.name}' by {amount}",
                    remedy="compute the kernel of this region, or use the region of the kernel",
                )


def _inside(layer: AnyArray, k: int, nodes: list[Array]) -> Array:
    """The nodes of the k-th layer along the first axis at which the value is positive."""
    places = np.argwhere(layer > 0)
    columns = [np.full(len(places), nodes[0][k])]
    columns += [n[p] for n, p in zip(nodes[1:], places.T, strict=True)]
    return np.stack(columns, axis=1)


def _has_all(scenario: KernelScenario | None, region: Region, system: System) -> bool:
    """Whether the kernel's region has every inequality of this one, with the same numbers."""
    if scenario is None or scenario.region is None or scenario.goal is not None:
        return False

    def said(of: Region, plant: System) -> set[sp.Expr]:
        values = {q.symbol: sp.Float(q.value) for q in (*plant.parameters, *of.parameters)}
        return {c.expression.xreplace(values) for c in of.inequalities}

    return said(region, system) <= said(scenario.region, scenario.system)


def _loaded(path: str) -> ValueFunction:
    loaded = load(path)
    if isinstance(loaded, PartsValue):
        raise ScenarioError(
            f"{path} is put together from parts and has no grid of all its states",
            expected="a kernel on one grid here",
            remedy="take hf.parts_law and the value that hf.load gives",
        )
    if not isinstance(loaded, ValueFunction):
        raise ScenarioError(f"{path} holds trajectories", expected="a value function")
    return loaded


@dataclass(frozen=True)
class Safety:
    """The kernel of a safety filter, and the settings of the filter: arguments of `safety_law`.

    alone: whether the optimal inputs replace those of the law. tracking: the gains by which the
    vehicle follows velocities, where those are the inputs of the kernel; None where its inputs are
    the vehicle's own.
    """

    kernel: NamedKernel
    alone: bool
    settings: Mapping[str, Any]
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
            None if self.alone else law,
            sample_time=sample_time,
            delay=delay,
            **self.settings,
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
    asked = validated(SafetySpec, spec.safety, file, "safety")
    with at(file, "safety"):
        kernel = named_kernel(asked.kernel, spec.system, spec.kernels)
        inputs = () if kernel.scenario is None else kernel.scenario.system.input_names
        velocities = [n for n in inputs if n in system.state_names]  # of the vehicle, as inputs
        if velocities and not (asked.alone and spec.tracking is not None):
            raise ScenarioError(
                f"the kernel of '{kernel.name}' has the inputs {' and '.join(velocities)}, "
                "which are states here",
                expected="alone = true, and [tracking] to follow them",
            )
        settings = asked.read(file, "safety")
        return Safety(kernel, asked.alone, settings, spec.tracking if velocities else None)
