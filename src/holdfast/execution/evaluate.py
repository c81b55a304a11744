"""Expressions of the state, compiled: values at many points in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.printer import function_source
from holdfast.execution.compile import compile_functions
from holdfast.maths.definitions.quantity import Parameter

_LOOP = """@compiled
def evaluate(points, p, out):
    for i in range(points.shape[0]):
        values = function(points[i], p)
        for j in range(out.shape[1]):
            out[i, j] = values[j]
"""


class Evaluator:
    """values(points)[i, j] = expressions[j] at points[i].

    `arguments` are the symbols of the columns of `points`. `parameters` give the values of their
    symbols unless `given` replaces them. Raises `DefinitionError` for an expression
    with any other symbol, `SimulationError` for points of another shape.
    """

    def __init__(
        self,
        expressions: Sequence[Any],
        arguments: Sequence[Any],
        parameters: Sequence[Parameter],
    ) -> None:
        known = {*arguments, *(q.symbol for q in parameters)}
        for expression in expressions:
            if unknown := expression.free_symbols - known:
                raise DefinitionError(f"the expression uses '{min(map(str, unknown))}'")
        self.count, self.width = len(expressions), len(arguments)
        self.parameters = tuple(parameters)
        unpack = {"q": list(arguments), "p": [q.symbol for q in parameters]}
        source = function_source("function", ("q", "p"), unpack, list(expressions))
        self._module = compile_functions(f"{source}\n\n\n{_LOOP}")

    def values(self, points: Array, given: Mapping[str, float] | None = None) -> Array:
        """The values at points of shape (count, arguments), shape (count, expressions)."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != self.width:
            raise SimulationError(
                f"points have the shape {points.shape}", expected=f"(count, {self.width})"
            )
        chosen = {q.name: q.value for q in self.parameters} | dict(given or {})
        out = np.zeros((len(points), self.count))
        if out.size:
            self._module.evaluate(points, np.array([*chosen.values(), 0.0]), out)
        return out
