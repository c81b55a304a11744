"""Options of several commands (--set, --out, --runs, --seed), and the exit statuses."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

ANSWERED, NOT_ANSWERED, BAD_INPUT = 0, 1, 2
"""Exit status of a command."""


class WholeNumber(click.ParamType):  # type: ignore[type-arg]
    """A whole number that is written in digits."""

    name = "integer"

    def convert(
        self, value: Any, parameter: click.Parameter | None, context: click.Context | None
    ) -> int:
        text = str(value).strip()
        shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
        if not re.fullmatch(r"[+-]?[0-9]+", text):
            self.fail(f"'{shown}' is not a whole number in digits, such as 200", parameter, context)
        if len(text) > LONGEST or abs(int(text)) >= 2**64:
            self.fail(f"{shown} is too large, expected less than 2^64", parameter, context)
        return int(text)


WHOLE = WholeNumber()
LONGEST = 40

set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a value, such as law.k1=0.2 (repeatable).",
)


def file_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a command that reads a scenario and writes files."""
    for option in (
        click.option("--no-figures", is_flag=True, help="Write the data only."),
        set_option,
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            help="Folder for the results [default: runs/SCENARIO].",
        ),
    ):
        command = option(command)
    return command


def simulation_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a command that simulates."""
    for option in (
        click.option("--seed", type=WHOLE, help="Seed of every random number."),
        click.option(
            "--runs", type=WHOLE, help="Number of starts: the given states, then random ones."
        ),
        file_options,
    ):
        command = option(command)
    return command
