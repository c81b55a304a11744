"""`holdfast margin`: the largest disturbance that leaves a kernel, or where a place at rest is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from holdfast.commands.options import NOT_ANSWERED, file_options
from holdfast.errors import ScenarioError
from holdfast.host.files import check_writable
from holdfast.studies.progress import bar

STANDARD = "current.speed"


@click.command("margin")
@click.argument("scenario")
@click.option(
    "--of",
    default=STANDARD,
    show_default=True,
    metavar="KEY",
    help="The number to vary: a key such as system.current_limit, or the speed of the current.",
)
@click.option(
    "--between",
    type=(float, float),
    metavar="LOW HIGH",
    help="The interval to search [default: from 0 to twice the scenario's value, then further].",
)
@click.option(
    "--tolerance", type=float, help="Width of the final interval [default: a hundredth of HIGH]."
)
@click.option(
    "--keep",
    multiple=True,
    metavar="STATE",
    help="A state that the kernel must contain, such as x=-0.8,psi=0 (repeatable).",
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
    """Find the largest disturbance for which the kernel of SCENARIO is not empty.

    With --keep the kernel must also contain these states. The kernel is that of the horizon of the
    scenario, or with march.forever = true the infinite-horizon kernel.

    For a scenario of closed loops the answer is the place at which the vehicle can rest in its
    region, in the disturbance of the scenario, and how far inside this place is.
    """
    asks = of == STANDARD and between is None and tolerance is None and not keep
    if asks and _closed_loops(scenario, overrides):
        _rest(scenario, overrides, out)
        return
    from holdfast.presentation.studies.margin import margin_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.disturbance_margin import disturbance_margin
    from holdfast.studies.write_results import write_margin

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    with bar("preparing") as tell:
        margin = disturbance_margin(
            scenario,
            of,
            between=between,
            tolerance=tolerance,
            keep=[_state(text) for text in keep],
            overrides=overrides,
            progress=tell,
        )
    files = write_margin(margin, folder, figures=not no_figures)
    click.echo(margin_text(margin, files))
    if not margin.answered:
        remedy = "raise march.horizon" if margin.undecided else "look elsewhere with --between"
        click.echo(f"holdfast: the limit of {margin.key} was not found; {remedy}", err=True)
        sys.exit(NOT_ANSWERED)


def _closed_loops(scenario: str, overrides: tuple[str, ...]) -> bool:
    """Whether it is closed loops of one vehicle: no kernel, but a place at rest."""
    from holdfast.scenario.files import read_tables
    from holdfast.scenario.kinds import kind_of

    file, _, data = read_tables(scenario, overrides)
    return kind_of(file, data).name == "closed-loop"


def _rest(scenario: str, overrides: tuple[str, ...], out: Path | None) -> None:
    from holdfast.host.files import make_folder, write_summary
    from holdfast.presentation.text.values import resting_text
    from holdfast.scenario.kinds.closed_loop import resting_places
    from holdfast.scenario.load import load_scenario

    loaded = load_scenario(scenario, overrides)
    folder = out if out is not None else Path("runs") / loaded.name
    check_writable(folder)
    resting = resting_places(loaded)
    make_folder(folder)
    file = write_summary(folder / "rest.json", resting.summary())
    click.echo(resting_text(resting.title, resting.found, resting.units, resting.drawn, file))
    if not resting.answered:
        sys.exit(NOT_ANSWERED)


def _state(text: str) -> dict[str, Any]:
    """x=-0.8,psi=10 deg as a table; numbers are numbers, the rest is left as text."""
    state: dict[str, Any] = {}
    for part in text.split(","):
        name, separator, value = (p.strip() for p in part.partition("="))
        if not (name and separator and value) or name in state:
            raise ScenarioError(f"--keep {text}", expected="a state, such as x=-0.8,psi=10 deg")
        try:
            state[name] = float(value)
        except ValueError:
            state[name] = value
    return state
