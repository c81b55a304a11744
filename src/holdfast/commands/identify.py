"""`holdfast identify`: from a log to a vehicle to a guarantee."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from holdfast.commands.options import NOT_ANSWERED, WHOLE, file_options
from holdfast.errors import ScenarioError
from holdfast.host.files import check_writable
from holdfast.studies.progress import bar


@click.command("identify")
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--system",
    "name",
    required=True,
    metavar="NAME",
    help="A vehicle, a system of the catalogue, or a scenario, which is then computed again; or a "
    "file of one.",
)
@click.option(
    "--held-out",
    type=click.Path(path_type=Path),
    metavar="LOG",
    help="A second log, which must be within the bound on what the model leaves unexplained.",
)
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="NAME=COLUMN",
    help='Where a state or an input is in the log, such as psi="heading [deg]" or '
    "x=/odom:pose.pose.position.x (repeatable) [default: a column of its name].",
)
@click.option("--time", default="", metavar="COLUMN", help="The column of times of a table.")
@click.option(
    "--measures",
    multiple=True,
    metavar="NAME=EXPRESSION",
    help='What a signal measures if it is not the state of its name, such as "u=u + Vx*cos(psi) + '
    'Vy*sin(psi)" for a speed over ground (repeatable).',
)
@click.option(
    "--estimate", multiple=True, metavar="NAME", help="Parameters to estimate [default: all]."
)
@click.option("--hold", multiple=True, metavar="NAME", help="Parameters that keep their numbers.")
@click.option(
    "--unexplained",
    multiple=True,
    metavar="STATE",
    help="States whose rates may have an unexplained part [default: those with inputs or "
    "parameters].",
)
@click.option(
    "--level", type=float, default=0.95, show_default=True, help="Confidence of the intervals."
)
@click.option("--window", type=float, help="Seconds of a window [default: from the model].")
@click.option(
    "--gap", type=float, help="Seconds without a value that split the log [default: 5 periods]."
)
@click.option(
    "--widen",
    type=float,
    default=1.5,
    show_default=True,
    help="Factor on the box of the additional rates that the windows of the log need.",
)
@click.option(
    "--no-margins",
    is_flag=True,
    help="Leave out the answers of `holdfast margin` before and after.",
)
@click.option("--runs", type=WHOLE, help="Starts of a scenario of closed loops.")
@click.option("--seed", type=WHOLE, help="Seed of its random numbers.")
@file_options
def command(
    log: Path,
    name: str,
    held_out: Path | None,
    columns: tuple[str, ...],
    time: str,
    measures: tuple[str, ...],
    estimate: tuple[str, ...],
    hold: tuple[str, ...],
    unexplained: tuple[str, ...],
    level: float,
    window: float | None,
    gap: float | None,
    widen: float,
    no_margins: bool,
    runs: int | None,
    seed: int | None,
    out: Path | None,
    overrides: tuple[str, ...],
    no_figures: bool,
) -> None:
    """Estimate the parameters of a vehicle from LOG: CSV, an MCAP file, or a ROS 2 bag.

    Each estimated number has an interval. A number that the log does not show keeps its value, and
    the report names the manoeuvre that would show it. The motion that the model leaves unexplained
    becomes a bound on additional rates. The files are identification.json and its page,
    vehicle.toml, and for a scenario identified.toml, which has the bound, and the results of the
    scenario with it. The exit status is 1 if the second log is not within the bound.
    """
    from holdfast.analysis.identification.identify import identify
    from holdfast.interop.logs.read import read_log
    from holdfast.presentation.studies.identification import identification_text
    from holdfast.studies.identification import (
        measured_expressions,
        redrawn,
        subject_of,
        write_identified,
    )

    folder = out if out is not None else Path("runs") / log.name.split(".")[0]
    check_writable(folder)
    subject = subject_of(name, overrides)
    if not subject.asks and (no_margins or runs is not None or seed is not None):
        raise ScenarioError(
            f"{name} is no scenario with a law or a kernel: --runs, --seed and --no-margins are "
            "for one",
            remedy="leave them out",
        )
    named = dict(_pair("--column", text) for text in columns)
    outputs = measured_expressions(subject.system, dict(_pair("--measures", m) for m in measures))
    with bar("reading") as tell:
        first = read_log(log, subject.system, names=named, time=time, gap=gap)
        second = None
        if held_out is not None:
            second = read_log(held_out, subject.system, names=named, time=time, gap=gap)
        tell("estimating", 0.05)
        identified = identify(
            subject.system,
            first,
            held_out=second,
            estimate=estimate,
            hold=hold,
            outputs=outputs,
            unexplained_rates=unexplained,
            level=level,
            window=window,
            widen=widen,
        )
    files = write_identified(identified, subject, folder, figures=not no_figures)
    answers = None
    if subject.asks:
        with bar("scenario") as tell:
            answers, more = redrawn(
                identified,
                subject,
                folder,
                runs=runs,
                seed=seed,
                figures=not no_figures,
                margins=not no_margins,
                progress=tell,
            )
        files += more
    click.echo(identification_text(identified, files, answers.summary() if answers else None))
    if identified.held_out is not None and not identified.held_out.covered:
        click.echo(f"holdfast: {identified.verdict}", err=True)
        sys.exit(NOT_ANSWERED)


def _pair(option: str, text: str) -> tuple[str, str]:
    key, sign, value = text.partition("=")
    if not (sign and key.strip() and value.strip()):
        raise ScenarioError(f"{option} {text}", expected="NAME=...")
    return key.strip(), value.strip()
