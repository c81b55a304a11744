"""Expressions at the nodes of a grid: values at every node, the largest speeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any, Protocol

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

ALL = slice(None)


class AtTime(Protocol):
    """An expression at the nodes of a grid."""

    def __call__(self, time: float, of: slice = ALL) -> npt.NDArray[Any]:
        """At a time, at all nodes or at some that follow one another."""


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
        self._leaves = _leaves_of(tuple(expressions), tuple(symbols), same)
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

    def parts(self, time: float, of: slice = ALL) -> Iterator[tuple[slice, Array]]:
        """Nodes that follow one another, of the grid or of some of its nodes, and the expressions
        at these; they are overwritten with the next."""
        u, out = self._u.copy(), np.empty((self._count, self._w.shape[1]))
        u[0] = time
        first, last, _ = of.indices(self.size)
        parts = range(first // self._nodes, -(-last // self._nodes))
        places = itertools.islice(itertools.product(*self._outer), parts.start, parts.stop)
        for k, place in zip(parts, places, strict=True):
            self._w[: len(place)] = np.array(place)[:, np.newaxis]
            self._leaves.call("values", self._w, u, out)
            begin = k * self._nodes
            low, high = max(first, begin), min(last, begin + self._nodes)
            yield slice(low, high), out[:, low - begin : high - begin]


@lru_cache(maxsize=64)
def _leaves_of(
    expressions: tuple[sp.Expr, ...], symbols: tuple[sp.Symbol, ...], same: tuple[sp.Symbol, ...]
) -> Leaves:
    """The same margin is wanted at all nodes, beyond every end, and by both marches of a kernel."""
    leaf = leaf_of({"w": symbols, "u": same}, expressions, uniform=("u",))
    return compiled_leaves({"values": leaf})


def over_grid(
    expression: sp.Expr,
    symbols: Sequence[sp.Symbol],
    parameters: Sequence[Parameter],
    axes: Sequence[npt.NDArray[np.float64]],
    *,
    band: float = math.inf,
    precision: str = "float64",
    room: Callable[[int], npt.NDArray[Any]] | None = None,
) -> AtTime:
    """At a time: the expression at every node, or at some, flat, cut off at +-band.

    `symbols` are those of the axes. room: gives an array of the values at every node.
    """
    values = OverGrid([expression], symbols, parameters, axes)

    def at(time: float, of: slice = ALL) -> npt.NDArray[Any]:
        first, last, _ = of.indices(values.size)
        out = (
            room(values.size)
            if room is not None and of is ALL
            else np.empty(last - first, dtype=precision)
        )
        for nodes, (part,) in values.parts(time, of):
            to = out[nodes.start - first : nodes.stop - first]
            np.clip(part, -band, band, out=to, casting="same_kind")
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
