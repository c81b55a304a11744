"""From a value function to a law that runs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from holdfast.analysis.posed import definition, with_disturbance
from holdfast.analysis.value_function import Array, ValueFunction
from holdfast.errors import SimulationError
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.hamiltonian import hamiltonian
from holdfast.maths.law import Law
from holdfast.maths.lookup import Lookup
from holdfast.maths.quantity import TIME
from holdfast.maths.safety import against_the_worst, keep_value, optimal_law
from holdfast.maths.switching import Switching
from holdfast.maths.system import System

L = TypeVar("L", bound=Law | Switching)

KEPT = ("viability-kernel", "discriminating-kernel", "capture-basin", "backward-reachable-set")
"""Problems whose value the inputs raise against the disturbances."""

MANY = 100_000
"""Nodes near the boundary that a margin is taken from."""


def safety_law(
    system: System,
    value: ValueFunction,
    law: L | None = None,
    *,
    rate: float = 2.0,
    margin: float | None = None,
    sample_time: float = 0.02,
    scales: Mapping[str, float] | None = None,
) -> L | Law:
    """The law that keeps the state where V > 0.

    Without `law` the optimal inputs, bang-bang within a box: max_u p . f with p = dV/dq (thesis
    (7.3), (7.7)). With one, `law` changed no more, in units of `scales`, than

        p . f(q, u, d) + rate (V - margin) >= 0   for every disturbance d

    asks: left alone well inside, taken over towards the boundary. rate [1/s]. margin [unit of V]:
    by default `sampled_margin`, what may be lost while an input is held for `sample_time`. Where
    no admissible input is enough, the least violation, which a run counts. A value function with
    several times that has not converged is used at the time that is left, and stands still at the
    first of them; one that has converged is used at its last.

    Raises `SimulationError` for a value function of another system, or one that says nothing
    about what the inputs keep, and for a rate that a held input cannot follow.
    """
    known = decided(system, value)
    lookup = lookup_of(value)
    if law is None:
        return optimal_law(known, lookup)
    if not 0 < rate * sample_time <= 1:
        raise SimulationError(
            f"rate {rate:g} 1/s with a sample time of {sample_time:g} s",
            expected="above 0, at most 1 / sample_time",
        )
    if margin is None:
        margin = sampled_margin(system, value, sample_time)
    return keep_value(known, law, lookup, rate=rate, margin=margin, scales=scales)


def sampled_margin(system: System, value: ValueFunction, sample_time: float) -> float:
    """The most that V can fall while an input is held: sample_time * max(-min_u min_d p . f).

    The maximum is over the nodes within two cells of the boundary, or `MANY` of them. A state with
    V above it at a sample has V > 0 until the next, whatever the input and the disturbance do.
    """
    known = decided(system, value)
    near = _near_boundary(value)
    if not len(near):
        return 0.0
    h = hamiltonian(known, inputs="min", disturbances="min")
    states = [q.symbol for q in known.states]
    falls = Evaluator([h.value], [*states, *h.costates], known.parameters)
    points = np.hstack([near, value.gradient(near)])
    fall = falls.values(points, _parameters(value, known))[:, 0]
    return float(sample_time * max(0.0, -fall.min()))


def worst_disturbance(system: System, value: ValueFunction, law: L) -> tuple[System, L]:
    """System and law with the disturbance that lowers V the most, held as the inputs are."""
    return against_the_worst(decided(system, value), law, lookup_of(value))


def optimal_inputs(
    system: System, value: ValueFunction, plane: tuple[str, str], held: Mapping[str, float]
) -> tuple[dict[str, Array], tuple[Array, Array]]:
    """At the nodes of a plane: the optimal inputs, and the two rates with the worst disturbance.

    The states outside the plane are held. Arrays of shape (nodes of the first, of the second).
    """
    known = decided(system, value)
    h = hamiltonian(known)
    states = {q.name: q.symbol for q in known.states}
    chosen = {q.symbol: h.inputs[q.name] for q in known.inputs}
    chosen |= {q.symbol: h.disturbances[q.name] for q in known.disturbances}
    rates = [known.rates[n].xreplace(chosen) for n in plane]
    wanted = Evaluator(
        [*h.inputs.values(), *rates], [*states.values(), *h.costates], known.parameters
    )
    axes = {a.name: a.nodes for a in value.grid.axes}
    first, second = np.meshgrid(*(axes[n] for n in plane), indexing="ij")
    columns = dict(held) | {plane[0]: first.ravel(), plane[1]: second.ravel()}
    points = np.stack([np.broadcast_to(columns[n], first.size) for n in states], axis=1)
    found = wanted.values(np.hstack([points, value.gradient(points)]), _parameters(value, known))
    tables = [column.reshape(first.shape) for column in found.T]
    return dict(zip(h.inputs, tables, strict=False)), (tables[-2], tables[-1])


def lookup_of(value: ValueFunction) -> Lookup:
    """The value function as a law looks it up."""
    axes = value.grid.axes
    places = [a.state.symbol for a in axes]
    low, steps = [a.low for a in axes], [a.step for a in axes]
    counts, periodic = [a.count for a in axes], [a.ends == "periodic" for a in axes]
    data = value.dataset["value"]
    first = 0.0
    if "time" in data.dims and data.sizes["time"] > 1 and not value.dataset.attrs["converged"]:
        times = data["time"].values
        gaps = np.diff(times)
        if not np.allclose(gaps, gaps[0], rtol=1e-6):
            raise SimulationError(
                "the times of the value function are not equally spaced",
                remedy="ask for equally spaced ones, or for the last alone",
            )
        first = float(times[0])
        places.insert(0, float(times[-1]) - TIME)
        low.insert(0, float(times[0]))
        steps.insert(0, float(gaps[0]))
        counts.insert(0, len(times))
        periodic.insert(0, False)
        numbers = data.values
    else:
        numbers = value.values()
    table = (
        np.ascontiguousarray(numbers).ravel(),
        np.array(low),
        np.array(steps),
        np.array(counts, dtype=np.int64),
        np.array(periodic),
    )
    return Lookup(tuple(places), table, first)


def decided(system: System, value: ValueFunction) -> System:
    """The system as the value function was computed for: with what disturbances were given."""
    said = value.dataset.attrs
    if said.get("kind") not in KEPT:
        raise SimulationError(
            f"a value function of the kind '{said.get('kind')}'",
            expected="one of " + ", ".join(KEPT),
        )
    if said.get("disturbances") == "max":
        raise SimulationError(
            "the value counts on the disturbances, and a law cannot",
            remedy='compute it with disturbances="min"',
        )
    if value.names != system.state_names or said["system"] != system.name:
        raise SimulationError(
            f"the value function is one of system '{said['system']}' with the states "
            + ", ".join(value.names),
            expected=f"system '{system.name}' with " + ", ".join(system.state_names),
        )
    if said.get("depends_on_time"):
        raise SimulationError(
            "the value function depends on time, and holds at the beginning of its problem only",
            expected="a problem in which nothing depends on time, for a law",
        )
    numbers = json.loads(said["parameters"])
    for q in system.parameters:
        if q.name in numbers and float(q.value) != numbers[q.name]:
            raise SimulationError(
                f"the value function was computed with {q.name} = {numbers[q.name]:g}, the system "
                f"has {q.value:g}",
                remedy="compute it again; to simulate another vehicle under this law, use plant",
            )
    if said.get("definition") not in (None, definition(system)):
        raise SimulationError(
            f"the rates or the bounds of system '{system.name}' are not those that the value "
            "function was computed for",
            remedy="compute it again; to simulate another vehicle under this law, use plant",
        )
    known = with_disturbance(system, json.loads(said["disturbance"]))
    return replace(known, samples=int(said.get("samples", 0)))


def _parameters(value: ValueFunction, system: System) -> dict[str, float]:
    numbers = json.loads(value.dataset.attrs["parameters"])
    return {q.name: numbers[q.name] for q in system.parameters if q.name in numbers}


def _near_boundary(value: ValueFunction) -> Array:
    """States of the nodes with 0 < V <= two cells, all or `MANY` drawn from them."""
    table = value.values()
    cell = float(value.dataset.attrs["cell"])
    chosen = np.flatnonzero((table.ravel() > 0) & (table.ravel() <= 2 * cell))
    if len(chosen) > MANY:
        chosen = np.random.default_rng(0).choice(chosen, MANY, replace=False)
    places = np.unravel_index(chosen, table.shape)
    columns = [a.nodes[k] for a, k in zip(value.grid.axes, places, strict=True)]
    return np.stack(columns, axis=1) if len(chosen) else np.empty((0, len(columns)))
