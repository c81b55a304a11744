"""`holdfast run`: one scenario, whatever its kind."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path

import click

from holdfast.commands.options import NOT_ANSWERED, simulation_options
from holdfast.host.files import check_writable
from holdfast.studies.progress import bar

DEVICES = ("cpu", "gpu", "c++")
"""As in `execution/device/program.py`, which takes longer to import than to look at."""


@click.command("run")
@click.argument("scenario")
@simulation_options
@click.option(
    "--cluster",
    metavar="ADDRESS",
    help="Address of the scheduler of a Dask cluster whose workers march a kernel, such as "
    "tcp://host:8786.",
)
@click.option(
    "--on-disk",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder for the arrays of a kernel that is larger than the memory.",
)
@click.option(
    "--controller",
    metavar="COMMAND",
    help="Your controller: a program that reads states and answers with commands, line by line "
    "(JSON); for a [law] with external = true.",
)
@click.option(
    "--device",
    type=click.Choice(DEVICES),
    default="cpu",
    help="Where marches and simulations run: on the processor, on a GPU by way of CuPy, or, to "
    "check the GPU's code, compiled by the C++ compiler.",
)
def command(
    scenario: str,
    controller: str | None,
    device: str,
    cluster: str | None,
    on_disk: Path | None,
    out: Path | None,
    overrides: tuple[str, ...],
    runs: int | None,
    seed: int | None,
    no_figures: bool,
) -> None:
    """Run SCENARIO, the name of a shipped scenario or a TOML file.

    A scenario of closed loops is simulated. One whose kind is a kernel, a reachable set or a basin
    is marched, and its promise is validated in closed loop.
    """
    from holdfast.scenario.load import load_scenario

    loaded = load_scenario(scenario, overrides, runs, seed)
    if controller is not None:
        loaded = loaded.with_controller(controller)
    if device != "cpu":
        from holdfast.execution.device.program import device_named

        device_named(device)  # refused now, if there is none
        loaded = loaded.on_device(device)
    loaded = loaded.beforehand()
    if loaded.remark:
        click.echo(f"{loaded.remark}\n")
    folder = out if out is not None else Path("runs") / loaded.name
    check_writable(folder)
    with ExitStack() as stack:
        if cluster is not None or on_disk is not None:
            loaded = loaded.marched_on(on_disk=on_disk)
        if cluster is not None:
            from holdfast.interop.march_cluster import march_cluster

            workers = stack.enter_context(march_cluster(cluster))
            loaded = loaded.marched_on(cluster=workers)
        tell = stack.enter_context(bar(f"{loaded.name}, preparing"))
        answer = loaded.run(lambda fraction: tell(loaded.name, fraction))
    files = loaded.write(answer, folder, figures=not no_figures, bar=bar)
    click.echo(loaded.report(answer, files))
    complaints = loaded.complaints(answer)
    for complaint in complaints:
        click.echo(f"holdfast: {complaint}", err=True)
    if complaints:
        sys.exit(NOT_ANSWERED)
