"""`holdfast reproduce`: the claims of the thesis, run and judged."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from holdfast.commands.options import NOT_ANSWERED, WHOLE
from holdfast.host.output import check_writable
from holdfast.studies.progress import bar


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
def command(chapters: tuple[int, ...], quick: bool, workers: int | None, out: Path) -> None:
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
