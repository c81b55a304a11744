"""Whether a certificate is of a scenario: `holdfast-check --expect` asks it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.certified_law import cell_table, check_fits
from holdfast.analysis.certificates.law_of_cases import law_of_cases
from holdfast.analysis.certificates.law_written import written
from holdfast.analysis.certificates.problem import ROUNDED, parameters_of, parts_of
from holdfast.analysis.certificates.reading import unchecked
from holdfast.errors import ScenarioError
from holdfast.maths.definitions.lookup import CellLookup
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.expressions.plain_text import plain_text
from holdfast.scenario.certificate import check_goal, check_region
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario
from holdfast.studies.law_certification import without_bounds


def check_of_scenario(certificate: str | Path, scenario: str) -> None:
    """Raise unless what a certificate says is of a scenario.

    Its states, inputs and rates have to be those of the scenario, numbers and disturbances within
    its ranges, the constraints of the region and of the goal proved, for as long as the scenario
    lasts where it stays; of a closed loop the sample time, a delay and noise that are no larger,
    and the law. What it proves of its cells `holdfast-check` says.

    Raises `ScenarioError` or `DefinitionError` that name the first thing that is another, and what
    reading the two files raises.
    """
    (proved, _), asked = unchecked(Path(certificate)), load_scenario(scenario)
    if not isinstance(asked, KernelScenario | Scenario):
        raise ScenarioError(
            f"'{scenario}' is no scenario that is certified", expected="a kernel or a closed loop"
        )
    if asked.region is None:
        raise ScenarioError(f"'{scenario}' has no region", remedy="add a [region]")
    if isinstance(asked, KernelScenario):
        known = dict(asked.options.get("disturbance") or {})
        goal = asked.goal if asked.kind == "capture-basin" else None
        lasts = math.inf if asked.forever else asked.horizon
        _check_goal(proved, goal, must=goal is not None)
    else:
        known, goal, lasts = without_bounds(asked), asked.goal, float(asked.settings["horizon"])
        _check_run(proved, asked.settings)
        _check_law(proved, asked)
        _check_goal(proved, goal, must=False)
    check_fits(proved, asked.system, known)
    check_region(proved, asked.region)
    holds = proved.kept.holds
    if not proved.target and holds is not None and holds * proved.hold < lasts - ROUNDED:
        raise ScenarioError(
            f"the certificate is for {holds * proved.hold:g} s",
            expected="for ever" if lasts == math.inf else f"{lasts:g} s at least",
        )


def _check_goal(proved: Certificate, goal: Region | None, *, must: bool) -> None:
    """must: whether the certificate has to lead there."""
    if proved.target and goal is None:
        raise ScenarioError(
            "the certificate leads to a target", expected="one that stays in the region"
        )
    if must and not proved.target:
        raise ScenarioError("the certificate has no target", expected="the goal of the scenario")
    if goal is not None and proved.target:
        check_goal(proved, goal)


def _check_run(proved: Certificate, run: Mapping[str, Any]) -> None:
    sampling, sample_time = proved.sampling, float(run["sample_time"])
    if run.get("continuous") or sample_time != proved.hold:
        raise ScenarioError(
            f"inputs are held for {proved.hold:g} s in the certificate",
            expected="continuous ones" if run.get("continuous") else f"{sample_time:g} s",
        )
    if float(run["delay"]) > sampling.delay:
        raise ScenarioError(
            f"inputs are {sampling.delay:g} s late in the certificate",
            expected=f"{float(run['delay']):g} s at least",
        )
    errors = dict(zip((n for n, _ in proved.states), sampling.errors, strict=False))
    for name, size in run.get("noise_uniform", {}).items():
        if float(size) > errors.get(name, 0.0):
            raise ScenarioError(
                f"'{name}' is measured within {errors.get(name, 0.0):g} in the certificate",
                expected=f"{float(size):g} at least",
            )
    if any(run.get("noise_normal", {}).values()):
        raise ScenarioError("noise without a bound", expected="a uniform one")


def _check_law(proved: Certificate, asked: Scenario) -> None:
    law, said = asked.kept().law, proved.sampling.law
    if said is None:
        lookup = None if isinstance(law, Switching) else law.lookup
        if isinstance(lookup, CellLookup) and _is_of(lookup, proved):
            return
        raise ScenarioError(
            "the certificate is of inputs that were tried", expected=f"the law '{law.name}'"
        )
    numbers = parameters_of(asked.system, ())
    ranges = {n: proved.ranges.get(n, (p.value, p.value)) for n, p in numbers.items()}
    counts = {q.name: len(e) - 1 for q, e in zip(asked.system.inputs, said.parts, strict=False)}
    parts = parts_of(asked.system, counts, ranges)
    own = law_of_cases(asked.system, law, {**proved.ranges, **ranges}, proved.hold, parts)
    if written(own, (), plain_text) != written(said, (), plain_text):
        raise ScenarioError("the law of the certificate is another", expected=f"'{law.name}'")


def _is_of(lookup: CellLookup, proved: Certificate) -> bool:
    """Whether the cells and inputs of a law are those of a certificate."""
    table: Any = lookup.table
    return lookup.hold == proved.hold and all(map(np.array_equal, table, cell_table(proved)))
