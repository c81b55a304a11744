"""The state of a filter in a few lines, for a terminal that is drawn again and again."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from holdfast.analysis.online.decision import DecisionRecord
from holdfast.analysis.online.interventions import GRAVITY, Intervention

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
        given, wanted = self.record.input[name], self.record.command.get(name, math.nan)
        said = f"command {_number(wanted):>9}  input {_number(given):>9}"
        difference = given - wanted
        if difference:
            said += "" if math.isnan(difference) else f"  ({difference:+.2g})"
        line = _cut(f"{_cut(name, LEFT - 1):<{LEFT}}{said}", width)
        return self._in(line, YELLOW) if difference else line

    def _columns(self, across: int) -> list[list[Point]]:
        """The points of each column; the last column is now."""
        assert self.record is not None
        found: list[list[Point]] = [[] for _ in range(across)]
        for point in self._points:
            age = (self.record.t - point.t) / SPAN
            found[max(across - 1 - int(age * across), 0)].append(point)
        return found

    def _trend(self, across: int) -> str:
        """The least value of each column; the scale reaches from 0, or below, to the greatest."""
        least = [
            min((p.value for p in column if not math.isnan(p.value)), default=math.nan)
            for column in self._columns(across)
        ]
        known = [v for v in least if math.isfinite(v)]
        low, high = min([0.0, *known]), max([0.0, *known])
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
