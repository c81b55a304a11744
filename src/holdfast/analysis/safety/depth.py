"""Random states inside or outside a set by a given depth, as starts of a validation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.analysis.reachability.value_function import Places, ValueFunction
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System

DRAWS, EMPTY_DRAWS = 400, 40
"""Most batches of draws, and most batches while no state is found at all."""

SHARED = 4000
"""Number of states of the set that estimate the shares of its layers."""

POOLS = 10
"""Most batches of states of the whole set, in which those of its outer layers are looked for."""


def inside_states(
    value: ValueFunction,
    generator: np.random.Generator,
    runs: int,
    margin: float | None,
    loss: float,
) -> tuple[Array, float]:
    """Random states inside, and the allowed loss; the states have the shape (runs, states)."""
    numbers = value.values()
    within = Places(lambda k: numbers[k] > 0, numbers.shape)
    for allowed in (loss, 0.0) if loss else (0.0,):

        def deep(states: Array, allowed: float = allowed) -> Any:
            return _deep(value, states, margin, allowed)

        inside = _drawn(value, generator, runs, deep, within)
        if inside is not None:
            return inside, allowed
    shown = "a cell" if margin is None else f"{margin:g}"
    raise SimulationError(
        f"no state of the set is further inside than {shown}",
        remedy="take a finer grid, or " + ("give a" if margin is None else "a smaller") + " margin",
    )


@dataclass(frozen=True)
class Outer:
    """The set beside the states `inside`: their share, and states of the layers around them.

    between: states at least a cell inside; edge: within a cell of the edge. The shares are of the
    volume of the set.
    """

    share: float
    between_share: float
    edge_share: float
    between: Array
    edge: Array


def outer_states(
    value: ValueFunction,
    generator: np.random.Generator,
    runs: int,
    margin: float | None,
    loss: float,
) -> Outer:
    """Up to `runs` random states in each layer of the set outside the states `inside`.

    States of the whole set V > 0, between nodes too, are drawn uniformly and sorted by their depth.
    """
    near = value.values() > 0
    for i in range(near.ndim):
        near = near | np.roll(near, 1, i) | np.roll(near, -1, i)
    nodes = Places(lambda k: near[k], near.shape)
    between: list[Array] = []
    edge: list[Array] = []
    total = deep = cells = 0
    for _ in range(POOLS):
        states = _drawn(value, generator, SHARED, lambda q: value.at(q) > 0, nodes)
        if states is None:
            break
        inside = _deep(value, states, margin, loss)
        a_cell = a_cell_inside(value, states)
        between.append(states[a_cell & ~inside])
        edge.append(states[~a_cell & ~inside])
        total, deep = total + len(states), deep + int(inside.sum())
        cells += len(between[-1])
        if cells >= runs and total - deep - cells >= runs:
            break
    layers = [np.vstack(some)[:runs] for some in (between, edge)]
    rest = total - deep - cells
    return Outer(deep / total, cells / total, rest / total, layers[0], layers[1])


def _deep(value: ValueFunction, states: Array, margin: float | None, loss: float) -> Truths:
    """Whether V > margin; without a margin, whether V > loss at all states a cell away."""
    if margin is None:
        return a_cell_inside(value, states, above=loss)
    there: Truths = value.at(states) > margin
    return there


def outside_states(
    value: ValueFunction,
    generator: np.random.Generator,
    runs: int,
    margin: float | None,
    region: Region | None,
    system: System,
) -> Array | None:
    """Random states of the region outside the set, or None if the set covers the region. Their
    shape is (runs, states)."""
    numbers = value.values()
    symbols = [q.symbol for q in system.states]
    constraints = None if region is None else Evaluator([region.margin], symbols, region.parameters)

    def wanted(states: Array) -> Any:
        if margin is None:
            there = a_cell_inside(value, states, sign=-1)
        else:
            there = value.at(states) < -margin
        return there if constraints is None else there & (constraints.values(states)[:, 0] > 0)

    without = Places(lambda k: numbers[k] < -(margin or 0.0), numbers.shape)
    return _drawn(value, generator, runs, wanted, without)


def a_cell_inside(
    value: ValueFunction, states: Array, *, sign: int = 1, above: float = 0.0
) -> Truths:
    """Whether sign V > above at the states and at all states one cell away along every axis.

    The criterion uses the local change of V between neighbours, not its unit. Beyond the end of a
    "limited" axis no states exist; beyond other ends no state counts as inside.

    states: shape (count, states). The answers have the shape (count,).
    """
    inside: Truths = sign * value.at(states) > above
    for i, axis in enumerate(value.grid.axes):
        for step in (-axis.step, axis.step):
            moved = states.copy()
            moved[:, i] += step
            if axis.ends == "limited" or (sign < 0 and axis.ends != "periodic"):
                moved[:, i] = np.clip(moved[:, i], axis.low, axis.high)
            with np.errstate(invalid="ignore"):
                inside &= sign * value.at(moved) > above
    return inside


def highest_within(value: ValueFunction, lengths: Array) -> float:
    """The largest V of a state from which the boundary is within these lengths along the axes.

    Counted in whole cells, and one more for states between nodes.

    lengths: in the units of the states, shape (states,).
    """
    from scipy.ndimage import minimum_filter

    numbers, axes = value.values(), value.grid.axes
    cells = [math.ceil(s / a.step) + 1 for s, a in zip(lengths, axes, strict=True)]
    sizes = [min(2 * k + 1, 2 * a.count - 1) for k, a in zip(cells, axes, strict=True)]
    modes = ["wrap" if a.ends == "periodic" else "nearest" for a in axes]
    near = numbers[minimum_filter(numbers, size=sizes, mode=modes) <= 0]
    return float(near.max(initial=0.0))


def _drawn(
    value: ValueFunction, generator: np.random.Generator, count: int, wanted: Any, nodes: Places
) -> Array | None:
    """States around the nodes chosen, uniform in their cells, for which `wanted` holds."""
    if not len(nodes):
        return None
    axes = value.grid.axes
    accepted: list[Array] = []
    have = 0
    for batch in range(DRAWS):
        if batch == EMPTY_DRAWS and not have:
            break
        picked = nodes.at(generator.choice(len(nodes), 4 * count))
        points = np.stack(
            [
                a.low + a.step * (k + generator.uniform(-0.5, 0.5, len(k)))
                for a, k in zip(axes, picked, strict=True)
            ],
            axis=1,
        )
        with np.errstate(invalid="ignore"):
            points = points[wanted(points)]
        accepted.append(points)
        have += len(points)
        if have >= count:
            return np.vstack(accepted)[:count]
    return None
