"""Closed-loop (Monte Carlo) validation of a set that is put together, on the whole system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.analysis.decomposition.parts_law import parts_law
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.given import by_name, whole
from holdfast.analysis.reachability.problem import with_disturbance
from holdfast.analysis.safety.adversary import CONSTANT, INSIDE, SWINGING, SWITCHING, schedules
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.analysis.simulation.simulate import simulate
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

DRAWS = 200
"""Most batches of random states."""


@dataclass(frozen=True)
class PartsPromise:
    """States of the region, drawn in a box: how many are promised, and how many of each are kept.

    promised: of the states drawn in the region. inside: promised states, kept against every
    disturbance tried; outside: the others, kept against none or against constant ones by the same
    law: what the set gives away at least, None where every state is promised.
    """

    promised: Rate
    inside: Rate
    outside: Rate | None
    horizon: float
    margin: float
    sample_time: float

    @property
    def held(self) -> bool:
        return self.inside.count == self.inside.total

    @property
    def verdict(self) -> str:
        """The shortfall as a sentence, or an empty text."""
        if self.held:
            return ""
        return (
            f"the promise falls short: {self.inside.count} of {self.inside.total} starts "
            f"{self.margin:g} inside stay"
        )

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""
        return {
            "horizon_s": self.horizon,
            "margin": self.margin,
            "sample_time_s": self.sample_time,
            "held": self.held,
            "promised": self.promised.summary(),
            "inside": self.inside.summary(),
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
    rate: float = 2.0,
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
    inside, outside, promised = _drawn(value, region, box, runs, margin, seed)
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
    )


def _drawn(
    value: PartsValue,
    region: Region,
    box: Mapping[str, tuple[float, float]],
    runs: int,
    margin: float,
    seed: int,
) -> tuple[Array, Array, Rate]:
    """States inside and outside the set, and the share of the region's states that is inside."""
    system: System = value.decomposition.system
    low, high = (np.array([box[n][k] for n in system.state_names]) for k in (0, 1))
    symbols = [q.symbol for q in system.states]
    safe = Evaluator([region.margin], symbols, region.parameters)
    generator = np.random.default_rng(seed)
    found: dict[bool, list[Array]] = {True: [], False: []}
    count = total = 0
    for _ in range(DRAWS):
        states = generator.uniform(low, high, (20 * runs, len(low)))
        states = states[safe.values(states)[:, 0] > 0]
        levels = value.at(states)
        there = levels > 0
        count, total = count + int(there.sum()), total + len(states)
        found[True].append(states[levels > margin])
        found[False].append(states[~there])
        if all(sum(map(len, some)) >= runs for some in found.values()):
            break
    inside, outside = (np.vstack(found[k])[:runs] for k in (True, False))
    return inside, outside, Rate(count, max(total, 1))
