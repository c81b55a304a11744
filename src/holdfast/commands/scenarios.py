"""The commands that compute one scenario: `run`, `compare`, `margin`."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from holdfast.errors import ScenarioError
from holdfast.studies.progress import bar
from holdfast.studies.write_results import check_writable, kernel_report, written

if TYPE_CHECKING:
    from holdfast.analysis.simulation.result import Result
    from holdfast.scenario.kernel import KernelScenario
    from holdfast.scenario.load import Scenario

ANSWERED, NOT_ANSWERED = 0, 1


class WholeNumber(click.ParamType):  # type: ignore[type-arg]
    """A whole number that is written in digits."""

    name = "integer"

    def convert(
        self, value: Any, parameter: click.Parameter | None, context: click.Context | None
    ) -> int:
        text = str(value).strip()
        shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
        if not re.fullmatch(r"[+-]?[0-9]+", text):
            self.fail(f"'{shown}' is no whole number in digits, such as 200", parameter, context)
        if len(text) > LONGEST or abs(int(text)) >= 2**64:
            self.fail(f"{shown} is too large, expected less than 2^64", parameter, context)
        return int(text)


WHOLE = WholeNumber()
LONGEST = 40

set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a value, such as law.k1=0.2 (repeatable).",
)


def file_options(command: Callable[..., None]) -> Callable[..., None]:
    """What every command that reads a scenario and writes files takes."""
    for option in (
        click.option("--no-figures", is_flag=True, help="Write the data only."),
        set_option,
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            help="Folder for the results [default: runs/SCENARIO].",
        ),
    ):
        command = option(command)
    return command


def simulation_options(command: Callable[..., None]) -> Callable[..., None]:
    """What every command that simulates takes."""
    for option in (
        click.option("--seed", type=WHOLE, help="Seed of every random number."),
        click.option(
            "--runs", type=WHOLE, help="How many starts: the given states, then random ones."
        ),
        file_options,
    ):
        command = option(command)
    return command


@click.command("run")
@click.argument("scenario")
@simulation_options
def run_command(
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


@click.command("compare")
@click.argument("scenario")
@click.option("--laws", help="Laws to compare, such as inspection,convergent [default: all].")
@click.option("--cases", help="Cases to compare them in [default: all of the scenario].")
@simulation_options
def compare_command(
    scenario: str,
    laws: str | None,
    cases: str | None,
    out: Path | None,
    overrides: tuple[str, ...],
    runs: int | None,
    seed: int | None,
    no_figures: bool,
) -> None:
    """Compare the laws of SCENARIO: how many starts each of them rescues, in every case.

    A law is a name in its table [compare.laws], its own name, or another scenario, whose law is
    taken. All of them run from the same starts.
    """
    from holdfast.presentation.studies.comparison import comparison_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.comparison.compare import compare
    from holdfast.studies.write_results import write_comparison

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    with bar("preparing") as tell:
        found = compare(
            scenario,
            _listed(laws),
            _listed(cases),
            overrides=overrides,
            runs=runs,
            seed=seed,
            progress=tell,
        )
    files = write_comparison(found, folder, figures=not no_figures)
    click.echo(comparison_text(found))
    click.echo(f"  files in {folder}: " + ", ".join(f.name for f in files))


@click.command("margin")
@click.argument("scenario")
@click.option(
    "--of",
    default="current.speed",
    show_default=True,
    metavar="KEY",
    help="Which number: a key such as system.current_limit, or the speed of the current.",
)
@click.option(
    "--between",
    type=(float, float),
    metavar="LOW HIGH",
    help="Where the limit is looked for [default: 0 and twice the scenario's own, and further].",
)
@click.option(
    "--tolerance", type=float, help="How close it is enclosed [default: a hundredth of HIGH]."
)
@click.option(
    "--keep",
    multiple=True,
    metavar="STATE",
    help="A state that the kernel has to contain, such as x=-0.8,psi=0 (repeatable).",
)
@file_options
def margin_command(
    scenario: str,
    of: str,
    between: tuple[float, float] | None,
    tolerance: float | None,
    keep: tuple[str, ...],
    out: Path | None,
    overrides: tuple[str, ...],
    no_figures: bool,
) -> None:
    """Find how large a disturbance the kernel of SCENARIO stands: until when it is not empty.

    With --keep: until when it contains these states. A kernel is one for the horizon of the
    scenario, or with march.forever = true the set that lasts.
    """
    from holdfast.presentation.studies.margin import margin_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.disturbance_margin import disturbance_margin
    from holdfast.studies.write_results import write_margin

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    with bar("preparing") as tell:
        found = disturbance_margin(
            scenario,
            of,
            between=between,
            tolerance=tolerance,
            keep=[_state(text) for text in keep],
            overrides=overrides,
            progress=tell,
        )
    files = write_margin(found, folder, figures=not no_figures)
    click.echo(margin_text(found, files))
    if not found.answered:
        remedy = "raise march.horizon" if found.undecided else "look elsewhere with --between"
        click.echo(f"holdfast: the limit of {found.key} was not found; {remedy}", err=True)
        sys.exit(NOT_ANSWERED)


def _state(text: str) -> dict[str, Any]:
    """x=-0.8,psi=10 deg as a table; numbers are numbers, the rest is left as text."""
    found: dict[str, Any] = {}
    for part in text.split(","):
        name, separator, value = (p.strip() for p in part.partition("="))
        if not (name and separator and value) or name in found:
            raise ScenarioError(f"--keep {text}", expected="a state, such as x=-0.8,psi=10 deg")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = value
    return found


def _listed(text: str | None) -> list[str] | None:
    return None if text is None else [part.strip() for part in text.split(",")]


def _simulated(scenario: Scenario) -> Result:
    with bar(f"{scenario.name}, preparing") as tell:
        return scenario.run(lambda fraction: tell(scenario.name, fraction))
