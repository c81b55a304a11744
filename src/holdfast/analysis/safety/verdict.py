"""What closed loops said of a set: how many starts each disturbance left, and the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.simulation.law_comparison import Rate

LISTED = 20
"""Starts that were beaten, in a summary."""


@dataclass(frozen=True)
class Trials:
    """Starts against one kind of disturbance: `kept` stayed in the region, or, of a basin, reached
    the goal through it, and never left the grid on the way. off_grid: how many left the grid, where
    nothing is known, before they left the region. excursion: the largest max_j c_j / s_j of any run
    (of a basin, whose runs go on beyond the goal, not a number)."""

    what: str
    kept: Rate
    off_grid: int
    excursion: float
    relaxed: int


@dataclass(frozen=True)
class Beaten:
    """A start that was not kept: which one, by which disturbance first, how it ended and when."""

    start: tuple[float, ...]
    by: str
    outcome: str
    time: float


@dataclass(frozen=True)
class Promise:
    """Closed loops from random states inside the set, and from states of K outside it.

    margin: V of the states inside is above it, and of those outside below -margin; None: one cell
    along any axis from the states inside V is above `held_loss`, the most that it can fall by while
    an input is held (0 where no state is as far inside), and from those outside it is below 0.
    share: how much of the set is that far inside. inside: against every disturbance that
    was tried, then against each kind; a single entry where the system has none. outside: against
    the gradient of the value, None where K has no such state. beaten: the starts not kept.
    doubt: why the runs cannot confirm the set, even if all of them are kept.
    """

    law: str
    margin: float | None
    unit: str
    horizon: float
    sample_time: float
    inside: tuple[Trials, ...]
    outside: Trials | None
    aim: str = "stay"
    beaten: tuple[Beaten, ...] = ()
    doubt: str = ""
    held_loss: float = 0.0
    share: float = 1.0

    @property
    def held(self) -> bool:
        """Whether every run from inside stayed."""
        return all(t.kept.count == t.kept.total for t in self.inside)

    @property
    def confirmed(self) -> bool:
        """Whether every run from inside stayed, and the set does not rest on extrapolation."""
        return self.held and not self.doubt

    @property
    def depth(self) -> str:
        """How far inside the starts are."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        if self.margin is not None:
            return f"{self.margin:.3g}{unit}"
        return "a cell" + (f" and {self.held_loss:.3g}{unit}" if self.held_loss else "")

    @property
    def depth_outside(self) -> str:
        """How far outside the others are."""
        return "a cell" if self.margin is None else self.depth

    @property
    def verdict(self) -> str:
        """What the promise falls short of, or nothing."""
        total = self.inside[0]
        if not self.held:
            off = f", {total.off_grid} left the grid" if total.off_grid else ""
            return (
                f"the promise falls short: {total.kept.count} of {total.kept.total} starts "
                f"{self.depth} inside {self.aim}{off}"
            )
        return f"the promise is not confirmed: {self.doubt}" if self.doubt else ""

    def summary(self) -> dict[str, Any]:
        """For summary.json."""

        def said(t: Trials) -> dict[str, Any]:
            worst = t.excursion if math.isfinite(t.excursion) else None
            more = {"left_grid": t.off_grid, "worst_constraint": worst, "runs_relaxed": t.relaxed}
            return {"against": t.what, "runs": t.kept.total, **t.kept.summary(), **more}

        return {
            "law": self.law,
            "margin": "one cell" if self.margin is None else self.margin,
            "held_loss": self.held_loss,
            "share_of_set": self.share,
            "unit": self.unit,
            "horizon_s": self.horizon,
            "sample_time_s": self.sample_time,
            "held": self.held,
            "confirmed": self.confirmed,
            "verdict": self.verdict,
            "inside": [said(t) for t in self.inside],
            "beaten": [
                {"start": list(b.start), "by": b.by, "outcome": b.outcome, "time_s": b.time}
                for b in self.beaten[:LISTED]
            ],
            "outside": said(self.outside) if self.outside else None,
        }
