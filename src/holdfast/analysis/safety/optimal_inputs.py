"""The optimal inputs over a plane of the states, for figures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import decided, parameters_of
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.definitions.system import System
from holdfast.maths.games.hamiltonian import hamiltonian


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
    found = wanted.values(np.hstack([points, value.gradient(points)]), parameters_of(value, known))
    tables = [column.reshape(first.shape) for column in found.T]
    return dict(zip(h.inputs, tables, strict=False)), (tables[-2], tables[-1])
