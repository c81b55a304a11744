"""Interventions of a filter as sentences, and the table of a whole stream."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from holdfast.analysis.online.interventions import Event

MOST_NAMED = 4
"""Changes of inputs that a line shows."""


def event_line(event: Event) -> str:
    """One line: the time, what began, grew graver or ended, and why."""
    of = event.intervention
    if event.what != "ended":
        more = "now " if event.what == "graver" else ""
        known = of.why.startswith(of.kind.split(",")[0])  # the sentence says it itself
        said = of.why if known else f"{of.kind}: {of.why}" if of.why else of.kind
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
    rows = [("samples", f"{total:,} in {seconds:.2f} s{_sessions(said['sessions'])}")]
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


def _sessions(count: int) -> str:
    return f", {count} sessions" if count > 1 else ""


def _share(share: float) -> str:
    return f"{100 * share:.3g} %"
