"""Closed-loop (Monte Carlo) validation of a set that is put together, on the whole system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.analysis.decomposition.parts_law import parts_law
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.grid import by_name, whole
from holdfast.analysis.reachability.problem import with_disturbance
from holdfast.analysis.safety.validation import (
    CONFIRMED,
    CONSTANT,
    EVERY,
    FALLS,
    FELL_SHORT,
    FROM_INSIDE,
    INSIDE,
    SWINGING,
    SWITCHING,
    at_rest,
    confirmation,
    schedules,
    shortfall,
)
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.analysis.simulation.simulate import simulate
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

DRAWS = 200
"""Most batches of random states."""

RUNS, SAMPLES = 100, 100_000
"""Of the trial by default: the starts, and the samples of their runs at most."""


@dataclass(frozen=True)
class PartsPromise:
    """States of the region, drawn in a box: how many are promised, and how many of each are kept.

    promised: of the states drawn in the region. share: of the set that is more than `margin`
    inside, which was tried. inside: promised states, kept against every disturbance tried; outside:
    the others, kept against none or against constant ones by the same law: what the set gives away
    at least, None where every state is promised. edge: promised states at most `margin` inside.
    """

    promised: Rate
    inside: Rate
    outside: Rate | None
    horizon: float
    margin: float
    sample_time: float
    share: float = 1.0
    edge: Rate | None = None

    @property
    def outcome(self) -> str:
        """CONFIRMED, FROM_INSIDE or FELL_SHORT."""
        if not self.held:
            return FELL_SHORT
        whole = self.share == 1 or (self.edge is not None and self.edge.count == self.edge.total)
        return CONFIRMED if whole else FROM_INSIDE

    @property
    def kept_share(self) -> float:
        """The share of the set in which no start is lost."""
        if not self.held:
            return 0.0
        return 1.0 if self.outcome == CONFIRMED else self.share

    @property
    def conclusion(self) -> str:
        """What the runs come to, as a sentence."""
        if self.verdict:
            return self.verdict
        whence = "" if self.outcome == CONFIRMED else f"{self.margin:.3g}"
        return confirmation(self.kept_share, EVERY, whence, self.edge)

    @property
    def held(self) -> bool:
        return self.inside.count == self.inside.total

    @property
    def verdict(self) -> str:
        """The shortfall as a sentence, or an empty text."""
        return "" if self.held else shortfall(self.inside, f"{self.margin:g}")

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""
        return {
            "horizon_s": self.horizon,
            "margin": self.margin,
            "sample_time_s": self.sample_time,
            "held": self.held,
            "share_of_set": self.share,
            "outcome": self.outcome,
            "conclusion": self.conclusion,
            "promised": self.promised.summary(),
            "inside": self.inside.summary(),
            "edge": self.edge.summary() if self.edge else None,
            "outside": self.outside.summary() if self.outside else None,
        }


@checked
def check_parts(
    value: PartsValue,
    region: Region,
    box: Mapping[str, tuple[float, float]],
    *,
    law: Law | None = None,
    disturbance: Mapping[str, float] | None = None,
    runs: int = 1000,
    margin: float = 0.0,
    horizon: float = 1.0,
    sample_time: float = 0.02,
    rate: float | None = None,
    seed: int = 0,
) -> PartsPromise:
    """Simulate the whole system from `runs` promised states, V > margin, and as many others.

    The states are drawn uniformly in a box of all states and lie in the region. law: kept safe
    (`parts_law`), or None for the optimal inputs. Raises `SimulationError` for a value of several
    parts, for a sample time in which actuators would leave their share, and where no state is
    promised.
    """
    whole("runs: ", runs, 1)
    whole("seed: ", seed, 0)
    system = value.decomposition.system
    for name in system.state_names:
        if name not in by_name("box", box, '{"x": (0, 1)}'):
            raise SimulationError(
                f"the box of the starts has no interval for '{name}'",
                expected="intervals of all states of the whole system",
                remedy="leave out the promise where states are relative or do not matter",
            )
    steered = parts_law(value, law, sample_time=sample_time, rate=rate)
    known = with_disturbance(system, disturbance or {})
    inside, edge, outside, promised, share = _drawn(value, region, box, runs, margin, seed)
    if not len(inside):
        raise SimulationError(
            f"no state of the set is further inside than {margin:g}",
            expected="a set with states in the box",
            remedy="take a finer grid, or a smaller margin",
        )

    def kept(starts: Array, kinds: tuple[str, ...]) -> Rate:
        stays = np.ones(len(starts), dtype=bool)
        for kind in kinds:
            more: dict[str, Any] = {}
            if kind:
                found = schedules(known)
                more = {
                    "disturbance": found.expressions,
                    "varied": found.drawn(kind, horizon, sample_time),
                }
            result = simulate(
                known, steered, starts=starts, region=region, horizon=horizon,
                sample_time=sample_time, record_every=horizon, start_outside=True, seed=seed,
                **more,
            )  # fmt: skip
            stays &= result.arrays["outcome"].values == int(Outcome.STAYED)
        return Rate(int(stays.sum()), len(stays))

    every = (CONSTANT, INSIDE, SWITCHING, SWINGING) if known.disturbances else ("",)
    return PartsPromise(
        promised=promised,
        inside=kept(inside, every),
        outside=kept(outside, every[:1]) if len(outside) else None,
        horizon=horizon,
        margin=margin,
        sample_time=sample_time,
        share=share,
        edge=kept(edge, every) if len(edge) else None,
    )


def default_parts_promise(value: PartsValue) -> PartsPromise | None:
    """The promise of a kernel that was put together here: `RUNS` starts for its horizon at most.

    The law is the filter around inputs of zero, held for an Euler step of the marches. The starts
    inside have the largest change of V over a cell of any part, where a state of the set has it.

    Raises `SimulationError` where it cannot be tried.
    """
    whole = value.decomposition
    if whole.kept is None or any(v.claim is None for v in value.values):
        return None
    reports = [v.report for v in value.values]
    hold = min(r.euler_step for r in reports)
    horizon = min(min(r.horizon_s for r in reports), SAMPLES * hold / RUNS)
    deepest = min(v.highest() for v in value.values)
    cell = max(r.cell for r in reports)
    margin = cell if cell < deepest else 0.0
    given = reports[0].disturbance
    disturbance = {n: float(v) for n, v in given.items()}
    return check_parts(
        value, whole.kept, box_of_starts(value), disturbance=disturbance, runs=RUNS, margin=margin,
        horizon=horizon, sample_time=hold, law=at_rest(whole.system), rate=FALLS / hold,
    )  # fmt: skip


def box_of_starts(value: PartsValue) -> dict[str, tuple[float, float]]:
    """The box of the starts: of the grids, and of the states that the domain bounds.

    A state that no part reads begins at 0.
    """
    whole = value.decomposition
    found: dict[str, tuple[float, float]] = {}
    for solved in (s for parts in value.parts for s in parts):
        for axis in solved.value.grid.axes:
            if axis.name in whole.system.state_names:
                found.setdefault(axis.name, (axis.low, axis.high))
    for name, interval in ((n, i) for p in whole.parts for n, i in p.cut.items()):
        found.setdefault(name, interval)
    if whole.prediction is not None:
        names = (a.name for a in whole.prediction.actuators)
        found |= dict(zip(names, whole.prediction.intervals, strict=True))
    read = {s for p in whole.parts for e in p.coordinates.values() for s in e.free_symbols}
    for q in whole.system.states:
        if q.symbol not in read:
            found.setdefault(q.name, (0.0, 0.0))
    return found


def _drawn(
    value: PartsValue,
    region: Region,
    box: Mapping[str, tuple[float, float]],
    runs: int,
    margin: float,
    seed: int,
) -> tuple[Array, Array, Array, Rate, float]:
    """States inside, nearer to the edge, and outside the set; of the region's states the share that
    is inside the set, and of these the share that is deeper than the margin."""
    system: System = value.decomposition.system
    low, high = (np.array([box[n][k] for n in system.state_names]) for k in (0, 1))
    symbols = [q.symbol for q in system.states]
    safe = Evaluator([region.margin], symbols, region.parameters)
    generator = np.random.default_rng(seed)
    found: dict[bool, list[Array]] = {True: [], False: []}
    near: list[Array] = []
    count = total = deep = 0
    for _ in range(DRAWS):
        states = generator.uniform(low, high, (20 * runs, len(low)))
        states = states[safe.values(states)[:, 0] > 0]
        levels = value.at(states)
        there = levels > 0
        count, total = count + int(there.sum()), total + len(states)
        found[True].append(states[levels > margin])
        near.append(states[there & (levels <= margin)])
        deep += len(found[True][-1])
        found[False].append(states[~there])
        if all(sum(map(len, some)) >= runs for some in found.values()):
            break
    inside, outside = (np.vstack(found[k])[:runs] for k in (True, False))
    edge = np.vstack(near)[: (runs + 1) // 2]
    return inside, edge, outside, Rate(count, max(total, 1)), deep / max(count, 1)
