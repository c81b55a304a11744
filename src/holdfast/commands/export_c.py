"""`holdfast export-c`: a law written as C99."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.commands.options import set_option
from holdfast.errors import ScenarioError
from holdfast.host.files import check_writable
from holdfast.studies.progress import bar

if TYPE_CHECKING:
    from holdfast.scenario.kinds.closed_loop import Scenario


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
    help="Compile the file here and time it along runs of the scenario.",
    show_default=True,
)
@click.option(
    "--table",
    type=click.Choice(["text", "file"]),
    help="Where the table of a kernel is written [default: in the text up to 65,536 numbers, "
    "otherwise in a file].",
)
def command(
    scenario: str,
    overrides: tuple[str, ...],
    out: Path | None,
    timing: bool,
    table: str | None,
) -> None:
    """Write the law of SCENARIO as one file of C99, and its header for C and C++.

    The file allocates no memory and needs no library but libm. It contains the modes and the memory
    of the law, the optimization of a safeguard, the table of a kernel, and the limits of the
    actuators; its comments explain every number. Every name begins with that of the scenario, so
    that one program can contain several laws.

    The table of a kernel of more than 65,536 nodes is a file .bin beside it, which NAME_load opens
    or the assembler links.
    """
    from holdfast.execution.codegen.c_source import (
        MOST_AS_TEXT,
        export_c,
        export_c_header,
        export_c_table,
        numbers_of,
    )
    from holdfast.host.files import make_folder, write_text
    from holdfast.scenario.kinds.closed_loop import Scenario
    from holdfast.scenario.load import load_scenario

    loaded = load_scenario(scenario, overrides)
    if not isinstance(loaded, Scenario):
        raise ScenarioError(f"{loaded.file}: a {loaded.kind} has no law to export")
    path = out if out is not None else Path(f"{loaded.name}.c")
    header = path.with_suffix(".h")
    if path.suffix != ".c":
        raise ScenarioError(
            f"--out {path}: a law in C is a file that ends in .c",
            remedy=f"write --out {path.with_suffix('.c')}",
        )
    check_writable(path.parent)
    with bar(f"{loaded.name}, preparing") as tell:
        loaded = loaded.kept(lambda fraction: tell("the kernel", fraction))
        numbers = numbers_of(loaded.law.lookup)
        in_file = numbers > MOST_AS_TEXT if table is None else table == "file"
        where = "file" if in_file else "text"
        text = export_c(loaded.model, loaded.law, loaded.name, table=where)
        declared = export_c_header(loaded.model, loaded.law, loaded.name, table=where)
        make_folder(path.parent)
        binary = export_c_table(loaded.law, path.with_suffix(".bin")) if in_file else None
        write_text(path, text)
        write_text(header, declared)
    click.echo(
        f"written: {path} ({len(text.splitlines())} lines); its comments explain every number"
    )
    click.echo(f"  header: {header}")
    if binary is not None:
        size = binary.stat().st_size / 2**20
        click.echo(f"  table:  {binary} ({numbers:,} numbers, {size:,.1f} MiB)")
    if timing:
        click.echo(_timed(loaded, text, binary))


TIMED_RUNS = 4


def _timed(scenario: Scenario, text: str, table: Path | None) -> str:
    """The nanoseconds of a call, or the reason why they were not measured."""
    from holdfast.errors import HoldfastError
    from holdfast.execution.codegen.c_timing import time_law

    if scenario.law.handed:
        return "  not timed: others hand it a command, or obstacles, at every sample"
    runs = min(scenario.runs, TIMED_RUNS)
    try:
        with bar("runs to time it") as tell:
            result = scenario.run(lambda f: tell("runs to time it", f), range(runs))
        times, states = (result.arrays[n].values for n in ("time", "state"))
        states = states[..., : len(scenario.model.states)]
        sample_time = scenario.settings["sample_time"]
        timing = time_law(text, scenario.name, times, states, sample_time, table)
    except HoldfastError as error:
        return f"  not timed: {error}"
    return (
        f"  {timing.nanoseconds:.0f} ns per call on this machine ({timing.compiler}), along {runs} "
        "of its runs"
    )
