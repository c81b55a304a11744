"""Where results are written: folders checked before the work, files that appear whole."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.errors import OutputError

if TYPE_CHECKING:
    from holdfast.analysis.reachability.bisection import Margin
    from holdfast.analysis.reachability.value_function import ValueFunction
    from holdfast.analysis.simulation.law_comparison import Comparison
    from holdfast.analysis.simulation.result import Result
    from holdfast.analysis.simulation.sweep_table import Campaign
    from holdfast.scenario.kernel import KernelResult, KernelScenario
    from holdfast.scenario.load import Scenario


def check_writable(folder: Path, option: str = "--out") -> None:
    """Find out before the work whether the folder can be made and written."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        raise OutputError(
            f"the folder {folder} cannot be written ({place} is no folder, or not yours)",
            remedy=f"choose another with {option}",
        )


def make_folder(folder: Path, option: str = "--out") -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"the folder {folder} cannot be made ({error.strerror})",
            remedy=f"choose another with {option}",
        ) from None


def _saved(result: Result | ValueFunction | Campaign, path: Path) -> Path:
    """The file; where it cannot be written the result is not lost, but beside other such."""
    try:
        return result.save(path)
    except OutputError as error:
        spare = Path(tempfile.mkdtemp(prefix="holdfast-")) / path.name
        try:
            result.save(spare)
        except OutputError:
            raise error from None
        raise OutputError(error.cause, remedy=f"what was computed is in {spare}") from None


def written(scenario: Scenario, result: Result, folder: Path, *, figures: bool) -> list[Path]:
    make_folder(folder)
    files = [_saved(result, folder / "result.nc")]
    if figures:
        drawn = _figures if scenario.course is None else _formation_figures
        files += drawn(scenario, result, folder)
    return [*files, _summary(folder / "summary.json", result.summary())]


def _figures(scenario: Scenario, result: Result, folder: Path) -> list[Path]:
    from holdfast.presentation.figures import style
    from holdfast.presentation.figures.histories import histories_figure
    from holdfast.presentation.figures.paths import paths_figure
    from holdfast.scenario.schema.closed_loop import FiguresSpec

    chosen = scenario.figures
    assert isinstance(chosen, FiguresSpec)
    run = min(chosen.history, result.dataset.sizes["run"] - 1)
    files = []
    if scenario.plane is not None:
        plane = paths_figure(result, scenario.plane, chosen.highlight, chosen.cones, run)
        files += style.write(plane, folder, "paths")
    return files + style.write(histories_figure(result, run), folder, "histories")


def _formation_figures(scenario: Scenario, result: Result, folder: Path) -> list[Path]:
    """The map, the constraints, and the animation where it is asked for."""
    from holdfast.presentation.figures import style
    from holdfast.presentation.figures.formation import (
        Ground,
        constraints_figure,
        formation_figure,
        write_animation,
    )
    from holdfast.scenario.schema.formation import FormationFigures
    from holdfast.studies.progress import bar

    course, chosen = scenario.course, scenario.figures
    assert course is not None
    assert isinstance(chosen, FormationFigures)
    ground = Ground([c.corners for c in course.environment.cells], course.arrows(), course.goal)
    files = style.write(formation_figure(result, ground, chosen.cones), folder, "map")
    files += style.write(constraints_figure(result), folder, "constraints")
    if chosen.animate:
        with bar(f"{scenario.name}, animation") as tell:
            files.append(
                write_animation(
                    result,
                    ground,
                    folder / "animation.gif",
                    chosen.animate,
                    progress=lambda fraction: tell(f"{scenario.name}, animation", fraction),
                )
            )
    return files


def kernel_report(
    scenario: KernelScenario, result: KernelResult, folder: Path, *, figures: bool
) -> str:
    """Write the files of a value function, and tell what it says."""
    from holdfast.analysis.reachability.solve import set_on_grid
    from holdfast.presentation.text.values import value_text

    alike = {k: v for k, v in scenario.options.items() if k in ("band", "precision")}
    begun = set_on_grid(scenario.about, scenario.grid, **alike)  # in as little memory
    files = _written_kernel(scenario, result, begun, folder, figures=figures)
    asked = scenario.promised is not None
    return value_text(result.value, result.promise, begun, files, promised=asked)


