"""The verdict of a closed-loop validation: starts kept against each disturbance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.simulation.law_comparison import Rate

LISTED = 20
"""Most beaten starts listed in a summary."""


@dataclass(frozen=True)
class Trials:
    """Starts against one kind of disturbance: `kept` stayed in the region, or, of a basin, reached
    the goal through it, and never left the grid on the way. off_grid: the number that left the
    grid, where V is unknown, before the region. excursion: the largest max_j c_j / s_j of any run
    (NaN for a basin, whose runs continue beyond the goal)."""

    what: str
    kept: Rate
    off_grid: int
    excursion: float
    relaxed: int


@dataclass(frozen=True)
class Beaten:
    """A lost start: its state, the first disturbance that beat it, its outcome and time."""

    start: tuple[float, ...]
    by: str
    outcome: str
    time: float


@dataclass(frozen=True)
class Promise:
    """Closed loops from random states inside the set, and from states of K outside it.

    margin: V of the states inside is above it, and of those outside below -margin. None: one cell
    along any axis from the states inside V is above `held_loss`, the most that it can fall while
    an input is held (0 if no state is as far inside), and from those outside it is below 0.
    share: the share of the set that is as far inside. inside: against all disturbances together,
    then against each kind; a single entry for a system without disturbances. outside: against the
    gradient of the value, None if K has no such state. beaten: the lost starts. doubt: the reason
    why the runs cannot confirm the set, even if all of them are kept.
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
        """Whether every run from inside stayed, and the set does not depend on extrapolation."""
        return self.held and not self.doubt

    @property
    def depth(self) -> str:
        """The depth of the starts inside the set."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        if self.margin is not None:
            return f"{self.margin:.3g}{unit}"
        return "a cell" + (f" and {self.held_loss:.3g}{unit}" if self.held_loss else "")

    @property
    def depth_outside(self) -> str:
        """The depth of the other starts outside the set."""
        return "a cell" if self.margin is None else self.depth

    @property
    def verdict(self) -> str:
        """The shortfall of the promise as a sentence, or an empty text."""
        total = self.inside[0]
        if not self.held:
            off = f", {total.off_grid} left the grid" if total.off_grid else ""
            return (
                f"the promise falls short: {total.kept.count} of {total.kept.total} starts "
                f"{self.depth} inside {self.aim}{off}"
            )
        return f"the promise is not confirmed: {self.doubt}" if self.doubt else ""

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""

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
