"""`holdfast explain`: the derivation from the constraint of a system to its law."""

from __future__ import annotations

from pathlib import Path

import click

from holdfast.errors import ScenarioError
from holdfast.host.files import check_writable, make_folder


def _a_number(context: click.Context, parameter: click.Parameter, value: float) -> float:
    if value != value:
        raise click.BadParameter("nan is not a number of seconds")
    return value


@click.command("explain")
@click.argument("system")
@click.option(
    "--moment", metavar="P1,P2,...", help="The moment p, if the system leaves a choice of it."
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
    help="Time limit of the derivation, in seconds.",
)
@click.option("--latex", is_flag=True, help="Print a LaTeX document instead of text.")
@click.option(
    "--markdown",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write a Markdown page with formulas to this file.",
)
def command(
    system: str,
    moment: str | None,
    overrides: tuple[str, ...],
    limit: float,
    latex: bool,
    markdown: Path | None,
) -> None:
    """Derive the consequences of the constraint of SYSTEM, and its steering law where there is one.

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
        from holdfast.host.files import atomic_file

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
