"""`holdfast list`: the entries of the catalogue and the scenarios, one line each."""

from __future__ import annotations

import click


@click.command("list")
def command() -> None:
    """List the systems, laws, regions, fields, vehicles and scenarios, one line each."""
    from holdfast.studies.catalogue import catalogue_lines

    for line in catalogue_lines():
        click.echo(line)
