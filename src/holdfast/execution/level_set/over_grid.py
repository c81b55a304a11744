"""Expressions at the nodes of a grid: values at every node, the largest speeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.lowering import leaf_of
from holdfast.execution.leaf import Leaves, compiled_leaves, padded
from holdfast.maths.definitions.quantity import TIME, Parameter
from holdfast.maths.expressions.traversal import symbols_of

TOGETHER = 1 << 14
"""Nodes that are computed at a time, if a row of the last axis is not longer."""


class OverGrid:
    """Expressions of states, parameters and time on a grid; `symbols` are those of the axes."""

    def __init__(
        self,
        expressions: Sequence[sp.Expr],
        symbols: Sequence[sp.Symbol],
        parameters: Sequence[Parameter],
        axes: Sequence[Array],
    ) -> None:
        same = (TIME, *(q.symbol for q in parameters))
        leaf = leaf_of({"w": symbols, "u": same}, expressions, uniform=("u",))
        self._leaves: Leaves = compiled_leaves({"values": leaf})
        self._u = np.array([0.0, *(float(q.value) for q in parameters)])
        self._count = len(expressions)
        inner = len(axes) - 1
        while inner > 0 and math.prod(len(a) for a in axes[inner - 1 :]) <= TOGETHER:
            inner -= 1
        self._outer = axes[:inner]
        within = np.meshgrid(*axes[inner:], indexing="ij")
        self._nodes = within[0].size
        self._w = np.zeros((len(axes), padded(self._nodes)))
        for row, values in zip(self._w[inner:], within, strict=True):
            row[: self._nodes], row[self._nodes :] = values.ravel(), values.ravel()[-1]
        self.size = self._nodes * math.prod(len(a) for a in self._outer)

    def parts(self, time: float) -> Iterator[tuple[int, Array]]:
        """The first node of every part of the grid, and the expressions at its nodes."""
        u, out = self._u.copy(), np.empty((self._count, self._w.shape[1]))
        u[0] = time
        for k, place in enumerate(itertools.product(*self._outer)):
            self._w[: len(place)] = np.array(place)[:, np.newaxis]
            self._leaves.call("values", self._w, u, out)
            yield k * self._nodes, out[:, : self._nodes]


def over_grid(
    expression: sp.Expr,
    symbols: Sequence[sp.Symbol],
    parameters: Sequence[Parameter],
    axes: Sequence[npt.NDArray[np.float64]],
    *,
    band: float = math.inf,
    precision: str = "float64",
    room: Callable[[int], npt.NDArray[Any]] | None = None,
) -> Callable[[float], npt.NDArray[Any]]:
    """At a time: the expression at every node, flat, cut off at +-band.

    `symbols` are those of the axes. room: gives an array of so many values.
    """
    values = OverGrid([expression], symbols, parameters, axes)

    def at(time: float) -> npt.NDArray[Any]:
        out = np.empty(values.size, dtype=precision) if room is None else room(values.size)
        for first, (part,) in values.parts(time):
            np.clip(part, -band, band, out=out[first : first + len(part)], casting="same_kind")
        return out

    return at


class Fastest:
    """The largest speed along every axis, and the largest sum of them over the steps.

    A speed that is NaN at a node is NaN over the grid.
    """

    def __init__(
        self,
        speeds: Sequence[sp.Expr],
        symbols: Sequence[sp.Symbol],
        parameters: Sequence[Parameter],
        axes: Sequence[Array],
        steps: Array,
    ) -> None:
        matters = symbols_of(speeds)
        some = [a if s in matters else a[:1] for s, a in zip(symbols, axes, strict=True)]
        self._values, self._steps = OverGrid(speeds, symbols, parameters, some), steps

    def at(self, times: Sequence[float]) -> tuple[Array, float]:
        """Over these times."""
        largest, total = np.zeros(len(self._steps)), 0.0
        for time in times:
            for _, part in self._values.parts(time):
                largest = np.maximum(largest, part.max(axis=1))
                total = max(total, float((part / self._steps[:, np.newaxis]).sum(axis=0).max()))
        return largest, total


def padded_rows(axes: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """The nodes of every axis as the rows of one array."""
    rows = np.zeros((len(axes), max(len(a) for a in axes)))
    for row, axis in zip(rows, axes, strict=True):
        row[: len(axis)] = axis
    return rows
