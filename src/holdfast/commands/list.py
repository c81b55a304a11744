"""`holdfast list`: the entries of the catalogue and the scenarios, one line each."""

from __future__ import annotations

import click


@click.command("list")
@click.argument("words", nargs=-1)
def command(words: tuple[str, ...]) -> None:
    """List the systems, laws, regions, fields, vehicles and scenarios, one line each.

    With WORDS, such as "bicycle", those that have them, and what the glossary says of them.
    """
    from holdfast.studies.catalogue import catalogue_lines

    for line in catalogue_lines(" ".join(words)):
        click.echo(line)
