"""The file of a scenario that reproduces what a page shows: its tables, and where there is none."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.errors import HoldfastError
from holdfast.execution.simulation.settings import Settings
from holdfast.scenario.files import overridden, read_text, scenario_names
from holdfast.scenario.kernel_reference import DECISIVE
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.kinds.formation import FormationScenario
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import scenario_of

OF_THE_KERNEL = ("system", "region", "goal", "law", "tracking", "disturbance")
"""Tables of a kernel that its closed loops need too."""

OPTIMAL = {"alone": True, "ahead": False}
"""[safety] of the optimal inputs, as a page has them."""

COURSE = (
    "The course of a formation is planned from its start, for the vehicles of its file. No file "
    "has the same course and another start, or other vehicles. Reset them to copy the scenario."
)


@dataclass(frozen=True)
class Copy:
    """tables: of a file, with paths as the scenario's own file has them; None with the reason.

    fixed: why the start and the true vehicle have to be those of the file; empty if they need not.
    """

    tables: Mapping[str, Any] | None
    reason: str = ""
    fixed: str = ""


def copied_loop(loaded: Scenario, scenario: str, changes: Sequence[str]) -> Copy:
    """The tables of the file that one run needs."""
    _, tables = _written(scenario, changes)
    kept = {name: table for name, table in tables.items() if name not in ("compare", "kernels")}
    named = str(tables.get("safety", ""))
    kernels = {n: k for n, k in tables.get("kernels", {}).items() if n in named}
    kept |= {"kernels": kernels} if kernels else {}
    return Copy(kept, fixed=COURSE if isinstance(loaded, FormationScenario) else "")


def copied_kernel(
    loaded: KernelScenario, scenario: str, changes: Sequence[str], settings: Settings
) -> Copy:
    """Closed loops with the kernel in [safety]: its optimal inputs, or a filter around its law."""
    before, tables = _written(scenario, changes)
    name = scenario if scenario in scenario_names() else Path(scenario).name
    inputs = dict.fromkeys(loaded.system.input_names, 0)
    kept: dict[str, Any] = {
        "scenario": {"title": loaded.title, "kind": "closed-loop", "source": loaded.source},
        "law": {"outputs": inputs},
        **{n: tables[n] for n in OF_THE_KERNEL if n in tables},
        "safety": {"kernel": name, **({} if loaded.law is not None else OPTIMAL)},
        "run": {
            **{n: getattr(settings, n) for n in ("horizon", "sample_time", "record_every")},
            "until_goal": settings.until_goal,
        },
    }
    others = {n: tables[n] for n in DECISIVE if tables.get(n) != before.get(n) and n in tables}
    if others:
        kept["kernels"] = {name: others}
    return Copy(kept) if (said := _refused(kept, scenario, name)) is None else Copy(None, said)


def _refused(tables: Mapping[str, Any], scenario: str, name: str) -> str | None:
    """Why no file can have these tables."""
    starts = {"states": [{}], "start_outside": True}
    here = {**tables, "starts": starts, "safety": {**tables["safety"], "kernel": scenario}}
    if name in (kernels := tables.get("kernels", {})):
        here["kernels"] = {scenario: kernels[name]}
    try:
        scenario_of(scenario, "", here)
    except HoldfastError as error:
        return f"No file of closed loops has this law: {error.cause}."
    return None


def _written(scenario: str, changes: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The tables of the file, and those with the overrides."""
    _, text = read_text(scenario)
    before = tomllib.loads(text)
    return before, overridden(text, before, changes)[1]
