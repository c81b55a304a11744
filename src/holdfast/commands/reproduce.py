"""`holdfast reproduce`: the claims of the thesis, computed and judged."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from holdfast.commands.options import NOT_ANSWERED, WHOLE
from holdfast.host.files import check_writable
from holdfast.host.interruption import going_on
from holdfast.studies.progress import bar


@click.command("reproduce")
@click.option("--chapter", "chapters", type=WHOLE, multiple=True, help="A chapter (repeatable).")
@click.option("--quick", is_flag=True, help="Only the claims that take seconds.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    help="Number of processes [default: one for each core].",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("runs") / "thesis",
    show_default=True,
    help="Folder for the report; claims that are judged there are not computed again.",
)
@click.option(
    "--no-explorers",
    "bare",
    is_flag=True,
    help="Leave out the pages in which the trials run. (They are 60, have 39 MiB and take a minute "
    "and a half.)",
)
def command(
    chapters: tuple[int, ...], quick: bool, workers: int | None, out: Path, bare: bool
) -> None:
    """Compute the claims of the thesis and write a report: which of them hold?

    Every claim has a recorded verdict and number. The exit status is 1 if one of them differs. An
    interrupted reproduction resumes when it is repeated.

    Beside the report are pages in which the trials run and can be dragged, to which it links.
    """
    from holdfast.studies.thesis.reproduce import CHAPTERS, reproduce

    check_writable(out)
    with going_on("the claims that are judged", out), bar("reproducing") as tell:
        judged = reproduce(out, chapters or CHAPTERS, quick=quick, workers=workers, progress=tell)
    from holdfast.studies.thesis.report import report_text, write_report

    explorers = {}
    if not bare:
        from holdfast.studies.thesis.report import write_explorers

        with bar("pages to drag") as tell:
            explorers = write_explorers(judged, out, workers=workers, progress=tell)
    report = write_report(judged, out / "report.html", explorers)
    click.echo(report_text(judged))
    click.echo(f"  report: {report}")
    if pages := [e.page for e in explorers.values() if e.page is not None]:
        size = sum(p.stat().st_size for p in pages) / 2**20
        click.echo(f"  to drag: {len(pages)} pages, {size:.1f} MiB, in {pages[0].parent}")
    if any(j.problems for j in judged):
        click.echo("holdfast: some verdicts or numbers differ from the recorded ones", err=True)
        sys.exit(NOT_ANSWERED)
