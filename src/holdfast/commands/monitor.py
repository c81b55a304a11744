"""`holdfast monitor`: when a filter intervened and why, as it happens."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from holdfast.commands.options import ANSWERED, NOT_ANSWERED
from holdfast.errors import OutputError, ScenarioError, SimulationError
from holdfast.host.files import check_writable, write_summary
from holdfast.host.interruption import postponed
from holdfast.host.streams import (
    Foot,
    descriptor_of,
    has_blocks,
    has_colours,
    has_reader,
    is_live,
    lines,
    plain,
)

if TYPE_CHECKING:
    from holdfast.analysis.online.decision import DecisionRecord, Event
    from holdfast.interop.decision_log import DecisionLog

REFRESH = 0.1
"""Seconds between two drawings."""
MOST_REFUSALS = 20
"""Lines that are no decisions and are shown."""


@click.command("monitor")
@click.argument("file", type=click.Path(), default="-")
@click.option(
    "--gap",
    type=float,
    help="Seconds between two interventions that are shown as one [default: 0.5].",
)
@click.option(
    "--mcap",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write decisions, interventions and sentences to this file, for Foxglove.",
)
@click.option(
    "--summary",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the summary and every intervention to this file (JSON).",
)
def command(file: str, gap: float | None, mcap: Path | None, summary: Path | None) -> None:
    """Show when a filter intervened and why, from the decisions in FILE or on standard input.

    A decision is a line of `holdfast filter` or of its --log. On a terminal the last seconds are
    drawn at its foot; elsewhere there is one line where an intervention begins, grows graver or
    ends. The summary stands at the end, also after Ctrl-C.
    """
    if summary is not None:
        check_writable(summary.parent, "--summary")
        if summary.exists():
            raise OutputError(f"{summary} exists already", remedy="choose another for --summary")
    with ExitStack() as stack, postponed() as asked:
        watch = Watch(gap)
        descriptor = stack.enter_context(_opened(file))
        if mcap is not None:
            watch.log = stack.enter_context(_mcap(mcap))
        for line in lines(descriptor, REFRESH):
            if asked() or not has_reader(sys.stdout):
                break
            if line is not None:
                watch.read(line)
            watch.refresh()
        watch.end()
    if summary is not None:
        write_summary(summary, watch.summary() | {"list": [i.plain() for i in watch.ended]})
    if not watch.seen.samples:
        click.echo("holdfast: there was no decision to read", err=True)
    answered = watch.seen.samples > 0 and not watch.refused
    sys.exit(asked() or (ANSWERED if answered else NOT_ANSWERED))


class Watch:
    """Reads decisions, and says what happened on a terminal or in lines, and in a log."""

    def __init__(self, gap: float | None) -> None:
        from holdfast.analysis.online.decision import GAP, Intervention, Interventions
        from holdfast.presentation.text.interventions import Live

        self.seen = Interventions(GAP if gap is None else gap)
        self.ended: list[Intervention] = []
        self.log: DecisionLog | None = None
        self.refused = self.number = 0
        out = sys.stdout
        self.foot = Foot(out) if is_live(out) else None
        self.live = Live(colours=has_colours(out), blocks=has_blocks(out))
        self._said: list[str] = []
        self._drawn = -REFRESH
        self._heard = time.monotonic()

    def read(self, line: bytes) -> None:
        """Take the next line of the stream."""
        from holdfast.analysis.online.decision import DecisionRecord

        self.number += 1
        self._heard = time.monotonic()
        try:
            record = DecisionRecord.read(line)
            events = self.seen.add(record)
        except SimulationError as error:
            self.refused += 1
            if self.refused <= MOST_REFUSALS:
                more = "; further ones are counted" if self.refused == MOST_REFUSALS else ""
                self._say(f"line {self.number}: {error.cause}{more}")
            return
        self.live.add(record)
        self._write(record, events)

    def _write(self, record: DecisionRecord | None, events: list[Event]) -> None:
        from holdfast.presentation.text.interventions import event_line

        if self.log is not None and record is not None:
            self.log.decided(record)
        for event in events:
            line = event_line(event)
            self._say(line)
            if event.what == "ended":
                self.ended.append(event.intervention)
            if self.log is not None:
                self.log.happened(event, line.partition(" s  ")[2])

    def _say(self, text: str) -> None:
        text = plain(text, sys.stdout)
        if self.foot is None:
            click.echo(text)
        else:
            from holdfast.presentation.text.interventions import wrapped

            self._said += wrapped(text, self.foot.size[0])

    def refresh(self, last: bool = False) -> None:
        """Draw, not more often than every `REFRESH`."""
        now = time.monotonic()
        if self.foot is None or (now - self._drawn < REFRESH and not last):
            return
        seen = self.seen
        shown = self.live.lines(self.foot.size[0], seen.current, seen.count, now - self._heard)
        self.foot.draw([] if last else shown, self._said)
        self._said, self._drawn = [], now

    def end(self) -> None:
        """The stream has ended: what goes on is closed, and the summary is said."""
        from holdfast.presentation.text.interventions import summary_lines

        self._write(None, self.seen.end())
        self.refresh(last=True)
        if self.seen.samples:
            click.echo("\n" + "\n".join(summary_lines(self.summary())))

    def summary(self) -> dict[str, Any]:
        """For JSON."""
        refused = {"lines_refused": self.refused} if self.refused else {}
        return self.seen.summary() | refused


@contextmanager
def _opened(file: str) -> Iterator[int]:
    """The descriptor of a file, a named pipe or standard input."""
    if file == "-":
        yield descriptor_of(sys.stdin)
        return
    try:
        descriptor = os.open(file, os.O_RDONLY)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a valid file name"
        raise ScenarioError(f"{file}: cannot be read ({reason})") from None
    try:
        yield descriptor
    except IsADirectoryError:
        raise ScenarioError(f"{file}: cannot be read (it is a folder)") from None
    finally:
        os.close(descriptor)


def _mcap(path: Path) -> DecisionLog:
    try:
        from holdfast.interop.decision_log import DecisionLog
    except ModuleNotFoundError as error:
        raise OutputError(
            f"--mcap needs the package '{error.name}', which is not installed",
            remedy='pip install "holdfast[interop]"',
        ) from None
    return DecisionLog(path)
