"""Certificates of the laws of closed loops: what `holdfast certify --box` and `--from` prove."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from holdfast.analysis.certificates.certificate import Range
from holdfast.analysis.certificates.certify import CELLS
from holdfast.analysis.certificates.flowpipe import Flowpipe, flowpipe
from holdfast.analysis.certificates.law_keeps import LawJudgement, judge_law
from holdfast.analysis.certificates.problem import INPUTS
from holdfast.errors import ScenarioError, SimulationError
from holdfast.host.files import make_folder, write_summary
from holdfast.scenario.kinds.closed_loop import Scenario
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