def _written_kernel(
    scenario: KernelScenario,
    result: KernelResult,
    begun: ValueFunction,
    folder: Path,
    *,
    figures: bool,
) -> list[Path]:
    """result.nc, summary.json and the figures of a value function."""
    make_folder(folder)
    files = [_saved(result.value, folder / "result.nc")]
    if figures:
        from holdfast.presentation.figures import style
        from holdfast.presentation.figures.value_function import value_function_figure

        about = scenario.about
        around: dict[str, Any] = {
            "others": {about.name.replace("_", " "): begun},
            "scene": about.scene,
            "parameters": {q.name: q.value for q in about.parameters},
        }
        plane = scenario.figures.plane
        drawn = value_function_figure(result.value, plane=plane, at=scenario.held or None, **around)
        files += style.write(drawn, folder, "set")
        if scenario.figures.inputs:
            files += style.write(_law_figure(scenario, result, around), folder, "law")
    files.append(_summary(folder / "summary.json", result.summary()))
    return files


def _law_figure(scenario: KernelScenario, result: KernelResult, around: dict[str, Any]) -> Any:
    """The optimal inputs in the plane of the figures; around: what is drawn beside the set."""
    from holdfast.analysis.safety.safety_filter import optimal_inputs
    from holdfast.presentation.figures.optimal_input import optimal_input_figure

    names = scenario.system.state_names
    plane = scenario.figures.plane or (names[0], names[1])
    held = {n: scenario.held.get(n, 0.0) for n in names if n not in plane}
    inputs, velocity = optimal_inputs(scenario.system, result.value, plane, held)
    chosen = {n: inputs[n] for n in scenario.figures.inputs}
    return optimal_input_figure(result.value, chosen, velocity, plane=plane, at=held, **around)


def write_margin(found: Margin, folder: Path, *, figures: bool) -> list[Path]:
    """margin.json and the figure."""
    make_folder(folder)
    files = [_summary(folder / "margin.json", found.summary())]
    if figures:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.margin import margin_figure

        drawn = margin_figure(
            [t.value for t in found.trials],
            [t.fraction for t in found.trials],
            found.name,
            found.unit,
            answers=[t.answer for t in found.trials],
            keeps=found.keeps,
        )
        files += style.write(drawn, folder, "margin")
    return files


def write_campaign(
    found: Campaign, folder: Path, variable: str | None, *, figures: bool
) -> list[Path]:
    """sweep.nc, sweep.json and the figure of a variable."""
    make_folder(folder)
    files = [_saved(found, folder / "sweep.nc")]
    if figures:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.sweep import campaign_figure

        files += style.write(campaign_figure(found, variable), folder, "sweep")
    return [*files, _summary(folder / "sweep.json", found.summary(variable))]


def write_comparison(found: Comparison, folder: Path, *, figures: bool) -> list[Path]:
    """comparison.json, comparison.txt and the figure."""
    from holdfast.presentation.studies.comparison import comparison_figure, comparison_text

    make_folder(folder)
    files = [
        write_text(folder / "comparison.txt", comparison_text(found) + "\n"),
        _summary(folder / "comparison.json", found.summary()),
    ]
    if figures:
        from holdfast.presentation.figures import style

        files += style.write(comparison_figure(found), folder, "comparison")
    return files


def _summary(path: Path, said: dict[str, Any]) -> Path:
    return write_text(path, json.dumps(said, indent=2) + "\n")


def write_text(path: Path, text: str) -> Path:
    """The file with this text, whole or not at all."""
    from holdfast.host.writing import atomic_file

    with atomic_file(path) as partial:
        partial.write_text(text, "utf-8")
    return path
