"""The commands around scenarios: `sweep`, `reproduce`, `export-c`."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.commands.scenarios import NOT_ANSWERED, WHOLE, set_option, simulation_options
from holdfast.errors import ScenarioError
from holdfast.studies.progress import bar
from holdfast.studies.write_results import check_writable

if TYPE_CHECKING:
    from holdfast.scenario.load import Scenario


@click.command("sweep")
@click.argument("scenario")
@click.option(
    "--over",
    multiple=True,
    metavar="KEY=LOW:HIGH:COUNT",
    help="Over which values of which number (repeatable); also KEY=LOW:HIGH:COUNT:log and "
    "KEY=VALUE,VALUE. KEY may be the last part of one, such as k1, or current.speed.",
)
@click.option(
    "--latin",
    type=WHOLE,
    metavar="CELLS",
    help="A Latin hypercube of so many cells, with --over KEY=LOW:HIGH.",
)
@click.option("--show", metavar="VARIABLE", help="What of the table the figure shows.")
@click.option(
    "--workers", type=click.IntRange(min=1), help="How many processes [default: one a core]."
)
@click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Compute on the Dask cluster whose scheduler is there, such as tcp://host:8786.",
)
@simulation_options
def sweep_command(
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
    """Run SCENARIO in every cell of a grid over its numbers, and count what becomes of the runs.

    The table is sweep.nc, its heat map sweep.png. Killed or interrupted, it goes on where it was;
    exit status 1 says that some cells were refused.
    """
    from holdfast.presentation.studies.sweep import campaign_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.sweep.sweep import sweep
    from holdfast.studies.write_results import write_campaign

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    with ExitStack() as stack:
        executor = None
        if cluster is not None:
            from holdfast.interop.cluster import cluster_executor

            executor, cores = stack.enter_context(cluster_executor(cluster))
            workers = workers or cores
        tell = stack.enter_context(bar("preparing"))
        found = sweep(
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
    found.variable(show)
    files = write_campaign(found, folder, show, figures=not no_figures)
    click.echo(campaign_text(found, show, files))
    if found.refused:
        click.echo(f"holdfast: {found.refused} cells were refused", err=True)
        sys.exit(NOT_ANSWERED)


@click.command("reproduce")
@click.option("--chapter", "chapters", type=WHOLE, multiple=True, help="A chapter (repeatable).")
@click.option("--quick", is_flag=True, help="Of every chapter what takes seconds.")
@click.option(
    "--workers", type=click.IntRange(min=1), help="How many processes [default: one a core]."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("runs") / "thesis",
    show_default=True,
    help="Folder for the report; what is there already is not run again.",
)
def reproduce_command(
    chapters: tuple[int, ...], quick: bool, workers: int | None, out: Path
) -> None:
    """Run what the thesis claims, and write a report: does it hold?

    Every claim has a recorded verdict and number; exit status 1 says that one of them differs.
    Interrupted, it goes on where it was.
    """
    from holdfast.studies.thesis.reproduce import CHAPTERS, reproduce

    check_writable(out)
    with bar("reproducing") as tell:
        judged = reproduce(out, chapters or CHAPTERS, quick=quick, workers=workers, progress=tell)
    from holdfast.studies.thesis.report import report_text, write_report

    report = write_report(judged, out / "report.html")
    click.echo(report_text(judged))
    click.echo(f"  report: {report}")
    if any(j.problems for j in judged):
        click.echo("holdfast: not all verdicts and numbers are those recorded", err=True)
        sys.exit(NOT_ANSWERED)


@click.command("export-c")
@click.argument("scenario")
@set_option
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The file, and a header .h beside it [default: SCENARIO.c].",
)
@click.option(
    "--timing/--no-timing",
    default=True,
    help="Compile it here and time it along runs of the scenario.",
    show_default=True,
)
def export_command(
    scenario: str, overrides: tuple[str, ...], out: Path | None, timing: bool
) -> None:
    """Write the law of SCENARIO as one file of C99, and its header for C and C++.

    No allocation, no library but libm; with the modes of the law, what it remembers, the program
    of a safeguard, the table of a kernel, and the limits of the actuators. The comments of the file
    say what every number is. Every name begins with that of the scenario, so that several laws can
    be in one program.
    """
    from holdfast.execution.codegen.c_source import export_c, export_c_header
    from holdfast.scenario.load import Scenario, load_scenario
    from holdfast.studies.write_results import make_folder, write_text

    loaded = load_scenario(scenario, overrides)
    if not isinstance(loaded, Scenario):
        raise ScenarioError(f"{loaded.file}: a {loaded.kind} has no law to export")
    path = out if out is not None else Path(f"{loaded.name}.c")
    header = path.with_suffix(".h")
    if header == path:
        raise ScenarioError(
            f"--out {path}: the law and its header would be one file",
            remedy=f"write --out {path.with_suffix('.c')}",
        )
    check_writable(path.parent)
    with bar(f"{loaded.name}, preparing") as tell:
        loaded = loaded.kept(lambda fraction: tell("the kernel", fraction))
        text = export_c(loaded.system, loaded.law, loaded.name)
        declared = export_c_header(loaded.system, loaded.law, loaded.name)
        make_folder(path.parent)
        write_text(path, text)
        write_text(header, declared)
    click.echo(f"written: {path} ({len(text.splitlines())} lines); its comments say what is what")
    click.echo(f"  header: {header}")
    if timing:
        click.echo(_timed(loaded, text))


TIMED_RUNS = 4


def _timed(scenario: Scenario, text: str) -> str:
    """The nanoseconds of a call, or why they are not known: the file is written in any case."""
    from holdfast.errors import HoldfastError
    from holdfast.execution.codegen.c_timing import time_law

    runs = min(scenario.runs, TIMED_RUNS)
    try:
        with bar("runs to time it") as tell:
            result = scenario.run(lambda f: tell("runs to time it", f), range(runs))
        times, states = (result.dataset[n].values for n in ("time", "state"))
        found = time_law(text, scenario.name, times, states, scenario.settings["sample_time"])
    except HoldfastError as error:
        return f"  not timed: {error}"
    return (
        f"  {found.nanoseconds:.0f} ns a call on this machine ({found.compiler}), along {runs} "
        "of its runs"
    )
