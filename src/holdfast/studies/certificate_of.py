"""Whether a certificate is of a scenario: `holdfast-check --expect` asks it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.analysis.certificates.certificate import Certificate, Range, written
from holdfast.analysis.certificates.certified_law import cell_table, check_fits
from holdfast.analysis.certificates.flowpipe import read_statement, statement
from holdfast.analysis.certificates.law_cells import law_of_cases
from holdfast.analysis.certificates.problem import ROUNDED, parameters_of, parts_of
from holdfast.analysis.certificates.reading import unchecked
from holdfast.errors import OutputError, ScenarioError
from holdfast.maths.definitions.law import CellLookup
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.expressions.traversal import plain_text
from holdfast.scenario.certificate import check_goal, check_region
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario
from holdfast.studies.law_certification import question, without_bounds


def check_of_scenario(certificate: str | Path, scenario: str) -> None:
    """Raise unless what a certificate says is of a scenario.

    Its states, inputs and rates have to be those of the scenario, numbers and disturbances within
    its ranges, the constraints of the region and of the goal proved, for as long as the scenario
    lasts where it stays; of a closed loop the sample time, a delay and noise that are no larger,
    and the law. A flowpipe is of a closed loop, and at least as long; with a target, as long. What
    it proves of its cells, or of its box, `holdfast-check` says.

    Raises `ScenarioError` or `DefinitionError` that name the first thing that is another, and what
    reading the two files raises.
    """
    file, asked = Path(certificate), load_scenario(scenario)
    if (proved_of_box := read_statement(file)) is not None:
        try:
            return _check_flowpipe(proved_of_box, asked, scenario)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise OutputError(f"{file} is damaged: {error}") from None
    proved, _ = unchecked(file)
    if not isinstance(asked, KernelScenario | Scenario):
        raise ScenarioError(
            f"'{scenario}' is no scenario that is certified", expected="a kernel or a closed loop"
        )
    if asked.region is None:
        raise ScenarioError(f"'{scenario}' has no region", remedy="add a [region]")
    if isinstance(asked, KernelScenario):
        disturbance = dict(asked.options.get("disturbance") or {})
        goal = asked.goal if asked.kind == "capture-basin" else None
        lasts = math.inf if asked.forever else asked.horizon
        _check_goal(proved, goal, must=goal is not None)
    else:
        disturbance, goal, lasts = (
            without_bounds(asked),
            asked.goal,
            float(asked.settings["horizon"]),
        )
        _check_run(proved, asked.settings)
        _check_law(proved, asked)
        _check_goal(proved, goal, must=False)
    check_fits(proved, asked.system, disturbance)
    check_region(proved, asked.region)
    holds = proved.kept.holds
    if not proved.target and holds is not None and holds * proved.hold < lasts - ROUNDED:
        raise ScenarioError(
            f"the certificate is for {holds * proved.hold:g} s",
            expected="for ever" if lasts == math.inf else f"{lasts:g} s at least",
        )


def _check_flowpipe(proved: Mapping[str, Any], asked: Any, scenario: str) -> None:
    """Raise unless a flowpipe is of a closed loop, whatever box it is from."""
    if not isinstance(asked, Scenario) or asked.region is None:
        raise ScenarioError(
            f"'{scenario}' has no law, or no region", expected="the closed loop of the flowpipe"
        )
    posed = question(asked, bool(proved["target"]))
    numbers = _numbers_of(asked)
    parameters, disturbances = (
        {(q["name"], q["unit"]): _ends(q) for q in proved[key]}
        for key in ("parameters", "disturbances")
    )
    uncertain = {name: ends for (name, _), ends in parameters.items() if name in numbers}
    start = dict.fromkeys(asked.system.state_names, (0.0, 0.0))
    wanted = statement(**posed, start=start, uncertain=uncertain)
    for key in ("states", "inputs", "rates", "constraints", "target", "law"):
        if proved[key] != wanted[key]:
            raise ScenarioError(
                f"the flowpipe has another {key.removesuffix('s')}: {_briefly(proved[key])}",
                expected=_briefly(wanted[key]),
            )
    for q in wanted["disturbances"]:
        _check_within(q, _ends(q), disturbances)
    for q in wanted["parameters"]:
        _check_within(q, numbers[q["name"]], disturbances | parameters)
    errors = dict(zip(asked.system.state_names, map(float.fromhex, proved["errors"]), strict=True))
    for name, size in posed["errors"].items():
        if size > errors[name]:
            raise ScenarioError(
                f"'{name}' is measured within {errors[name]:g} in the flowpipe",
                expected=f"{size:g} at least",
            )
    (hold, holds), (its_hold, its_holds) = (
        (float.fromhex(h["hold"]), h["holds"]) for h in (proved, wanted)
    )
    if wanted["inputs"] and hold != its_hold:
        raise ScenarioError(
            f"inputs are held for {hold:g} s in the flowpipe", expected=f"{its_hold:g} s"
        )
    same = (hold, holds) == (its_hold, its_holds)
    longer = holds >= its_holds if hold == its_hold else hold * holds >= its_hold * its_holds
    if not (same or (longer and not proved["target"])):
        raise ScenarioError(
            f"the flowpipe is for {hold * holds:g} s",
            expected=f"{its_hold * its_holds:g} s" + ("" if proved["target"] else " at least"),
        )


def _numbers_of(asked: Scenario) -> dict[str, Range]:
    """Between what each parameter is, in the law and in the vehicle."""
    if asked.varied.names or asked.varied.plant:
        raise ScenarioError(
            "the numbers of the scenario vary from run to run", expected="no [varied]"
        )
    every = parameters_of(asked.system, [r for r in (asked.region, asked.goal) if r is not None])
    return {
        name: (min(p.value, real), max(p.value, real))
        for name, p in every.items()
        for real in (float(asked.plant.get(name, p.value)),)
    }


def _ends(q: Mapping[str, Any]) -> Range:
    low, high = map(float.fromhex, q["range"])
    return low, high


def _check_within(
    q: Mapping[str, Any], ends: Range, proved: Mapping[tuple[str, str], Range]
) -> None:
    """Raise unless a quantity of a scenario is within what is proved."""
    low, high = ends
    if (q["name"], q["unit"]) not in proved:
        raise ScenarioError(
            f"the flowpipe has no '{q['name']}' in '{q['unit']}'", expected=f"{low:g} to {high:g}"
        )
    least, most = proved[q["name"], q["unit"]]
    if not (least <= low and high <= most):
        raise ScenarioError(
            f"'{q['name']}' is from {least:g} to {most:g} in the flowpipe",
            expected=f"{low:g} to {high:g}",
        )


def _briefly(said: Any) -> str:
    text = json.dumps(said)
    return text if len(text) <= 200 else text[:200] + " ..."


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
    cases = law_of_cases(asked.system, law, {**proved.ranges, **ranges}, proved.hold, parts)
    if written(cases, (), plain_text) != written(said, (), plain_text):
        raise ScenarioError("the law of the certificate is another", expected=f"'{law.name}'")


def _is_of(lookup: CellLookup, proved: Certificate) -> bool:
    """Whether the cells and inputs of a law are those of a certificate."""
    table: Any = lookup.table
    return lookup.hold == proved.hold and all(map(np.array_equal, table, cell_table(proved)))
