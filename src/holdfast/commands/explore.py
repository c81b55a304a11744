"""`holdfast explore`: a scenario as one page, in which it runs and can be dragged."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import click

from holdfast.host.files import atomic_file, check_writable, make_folder


@click.command("explore")
@click.argument("scenario")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The file; by default runs/SCENARIO/explorer.html, or explorer.html beside a sweep.",
)
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a value, such as law.k1=0.3 (repeatable).",
)
@click.option("--open", "shown", is_flag=True, help="Open the page in the browser.")
def command(scenario: str, out: Path | None, overrides: tuple[str, ...], shown: bool) -> None:
    """Write SCENARIO, closed loops or a kernel, as one HTML file in which it runs.

    Drag the start, the current and the numbers of the law: paths, modes and constraints follow. The
    file needs no server and no network, and its runs have the numbers of `holdfast run`. SCENARIO
    may be the table of a sweep, sweep.nc, or its folder: the cell under the pointer runs.
    """
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.explored_sweep import explore, sweep_file
    from holdfast.studies.progress import bar

    table = sweep_file(scenario)
    folder = Path("runs") / scenario_title(scenario) if table is None else table.parent
    path = out if out is not None else folder / "explorer.html"
    check_writable(path.parent)
    with bar(f"{scenario}, preparing") as tell:
        page = explore(scenario, overrides, progress=lambda done: tell(scenario, done))
    make_folder(path.parent)
    with atomic_file(path) as partial:
        partial.write_text(page, "utf-8")
    click.echo(f"{path}, {len(page) / 2**20:.2f} MiB: open it in a browser")
    if shown:
        webbrowser.open(path.resolve().as_uri())
