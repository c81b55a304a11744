"""`holdfast show`: the equations of one catalogue entry, or the text of a scenario."""

from __future__ import annotations

from pathlib import Path

import click

from holdfast.errors import ScenarioError
from holdfast.host.files import check_writable, make_folder


@click.command("show")
@click.argument("name")
@click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="An argument of a system or field, such as lam=2 (repeatable).",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Also write the figure of a field, its flow lines, to this folder.",
)
def command(name: str, overrides: tuple[str, ...], out: Path | None) -> None:
    """Show the equations, the parameters with units and the source of NAME.

    For a field, its known facts are shown too; for a scenario, its text. For a word of the
    glossary, such as "bicycle", what it is here.
    """
    from holdfast.studies.catalogue import describe

    if out is not None:
        from holdfast.maths.catalogue import fields
        from holdfast.scenario.files import load_field

        if name not in [f.__name__ for f in fields.ALL]:
            raise ScenarioError(f"'{name}' has no figure", expected="a field with --out")
        check_writable(out)
        field = load_field(name, overrides)
    from holdfast.studies.progress import bounded

    with bounded(f"showing '{name}'", 60.0, "use fewer dimensions or simpler values"):
        text = describe(name, overrides)
    click.echo(text)
    if out is not None:
        from holdfast.presentation.figures import style
        from holdfast.presentation.figures.flow_lines import flow_lines_figure

        make_folder(out)
        written = style.write(flow_lines_figure(field), out, name)
        click.echo(f"\n  files in {out}: " + ", ".join(f.name for f in written))
