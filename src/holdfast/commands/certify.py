"""`holdfast certify`: a proof, cell by cell, that held inputs keep a region."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from holdfast.commands.options import NOT_ANSWERED, WHOLE, file_options
from holdfast.errors import ScenarioError
from holdfast.host.output import check_writable
from holdfast.studies.progress import bar


@click.command("certify")
@click.argument("scenario")
@click.option("--cells", type=WHOLE, help="Cells along each state [default: the grid's nodes].")
@click.option(
    "--sample-time", type=float, help="For which inputs are held [default: 0.1, or the run's]."
)
@click.option(
    "--box",
    multiple=True,
    metavar="NAME=LOW,HIGH",
    help="The range of a state whose cells are tried: of a closed loop, whose own law is certified "
    "(once for each state).",
)
@click.option("--horizon", type=float, help="Seconds for which it is proved [default: for ever].")
@click.option(
    "--inputs", type=WHOLE, default=5, show_default=True, help="Values of each input to try."
)
@click.option(
    "--uncertain",
    multiple=True,
    metavar="NAME=LOW,HIGH",
    help="A parameter that is any number in a range (repeatable).",
)
@click.option(
    "--error",
    multiple=True,
    metavar="NAME=SIZE",
    help="By how much a state may be measured wrong (repeatable).",
)
@click.option(
    "--delay",
    type=float,
    help="Seconds by which an input may come late [default: 0, or the run's].",
)
@click.option(
    "--refine",
    type=WHOLE,
    default=0,
    show_default=True,
    help="How often cells beside certified ones are halved along each state.",
)
@click.option(
    "--room",
    multiple=True,
    metavar="KEY=VALUE",
    help="A harder case to search, such as a larger current, so that the checker, whose arithmetic "
    "is wider, agrees with what is stated (repeatable).",
)
@click.option(
    "--largest",
    metavar="NAME",
    help="Bisect a number of the scenario, such as a current, or uncertain.NAME: how far a "
    "parameter may be off.",
)
@click.option(
    "--between",
    type=(float, float),
    metavar="LOW HIGH",
    help="With --largest: the interval [default: from 0 to twice the value, then further].",
)
@click.option(
    "--tolerance", type=float, help="With --largest: of the limit [default: a hundredth of HIGH]."
)
@click.option(
    "--share",
    type=float,
    help="With --largest: of the cells in the region, 0 to 1 [default: one cell].",
)
@file_options
def command(
    scenario: str,
    cells: int | None,
    sample_time: float | None,
    box: tuple[str, ...],
    horizon: float | None,
    inputs: int,
    uncertain: tuple[str, ...],
    error: tuple[str, ...],
    delay: float | None,
    refine: int,
    room: tuple[str, ...],
    largest: str | None,
    between: tuple[float, float] | None,
    tolerance: float | None,
    share: float | None,
    out: Path | None,
    overrides: tuple[str, ...],
    no_figures: bool,
) -> None:
    """Prove from which cells of SCENARIO's grid held inputs keep its region.

    In a capture basin: from which they lead to its goal, in the region until then. Between samples
    too, for every disturbance within its bounds, with every rounding counted. With --box SCENARIO
    is a closed loop, and its own law is what keeps the region, or is refuted by a trajectory. The
    file certificate.holdfast is checked by another program: holdfast-check FILE. An interrupted
    run, but for --largest and --box, resumes when it is repeated. The exit status is 1 if no cell
    is certified, and with --largest if the limit was not found.
    """
    from holdfast.presentation.studies.certificate import certificate_text
    from holdfast.scenario.files import scenario_title
    from holdfast.studies.certification import certified, certified_with_room, write_certificate

    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    options: dict[str, Any] = {
        "cells": cells,
        "horizon": horizon,
        "inputs": inputs,
        "uncertain": dict(_range(text) for text in uncertain),
        "errors": dict(_error(text) for text in error),
        "refine": refine,
    }
    timing = {"sample_time": sample_time, "delay": delay}
    options |= {name: value for name, value in timing.items() if value is not None}
    search = {"between": between, "tolerance": tolerance, "share": share}
    search = {name: value for name, value in search.items() if value is not None}
    if box:
        if largest is not None or room or search or options.pop("refine"):
            raise ScenarioError(
                "--box with --largest, --room or --refine", expected="a law's cells as they are"
            )
        _law(scenario, dict(_range(text, "--box") for text in box), overrides, options, folder,
             not no_figures)  # fmt: skip
        return
    if largest is not None and room:
        raise ScenarioError("--room with --largest", expected="one of them")
    if largest is not None:
        _largest(scenario, largest, overrides, {**options, **search}, folder, not no_figures)
        return
    if search:
        raise ScenarioError(f"--{next(iter(search))} without --largest", remedy="name a number")
    with bar("cells") as tell:
        options |= {"progress": tell, "store": folder}
        if room:
            found = certified_with_room(scenario, overrides, room, **options)
        else:
            found = certified(scenario, overrides, **options)
    files = write_certificate(found, folder, figures=not no_figures)
    click.echo(certificate_text(found, files))
    if not len(found.kept.members):
        click.echo("holdfast: no cell is certified; try more cells or inputs", err=True)
        sys.exit(NOT_ANSWERED)


def _law(
    scenario: str,
    box: dict[str, tuple[float, float]],
    overrides: tuple[str, ...],
    options: dict[str, Any],
    folder: Path,
    figures: bool,
) -> None:
    from holdfast.presentation.studies.certificate import judgement_text
    from holdfast.studies.certification import write_certificate
    from holdfast.studies.law_certification import judged_law

    with bar("cells") as tell:
        found = judged_law(scenario, overrides, box=box, **options, progress=tell)
    files = []
    if len(found.certificate.kept.members):
        files = write_certificate(found.certificate, folder, figures=figures)
    click.echo(judgement_text(found, files))
    if found.verdict != "proved":
        sys.exit(NOT_ANSWERED)


def _largest(
    scenario: str,
    name: str,
    overrides: tuple[str, ...],
    options: dict[str, Any],
    folder: Path,
    figures: bool,
) -> None:
    from holdfast.presentation.studies.largest_certified import largest_text
    from holdfast.studies.largest_certified import largest_certified, write_largest

    with bar("preparing") as tell:
        found = largest_certified(scenario, name, overrides=overrides, **options, progress=tell)
    files = write_largest(found, folder, figures=figures)
    click.echo(largest_text(found, files))
    if not found.answered:
        remedy = "look elsewhere with --between"
        click.echo(f"holdfast: the limit of {found.key} was not found; {remedy}", err=True)
        sys.exit(NOT_ANSWERED)


def _range(text: str, option: str = "--uncertain") -> tuple[str, tuple[float, float]]:
    name, sign, ends = text.partition("=")
    try:
        low, high = (float(e) for e in ends.split(","))
    except ValueError:
        sign = ""
    if not (sign and name.strip()):
        raise ScenarioError(f"{option} {text}", expected="NAME=LOW,HIGH, such as mass=4,6")
    return name.strip(), (low, high)


def _error(text: str) -> tuple[str, float]:
    name, sign, size = text.partition("=")
    try:
        value = float(size)
    except ValueError:
        sign, value = "", 0.0
    if not (sign and name.strip()):
        raise ScenarioError(f"--error {text}", expected="NAME=SIZE, such as x=0.01")
    return name.strip(), value
