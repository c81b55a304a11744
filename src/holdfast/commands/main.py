"""The command line. Heavy imports wait until a command needs them."""

from __future__ import annotations

import os
import sys
import warnings
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from typing import NoReturn

import click

from holdfast._version import __version__
from holdfast.commands.options import ANSWERED, BAD_INPUT, NOT_ANSWERED
from holdfast.errors import GainWarning, HoldfastError, suggestion
from holdfast.host.files import FETCH_VARIABLE
from holdfast.host.interruption import INTERRUPTED, end, listening, said
from holdfast.host.streams import forgiving


class Commands(click.Group):
    """Every module beside this one that has a `command`: `export_c.py` is `export-c`."""

    def list_commands(self, context: click.Context) -> list[str]:
        names = (m.name.replace("_", "-") for m in iter_modules([str(Path(__file__).parent)]))
        return sorted(n for n in names if self.get_command(context, n) is not None)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        module = f"holdfast.commands.{name.replace('-', '_')}"
        if "." in name or "_" in name or find_spec(module) is None:
            return None
        return getattr(import_module(module), "command", None)

    def resolve_command(
        self, context: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if self.get_command(context, args[0]) is None and not args[0].startswith("-"):
            help_ = suggestion(args[0], self.list_commands(context))
            context.fail(f"No such command '{args[0]}'; {help_}")
        return super().resolve_command(context, args)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="holdfast")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.option("--fetch", is_flag=True, help="Scenarios may fetch kernels that they name (https:).")
def cli(debug: bool, fetch: bool) -> None:
    """Viability control of nonholonomic systems.

    Exit status: 0 the question was answered, 1 it was not (a run
    diverged, chattered or left its grid, a promise fell short, no limit
    was found), 2 bad input, 130 interrupted, 143 terminated.
    """


def main() -> NoReturn:
    """Run the command line and exit; every refusal is one message on standard error."""
    with listening(), forgiving() as out:
        try:
            _main()
        except SystemExit as ended:
            out.flush()
            if out.trouble and not ended.code:
                _fail(f"standard output cannot be written ({out.trouble})", NOT_ANSWERED)
            raise


def _main() -> NoReturn:
    debug, fetch = "--debug" in sys.argv[1:], "--fetch" in sys.argv[1:]
    warnings.showwarning = _show_warning
    warnings.simplefilter("always", GainWarning)
    if fetch:
        os.environ[FETCH_VARIABLE] = "1"  # for processes of workers too
    arguments = [a for a in sys.argv[1:] if a not in ("--debug", "--fetch")]
    try:
        code = cli.main(arguments, prog_name="holdfast", standalone_mode=False)
        sys.exit(code if isinstance(code, int) else ANSWERED)
    except HoldfastError as error:
        if debug:
            raise
        _fail(str(error), BAD_INPUT)
    except MemoryError as error:
        if debug:
            raise
        reason = " ".join(str(error).split()) or "no more of it is given"
        _fail(
            f"not enough memory: {reason}; take a longer sample time, a shorter horizon, fewer "
            "starts or a coarser grid",
            BAD_INPUT,
        )
    except FileNotFoundError:
        if debug or _is_somewhere():
            raise
        _fail("the current folder was deleted; change to another", BAD_INPUT)
    except (click.exceptions.Abort, KeyboardInterrupt):
        end(INTERRUPTED, said())
    except click.ClickException as error:
        error.show()
        sys.exit(BAD_INPUT)


def _is_somewhere() -> bool:
    """Whether the current folder is there."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def _fail(message: str, status: int) -> NoReturn:
    click.echo(f"holdfast: {message}", err=True)
    sys.exit(status)


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: object = None,
    line: str | None = None,
) -> None:
    text = f"holdfast: warning: {message}"
    if "tqdm" in sys.modules:  # keep clear of the progress bar
        sys.modules["tqdm"].tqdm.write(text, file=sys.stderr)
    else:
        click.echo(text, err=True)
