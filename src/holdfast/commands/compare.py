"""`holdfast compare`: several laws, several cases, the same starts."""

from __future__ import annotations

from pathlib import Path

import click

from holdfast.commands.options import simulation_options
from holdfast.host.files import check_writable
from holdfast.studies.progress import bar


@click.command("compare")
@click.argument("scenario")
@click.option("--laws", help="Laws to compare, such as inspection,convergent [default: all].")
@click.option("--cases", help="Cases to compare them in [default: all of the scenario].")
@simulation_options
def command(
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

    A law is named by its table in [compare.laws]. The name of SCENARIO stands for its own law, and
    the name of another scenario for the law of that one. All laws run from the same starts.
    """
    from holdfast.presentation.studies.comparison import comparison_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.comparison import compare
    from holdfast.studies.write_results import write_comparison

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    with bar("preparing") as tell:
        comparison = compare(
            scenario,
            _listed(laws),
            _listed(cases),
            overrides=overrides,
            runs=runs,
            seed=seed,
            progress=tell,
        )
    files = write_comparison(comparison, folder, figures=not no_figures)
    click.echo(comparison_text(comparison))
    click.echo(f"  files in {folder}: " + ", ".join(f.name for f in files))


def _listed(text: str | None) -> list[str] | None:
    return None if text is None else [part.strip() for part in text.split(",")]
