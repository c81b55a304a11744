"""The search: Sobol points, of which the admissible ones begin a differential evolution."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import NonlinearConstraint, differential_evolution
from scipy.stats import qmc

from holdfast.analysis.safety.gain_conditions import JudgedCondition
from holdfast.execution.arrays import Array
from holdfast.studies.tuning.gains import Gain

FIRST, MOST = 6, 9
"""Powers of 2: Sobol points that are judged first, and at most, until enough are admissible."""

REPAIRS = 25
"""Generations in which the least slack is raised where no point is admissible."""

REFUSED = -1e3
"""The slack of gains that the law refuses."""


@dataclass(frozen=True)
class Trial:
    """Gains by key, the parameters of their law, and its conditions where they are worst."""

    key: tuple[float, ...]
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    conditions: tuple[JudgedCondition, ...]

    @property
    def slack(self) -> float:
        """The least of all conditions."""
        return min((c.slack for c in self.conditions), default=math.inf)


class UnmetError(Exception):
    """No gains meet all conditions: the condition that is worst at the best gains.

    alone: whether it is met nowhere, even without the others.
    """

    def __init__(
        self, condition: JudgedCondition | None, gains: Mapping[str, float], alone: bool
    ) -> None:
        super().__init__()
        self.condition, self.gains, self.alone = condition, gains, alone


Build = Callable[[Sequence[float]], Trial | None]


def best_of(
    build: Build,
    gains: Sequence[Gain],
    costs: Callable[[Sequence[Trial]], list[float]],
    margin: float,
    candidates: int,
    seed: int,
    tell: Callable[[str, float], None],
) -> None:
    """Let `costs` see about `candidates` admissible trials that become cheaper.

    build: the trial at shares of the ranges of the gains. Raises `UnmetError`.
    """
    count = len(gains)
    population = min(max(6 * count, 8), 32, max(candidates // 2, 5))
    points = _admissible(build, gains, margin, population, seed, tell)

    def slack(x: Array) -> Array:
        found = [build(column) for column in np.atleast_2d(x.T)]
        return np.array([[REFUSED if t is None else t.slack for t in found]])

    def cost(x: Array) -> Array:
        found = [build(column) for column in np.atleast_2d(x.T)]
        return np.array(costs([t for t in found if t is not None]))

    differential_evolution(
        cost,
        [(0.0, 1.0)] * count,
        constraints=NonlinearConstraint(slack, margin, np.inf),
        init=points,
        maxiter=max(1, candidates // population - 1),
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=0.0,
        rng=np.random.default_rng(seed),
    )


def _admissible(
    build: Build,
    gains: Sequence[Gain],
    margin: float,
    population: int,
    seed: int,
    tell: Callable[[str, float], None],
) -> Array:
    """`population` points, admissible ones first; the gains of the scenario, if they are."""
    sampler = qmc.Sobol(len(gains), rng=np.random.default_rng(seed))
    own = [gain.share(gain.own) for gain in gains]
    points = [own] if all(0 <= s <= 1 for s in own) else []
    slacks: list[float] = []
    for power in range(FIRST, MOST + 1):
        points += sampler.random(2 ** (power if power == FIRST else power - 1)).tolist()
        for point in points[len(slacks) :]:
            found = build(point)
            slacks.append(REFUSED if found is None else found.slack)
            tell("conditions", 0.1 * len(slacks) / 2**MOST)
        if sum(s >= margin for s in slacks) >= population:
            break
    order = sorted(range(len(points)), key=lambda i: (slacks[i] < margin, i))
    if slacks[order[0]] < margin:
        points.append(_repaired(build, points, slacks, margin, seed))
        order.insert(0, len(points) - 1)
    return np.array([points[i] for i in order[:population]])


def _repaired(
    build: Build,
    points: Sequence[Sequence[float]],
    slacks: Sequence[float],
    margin: float,
    seed: int,
) -> list[float]:
    """A point whose least slack is at least the margin, found by raising it; else `UnmetError`."""
    trials = [t for t in map(build, points) if t is not None]

    def shortfall(x: Array) -> Array:
        found = [build(column) for column in np.atleast_2d(x.T)]
        trials.extend(t for t in found if t is not None)
        return np.array([-REFUSED if t is None else -t.slack for t in found])

    best = sorted(range(len(points)), key=lambda i: -slacks[i])[: max(8, 4 * len(points[0]))]
    answer = differential_evolution(
        shortfall,
        [(0.0, 1.0)] * len(points[0]),
        init=np.array([points[i] for i in best]),
        maxiter=REPAIRS,
        vectorized=True,
        updating="deferred",
        polish=False,
        rng=np.random.default_rng(seed),
        callback=lambda intermediate_result: intermediate_result.fun <= -margin,
    )
    if answer.fun <= -margin:
        found: list[float] = answer.x.tolist()
        return found
    if not trials:
        raise UnmetError(None, {}, alone=True)
    final = max(trials, key=lambda t: t.slack)
    alone = [
        c
        for i, c in enumerate(final.conditions)
        if all(t.conditions[i].slack < margin for t in trials)
    ]
    short = alone or [c for c in final.conditions if c.slack < margin]
    raise UnmetError(min(short, key=lambda c: c.slack), final.gains, alone=bool(alone))
