"""Does this law keep this set: proved, refuted by a trajectory, or undecided."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.analysis.certificates.certificate import Certificate, Range
from holdfast.analysis.certificates.certify import CELLS, certify
from holdfast.analysis.certificates.problem import INPUTS
from holdfast.arguments import checked
from holdfast.execution.arrays import Array, Wholes
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.execution.intervals.held_flow import HeldFlow, Sampling
from holdfast.execution.intervals.law_ranges import LawRanges
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact

STARTS = 2000
"""Cells from whose middles a trajectory that leaves is looked for."""

SECONDS = 60.0
"""For which one is looked for."""


@dataclass(frozen=True)
class Leaving:
    """A trajectory that leaves, every rounding counted.

    start: the state; held: disturbances and uncertain numbers, constant all the while. time: the
    samples [s]; low, high: the states at them lie between, shape (samples, states). constraint:
    the one that is violated at the last sample, by at least `by`, in its unit.
    """

    start: Mapping[str, float]
    held: Mapping[str, float]
    time: Array
    low: Array
    high: Array
    constraint: str
    by: float


@dataclass(frozen=True)
class LawJudgement:
    """What is known of a law in a region: `verdict` is proved, refuted or undecided.

    certificate: the cells that the law surely keeps, all of those in the region where it is proved.
    leaving: a trajectory from the region that leaves it, where it is refuted.
    """

    certificate: Certificate
    leaving: Leaving | None

    @property
    def verdict(self) -> str:
        if self.leaving is not None:
            return "refuted"
        return "proved" if self.certificate.kept.share == 1 else "undecided"

    @property
    def undecided(self) -> Array:
        """The middles of the cells in the region of which nothing is proved, (cells, states)."""
        kept_set = self.certificate.kept
        low, high = kept_set.cells.corners(np.setdiff1d(kept_set.region, kept_set.members))
        return 0.5 * (low + high)


@checked
def judge_law(
    system: System,
    region: Region,
    law: Law | Switching,
    *,
    box: Mapping[str, Range],
    cells: int | Mapping[str, int | Sequence[float]] = CELLS,
    sample_time: float = 0.1,
    horizon: float | None = None,
    inputs: int | Mapping[str, int] = INPUTS,
    uncertain: Mapping[str, Range] | None = None,
    disturbance: Mapping[str, float] | None = None,
    errors: Mapping[str, float] | None = None,
    delay: float = 0.0,
    progress: Callable[[str, float], None] | None = None,
) -> LawJudgement:
    """Whether `law`, sampled and held, keeps `region` from all of its cells.

    Proved: from every cell in the region, not from those that its edge cuts, for every disturbance
    within its bounds, between samples too. Refuted: a trajectory from the middle of a cell leaves;
    disturbances are constant, at a corner of their bounds, for at most a minute or the horizon, in
    whole holds; every rounding is counted, and no error of measurement or delay; where it is not
    certain what the law does, such as which of two modes it takes, the trajectory says nothing.
    Undecided: neither; `undecided` says where.

    law: with its modes, safeguard and table; it begins in its first mode. box, cells, inputs,
    uncertain, disturbance, errors, delay: as of `certify`, which also says what is raised.

    >>> hf.judge_law(cart, track, brake, box={"x": (-1, 1), "v": (-1, 1)}, cells=21).verdict
    'refuted'
    """
    certificate = certify(
        system, region, box=box, cells=cells, sample_time=sample_time, horizon=horizon,
        inputs=inputs, uncertain=uncertain, disturbance=disturbance, law=law, errors=errors,
        delay=delay, progress=progress,
    )  # fmt: skip
    if certificate.kept.share == 1:
        return LawJudgement(certificate, None)
    return LawJudgement(certificate, _leaving(certificate))


def _leaving(certificate: Certificate) -> Leaving | None:
    """The first trajectory that surely leaves the region, from a cell that is not certified."""
    middles = LawJudgement(certificate, None).undecided
    if len(middles) > STARTS:
        middles = np.random.default_rng(0).permutation(middles)[:STARTS]
    states = [symbol(n) for n, _ in certificate.states]
    free = [n for n, _ in (*certificate.disturbances, *certificate.parameters)]
    names = [n for n, _, _ in certificate.constraints]
    limits = Enclosure(
        [exact(e) for _, _, e in certificate.constraints], [*states, *(symbol(n) for n in free)]
    )
    holds = certificate.kept.holds or max(round(SECONDS / certificate.hold), 1)
    for corner in itertools.product(*(sorted(set(certificate.ranges[n])) for n in free)):
        held = dict(zip(free, corner, strict=True))
        path = _run(certificate, states, held, middles, holds)
        for low, high in path:
            corners = np.broadcast_to(np.array(corner), (len(low[-1]), len(free)))
            least, _ = limits.over(
                np.concatenate([low[-1], corners], axis=1),
                np.concatenate([high[-1], corners], axis=1),
            )
            worst = np.nan_to_num(least, nan=-np.inf)
            if worst.max() > 0:
                k, c = np.unravel_index(worst.argmax(), worst.shape)
                return Leaving(
                    {n: float(v) for (n, _), v in zip(certificate.states, middles[k], strict=True)},
                    held,
                    certificate.hold * np.arange(len(low), dtype=np.float64),
                    np.array([row[k] for row in low]),
                    np.array([row[k] for row in high]),
                    names[c],
                    float(worst[k, c]),
                )
    return None


def _run(
    certificate: Certificate,
    states: list[Any],
    held: Mapping[str, float],
    starts: Array,
    holds: int,
) -> Iterator[tuple[list[Array], list[Array]]]:
    """After each hold all boxes until then; of trajectories under constant numbers."""
    disturbances = {symbol(n): (held[n], held[n]) for n, _ in certificate.disturbances}
    parameters = {symbol(n): (held[n], held[n]) for n, _ in certificate.parameters}
    flow = HeldFlow(
        certificate.rates, [], states, [symbol(n) for n, _ in certificate.inputs], disturbances,
        parameters, Sampling(certificate.hold, law=certificate.sampling.law),
    )  # fmt: skip
    assert flow.law is not None
    low, high = [starts], [starts]
    mode = np.full(len(starts), flow.law.initial)
    for _ in range(holds):
        row, least, most, mode = _certain(flow.law, mode, low[-1], high[-1])
        after = flow.held(low[-1][row], high[-1][row], least, most)
        followed = row[after.kept]  # of others no box of the way was found
        for ends, led in ((low, after.low), (high, after.high)):
            ends.append(np.full(starts.shape, np.nan))
            ends[-1][followed] = led[after.kept]
        yield low, high


def _certain(
    law: LawRanges, mode: Wholes, low: Array, high: Array
) -> tuple[Wholes, Array, Array, Wholes]:
    """The boxes with which the law surely does one thing, its inputs, and all modes afterwards."""
    rows, least, most, after = [], [], [], mode.copy()
    for k in range(law.modes):
        here = np.flatnonzero((mode == k) & np.isfinite(low).all(axis=1))
        choices = law.given(k, low[here], high[here])
        sure = np.bincount(choices.row, minlength=len(here))[choices.row] == 1
        rows.append(here[choices.row[sure]])
        least.append(choices.low[sure])
        most.append(choices.high[sure])
        after[rows[-1]] = choices.to[sure]
    return np.concatenate(rows), np.concatenate(least), np.concatenate(most), after
