"""Certificates of the laws of closed loops: what `holdfast certify --box` and `--from` prove.

Whether a certificate is of a scenario is what `holdfast-check --expect` asks.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.analysis.certificates.certificate import Certificate, Range, written
from holdfast.analysis.certificates.certified_law import cell_table, check_fits
from holdfast.analysis.certificates.certify import CELLS
from holdfast.analysis.certificates.flowpipe import Flowpipe, flowpipe, read_statement, statement
from holdfast.analysis.certificates.law_cells import law_of_cases
from holdfast.analysis.certificates.law_keeps import LawJudgement, judge_law
from holdfast.analysis.certificates.problem import INPUTS, ROUNDED, parameters_of, parts_of
from holdfast.analysis.certificates.reading import unchecked
from holdfast.errors import OutputError, ScenarioError, SimulationError
from holdfast.host.files import make_folder, write_summary
from holdfast.maths.definitions.law import CellLookup
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.expressions.traversal import plain_text
from holdfast.scenario.certificate import check_goal, check_region
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario
from holdfast.scenario.schema.values import at


def judged_law(
    scenario: str,
    overrides: Iterable[str] = (),
    *,
    box: Mapping[str, Range],
    cells: int | Mapping[str, int] | None = None,
    sample_time: float | None = None,
    horizon: float | None = None,
    inputs: int | Mapping[str, int] = INPUTS,
    uncertain: Mapping[str, Range] | None = None,
    errors: Mapping[str, float] | None = None,
    delay: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> LawJudgement:
    """`hf.judge_law` for the law of a closed loop, with its safeguard and [safety], in its region.

    cells: 101 along each state by default. sample_time, delay: those of the run by default.
    Disturbances are any within the bounds of the system; one without bounds is what [disturbance]
    says, if that is a number. Raises `ScenarioError` for a scenario of another kind, or without a
    region.
    """
    loaded = _closed_loop(scenario, overrides)
    assert loaded.region is not None
    run: Mapping[str, Any] = loaded.settings
    if run.get("continuous"):
        raise ScenarioError(
            f"the inputs of '{scenario}' follow the state at every instant",
            expected="run.continuous = false",
        )
    disturbance = without_bounds(loaded)
    with at(loaded.file, "law"):
        return judge_law(
            loaded.system,
            loaded.region,
            loaded.kept().law,
            box=box,
            cells=CELLS if cells is None else cells,
            sample_time=float(run["sample_time"]) if sample_time is None else sample_time,
            horizon=horizon,
            inputs=inputs,
            uncertain=uncertain,
            disturbance=disturbance,
            errors=errors,
            delay=float(run.get("delay", 0.0)) if delay is None else delay,
            progress=progress,
        )


def flowpipe_of(
    scenario: str,
    overrides: Iterable[str] = (),
    *,
    start: Mapping[str, Range],
    to_goal: bool = False,
    horizon: float | None = None,
    sample_time: float | None = None,
    uncertain: Mapping[str, Range] | None = None,
    errors: Mapping[str, float] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Flowpipe:
    """`hf.flowpipe` for a closed loop, its law and its region, from one box of states.

    to_goal: whether all have to be in the scenario's goal at the end. horizon, sample_time: those
    of the run by default; inputs follow the state at every instant where they do so there.
    Measurements are as wrong as the run's noise, or as `errors` say. Raises `ScenarioError` for a
    scenario of another kind, without a region or goal, with a delay or noise without bounds.
    """
    loaded = _closed_loop(scenario, overrides)
    asked = question(loaded, to_goal, horizon, sample_time, errors)
    with at(loaded.file, "law"):
        return flowpipe(**asked, start=start, uncertain=uncertain, progress=progress)


def question(
    loaded: Scenario,
    to_goal: bool,
    horizon: float | None = None,
    sample_time: float | None = None,
    errors: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """What a closed loop asks of `hf.flowpipe`, but for the box. Raises as `flowpipe_of` does."""
    run: Mapping[str, Any] = loaded.settings
    if run.get("delay") or run.get("noise_normal"):
        raise ScenarioError(
            f"'{loaded.file}' has a delay, or noise without bounds",
            expected="run.delay = 0 and no run.noise_normal",
        )
    if to_goal and loaded.goal is None:
        raise ScenarioError(f"'{loaded.file}' has no goal", remedy="add a [goal]")
    if sample_time is None and not run.get("continuous"):
        sample_time = float(run["sample_time"])
    with at(loaded.file, "law"):
        law = loaded.kept().law
        disturbance = without_bounds(loaded)
    return {
        "system": loaded.system,
        "region": loaded.region,
        "horizon": float(run["horizon"]) if horizon is None else horizon,
        "law": law,
        "sample_time": sample_time,
        "target": loaded.goal if to_goal else None,
        "disturbance": disturbance,
        "errors": {**dict(run.get("noise_uniform") or {}), **dict(errors or {})},
    }


FLOWPIPE_FILES = ("flowpipe.holdfast", "flowpipe.json", "flowpipe.png", "flowpipe.svg")


def write_flowpipe(pipe: Flowpipe, folder: Path, *, figures: bool) -> list[Path]:
    """The file that is checked, what it says in JSON, and the figure, if it is proved."""
    for name in FLOWPIPE_FILES:  # of an earlier question
        (folder / name).unlink(missing_ok=True)
    if not pipe.proved:
        return []
    make_folder(folder)
    files = [
        pipe.write(folder / "flowpipe.holdfast"),
        write_summary(folder / "flowpipe.json", pipe.summary()),
    ]
    if figures and len(pipe.states) > 1:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.certificate import flowpipe_figure

        files += style.write(flowpipe_figure(pipe), folder, "flowpipe")
    return files


def _closed_loop(scenario: str, overrides: Iterable[str]) -> Scenario:
    """Raises `ScenarioError` for a scenario of another kind, or without a region."""
    loaded = load_scenario(scenario, overrides)
    if not isinstance(loaded, Scenario):
        raise ScenarioError(
            f"'{scenario}' has no law to certify",
            expected="a scenario of the kind closed-loop with --box or --from, or a kernel without",
        )
    if loaded.region is None:
        raise ScenarioError(f"'{scenario}' has no region", remedy="add a [region]")
    return loaded


def without_bounds(loaded: Scenario) -> dict[str, float]:
    """The disturbances of a closed loop that are known numbers, as they have no bounds.

    Raises `SimulationError` for one that varies.
    """
    numbers: dict[str, float] = {}
    if loaded.system.disturbance_bounds is None:
        for name in loaded.system.disturbance_names:
            number = loaded.disturbance.get(name, 0)
            if not (isinstance(number, int | float) or number.is_number):
                raise SimulationError(
                    f"the disturbance '{name}' varies and has no bounds",
                    remedy="give it bounds in [system]",
                )
            numbers[name] = float(number)
    return numbers


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
