"""The kernel of another scenario, for the vehicle of the one that names it; computed once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.result import load
from holdfast.analysis.value_function import ValueFunction
from holdfast.errors import ScenarioError, suggestion
from holdfast.execution.closed_loop import Progress
from holdfast.execution.compile import cache_directory
from holdfast.kernel_scenario import KernelScenario, composed_kernel, is_kernel
from holdfast.kernel_schema import KINDS
from holdfast.sources import code_digest, merged, read_tables

DECISIVE = ("system", "region", "goal", "origin", "disturbance", "grid", "march")
"""The tables that a value depends on, beside the kind."""


@dataclass(frozen=True)
class NamedKernel:
    """A kernel that a scenario names.

    scenario: what computes it, None for the file of a value function; digest: of all that the
    value depends on, so that equal questions are answered once.
    """

    name: str
    scenario: KernelScenario | None
    digest: str = ""

    def value(self, progress: Progress | None = None) -> ValueFunction:
        """The value function, computed once and kept in the cache, or that of the file."""
        if self.scenario is None:
            return _loaded(self.name)
        kept = cache_directory() / f"value_{self.digest}.nc"
        if kept.exists():
            return _loaded(str(kept))
        value = self.scenario.solve(progress)
        value.save(kept)
        return value

    def check_horizon(self, value: ValueFunction, horizon: float) -> None:
        """Refuse runs for longer than a kernel that has not converged says anything about."""
        said = value.dataset.attrs
        if not said["converged"] and horizon > said["horizon_s"] * (1 + 1e-9):
            raise ScenarioError(
                f"the kernel of '{self.name}' is one for {said['horizon_s']:g} s, and the run "
                f"takes {horizon:g} s",
                remedy="raise its march.horizon until it converges, or shorten the run",
            )


def named_kernel(
    name: str,
    system: Mapping[str, Any] | None = None,
    altered: Mapping[str, Mapping[str, Any]] | None = None,
) -> NamedKernel:
    """The kernel of the scenario, or of the value function, of that name or file.

    system: the table of the vehicle that it is wanted for, whose keys take the place of those of
    the scenario; altered: name -> tables, [kernels], which take the place of both.

    Raises `ScenarioError` for a scenario that computes no set or cannot be composed, and for the
    file of a value function that is to be altered.
    """
    changes = dict((altered or {}).get(name, {}))
    if name.endswith(".nc"):
        if changes:
            raise ScenarioError(
                f"kernels.{name}: a value function is what it is",
                remedy="name the scenario that computes it",
            )
        return NamedKernel(name, None)
    file, text, own = read_tables(name)
    if not is_kernel(file, own):
        raise ScenarioError(f"'{name}' computes no kernel", expected="one of " + ", ".join(KINDS))
    data = merged(merged(own, {"system": dict(system or {})}), changes)
    if data != own:
        text += f"\n# with: {json.dumps({n: t for n, t in data.items() if t != own.get(n)})}\n"
    scenario = composed_kernel(file, text, data)
    numbers = [(q.name, q.value) for q in scenario.system.parameters]  # those of a vehicle's file
    decisive = [scenario.kind, {n: data[n] for n in DECISIVE if n in data}, numbers]
    posed = json.dumps(decisive, sort_keys=True, default=str)
    digest = hashlib.sha256(f"{code_digest()}{posed}".encode()).hexdigest()[:24]
    return NamedKernel(name, scenario, digest)


def check_kernels(file: str, data: Mapping[str, Any]) -> None:
    """Refuse [kernels] of a name that no key `kernel` of the file has: it would change nothing."""
    known = set(_named(data))
    for name in _altered(data):
        if name not in known:
            raise ScenarioError(
                f"{file}: kernels.{name}: no [safety] or [compare] names this kernel",
                remedy=suggestion(name, known),
            )


def _named(data: Mapping[str, Any]) -> Iterator[str]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from _named(value)
        elif key == "kernel" and isinstance(value, str):
            yield value


def _altered(data: Mapping[str, Any]) -> Iterator[str]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from (value if key == "kernels" else _altered(value))


def _loaded(path: str) -> ValueFunction:
    found = load(path)
    if not isinstance(found, ValueFunction):
        raise ScenarioError(f"{path} holds trajectories", expected="a value function")
    return found
