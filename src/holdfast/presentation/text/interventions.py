"""The interventions of a filter as text: sentences, a table of the stream, lines as it runs.

The lines are for a terminal that is drawn again and again.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from holdfast.analysis.online.decision import GRAVITY, DecisionRecord, Event, Intervention

SPAN = 10.0
"""Seconds of the stream that the trends show."""
COLUMNS = 60
"""Columns of a trend, at most."""
LEFT, RIGHT = 12, 20
"""Columns before a trend, and behind it."""
SILENT = 1.0
"""Seconds without a decision after which it is said."""
MOST_INPUTS = 6
BARS, MARKS = "▁▂▃▄▅▆▇█", "·▄█"
PLAIN_BARS, PLAIN_MARKS = "_.-=+*%#", ".x#"
GREEN, YELLOW, RED, FAINT, BOLD = "32", "33", "31", "2", "1"


class Point(NamedTuple):
    """A sample of the trends: gravity is 0 passed, 1 changed, 2 worse."""

    t: float
    value: float
    gravity: int


class Live:
    """The last seconds of a stream, as lines of a given width."""

    def __init__(self, *, colours: bool, blocks: bool) -> None:
        self.colours = colours
        self.bars, self.marks = (BARS, MARKS) if blocks else (PLAIN_BARS, PLAIN_MARKS)
        self.rule = "─" if blocks else "-"
        self.record: DecisionRecord | None = None
        self.why = ""
        self._points = deque[Point]()

    def add(self, record: DecisionRecord) -> None:
        """Take the next decision."""
        if self.record is not None and record.t < self.record.t:
            self._points.clear()
        self.record = record
        self._points.append(Point(record.t, record.value, gravity_of(record)))
        while self._points[0].t < record.t - SPAN:
            self._points.popleft()
        if record.why or not record.intervened:
            self.why = record.why

    def lines(
        self, width: int, current: Intervention | None, count: int, silence: float
    ) -> list[str]:
        """What is drawn. silence: seconds since the last decision, by the clock on the wall."""
        rule = self._in(self.rule * width, FAINT)
        record = self.record
        if record is None:
            return [rule, _cut(f"no decision yet{_waited(silence)}", width)]
        across = max(min(width - LEFT - RIGHT, COLUMNS), 8)
        worst = max(p.gravity for p in self._points)
        changed = sum(p.gravity > 0 for p in self._points) / len(self._points)
        slack = f", slack {record.slack:.3g}" if record.slack > 0 else ""
        value = "unknown" if math.isnan(record.value) else f"{record.value:.3g}"
        rows = [
            rule,
            self._head(width, record, current, count, silence),
            f"{'value':<{LEFT}}{self._trend(across)}  {_cut(value + slack, RIGHT - 2)}",
            f"{'intervened':<{LEFT}}{self._lane(across)}  "
            + self._in(_cut(f"{100 * changed:.0f} % of {SPAN:g} s", RIGHT - 2), _colour(worst)),
            *(self._input(name, width) for name in list(record.input)[:MOST_INPUTS]),
        ]
        if (more := len(record.input) - MOST_INPUTS) > 0:
            rows.append(f"{'':<{LEFT}}and {more} more inputs")
        rows.append(self._in(_cut(self.why, width), FAINT))
        return rows

    def _head(
        self,
        width: int,
        record: DecisionRecord,
        current: Intervention | None,
        count: int,
        silence: float,
    ) -> str:
        """Time, status, since when, and how often."""
        state = f"no {record.lost}" if record.lost else record.status
        since = ""
        if current is not None:
            since = f" since {current.begins:.2f} s ({record.t - current.begins:.2f} s)"
        gravity = gravity_of(record)
        if silence > SILENT:
            state, since, gravity = f"no decision{_waited(silence)}", "", 2
        left, right = f"{record.t:.2f} s  ", f"{count} intervention{'s' * (count != 1)}"
        room = width - len(left)
        shown = _cut(f"{state.upper()}{since}", room)
        gap = room - len(shown) - len(right)
        coloured = self._in(shown, f"{BOLD};{_colour(gravity)}")
        return left + coloured + (" " * gap + right if gap >= 2 else "")

    def _input(self, name: str, width: int) -> str:
        """The command and the input."""
        assert self.record is not None
        applied, wanted = self.record.input[name], self.record.command.get(name, math.nan)
        said = f"command {_number(wanted):>9}  input {_number(applied):>9}"
        difference = applied - wanted
        if difference:
            said += "" if math.isnan(difference) else f"  ({difference:+.2g})"
        line = _cut(f"{_cut(name, LEFT - 1):<{LEFT}}{said}", width)
        return self._in(line, YELLOW) if difference else line

    def _columns(self, across: int) -> list[list[Point]]:
        """The points of each column; the last column is now."""
        assert self.record is not None
        columns: list[list[Point]] = [[] for _ in range(across)]
        for point in self._points:
            age = (self.record.t - point.t) / SPAN
            columns[max(across - 1 - int(age * across), 0)].append(point)
        return columns

    def _trend(self, across: int) -> str:
        """The least value of each column; the scale reaches from 0, or below, to the greatest."""
        least = [
            min((p.value for p in column if not math.isnan(p.value)), default=math.nan)
            for column in self._columns(across)
        ]
        finite = [v for v in least if math.isfinite(v)]
        low, high = min([0.0, *finite]), max([0.0, *finite])
        shown = []
        for v in least:
            if not math.isfinite(v):
                shown.append(" ")
                continue
            step = int((v - low) / (high - low) * len(self.bars)) if high > low else 0
            bar = self.bars[min(step, len(self.bars) - 1)]
            shown.append(self._in(bar, RED) if v < 0 else bar)
        return "".join(shown)

    def _lane(self, across: int) -> str:
        """What the filter did in each column."""
        worst = [max((p.gravity for p in c), default=-1) for c in self._columns(across)]
        return "".join(self._in(self.marks[g], _colour(g)) if g >= 0 else " " for g in worst)

    def _in(self, text: str, colour: str) -> str:
        return f"\x1b[{colour}m{text}\x1b[0m" if self.colours and text else text


def gravity_of(record: DecisionRecord) -> int:
    """0 passed, 1 changed, 2 nothing is promised or something is lost."""
    return 2 if record.lost else min(GRAVITY.index(record.status), 2)


def _colour(gravity: int) -> str:
    return (GREEN, YELLOW, RED)[gravity]


def _waited(silence: float) -> str:
    return f" for {silence:.0f} s" if silence > SILENT else ""


def _number(value: float) -> str:
    return "unknown" if math.isnan(value) else f"{value:.4g}"


def _cut(text: str, width: int) -> str:
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= width else text[: max(width - 3, 0)] + "..."


def wrapped(line: str, width: int) -> Sequence[str]:
    """A line of the log in a terminal: what does not fit goes below its first word."""
    from textwrap import wrap

    return wrap(line, max(width, 24), subsequent_indent=" " * 13, drop_whitespace=True) or [line]


MOST_NAMED = 4
"""Changes of inputs that a line shows."""


def event_line(event: Event) -> str:
    """One line: the time, what began, grew graver or ended, and why."""
    of = event.intervention
    if event.what != "ended":
        more = "now " if event.what == "graver" else ""
        names_kind = of.why.startswith(of.kind.split(",")[0])  # the sentence says it itself
        said = of.why if names_kind else f"{of.kind}: {of.why}" if of.why else of.kind
        return f"{event.t:9.2f} s  {more}{said}"
    parts = [f"{of.kind} for {of.duration:.2f} s{_largest(of.changes)}"]
    if of.constraints:
        parts.append(", ".join(of.constraints))
    if not math.isnan(of.value):
        parts.append(f"least value {of.value:.3g}")
    if of.slack > 0:
        parts.append(f"largest slack {of.slack:.3g}")
    return f"{event.t:9.2f} s  ended: " + "; ".join(parts)


def _largest(changes: Mapping[str, float]) -> str:
    """The largest change of each input."""
    if not changes:
        return ""
    shown = [f"{name} by {value:+.3g}" for name, value in list(changes.items())[:MOST_NAMED]]
    more = len(changes) - MOST_NAMED
    return ", at most " + ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def summary_lines(said: Mapping[str, Any]) -> list[str]:
    """The summary of a stream, a line for each number."""
    total, seconds = said["samples"], said["duration"]
    sessions = f", {said['sessions']} sessions" if said["sessions"] > 1 else ""
    rows = [("samples", f"{total:,} in {seconds:.2f} s{sessions}")]
    rows += [(status, _share(share)) for status, share in said["share"].items()]
    if lost := said["lost"].get("command"):
        rows.append(("of which without a command", _share(lost)))
    rows.append(("interventions", f"{said['interventions']}, {said['intervened']:.2f} s in all"))
    if longest := said.get("longest_intervention"):
        rows.append(("longest", f"{longest['duration']:.2f} s, from {longest['begins']:.2f} s"))
    if worst := said.get("worst_value"):
        rows.append(("worst value", f"{worst['value']:.3g} at {worst['t']:.2f} s"))
    rows.append(("longest silence", f"{said['longest_silence']:.3g} s"))
    if refused := said.get("lines_refused"):
        rows.append(("no decisions", f"{refused} line{'s' * (refused > 1)}"))
    width = max(len(name) for name, _ in rows)
    return [f"  {name:<{width}}  {value}" for name, value in rows]


def _share(share: float) -> str:
    return f"{100 * share:.3g} %"
