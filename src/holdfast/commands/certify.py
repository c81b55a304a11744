"""`holdfast certify`: a proof, cell by cell, that held inputs keep a region."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click

from holdfast.commands.options import NOT_ANSWERED, WHOLE, file_options
from holdfast.errors import RenamedWarning, ScenarioError
from holdfast.host.files import check_writable
from holdfast.studies.progress import bar


@click.command("certify")
@click.argument("scenario")
@click.option(
    "--cells",
    type=WHOLE,
    help="Cells along each state [default: the scenario's, else the grid's nodes].",
)
@click.option(
    "--sample-time",
    type=float,
    help="Seconds for which an input is held [default: the scenario's, else 0.1].",
)
@click.option(
    "--box",
    multiple=True,
    metavar="NAME=LOW,HIGH",
    help="The range of a state whose cells are tried, once for each state. SCENARIO is a closed "
    "loop, and its own law is certified.",
)
@click.option(
    "--from",
    "start",
    multiple=True,
    metavar="NAME=LOW,HIGH",
    help="The range of a state at the start, once for each state. SCENARIO is a closed loop, and "
    "all its trajectories from this box are followed.",
)
@click.option(
    "--to-goal",
    is_flag=True,
    help="With --from: all trajectories must end in the scenario's goal.",
)
@click.option(
    "--horizon",
    type=float,
    help="Seconds for which the region is kept [default: the scenario's, else for ever].",
)
@click.option(
    "--inputs", type=WHOLE, help="Values of each input to try [default: the scenario's, else 5]."
)
@click.option(
    "--uncertain",
    multiple=True,
    metavar="NAME=LOW,HIGH",
    help="A parameter that may be any number in this range (repeatable).",
)
@click.option(
    "--error",
    multiple=True,
    metavar="NAME=SIZE",
    help="The largest error of the measurement of a state (repeatable).",
)
@click.option(
    "--delay",
    type=float,
    help="Seconds by which an input may come late [default: the scenario's, else 0].",
)
@click.option(
    "--halvings",
    type=WHOLE,
    help="How many times cells beside certified cells are halved along each state "
    "[default: the scenario's, else 0].",
)
@click.option(
    "--enclosure",
    metavar="NAME",
    help="The set that encloses the states between samples. zonotope is for holds that are a large "
    "part of a period [default: the scenario's, else parallelepiped].",
)
@click.option("--refine", type=WHOLE, hidden=True)  # the former name of --halvings
@click.option(
    "--kernel",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The result.nc of the scenario's kernel: only the cells that its set touches are tried.",
)
@click.option(
    "--margin",
    type=float,
    help="With --kernel: only the cells in which V is above this number are tried [default: 0].",
)
@click.option(
    "--outer",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The result.nc of the scenario's set. The answer is a set of cells outside which a state "
    "is lost, or is not reached, for sure.",
)
@click.option(
    "--largest",
    metavar="NAME",
    help="Find the largest value of a number of the scenario, such as a current, by bisection. "
    "uncertain.NAME is the largest error of a parameter.",
)
@click.option(
    "--between",
    type=(float, float),
    metavar="LOW HIGH",
    help="With --largest: the interval to search [default: from 0 to twice the value, then "
    "further].",
)
@click.option(
    "--tolerance",
    type=float,
    help="With --largest: the width of the final interval [default: a hundredth of HIGH].",
)
@click.option(
    "--share",
    type=float,
    help="With --largest: the share of the cells in the region that has to be certified, 0 to 1 "
    "[default: one cell].",
)
@file_options
def command(
    scenario: str,
    cells: int | None,
    sample_time: float | None,
    box: tuple[str, ...],
    start: tuple[str, ...],
    to_goal: bool,
    horizon: float | None,
    inputs: int | None,
    uncertain: tuple[str, ...],
    error: tuple[str, ...],
    delay: float | None,
    halvings: int | None,
    enclosure: str | None,
    refine: int | None,
    kernel: Path | None,
    margin: float | None,
    outer: Path | None,
    largest: str | None,
    between: tuple[float, float] | None,
    tolerance: float | None,
    share: float | None,
    out: Path | None,
    overrides: tuple[str, ...],
    no_figures: bool,
) -> None:
    """Prove from which cells of SCENARIO's grid held inputs keep its region.

    The proof holds between samples too, for every disturbance within its bounds, with every
    rounding counted. For a capture basin it proves from which cells inputs lead to the goal, inside
    the region until then. The file certificate.holdfast is checked by another program:
    holdfast-check FILE.

    With --box SCENARIO is a closed loop. The proof is that its own law keeps the region, or a
    trajectory refutes this. With --from SCENARIO is a closed loop too. The proof is that all
    trajectories from that box keep the region: a reachable tube, in flowpipe.holdfast. With --outer
    SCENARIO is any set on a grid. The proof says which states are surely not in it.

    An interrupted run resumes when it is repeated, except with --largest, --box, --from and
    --outer. The exit status is 1 if no cell is certified, if --from is not proved, and with
    --largest if the limit was not found.
    """
    if refine is not None:
        if halvings is not None:
            raise ScenarioError("both --halvings and its former name --refine")
        said = "the option '--refine' is now '--halvings'; the former goes with the next release"
        warnings.warn(said, RenamedWarning, stacklevel=1)
        halvings = refine
    options: dict[str, Any] = {
        "cells": cells,
        "horizon": horizon,
        "uncertain": dict(_range(text) for text in uncertain),
        "errors": dict(_error(text) for text in error),
    }
    ranges = dict(_range(text, "--box") for text in box)
    more = {
        "sample_time": sample_time, "delay": delay, "inputs": inputs, "halvings": halvings,
        "enclosure": enclosure,
    }  # fmt: skip
    options |= {name: value for name, value in more.items() if value is not None}
    search = {"between": between, "tolerance": tolerance, "share": share}
    search = {name: value for name, value in search.items() if value is not None}
    if sample_time is not None and not 0 < sample_time < math.inf:
        raise ScenarioError(f"--sample-time {sample_time:g}", expected="seconds, above 0")
    if box and (largest is not None or search or halvings is not None or enclosure is not None):
        raise ScenarioError(
            "--box with --largest, --halvings or --enclosure",
            expected="a law's cells as they are",
        )
    if kernel is None and margin is not None:
        raise ScenarioError("--margin without --kernel", remedy="name the file of a kernel")
    if kernel is not None and (largest is not None or box):
        raise ScenarioError(
            "--kernel with --largest or --box", expected="the scenario as it was solved"
        )
    if outer is not None:
        beside = {
            "kernel": kernel, "box": box, "largest": largest, "horizon": horizon,
            "uncertain": uncertain, "error": error, "delay": delay, "enclosure": enclosure,
            "set certificate": tuple(o for o in overrides if o.startswith("certificate")),
        }  # fmt: skip
        if wrong := [name for name, value in beside.items() if value not in (None, ())]:
            raise ScenarioError(f"--{wrong[0]} with --outer", expected="the set as it was solved")
    if search and largest is None:
        raise ScenarioError(f"--{next(iter(search))} without --largest", remedy="name a number")
    from holdfast.scenario.files import scenario_title

    if start:
        beside = {
            "kernel": kernel, "box": box, "largest": largest, "outer": outer, "cells": cells,
            "delay": delay, "halvings": halvings, "inputs": inputs, "enclosure": enclosure,
        }  # fmt: skip
        if wrong := [name for name, value in beside.items() if value not in (None, ())]:
            raise ScenarioError(f"--{wrong[0]} with --from", expected="one box, and no cells")
    elif to_goal:
        raise ScenarioError("--to-goal without --from", remedy="name the box of the start")
    folder = out if out is not None else Path("runs") / scenario_title(scenario)
    check_writable(folder)
    if outer is not None:
        names = ("cells", "sample_time", "inputs", "halvings")
        options = {"outer": outer} | {n: options[n] for n in names if n in options}
        answer = _of_outside(scenario, overrides, options)
    elif start:
        options = {name: options[name] for name in ("horizon", "uncertain", "errors")}
        options |= {"start": dict(_range(text, "--from") for text in start), "to_goal": to_goal}
        options |= {} if sample_time is None else {"sample_time": sample_time}
        answer = _of_box(scenario, overrides, options)
    elif box:
        answer = _of_law(scenario, overrides, ranges, options)
    elif largest is not None:
        answer = _of_largest(scenario, overrides, largest, options | search)
    else:
        options |= {"store": folder, "kernel": kernel, "margin": margin or 0.0}
        answer = _of_scenario(scenario, overrides, options)
    with bar(answer.stage) as tell:
        outcome = answer.find(progress=tell)
    click.echo(answer.text(outcome, answer.write(outcome, folder, figures=not no_figures)))
    if answer.helps is not None:
        with suppress(KeyboardInterrupt, MemoryError), bar("trying what helps") as tell:
            if advice := answer.helps(outcome, progress=tell):  # the answer stands without it
                click.echo(advice)
    missing = answer.missing(outcome)
    if missing is not None:
        if missing:
            click.echo(f"holdfast: {missing}", err=True)
        sys.exit(NOT_ANSWERED)


@dataclass(frozen=True)
class _Answer:
    """What a certificate is asked for: how it is found, written and told.

    missing: None where the question was answered, or what to say on standard error. helps: tries
    other numbers than were asked for, and says which certify more.
    """

    stage: str
    find: Callable[..., Any]
    write: Callable[..., list[Path]]
    text: Callable[[Any, list[Path]], str]
    missing: Callable[[Any], str | None]
    helps: Callable[..., str] | None = None


def _of_scenario(scenario: str, overrides: tuple[str, ...], options: dict[str, Any]) -> _Answer:
    from holdfast.presentation.studies.certificate import advice_text, certificate_text
    from holdfast.studies.certification import certified, what_helps, write_certificate

    def helps(certificate: Any, progress: Any) -> str:
        beside = {n: v for n, v in options.items() if n not in ("store", "kernel", "margin")}
        tried = what_helps(certificate, scenario, overrides, beside, progress)
        return "" if tried is None else advice_text(tried)

    find = partial(certified, scenario, overrides, **options)
    return _Answer(
        "cells", find, write_certificate, certificate_text,
        lambda certificate: None if len(certificate.kept.members) else "no cell is certified",
        None if options["kernel"] else helps,
    )  # fmt: skip


def _of_outside(scenario: str, overrides: tuple[str, ...], options: dict[str, Any]) -> _Answer:
    from holdfast.presentation.studies.certificate import outer_text
    from holdfast.studies.certification import outside_of, write_outer

    find = partial(outside_of, scenario, overrides, **options)
    return _Answer("cells", find, write_outer, outer_text, lambda outer: None)


def _of_law(
    scenario: str, overrides: tuple[str, ...], box: dict[str, Any], options: dict[str, Any]
) -> _Answer:
    from holdfast.presentation.studies.certificate import judgement_text
    from holdfast.studies.certification import clear, write_certificate
    from holdfast.studies.law_certification import judged_law

    def write(judgement: Any, folder: Path, *, figures: bool) -> list[Path]:
        certificate = judgement.certificate
        clear(folder)
        some = len(certificate.kept.members) > 0
        return write_certificate(certificate, folder, figures=figures) if some else []

    return _Answer(
        "cells", partial(judged_law, scenario, overrides, box=box, **options), write,
        judgement_text, lambda judgement: None if judgement.verdict == "proved" else "",
    )  # fmt: skip


def _of_box(scenario: str, overrides: tuple[str, ...], options: dict[str, Any]) -> _Answer:
    from holdfast.presentation.studies.certificate import flowpipe_text
    from holdfast.studies.law_certification import flowpipe_of, write_flowpipe

    return _Answer(
        "box", partial(flowpipe_of, scenario, overrides, **options), write_flowpipe, flowpipe_text,
        lambda flowpipe: None if flowpipe.proved else f"not proved: {flowpipe.why}",
    )  # fmt: skip


def _of_largest(
    scenario: str, overrides: tuple[str, ...], name: str, options: dict[str, Any]
) -> _Answer:
    from holdfast.presentation.studies.certificate import largest_text
    from holdfast.studies.certification import largest_certified, write_largest

    def missing(largest: Any) -> str | None:
        said = f"the limit of {largest.key} was not found; look elsewhere with --between"
        return None if largest.answered else said

    return _Answer(
        "preparing", partial(largest_certified, scenario, name, overrides=overrides, **options),
        write_largest, largest_text, missing,
    )  # fmt: skip


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
