"""`holdfast run`: one scenario, whatever its kind."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.commands.options import NOT_ANSWERED, simulation_options
from holdfast.studies.progress import bar
from holdfast.studies.write_results import check_writable, kernel_report, written

if TYPE_CHECKING:
    from holdfast.analysis.simulation.result import Result
    from holdfast.scenario.kernel import KernelScenario
    from holdfast.scenario.load import Scenario


@click.command("run")
@click.argument("scenario")
@simulation_options
def command(
    scenario: str,
    out: Path | None,
    overrides: tuple[str, ...],
    runs: int | None,
    seed: int | None,
    no_figures: bool,
) -> None:
    """Run SCENARIO, the name of a shipped scenario or a TOML file.

    A scenario of closed loops is simulated; one whose kind is a kernel, a reachable set or a basin
    is marched, and what it promises is tried in closed loop.
    """
    from holdfast.scenario.kernel import KernelScenario
    from holdfast.scenario.load import load_scenario

    loaded = load_scenario(scenario, overrides, runs, seed)
    folder = out if out is not None else Path("runs") / loaded.name
    check_writable(folder)
    if isinstance(loaded, KernelScenario):
        _run_kernel(loaded, folder, figures=not no_figures)
        return
    result = _simulated(loaded)
    files = written(loaded, result, folder, figures=not no_figures)
    from holdfast.presentation.text.runs import summary_text

    click.echo(summary_text(result, files))
    outcomes = (result.outcomes[n] for n in ("diverged", "chattered", "left grid"))
    diverged, chattered, astray = outcomes
    if diverged:
        click.echo(f"holdfast: {_runs(diverged)} diverged, with results up to there", err=True)
    if chattered:
        limit = loaded.settings["switch_limit"]
        click.echo(
            f"holdfast: {_runs(chattered)} chattered: more than {limit} changes of mode within a "
            "second; what happens then depends on the sample time",
            err=True,
        )
    if astray:
        click.echo(
            f"holdfast: {_runs(astray)} left the grid of the value function of the law, which says "
            "nothing there",
            err=True,
        )
    if diverged or chattered or astray:
        sys.exit(NOT_ANSWERED)


def _run_kernel(scenario: KernelScenario, folder: Path, *, figures: bool) -> None:
    with bar(f"{scenario.name}, preparing") as tell:
        result = scenario.run(lambda fraction: tell(scenario.name, fraction))
    click.echo(kernel_report(scenario, result, folder, figures=figures))
    if result.trouble:
        click.echo(f"holdfast: {result.trouble}", err=True)
        sys.exit(NOT_ANSWERED)
    if result.promise is not None and result.promise.verdict:
        click.echo(f"holdfast: {result.promise.verdict}", err=True)
    if not result.answers(scenario):
        click.echo(
            f"holdfast: not converged within {scenario.horizon:g} s, and the set that lasts was "
            "asked for; raise march.horizon",
            err=True,
        )
        sys.exit(NOT_ANSWERED)
    if result.promise is not None and result.promise.verdict:
        sys.exit(NOT_ANSWERED)


def _runs(count: int) -> str:
    return f"{count} run" + ("s" if count != 1 else "")


def _simulated(scenario: Scenario) -> Result:
    with bar(f"{scenario.name}, preparing") as tell:
        return scenario.run(lambda fraction: tell(scenario.name, fraction))
