"""What the trial of a kernel comes to: counts of starts, layers of the set, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from textwrap import wrap
from typing import Any

from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.maths.definitions.value import COLUMNS, Printed

LISTED = 20
"""Most beaten starts listed in a summary."""

CONFIRMED, FROM_INSIDE = "confirmed", "confirmed from inside"
UNCONFIRMED, FELL_SHORT = "not confirmed", "fell short"


EVERY = "every start is kept"


def shortfall(rate: Rate, depth: str, aim: str = "stay") -> str:
    """That not all starts are kept, as a sentence."""
    return f"the promise falls short: {rate.count} of {rate.total} starts {depth} inside {aim}"


def confirmation(share: float, claim: str, whence: str, edge: Rate | None, missed: str = "") -> str:
    """On which share of the set starts are kept, as a sentence.

    whence: how far inside they begin, where not all are kept that are nearer to the edge; edge: how
    many of these are, None where none was tried; missed: what follows on those that are lost.
    """
    where = f"from {whence} inside on, " if whence else "on "
    sentence = f"confirmed {where}{100 * share:.3g} % of the set: {claim}"
    if not whence or edge is None:
        return sentence
    lost = edge.total - edge.count
    return f"{sentence}; of {edge.total} starts nearer to the edge {lost} are lost{missed}"


@dataclass(frozen=True)
class Trials:
    """Starts against one kind of disturbance: `kept` stayed in the region, or, of a basin, reached
    the goal through it, and never left the grid on the way. off_grid: the number that was lost to
    nothing else: they left the grid, beyond which V is unknown, before the region. excursion: the
    largest max_j c_j / s_j of any run (NaN for a basin, whose runs continue beyond the goal)."""

    what: str
    kept: Rate
    off_grid: int
    excursion: float
    relaxed: int

    @property
    def refuting(self) -> int:
        """The number of lost starts that left the region, or missed the goal, within the grid."""
        return self.kept.total - self.kept.count - self.off_grid

    @property
    def line(self) -> str:
        """The numbers, for `print`."""
        off = f", {self.off_grid} left the grid" if self.off_grid else ""
        return f"{self.kept.count} of {self.kept.total} kept{off}"

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""
        worst = self.excursion if math.isfinite(self.excursion) else None
        more = {"left_grid": self.off_grid, "worst_constraint": worst, "runs_relaxed": self.relaxed}
        return {"against": self.what, "runs": self.kept.total, **self.kept.summary(), **more}


@dataclass(frozen=True)
class Beaten:
    """A lost start: its state, the first disturbance that beat it, its outcome and time."""

    start: tuple[float, ...]
    by: str
    outcome: str
    time: float


@dataclass(frozen=True)
class Layer:
    """States of the set nearer to its edge than the starts `inside`, and what of them is kept.

    where: the depth in words; down_to: the depth at which the layer ends. share: of the volume of
    the set. missed: by how much the worst of the lost starts within the grid leaves the region, or
    misses the goal, in the unit of V. allowed: how much a held input may lose there; a layer that
    misses more refutes the set. None within a cell of the edge, which a grid does not know better.
    """

    where: str
    down_to: str
    share: float
    trials: Trials
    missed: float = 0.0
    allowed: float | None = None

    @property
    def lost(self) -> int:
        """The number of starts that are lost."""
        return self.trials.kept.total - self.trials.kept.count

    @property
    def refutes(self) -> bool:
        """Whether more is lost than an input that is held may lose."""
        lost = self.trials.refuting > 0
        return lost and self.allowed is not None and not self.missed <= self.allowed

    @property
    def unknown(self) -> bool:
        """Whether starts that are to be kept leave the grid."""
        return self.allowed is not None and self.trials.off_grid > 0

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""
        missed = self.missed if math.isfinite(self.missed) else None
        more = {"share_of_set": self.share, "missed_by": missed, "allowed": self.allowed}
        return {"where": self.where, **more, **self.trials.summary()}


@dataclass(frozen=True, repr=False)
class Promise(Printed):
    """Closed loops from random states inside the set, and from states of K outside it.

    margin: V of the states inside is above it, and of those outside below -margin. None: one cell
    along any axis from the states inside V is above `held_loss`, the most that it can fall while
    an input is held (0 if no state is as far inside), and from those outside it is below 0.
    share: the share of the set that is as far inside. inside: against all disturbances together,
    then against each kind; a single entry for a system without disturbances. layers: the rest of
    the set, from the inside out to its edge. outside: against the gradient of the value, None if K
    has no such state. beaten: the lost starts inside. doubt: the reason why the runs cannot confirm
    the set, even if all of them are kept.
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
    layers: tuple[Layer, ...] = ()

    def _lines(self) -> tuple[str, list[str], list[str]]:
        head = f"Promise over {self.horizon:g} s, by '{self.law}': {self.outcome}"
        rows = [(t.what, t) for t in self.inside] + [(b.where, b.trials) for b in self.layers]
        if self.outside is not None:
            rows.append((f"at least {self.depth_outside} outside", self.outside))
        return (
            head,
            [f"{what}: {trials.line}" for what, trials in rows],
            wrap(self.conclusion, COLUMNS - 2),
        )

    @property
    def held(self) -> bool:
        """Whether every run from inside stayed, and no start refutes the set."""
        stayed = all(t.kept.count == t.kept.total for t in self.inside)
        return stayed and self._refuting is None and not any(b.unknown for b in self.layers)

    @property
    def confirmed(self) -> bool:
        """Whether every run stayed, up to the edge, and the set depends on no extrapolation."""
        return self.outcome == CONFIRMED

    @property
    def outcome(self) -> str:
        """One of CONFIRMED, FROM_INSIDE, UNCONFIRMED, FELL_SHORT."""
        if self.inside[0].refuting or self._refuting is not None:
            return FELL_SHORT
        if self.doubt or not self.held:
            return UNCONFIRMED
        return FROM_INSIDE if any(b.lost for b in self.layers) else CONFIRMED

    @property
    def tried_share(self) -> float:
        """The share of the set that was tried, by volume."""
        return min(1.0, self.share + sum(b.share for b in self.layers))

    @property
    def kept_share(self) -> float:
        """The share of the set from the inside out to the first layer that loses a start."""
        in_layers = sum(b.share for b in self._kept_layers)
        return min(1.0, self.share + in_layers) if self.held else 0.0

    @property
    def _kept_layers(self) -> tuple[Layer, ...]:
        return tuple(takewhile(lambda b: not b.lost, self.layers))

    @property
    def _refuting(self) -> Layer | None:
        return next((b for b in self.layers if b.refutes), None)

    @property
    def depth(self) -> str:
        """The depth of the starts inside the set."""
        if self.margin is not None:
            return self._amount(self.margin)
        return "a cell" + (f" and {self._amount(self.held_loss)}" if self.held_loss else "")

    def _amount(self, value: float) -> str:
        """A difference of V with its unit."""
        return f"{value:.3g}" + ("" if self.unit == "1" else f" {self.unit}")

    def _beyond(self, layers: Sequence[Layer]) -> str:
        """How far lost starts come."""
        if any(b.trials.off_grid for b in layers):
            return "some off the grid"
        missed = max(b.missed for b in layers)
        return f"by up to {self._amount(missed)}" if math.isfinite(missed) else "some without end"

    @property
    def depth_outside(self) -> str:
        """The depth of the other starts outside the set."""
        return "a cell" if self.margin is None else self.depth

    @property
    def verdict(self) -> str:
        """The shortfall of the promise as a sentence, or an empty text."""
        total = self.inside[0]
        if total.refuting:
            off = f", {total.off_grid} left the grid" if total.off_grid else ""
            return f"{shortfall(total.kept, self.depth, self.aim)}{off}"
        if (layer := self._refuting) is not None:
            assert layer.allowed is not None
            return (
                f"the promise falls short: {layer.lost} of {layer.trials.kept.total} starts "
                f"{layer.where} are lost, {self._beyond([layer])}, where an input "
                f"held for {1000 * self.sample_time:g} ms may lose {self._amount(layer.allowed)}"
            )
        tried = [(f"{self.depth} inside", total)]
        tried += [(b.where, b.trials) for b in self.layers if b.unknown]
        left = next(((where, t) for where, t in tried if t.off_grid), None)
        if left is None:
            return f"the promise is not confirmed: {self.doubt}" if self.doubt else ""
        where, trials = left
        return (
            f"the promise is not confirmed: {trials.off_grid} of {trials.kept.total} starts "
            f"{where} leave the grid before the region, and what becomes of them beyond it is not "
            "known; widen the grid until none does"
        )

    @property
    def conclusion(self) -> str:
        """What the runs come to, as a sentence."""
        if self.verdict:
            return self.verdict
        claim = f"{EVERY}{' against every disturbance tried' * (len(self.inside) > 1)}"
        rest = self.layers[len(self._kept_layers) :]
        if not rest:
            return confirmation(self.tried_share, claim, "", None)
        whence = [self.depth, *(b.down_to for b in self._kept_layers)][-1]
        rates = [b.trials.kept for b in rest]
        edge = Rate(sum(r.count for r in rates), sum(r.total for r in rates))
        missed = self._beyond(rest)
        return confirmation(self.kept_share, claim, whence, edge, f", {missed}")

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""
        return {
            "law": self.law,
            "margin": "one cell" if self.margin is None else self.margin,
            "held_loss": self.held_loss,
            "share_of_set": self.share,
            "share_tried": self.tried_share,
            "share_kept": self.kept_share,
            "unit": self.unit,
            "horizon_s": self.horizon,
            "sample_time_s": self.sample_time,
            "held": self.held,
            "confirmed": self.confirmed,
            "outcome": self.outcome,
            "conclusion": self.conclusion,
            "verdict": self.verdict,
            "inside": [t.summary() for t in self.inside],
            "layers": [b.summary() for b in self.layers],
            "beaten": [
                {"start": list(b.start), "by": b.by, "outcome": b.outcome, "time_s": b.time}
                for b in self.beaten[:LISTED]
            ],
            "outside": self.outside.summary() if self.outside else None,
        }
