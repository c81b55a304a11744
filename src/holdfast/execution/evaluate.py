"""Expressions of the state, compiled: values at many points in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.lowering import leaf_of
from holdfast.execution.leaf import compiled_leaves
from holdfast.maths.definitions.quantity import Parameter


class Evaluator:
    """values(points)[i, j] = expressions[j] at points[i].

    `arguments` are the symbols of the columns of `points`. `parameters` give the values of their
    symbols unless `given` replaces them; of two with one name the last counts. Raises
    `DefinitionError` for an expression with any other symbol, `SimulationError` for points of
    another shape.
    """

    def __init__(
        self,
        expressions: Sequence[Any],
        arguments: Sequence[Any],
        parameters: Sequence[Parameter],
    ) -> None:
        self.count, self.width = len(expressions), len(arguments)
        self.parameters = tuple({q.name: q for q in parameters}.values())
        arrays = {"q": list(arguments), "p": [q.symbol for q in self.parameters]}
        self._leaves = compiled_leaves({"values": leaf_of(arrays, expressions)})

    def values(self, points: Array, given: Mapping[str, float] | None = None) -> Array:
        """The values at points of shape (count, arguments), shape (count, expressions)."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != self.width:
            raise SimulationError(
                f"points have the shape {points.shape}", expected=f"(count, {self.width})"
            )
        chosen = {q.name: q.value for q in self.parameters} | dict(given or {})
        numbers = np.array(list(chosen.values()), dtype=np.float64)
        return self._leaves.values("values", len(points), self.count, points, numbers)
