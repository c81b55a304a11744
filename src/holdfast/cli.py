"""The command line: list, show, explain, run. Heavy imports wait until a command needs them."""

from __future__ import annotations

import json
import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from holdfast._version import __version__
from holdfast.errors import GainWarning, HoldfastError, OutputError, ScenarioError
from holdfast.patience import listen

if TYPE_CHECKING:
    from holdfast.analysis.result import Result
    from holdfast.scenario import Scenario

ANSWERED, NOT_ANSWERED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def _a_number(context: click.Context, parameter: click.Parameter, value: float) -> float:
    if value != value:
        raise click.BadParameter("nan is no number of seconds")
    return value


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="holdfast")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """Viability control of nonholonomic systems.

    Exit status: 0 answered, 1 a run diverged or chattered, 2 bad input, 130 interrupted.
    """


@cli.command("list")
def list_command() -> None:
    """List the systems, laws, regions, vehicles and scenarios, one line each."""
    from holdfast.describe import catalogue_lines

    for line in catalogue_lines():
        click.echo(line)


@cli.command("show")
@click.argument("name")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="An argument of a system or field, such as lam=2 (repeatable).",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Also write the figure of a field, its flow lines, to this folder.",
)
def show_command(name: str, overrides: tuple[str, ...], out: Path | None) -> None:
    """Show what NAME is: equations, parameters with units, source; of a field what is known."""
    from holdfast.describe import describe

    if out is not None:
        from holdfast.maths import fields
        from holdfast.sources import load_field

        if name not in [f.__name__ for f in fields.ALL]:
            raise ScenarioError(f"'{name}' has no figure", expected="a field with --out")
        _check_writable(out)
        field = load_field(name, overrides)
    from holdfast.patience import bounded

    with bounded(f"showing '{name}'", 60.0, "ask for less: fewer dimensions, simpler values"):
        text = describe(name, overrides)
    click.echo(text)
    if out is not None:
        from holdfast.presentation import style
        from holdfast.presentation.flow_lines import flow_lines_figure

        _make(out)
        written = style.write(flow_lines_figure(field), out, name)
        click.echo(f"\n  files in {out}: " + ", ".join(f.name for f in written))


@cli.command("explain")
@click.argument("system")
@click.option(
    "--moment", metavar="P1,P2,...", help="The moment p, where the system leaves a choice."
)
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a value, such as trailers=2 (repeatable).",
)
@click.option(
    "--limit",
    type=click.FloatRange(min=0.1, max=86_400.0),
    callback=_a_number,
    default=60.0,
    show_default=True,
    help="Seconds the derivation may take.",
)
@click.option("--latex", is_flag=True, help="Print a LaTeX document instead of text.")
@click.option(
    "--markdown",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write a Markdown page with formulas to this file.",
)
def explain_command(
    system: str,
    moment: str | None,
    overrides: tuple[str, ...],
    limit: float,
    latex: bool,
    markdown: Path | None,
) -> None:
    """Derive what the constraint of SYSTEM says, up to its steering law where there is one.

    SYSTEM is a system of the catalogue, a scenario, or a TOML file with a table [system]: rates
    with or without Pfaffian rows, or the rows alone.
    """
    from holdfast.derivation import explain
    from holdfast.patience import bounded
    from holdfast.sources import load_system

    if markdown is not None:
        _check_writable(markdown.parent, "--markdown")
    remedy = "allow more with --limit"
    with bounded(f"the derivation for '{system}'", limit, remedy) as progress:
        derived = explain(
            load_system(system, overrides),
            _numbers(moment) if moment is not None else None,
            limit=0.8 * limit,
            progress=progress,
        )
        text = derived.latex() if latex else derived.text()
    if markdown is not None:
        from holdfast.analysis.result import atomic_file

        _make(markdown.parent, "--markdown")
        with atomic_file(markdown) as partial:
            partial.write_text(derived.markdown(), "utf-8")
        click.echo(f"written: {markdown}")
    if latex or markdown is None:
        click.echo(text)


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ScenarioError(f"--moment {text}", expected="numbers, such as 1,0,0") from None


