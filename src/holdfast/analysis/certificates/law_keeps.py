"""Does this law keep this set: proved, refuted by a trajectory, or undecided."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.analysis.certificates.cells import Floats, Wholes
from holdfast.analysis.certificates.certificate import Certificate, Range
from holdfast.analysis.certificates.certify import CELLS, certify
from holdfast.analysis.certificates.problem import INPUTS
from holdfast.arguments import checked
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
    time: Floats
    low: Floats
    high: Floats
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
    def undecided(self) -> Floats:
        """The middles of the cells in the region of which nothing is proved, (cells, states)."""
        kept = self.certificate.kept
        low, high = kept.cells.corners(np.setdiff1d(kept.region, kept.members))
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
    """Whether `law`, sampled and held for `sample_time` [s], keeps `region` from all of its cells.

    Proved: from every cell in the region, not from those that its edge cuts, for every disturbance
    within its bounds, between samples too. Refuted: a trajectory from the middle of a cell leaves;
    disturbances are constant, at a corner of their bounds, for at most a minute or the horizon, in
    whole holds; every rounding is counted, and no error of measurement or delay; where it is not
    certain what the law does, such as which of two modes it takes, the trajectory says nothing.
    Undecided: neither; `undecided` says where.

    law: with its modes, safeguard and table; it begins in its first mode. The arguments are those
    of `hf.certify`, which also says what is raised.
    """
    found = certify(
        system, region, box=box, cells=cells, sample_time=sample_time, horizon=horizon,
        inputs=inputs, uncertain=uncertain, disturbance=disturbance, law=law, errors=errors,
        delay=delay, progress=progress,
    )  # fmt: skip
    if found.kept.share == 1:
        return LawJudgement(found, None)
    return LawJudgement(found, _leaving(found))


def _leaving(found: Certificate) -> Leaving | None:
    """The first trajectory that surely leaves the region, from a cell that is not certified."""
    middles = LawJudgement(found, None).undecided
    if len(middles) > STARTS:
        middles = np.random.default_rng(0).permutation(middles)[:STARTS]
    states = [symbol(n) for n, _ in found.states]
    free = [n for n, _ in (*found.disturbances, *found.parameters)]
    names = [n for n, _, _ in found.constraints]
    limits = Enclosure(
        [exact(e) for _, _, e in found.constraints], [*states, *(symbol(n) for n in free)]
    )
    holds = found.kept.holds or max(round(SECONDS / found.hold), 1)
    for corner in itertools.product(*(sorted(set(found.ranges[n])) for n in free)):
        held = dict(zip(free, corner, strict=True))
        path = _run(found, states, held, middles, holds)
        for low, high in path:
            given = np.broadcast_to(np.array(corner), (len(low[-1]), len(free)))
            least, _ = limits.over(
                np.concatenate([low[-1], given], axis=1), np.concatenate([high[-1], given], axis=1)
            )
            worst = np.nan_to_num(least, nan=-np.inf)
            if worst.max() > 0:
                k, c = np.unravel_index(worst.argmax(), worst.shape)
                return Leaving(
                    {n: float(v) for (n, _), v in zip(found.states, middles[k], strict=True)},
                    held,
                    found.hold * np.arange(len(low), dtype=np.float64),
                    np.array([row[k] for row in low]),
                    np.array([row[k] for row in high]),
                    names[c],
                    float(worst[k, c]),
                )
    return None


def _run(
    found: Certificate, states: list[Any], held: Mapping[str, float], starts: Floats, holds: int
) -> Iterator[tuple[list[Floats], list[Floats]]]:
    """After each hold all boxes until then; of trajectories under constant numbers."""
    disturbances = {symbol(n): (held[n], held[n]) for n, _ in found.disturbances}
    parameters = {symbol(n): (held[n], held[n]) for n, _ in found.parameters}
    flow = HeldFlow(
        found.rates, [], states, [symbol(n) for n, _ in found.inputs], disturbances, parameters,
        Sampling(found.hold, law=found.sampling.law),
    )  # fmt: skip
    assert flow.law is not None
    low, high = [starts], [starts]
    mode = np.full(len(starts), flow.law.initial)
    for _ in range(holds):
        row, least, most, mode = _certain(flow.law, mode, low[-1], high[-1])
        after = flow.held(low[-1][row], high[-1][row], least, most)
        known = row[after.kept]  # of others no box of the way was found
        for ends, led in ((low, after.low), (high, after.high)):
            ends.append(np.full(starts.shape, np.nan))
            ends[-1][known] = led[after.kept]
        yield low, high


def _certain(
    law: LawRanges, mode: Wholes, low: Floats, high: Floats
) -> tuple[Wholes, Floats, Floats, Wholes]:
    """The boxes with which the law surely does one thing, its inputs, and all modes afterwards."""
    rows, least, most, after = [], [], [], mode.copy()
    for k in range(law.modes):
        own = np.flatnonzero((mode == k) & np.isfinite(low).all(axis=1))
        given = law.given(k, low[own], high[own])
        sure = np.bincount(given.row, minlength=len(own))[given.row] == 1
        rows.append(own[given.row[sure]])
        least.append(given.low[sure])
        most.append(given.high[sure])
        after[rows[-1]] = given.to[sure]
    return np.concatenate(rows), np.concatenate(least), np.concatenate(most), after
