"""Trajectories of expressions, all at once, with their sensitivities if wanted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.execution.arithmetic.steps import Steps, Value
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import lowered
from holdfast.execution.leaf import compiled_leaves, padded
from holdfast.execution.simulation.settings import RK4
from holdfast.maths.definitions.quantity import Parameter


class Trajectories:
    """Trajectories of x' = f(x, u, v) by classical Runge-Kutta steps, u held over each step.

    rates: f, then, for the sensitivities S = dx/d(x(0), v), df/dx and df/dv row by row:

        S' = df/dx S + (0, df/dv),     S(0) = (I, 0)

    A compiled leaf makes a whole step of all trajectories. Raises `DefinitionError` for rates with
    a symbol that is none of x, u, v and the parameters.
    """

    def __init__(
        self,
        rates: Sequence[Any],
        states: Sequence[Any],
        inputs: Sequence[Any],
        unknown: Sequence[Any],
        parameters: Sequence[Parameter],
    ) -> None:
        self.states, self.inputs, self.unknown = len(states), len(inputs), len(unknown)
        self.sensitive = len(rates) > self.states
        seeds = self.states + self.unknown if self.sensitive else 0
        self.rows = self.states * (1 + seeds)
        self._parameters = np.array([p.value for p in parameters], dtype=np.float64)
        symbols = {"x": states, "u": inputs, "v": unknown, "p": [p.symbol for p in parameters]}
        self._leaves = compiled_leaves({"step": self._leaf(rates, symbols)})

    def nodes(
        self, first: Array, inputs: Array, unknown: Array, step: float
    ) -> tuple[Array, Array]:
        """Values and rates at the nodes, shapes (steps + 1, rows, trajectories).

        first: shape (trajectories, states). inputs: shape (trajectories, steps, inputs). unknown:
        shape (trajectories, unknown). Rows are x, then S row by row. A trajectory that diverges is
        not a number from there on.
        """
        count, steps = len(first), inputs.shape[1]
        stride, n = padded(count), self.states
        # x at a node, its rate there, x at the next node: a step fills what follows the first
        x = np.empty((2 * steps + 3, self.rows, stride))
        x[0, :n, :count] = first.T
        x[0, n:] = 0.0
        if self.sensitive:
            x[0, n :: n + self.unknown + 1][:n] = 1.0
        u = np.empty((steps + 1, self.inputs, stride))
        u[:steps, :, :count] = inputs.transpose(1, 2, 0)
        u[steps] = u[steps - 1]
        v = np.empty((self.unknown, stride))
        v[:, :count] = unknown.T
        for array in (x[0], u, v):
            array[..., count:] = array[..., count - 1 : count]
        numbers = np.array([step, *self._parameters])
        for k in range(steps + 1):
            after = x[2 * k + 1 :].reshape(-1, stride)
            self._leaves.call("step", x[2 * k], u[k], v, numbers, after)
        return x[:-1:2, :, :count], x[1::2, :, :count]

    def _leaf(self, rates: Sequence[Any], symbols: dict[str, Sequence[Any]]) -> Leaf:
        steps = Steps(expanded=True)
        names = {a: [f"{a}{i}" for i in range(len(s))] for a, s in symbols.items()}
        names["x"] = [f"x{i}" for i in range(self.rows)]
        names["p"] = ["step", *names["p"]]
        by_symbol = {
            symbol: steps.input(name)
            for a in ("u", "v", "p")
            for symbol, name in zip(symbols[a], names[a][a == "p" :], strict=True)
        }

        def rate(x: Sequence[Value]) -> list[Value]:
            now = by_symbol | dict(zip(symbols["x"], x, strict=False))
            return self._rates(steps, rates, lowered(steps, rates, now), x)

        x, h = [steps.input(name) for name in names["x"]], steps.input("step")
        stages: list[list[Value]] = []
        for row in RK4.a:
            stages.append(rate([_moved(q, h, row, stages, i) for i, q in enumerate(x)]))
        after = [_moved(q, h, RK4.b, stages, i) for i, q in enumerate(x)]
        return Leaf(steps, names, [*stages[0], *after], frozenset({"p"}))

    def _rates(
        self, steps: Steps, rates: Sequence[Any], values: Sequence[Value], x: Sequence[Value]
    ) -> list[Value]:
        """The rates of x, and of S where it is wanted."""
        n, m = self.states, self.unknown
        derivatives = list(values[:n])
        if not self.sensitive:
            return derivatives
        for i in range(n):
            row = [j for j in range(n) if rates[n + n * i + j] != 0]
            for k in range(n + m):
                terms = [values[n + n * i + j] * x[n + (n + m) * j + k] for j in row]
                if k >= n and rates[n + n * n + m * i + k - n] != 0:
                    terms.append(values[n + n * n + m * i + k - n])
                derivatives.append(_sum(terms, steps))
        return derivatives


def _moved(
    x: Value, h: Value, weights: Sequence[float], stages: Sequence[Sequence[Value]], i: int
) -> Value:
    """x + h (the weighted sum of the stages)."""
    terms = [w * stage[i] for w, stage in zip(weights, stages, strict=False) if w]
    return x + h * _sum(terms, x.steps) if terms else x


def _sum(terms: Sequence[Value], steps: Steps) -> Value:
    if not terms:
        return steps.constant(0.0, "float")
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total
