"""`holdfast store`: kernels by name, kept, checked and published."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.errors import OutputError

if TYPE_CHECKING:
    from holdfast.analysis.kernel_store import Store


@click.group("store")
def command() -> None:
    """Keep kernels by name, check them, and publish them.

    The store is a folder of this user's data, or the one that HOLDFAST_STORE names. A kernel of it
    is store:NAME in a scenario and in hf.load.
    """


@command.command("add")
@click.argument("file")
@click.option("--name", help="Name of the kernel in the store [default: that of the file].")
@click.option("--licence", default="", help="Text of the licence, for users of the kernel.")
@click.option("--citation", default="", help="Text of the citation, for users of the kernel.")
def add(file: str, name: str | None, licence: str, citation: str) -> None:
    """Put FILE into the store, or the kernel FOLDER#NAME or https://...#NAME."""
    from holdfast.analysis.decomposition.parts_value import PartsValue
    from holdfast.analysis.kernel_store import Store, entry_of, found
    from holdfast.analysis.load import load
    from holdfast.analysis.reachability.value_function import ValueFunction

    store = Store()
    path, said = found(file, store)
    value = load(path, lazy=True)
    if not isinstance(value, ValueFunction | PartsValue):
        raise OutputError(f"{file} is no kernel", expected="the file of a value function")
    named = name or (said.name if said else path.stem)
    if not name:
        _check_default(named)
    texts = (licence or said.licence, citation or said.citation) if said else (licence, citation)
    entry = store.add(path, entry_of(path, value, named, *texts))
    click.echo(f"added: {entry.name} ({entry.bytes / 2**20:,.1f} MiB, {entry.sha256[:12]})")


@command.command("list")
def list_() -> None:
    """List the kernels of the store."""
    from holdfast.analysis.kernel_store import Store

    store = Store()
    entries = store.entries()
    for name, entry in entries.items():
        about = _shown(f"{entry.problem.get('kind', '')} of {entry.problem.get('system', '')}")
        click.echo(f"{name:<30} {entry.bytes / 2**20:>10,.1f} MiB  {entry.sha256[:12]}  {about}")
    if not entries:
        click.echo(f"{store.folder} has no kernels")


@command.command("show")
@click.argument("name")
def show(name: str) -> None:
    """Show what the index says of NAME, and where its file is."""
    import json
    from dataclasses import asdict

    from holdfast.analysis.kernel_store import Store

    store = Store()
    click.echo(json.dumps(asdict(store.entry(name)), indent=2))
    click.echo(f"file: {store.path(name)}")


@command.command("verify")
@click.argument("names", nargs=-1)
def verify(names: tuple[str, ...]) -> None:
    """Read the files of NAMES, or of all, and compare their digests.

    Without NAMES, files without a name are listed too.
    """
    from holdfast.analysis.kernel_store import Store

    store = Store()
    chosen = names or tuple(store.entries())
    if not chosen:
        click.echo(f"{store.folder} has no kernels")
    faults = [fault for name in chosen if (fault := _verified(store, name))]
    for path in [] if names else store.unnamed():
        size = path.stat().st_size / 2**20
        whole = path.suffix == ".nc"
        advice = "add it with --name" if whole else "a download that stopped: fetch it again"
        click.echo(f"no name has {path} ({size:,.1f} MiB): {advice}, or delete it")
    if faults:
        raise OutputError("; ".join(faults))


@command.command("remove")
@click.argument("name")
def remove(name: str) -> None:
    """Remove NAME, and its file if no other name has it."""
    from holdfast.analysis.kernel_store import Store

    click.echo(f"removed: {Store().remove(name).name}")


@command.command("publish")
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1, required=True)
def publish(folder: Path, names: tuple[str, ...]) -> None:
    """Write NAMES to FOLDER with an index, to be put beside a paper or on a web server."""
    from holdfast.analysis.kernel_store import Store

    index = Store().publish(names, folder)
    click.echo(f"written: {index}; load them as {folder}#NAME, or https://...#NAME from a server")


def _check_default(name: str) -> None:
    from holdfast.analysis.kernel_store import check_name

    try:
        check_name(name)
    except OutputError as error:
        raise OutputError(error.cause, expected=error.expected, remedy="give --name") from None


def _verified(store: Store, name: str) -> str:
    """What is wrong with the file of a kernel, or an empty text."""
    try:
        entry = store.verify(name)
    except OutputError as error:
        return str(error)
    click.echo(f"as it was added: {entry.name} ({entry.sha256[:12]})")
    return ""


def _shown(text: str) -> str:
    """A text of an index without what a terminal would obey."""
    return "".join(c if c.isprintable() else "?" for c in text)[:80]
