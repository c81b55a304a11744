"""Certificates of the laws of closed loops: what `holdfast certify --box` proves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from holdfast.analysis.certificates.certificate import Range
from holdfast.analysis.certificates.certify import CELLS
from holdfast.analysis.certificates.law_keeps import LawJudgement, judge_law
from holdfast.analysis.certificates.problem import INPUTS
from holdfast.errors import ScenarioError, SimulationError
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import load_scenario
from holdfast.scenario.validation import at


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
    loaded = load_scenario(scenario, overrides)
    if not isinstance(loaded, Scenario):
        raise ScenarioError(
            f"'{scenario}' has no law to certify",
            expected="a scenario of the kind closed-loop with --box, or a kernel without",
        )
    if loaded.region is None:
        raise ScenarioError(f"'{scenario}' has no region", remedy="add a [region]")
    run: Mapping[str, Any] = loaded.settings
    if run.get("continuous"):
        raise ScenarioError(
            f"the inputs of '{scenario}' follow the state at every instant",
            expected="run.continuous = false",
        )
    known = without_bounds(loaded)
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
            disturbance=known,
            errors=errors,
            delay=float(run.get("delay", 0.0)) if delay is None else delay,
            progress=progress,
        )


def without_bounds(loaded: Scenario) -> dict[str, float]:
    """The disturbances of a closed loop that are known numbers, as they have no bounds.

    Raises `SimulationError` for one that varies.
    """
    known: dict[str, float] = {}
    if loaded.system.disturbance_bounds is None:
        for name in loaded.system.disturbance_names:
            number = loaded.disturbance.get(name, 0)
            if not (isinstance(number, int | float) or number.is_number):
                raise SimulationError(
                    f"the disturbance '{name}' varies and has no bounds",
                    remedy="give it bounds in [system]",
                )
            known[name] = float(number)
    return known
