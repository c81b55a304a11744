"""The command line. Heavy imports wait until a command needs them."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import NoReturn

import click

from holdfast._version import __version__
from holdfast.commands.scenarios import (
    ANSWERED,
    NOT_ANSWERED,
    compare_command,
    margin_command,
    run_command,
)
from holdfast.commands.studies import export_command, reproduce_command, sweep_command
from holdfast.errors import GainWarning, HoldfastError, ScenarioError
from holdfast.host.interruption import INTERRUPTED, SAID, end, listening
from holdfast.host.streams import forgiving
from holdfast.studies.write_results import check_writable, make_folder

BAD_INPUT = 2


def _a_number(context: click.Context, parameter: click.Parameter, value: float) -> float:
    if value != value:
        raise click.BadParameter("nan is no number of seconds")
    return value


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="holdfast")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """Viability control of nonholonomic systems.

    Exit status: 0 answered, 1 not (a run diverged, chattered or left
    its grid, a promise fell short, no limit was found), 2 bad input,
    130 interrupted, 143 terminated.
    """


@cli.command("list")
def list_command() -> None:
    """List the systems, laws, regions, vehicles and scenarios, one line each."""
    from holdfast.studies.catalogue import catalogue_lines

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
    from holdfast.studies.catalogue import describe

    if out is not None:
        from holdfast.maths.catalogue import fields
        from holdfast.scenario.files import load_field

        if name not in [f.__name__ for f in fields.ALL]:
            raise ScenarioError(f"'{name}' has no figure", expected="a field with --out")
        check_writable(out)
        field = load_field(name, overrides)
    from holdfast.studies.progress import bounded

    with bounded(f"showing '{name}'", 60.0, "ask for less: fewer dimensions, simpler values"):
        text = describe(name, overrides)
    click.echo(text)
    if out is not None:
        from holdfast.presentation.figures import style
        from holdfast.presentation.figures.flow_lines import flow_lines_figure

        make_folder(out)
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
    from holdfast.scenario.files import load_system
    from holdfast.studies.derivation import explain
    from holdfast.studies.progress import bounded

    if markdown is not None:
        check_writable(markdown.parent, "--markdown")
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
        from holdfast.host.writing import atomic_file

        make_folder(markdown.parent, "--markdown")
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


for _command in (
    run_command,
    compare_command,
    margin_command,
    sweep_command,
    reproduce_command,
    export_command,
):
    cli.add_command(_command)


def main() -> NoReturn:
    """Run the command line and exit; every refusal is one message on standard error."""
    with listening(), forgiving() as out:
        try:
            _main()
        except SystemExit as ended:
            out.flush()
            if out.trouble and not ended.code:
                _fail(f"standard output cannot be written ({out.trouble})", NOT_ANSWERED)
            raise


def _main() -> NoReturn:
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
        end(INTERRUPTED, SAID)
    except click.ClickException as error:
        error.show()
        sys.exit(BAD_INPUT)


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
