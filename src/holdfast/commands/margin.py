"""`holdfast margin`: the largest disturbance that a kernel stands."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from holdfast.commands.options import NOT_ANSWERED, file_options
from holdfast.errors import ScenarioError
from holdfast.host.output import check_writable
from holdfast.studies.progress import bar


@click.command("margin")
@click.argument("scenario")
@click.option(
    "--of",
    default="current.speed",
    show_default=True,
    metavar="KEY",
    help="Which number: a key such as system.current_limit, or the speed of the current.",
)
@click.option(
    "--between",
    type=(float, float),
    metavar="LOW HIGH",
    help="Where the limit is looked for [default: 0 and twice the scenario's own, and further].",
)
@click.option(
    "--tolerance", type=float, help="How close it is enclosed [default: a hundredth of HIGH]."
)
@click.option(
    "--keep",
    multiple=True,
    metavar="STATE",
    help="A state that the kernel has to contain, such as x=-0.8,psi=0 (repeatable).",
)
@file_options
def command(
    scenario: str,
    of: str,
    between: tuple[float, float] | None,
    tolerance: float | None,
    keep: tuple[str, ...],
    out: Path | None,
    overrides: tuple[str, ...],
    no_figures: bool,
) -> None:
    """Find how large a disturbance the kernel of SCENARIO stands: until when it is not empty.

    With --keep: until when it contains these states. A kernel is one for the horizon of the
    scenario, or with march.forever = true the set that lasts.
    """
    from holdfast.presentation.studies.margin import margin_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.disturbance_margin import disturbance_margin
    from holdfast.studies.write_results import write_margin

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    with bar("preparing") as tell:
        found = disturbance_margin(
            scenario,
            of,
            between=between,
            tolerance=tolerance,
            keep=[_state(text) for text in keep],
            overrides=overrides,
            progress=tell,
        )
    files = write_margin(found, folder, figures=not no_figures)
    click.echo(margin_text(found, files))
    if not found.answered:
        remedy = "raise march.horizon" if found.undecided else "look elsewhere with --between"
        click.echo(f"holdfast: the limit of {found.key} was not found; {remedy}", err=True)
        sys.exit(NOT_ANSWERED)


def _state(text: str) -> dict[str, Any]:
    """x=-0.8,psi=10 deg as a table; numbers are numbers, the rest is left as text."""
    found: dict[str, Any] = {}
    for part in text.split(","):
        name, separator, value = (p.strip() for p in part.partition("="))
        if not (name and separator and value) or name in found:
            raise ScenarioError(f"--keep {text}", expected="a state, such as x=-0.8,psi=10 deg")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = value
    return found
