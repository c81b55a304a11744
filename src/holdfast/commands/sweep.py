"""`holdfast sweep`: a scenario in every cell of a grid over its numbers."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path

import click

from holdfast.commands.options import NOT_ANSWERED, WHOLE, simulation_options
from holdfast.host.files import check_writable
from holdfast.host.interruption import going_on
from holdfast.studies.progress import bar


@click.command("sweep")
@click.argument("scenario")
@click.option(
    "--over",
    multiple=True,
    metavar="KEY=LOW:HIGH:COUNT",
    help="The values of a number (repeatable); also KEY=LOW:HIGH:COUNT:log and "
    "KEY=VALUE,VALUE. KEY may be the last part of a key, such as k1, or current.speed.",
)
@click.option(
    "--latin",
    type=WHOLE,
    metavar="CELLS",
    help="Number of cells of a Latin hypercube, with --over KEY=LOW:HIGH.",
)
@click.option("--show", metavar="VARIABLE", help="The variable of the table that the figure shows.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    help="Number of processes [default: one for each core].",
)
@click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Address of the scheduler of a Dask cluster to use, such as tcp://host:8786.",
)
@simulation_options
def command(
    scenario: str,
    over: tuple[str, ...],
    latin: int | None,
    show: str | None,
    workers: int | None,
    cluster: str | None,
    out: Path | None,
    overrides: tuple[str, ...],
    runs: int | None,
    seed: int | None,
    no_figures: bool,
) -> None:
    """Run SCENARIO in every cell of a grid over its numbers, and count the outcomes of the runs.

    The table is sweep.nc, its heat map sweep.png. An interrupted sweep resumes when it is repeated.
    The exit status is 1 if cells were refused.
    """
    from holdfast.presentation.studies.sweep import campaign_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.sweep import sweep
    from holdfast.studies.write_results import write_campaign

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    with ExitStack() as stack:
        executor = None
        if cluster is not None:
            from holdfast.interop.march_cluster import cluster_executor

            executor, cores = stack.enter_context(cluster_executor(cluster))
            workers = workers or cores
        stack.enter_context(going_on("the cells that are finished", folder))
        tell = stack.enter_context(bar("preparing"))
        campaign = sweep(
            scenario,
            over,
            latin=latin,
            runs=runs,
            seed=seed,
            overrides=overrides,
            show=show,
            folder=folder,
            workers=workers,
            executor=executor,
            progress=tell,
        )
    campaign.variable(show)
    files = write_campaign(campaign, folder, show, figures=not no_figures)
    click.echo(campaign_text(campaign, show, files))
    if campaign.refused:
        refused = "1 cell was" if campaign.refused == 1 else f"{campaign.refused:,} cells were"
        click.echo(f"holdfast: {refused} refused", err=True)
        sys.exit(NOT_ANSWERED)