@cli.command("run")
@click.argument("scenario")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for the results [default: runs/SCENARIO].",
)
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a value, such as law.k1=0.2 (repeatable).",
)
@click.option("--runs", type=int, help="How many starts: the given states, then random ones.")
@click.option("--seed", type=int, help="Seed of every random number.")
@click.option("--no-figures", is_flag=True, help="Write the data only.")
def run_command(
    scenario: str,
    out: Path | None,
    overrides: tuple[str, ...],
    runs: int | None,
    seed: int | None,
    no_figures: bool,
) -> None:
    """Run SCENARIO, the name of a shipped scenario or a TOML file."""
    from holdfast.scenario import load_scenario

    loaded = load_scenario(scenario, overrides, runs, seed)
    folder = out if out is not None else Path("runs") / loaded.name
    _check_writable(folder)
    result = _simulated(loaded)
    files = _written(loaded, result, folder, figures=not no_figures)
    from holdfast.presentation.text import summary_text

    click.echo(summary_text(result, files))
    diverged, chattered = (result.outcomes[n] for n in ("diverged", "chattered"))
    if diverged:
        click.echo(f"holdfast: {_runs(diverged)} diverged, with results up to there", err=True)
    if chattered:
        limit = loaded.settings["switch_limit"]
        click.echo(
            f"holdfast: {_runs(chattered)} chattered: more than {limit} changes of mode within a "
            "second; what happens then depends on the sample time",
            err=True,
        )
    if diverged or chattered:
        sys.exit(NOT_ANSWERED)


def _runs(count: int) -> str:
    return f"{count} run" + ("s" if count != 1 else "")


def _check_writable(folder: Path, option: str = "--out") -> None:
    """Find out before the work whether the folder can be made and written."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        raise OutputError(
            f"the folder {folder} cannot be written ({place} is no folder, or not yours)",
            remedy=f"choose another with {option}",
        )


def _make(folder: Path, option: str = "--out") -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"the folder {folder} cannot be made ({error.strerror})",
            remedy=f"choose another with {option}",
        ) from None


def _simulated(scenario: Scenario) -> Result:
    from tqdm import tqdm

    from holdfast.patience import BAR, heed

    with tqdm(
        total=100,
        desc=f"{scenario.name}, preparing",
        unit="%",
        leave=False,
        file=sys.stderr,
        bar_format=BAR,
    ) as bar:

        def progress(fraction: float) -> None:
            heed()
            bar.set_description_str(scenario.name, refresh=False)
            bar.update(100 * fraction - bar.n)

        result = scenario.run(progress)
        heed()
        return result


def _written(scenario: Scenario, result: Result, folder: Path, *, figures: bool) -> list[Path]:
    from holdfast.analysis.result import atomic_file

    _make(folder)
    files = [result.save(folder / "result.nc")]
    if figures:
        from holdfast.presentation import style
        from holdfast.presentation.histories import histories_figure
        from holdfast.presentation.paths import paths_figure

        chosen = scenario.figures
        run = min(chosen.history, result.dataset.sizes["run"] - 1)
        if scenario.plane is not None:
            plane = paths_figure(result, scenario.plane, chosen.highlight, chosen.cones, run)
            files += style.write(plane, folder, "paths")
        files += style.write(histories_figure(result, run), folder, "histories")
    path = folder / "summary.json"
    with atomic_file(path) as partial:
        partial.write_text(json.dumps(result.summary(), indent=2) + "\n", "utf-8")
    return [*files, path]


def main() -> NoReturn:
    """Run the command line and exit; every refusal is one message on standard error."""
    listen()
    debug = "--debug" in sys.argv[1:]
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", GainWarning)
    arguments = [a for a in sys.argv[1:] if a != "--debug"]
    try:
        code = cli.main(arguments, prog_name="holdfast", standalone_mode=False)
        sys.exit(code if isinstance(code, int) else ANSWERED)
    except HoldfastError as error:
        if debug:
            raise
        _fail(str(error), BAD_INPUT)
    except (click.exceptions.Abort, KeyboardInterrupt):
        _interrupted()
    except click.ClickException as error:
        error.show()
        sys.exit(BAD_INPUT)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(ANSWERED)


def _interrupted() -> NoReturn:
    """Leave with 130 whatever was interrupted.

    Where the interruption hit code that runs text (as `exec` in a library's import),
    CPython remembers it as unhandled and would turn a plain exit into death by the signal.
    """
    click.echo("holdfast: interrupted; no partial file is left", err=True)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(INTERRUPTED)


def _fail(message: str, status: int) -> NoReturn:
    click.echo(f"holdfast: {message}", err=True)
    sys.exit(status)


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: object = None,
    line: str | None = None,
) -> None:
    text = f"holdfast: warning: {message}"
    if "tqdm" in sys.modules:  # keep clear of the progress bar
        sys.modules["tqdm"].tqdm.write(text, file=sys.stderr)
    else:
        click.echo(text, err=True)
