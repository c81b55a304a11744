"""What gains cost in closed loop: many candidates in one simulation, from the same starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from holdfast.analysis.simulation.named_arrays import NamedArrays
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.tuning import Costs
from holdfast.execution.arrays import Array
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.variation import Varied
from holdfast.scenario.kinds.closed_loop import Scenario

INSTANTS = 400
"""Samples of the inputs, about, from which the effort is taken."""

MOST_CORNERS = 4
"""Corners that are simulated from every start; the conditions are judged at all of them."""

TOGETHER = 3000
"""Runs that are simulated together, which bounds the memory."""

NEAR = 0.05
"""A start nearer to a constraint than this share of the farthest start counts as that far."""

Numbers = Mapping[str, float]


class Measure:
    """The costs of laws that differ in their parameters, from the starts of a scenario.

    Each start is simulated with the draws of the scenario and, for at most two draws, at each of
    their corners. The cost of a candidate is the larger of both.
    """

    def __init__(self, scenario: Scenario, base: Numbers) -> None:
        samples = round(scenario.settings["horizon"] / scenario.settings["sample_time"])
        stride = next(
            d for d in range(1, samples + 1) if samples % d == 0 and samples / d <= INSTANTS
        )
        every = stride * scenario.settings["sample_time"]
        self.instants = samples // stride + 1
        self.scenario = replace(
            scenario.with_settings(record_every=every), law=without_conditions(scenario.law)
        )
        self.base = base
        own = scenario.varied
        self.varied = [own]
        if own.draws and not own.vertices and 2 ** len(own.draws) <= MOST_CORNERS:
            self.varied.append(replace(own, vertices=tuple(own.draws)))

    def costs(self, laws: Sequence[Numbers], progress: Progress | None = None) -> list[Costs]:
        """The costs of laws with these parameters, in their order."""
        found: list[Costs] = []
        heaviest = max(v.turns for v in self.varied) * self.scenario.starts.count
        some = max(1, TOGETHER // heaviest)
        for first in range(0, len(laws), some):
            part = laws[first : first + some]
            each = [self._simulated(varied, part) for varied in self.varied]
            found += [_worse(costs) for costs in zip(*each, strict=True)]
            if progress is not None:
                progress(min(first + some, len(laws)) / len(laws))
        return found

    def _simulated(self, varied: Varied, laws: Sequence[Numbers]) -> list[Costs]:
        names = [n for n in self.base if any(law[n] != self.base[n] for law in laws)]
        cases = {n: [law[n] for law in laws] for n in names}
        if not cases:  # all of them are the law of the scenario
            return [self._costs(replace(self.scenario, varied=varied), 1)[0]] * len(laws)
        return self._costs(replace(self.scenario, varied=replace(varied, cases=cases)), len(laws))

    def _costs(self, scenario: Scenario, cases: int) -> list[Costs]:
        result = scenario.run()
        corners = len(scenario.varied.corners)
        horizon = float(scenario.settings["horizon"])

        def folded(values: Array) -> Array:
            """(case, corner), the means over the starts."""
            return values.reshape(-1, cases, corners).mean(axis=0)

        lost = folded(_lost(result).astype(np.float64)).mean(axis=1)
        time = folded(_time(result, horizon)).max(axis=1)
        effort = folded(_effort(result.arrays, horizon)).max(axis=1)
        clearance = folded(_clearance(result.arrays)).min(axis=1)
        return [Costs(*map(float, row)) for row in zip(time, effort, clearance, lost, strict=True)]


def without_conditions(law: Law | Switching) -> Law | Switching:
    """The same law; its conditions, which are judged elsewhere, are not judged in every run."""
    if isinstance(law, Switching):
        return law.map_laws(lambda mode: replace(mode, conditions=()), law.name)
    return replace(law, conditions=())


def _worse(costs: Sequence[Costs]) -> Costs:
    return Costs(
        max(c.time for c in costs),
        max(c.effort for c in costs),
        min(c.clearance for c in costs),
        max(c.lost for c in costs),
    )


def _lost(result: Result) -> npt.NDArray[np.bool_]:
    outcome = result.arrays["outcome"].values
    kept = [Outcome.REACHED] if result.arrays.attrs.get("goal") else [Outcome.STAYED]
    lost: npt.NDArray[np.bool_] = ~np.isin(outcome, kept)
    return lost


def _time(result: Result, horizon: float) -> Array:
    """Seconds until a run is in the goal for good; the horizon for one that is lost."""
    if not result.arrays.attrs.get("goal"):
        return np.full(len(result.arrays["outcome"].values), np.nan)
    since = result.arrays["goal_time"].values
    return np.where(_lost(result) | ~np.isfinite(since), horizon, since)


def _effort(data: NamedArrays, horizon: float) -> Array:
    """The integral of sum (input / limit)^2 [s]; infinite for a run that diverged."""
    axis = "actuator" if data["actuator"].values.shape[-1] else "input"
    values = data[axis].values
    scale = np.ones(values.shape[-1])
    if f"{axis}_high" in data:
        size = np.maximum(np.abs(data[f"{axis}_low"].values), np.abs(data[f"{axis}_high"].values))
        scale = size.reshape(-1, size.shape[-1]).max(axis=0)
        scale = np.where(np.isfinite(scale) & (scale > 0), scale, 1.0)
    power = ((values / scale) ** 2).sum(axis=-1)
    mean = (power[:, 1:] + power[:, :-1]).mean(axis=1) / 2
    return np.where(np.isfinite(mean), mean, 1e6) * horizon


def _clearance(data: NamedArrays) -> Array:
    """The share of its distance at the start that a run keeps from its worst constraint."""
    worst, first = data["worst_constraint"].values, data["constraint"].values[:, 0]
    if not worst.shape[-1]:
        return np.full(len(worst), np.nan)
    floor = np.maximum(NEAR * np.nanmax(-first, axis=0), 1e-12)
    least: Array = (-worst / np.maximum(-first, floor)).min(axis=1)
    return least
