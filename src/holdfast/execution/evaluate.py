"""Expressions of the state, compiled: values at many points in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arithmetic.steps import Steps
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import lowered
from holdfast.execution.leaf import BLOCK, columns, compiled_leaves, padded
from holdfast.maths.definitions.quantity import Parameter


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
        self.count, self.width = len(expressions), len(arguments)
        self.parameters = tuple(parameters)
        steps = Steps(expanded=True)
        rows = {
            "q": [f"q{i}" for i in range(self.width)],
            "p": [f"p{i}" for i in range(len(self.parameters))],
        }
        symbols = {"q": list(arguments), "p": [q.symbol for q in self.parameters]}
        inputs = {
            s: steps.input(name)
            for array, names in rows.items()
            for s, name in zip(symbols[array], names, strict=True)
        }
        results = lowered(steps, expressions, inputs)
        self._leaves = compiled_leaves({"values": Leaf(steps, rows, results)})

    def values(self, points: Array, given: Mapping[str, float] | None = None) -> Array:
        """The values at points of shape (count, arguments), shape (count, expressions)."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != self.width:
            raise SimulationError(
                f"points have the shape {points.shape}", expected=f"(count, {self.width})"
            )
        chosen = {q.name: q.value for q in self.parameters} | dict(given or {})
        out = np.zeros((len(points), self.count))
        if not out.size:
            return out
        stride = min(padded(len(points)), BLOCK)
        p = np.repeat(np.array([*chosen.values(), 0.0], dtype=np.float64)[:, None], stride, axis=1)
        some = np.empty((self.count, stride))
        for first in range(0, len(points), stride):
            part = points[first : first + stride]
            self._leaves.call("values", columns(part, stride), p, some)
            out[first : first + stride] = some[:, : len(part)].T
        return out
