"""`holdfast tune`: gains that meet every condition of a law, best for a cost."""

from __future__ import annotations

from pathlib import Path

import click

from holdfast.commands.options import WHOLE, simulation_options
from holdfast.host.files import check_writable
from holdfast.studies.progress import bar


@click.command("tune")
@click.argument("scenario")
@click.option(
    "--cost",
    default="time",
    show_default=True,
    metavar="COST",
    help="What the gains are chosen for: least time, least effort or largest clearance.",
)
@click.option(
    "--gain",
    "gains",
    multiple=True,
    metavar="KEY=LOW:HIGH",
    help="A gain and its range (repeatable) [default: every gain of the law, a quarter to four "
    "times its value].",
)
@click.option(
    "--margin",
    type=float,
    default=0.1,
    show_default=True,
    help="Relative distance that every condition keeps from its limit.",
)
@click.option(
    "--candidates",
    type=WHOLE,
    default=200,
    show_default=True,
    help="Approximate number of simulated candidates.",
)
@click.option("--case", metavar="CASE", help="A case of the scenario's [compare] to tune in.")
@simulation_options
def command(
    scenario: str,
    cost: str,
    gains: tuple[str, ...],
    margin: float,
    candidates: int,
    case: str | None,
    out: Path | None,
    overrides: tuple[str, ...],
    runs: int | None,
    seed: int | None,
    no_figures: bool,
) -> None:
    """Find gains that meet every condition of the law of SCENARIO, with the least cost.

    The conditions hold at every corner of the varied numbers; the cost is measured in closed loop.
    The files are tuned.toml (the scenario with its gains), tuning.csv, tuning.json and tuning.png.
    If no gains meet all conditions, the message names one that they cannot meet.
    """
    from holdfast.presentation.studies.tuning import tuning_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.tuning import STARTS, tune
    from holdfast.studies.write_results import write_tuning

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    with bar("preparing") as tell:
        tuning = tune(
            scenario,
            cost,
            gains=gains,
            margin=margin,
            candidates=candidates,
            runs=STARTS if runs is None else runs,
            seed=seed,
            case=case,
            overrides=overrides,
            progress=tell,
        )
    files = write_tuning(tuning, folder, figures=not no_figures)
    click.echo(tuning_text(tuning, files))
