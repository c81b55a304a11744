"""Whether a certificate is of a scenario: `holdfast-check --expect` asks it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.certified_law import check_fits
from holdfast.analysis.certificates.law_of_cases import law_of_cases
from holdfast.analysis.certificates.law_written import written
from holdfast.analysis.certificates.reading import read_certificate
from holdfast.errors import ScenarioError
from holdfast.maths.definitions.lookup import CellLookup
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
    its ranges, the constraints of the region and of the goal proved; of a closed loop the sample
    time, a delay that is no longer, and the law. What it proves of its cells `holdfast-check` says.

    Raises `ScenarioError` or `DefinitionError` that name the first thing that is another, and what
    reading the two files raises.
    """
    proved, asked = read_certificate(certificate), load_scenario(scenario)
    if not isinstance(asked, KernelScenario | Scenario):
        raise ScenarioError(
            f"'{scenario}' is no scenario that is certified", expected="a kernel or a closed loop"
        )
    if asked.region is None:
        raise ScenarioError(f"'{scenario}' has no region", remedy="add a [region]")
    if isinstance(asked, KernelScenario):
        known = dict(asked.options.get("disturbance") or {})
        goal = asked.goal if asked.kind == "capture-basin" else None
    else:
        known, goal = without_bounds(asked), asked.goal if proved.target else None
        _check_run(proved, asked.settings)
        _check_law(proved, asked)
    check_fits(proved, asked.system, known)
    check_region(proved, asked.region)
    if goal is not None:
        if not proved.target:
            raise ScenarioError(
                "the certificate has no target", expected=f"the goal of '{scenario}'"
            )
        check_goal(proved, goal)


def _check_run(proved: Certificate, run: Mapping[str, Any]) -> None:
    sample_time, delay = run.get("sample_time"), float(run.get("delay", 0.0))
    if run.get("continuous") or (sample_time is not None and float(sample_time) != proved.hold):
        raise ScenarioError(
            f"inputs are held for {proved.hold:g} s in the certificate",
            expected="continuous ones" if run.get("continuous") else f"{float(sample_time):g} s",  # type: ignore[arg-type]
        )
    if delay > proved.sampling.delay:
        raise ScenarioError(
            f"inputs are {proved.sampling.delay:g} s late in the certificate",
            expected=f"{delay:g} s at least",
        )


def _check_law(proved: Certificate, asked: Scenario) -> None:
    law, given = asked.kept().law, proved.sampling.law
    lookup = None if isinstance(law, Switching) else law.lookup
    if given is None and isinstance(lookup, CellLookup):
        return  # the law of a certificate, whose inputs were tried
    if given is None:
        raise ScenarioError(
            "the certificate is of inputs that were tried", expected=f"the law '{law.name}'"
        )
    own = law_of_cases(asked.system, law, proved.ranges, proved.hold, given.parts)
    if written(own, (), plain_text) != written(given, (), plain_text):
        raise ScenarioError("the law of the certificate is another", expected=f"'{law.name}'")
