"""Sampled check of a region's viability: the worst state of many on its boundary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from holdfast.analysis.boundary.boundary import Boundary
from holdfast.analysis.reachability.grid import whole
from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.execution.arrays import Array


@dataclass(frozen=True)
class ViabilityCheck:
    """The findings at the sampled states of the boundary.

    `states` (count, n). `margins`: at each state minus the best input's worst outward rate; below
    0 no input keeps the state inside (minus infinity: an inequality is being crossed and the input
    acts only on its second derivative). `active`: the inequalities there. `worst` is the state of
    the least margin, `viable` whether every margin is >= 0. A sample can prove that a region is
    not a viability domain, never that it is one. Margins are in the units of the constraints'
    derivatives. If inputs act only on the second derivative, random states have dc/dt < 0 (any
    input is sufficient) or dc/dt > 0 (no input is): the share is then that of the states that are
    not yet leaving.
    """

    states: Array
    margins: Array
    active: tuple[tuple[str, ...], ...]

    @property
    def viable(self) -> bool:
        return bool((self.margins >= -1e-9).all())

    @property
    def share(self) -> float:
        """The share of the sampled boundary states at which some input keeps the state inside."""
        return float((self.margins >= -1e-9).mean())

    @property
    def worst(self) -> tuple[Array, float, tuple[str, ...]]:
        """The state of the least margin, that margin, and the active inequalities."""
        index = int(np.argmin(self.margins))
        return self.states[index], float(self.margins[index]), self.active[index]


@checked
def check_viability(
    boundary: Boundary,
    box: Mapping[str, tuple[float, float]],
    *,
    count: int = 500,
    seed: int = 0,
    disturbance: Mapping[str, float] | str = "none",
) -> ViabilityCheck:
    """Evaluate the regulation map at `count` random states of the boundary within `box`.

    `box` maps states to (lowest, highest); missing ones are 0. A random ray from a random
    state of the region is followed to its exit. Raises `SimulationError` when the
    box holds no state of the region, or none of its rays leaves the region within the box.
    """
    names = boundary.system.state_names
    if not (isinstance(count, int) and count >= 1):
        raise SimulationError(f"count is {count!r}", expected="a whole number, at least 1")
    whole("seed: ", seed, 0)
    for name, sides in box.items():
        if name not in names:
            raise SimulationError(f"'{name}' is not a state", remedy=suggestion(name, names))
        if len(sides) != 2:
            raise SimulationError(f"the box of '{name}' is {sides!r}", expected="lowest, highest")
    low, high = (np.array([box.get(n, (0.0, 0.0))[i] for n in names], float) for i in (0, 1))
    if not (np.isfinite([low, high]).all() and (low <= high).all()):
        raise SimulationError("the box is not finite", expected="lowest first, finite numbers")
    generator = np.random.default_rng(seed)
    found: list[Array] = []
    for _ in range(200):
        inside = generator.uniform(low, high, (4 * count, len(names)))
        inside = inside[boundary.worst(inside) < 0]
        if not len(inside):
            continue
        direction = generator.normal(size=inside.shape) * (high - low)
        found.append(_leaving(boundary, inside, direction, low, high))
        if sum(map(len, found)) >= count:
            break
    states = np.vstack(found)[:count] if found else np.zeros((0, len(names)))
    if not len(states):
        raise SimulationError(
            "no state of the region's boundary was found in the box",
            expected="a box that the boundary passes through",
        )
    margins, active = np.empty(len(states)), []
    for i, state in enumerate(states):
        answer = boundary.regulation_map(state, disturbance=disturbance)
        margins[i] = -math.inf if answer.hopeless else -answer.least_violation()[1]
        if not (answer.conditions or answer.hopeless) and not boundary.active_set(state):
            raise SimulationError(
                "a sampled state of the boundary has no active inequality",
                remedy="raise the tolerance of the boundary",
            )
        active.append((*answer.conditions, *answer.hopeless))
    return ViabilityCheck(states, margins, tuple(active))


def _leaving(boundary: Boundary, start: Array, direction: Array, low: Array, high: Array) -> Array:
    """The exit points of rays from inside the region, as far as they are within the box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(direction > 0, (high - start) / direction, (low - start) / direction)
    reach = np.where(direction == 0, np.inf, reach).min(axis=1)
    steps = np.linspace(0.0, 1.0, 65)[1:]
    inside, outside = np.zeros(len(start)), np.full(len(start), np.nan)
    for step in steps:  # the first crossing, not the last
        open_ = np.isnan(outside)
        here = boundary.worst(start + (step * reach)[:, None] * direction)
        outside = np.where(open_ & (here > 0), step * reach, outside)
        inside = np.where(open_ & (here <= 0), step * reach, inside)
    left = ~np.isnan(outside)
    start, direction, inside, outside = (a[left] for a in (start, direction, inside, outside))
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        good = boundary.worst(start + middle[:, None] * direction) <= 0
        inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
    points: Array = start + inside[:, None] * direction
    return points
