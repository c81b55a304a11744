"""The interval extension of expressions, compiled: boxes in, intervals out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import sympy as sp

from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.arithmetic.steps import Steps
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import Lowering
from holdfast.execution.intervals import functions
from holdfast.execution.intervals.interval import Interval
from holdfast.execution.leaf import compiled_leaves


class IntervalLowering(Lowering):
    """Expressions as steps on the ends of intervals.

    A number that is a float is itself, another one lies between two neighbours. Raises
    `DefinitionError` for a function without an enclosure.
    """

    known: dict[sp.Basic, Any]

    def _number(self, e: sp.Basic) -> Any:
        value = float(e)
        if not math.isfinite(value) or (e.is_number and e == sp.Rational(value)):
            return Interval.point(self.steps, value)
        ends = (math.nextafter(value, sign * math.inf) for sign in (-1, 1))
        low, high = (self.steps.constant(end, "float") for end in ends)
        return Interval(low, high)

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> Any:
        x: Any = self.value(base)
        if exponent.is_Rational and (2 * exponent).is_Integer:
            whole, half = divmod(int(abs(2 * exponent)), 2)
            parts = ([x.power(whole)] if whole else []) + ([x.root()] if half else [])
            found = parts[0] * parts[1] if len(parts) > 1 else parts[0]
            return found if exponent > 0 else found.inverse()
        other: Any = self.value(exponent)
        return functions.exponential_of(functions.logarithm(x) * other)

    def _function(self, name: str, e: sp.Basic) -> Callable[..., Any]:
        if name not in FUNCTIONS:
            raise DefinitionError(f"function '{name}' has no proved enclosure: {e}")
        return FUNCTIONS[name]


def _folded(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    def apply(first: Any, *others: Any) -> Any:
        for other in others:
            first = function(first, other)
        return first

    return apply


FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sin": functions.sine,
    "cos": functions.cosine,
    "tan": functions.tangent,
    "atan": functions.arctangent,
    "atan2": functions.direction,
    "angle": functions.direction,
    "exp": functions.exponential_of,
    "log": functions.logarithm,
    "tanh": functions.hyperbolic_tangent,
    "Abs": abs,
    "magnitude": abs,
    "Min": _folded(functions.least),
    "Max": _folded(functions.greatest),
    "least": functions.least,
    "greatest": functions.greatest,
    "sgn": functions.sign_from_zero,
    "sign": functions.sign,
    "select": functions.select,
    "wrap": functions.wrapped,
    "length": functions.length,
}
"""Functions of expressions that have an enclosure."""


def interval_leaf(symbols: Sequence[sp.Symbol], expressions: Sequence[Any]) -> Leaf:
    """The leaf from the ends of the symbols, low and high in turn, to those of the expressions."""
    steps = Steps(expanded=True)
    rows = [f"q{i}" for i in range(2 * len(symbols))]
    inputs: dict[Any, Any] = {
        symbol: Interval(steps.input(rows[2 * i]), steps.input(rows[2 * i + 1]))
        for i, symbol in enumerate(symbols)
    }
    lowering = IntervalLowering(steps, inputs)
    found: list[Any] = [lowering.value(sp.sympify(e)) for e in expressions]
    return Leaf(steps, {"q": rows}, [end for i in found for end in (i.low, i.high)])


class Enclosure:
    """Intervals that contain all values of expressions over boxes of their symbols.

    Every rounding is counted. NaN says that nothing is known, such as of 1/x where x may be 0.
    Raises `DefinitionError` for a function without a proved enclosure and for other symbols.
    """

    def __init__(self, expressions: Sequence[Any], symbols: Sequence[Any]) -> None:
        self.count, self.width = len(expressions), len(symbols)
        self._leaves = compiled_leaves({"enclosure": interval_leaf(symbols, expressions)})

    def over(self, low: Array, high: Array) -> tuple[Array, Array]:
        """The ends of the expressions over boxes, shapes (boxes, expressions).

        low, high: the corners of the boxes, shapes (boxes, symbols).
        """
        low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        if low.shape != high.shape or low.ndim != 2 or low.shape[1] != self.width:
            raise SimulationError(
                f"corners have the shapes {low.shape} and {high.shape}",
                expected=f"(count, {self.width}), both",
            )
        ends = np.stack([low, high], axis=2).reshape(len(low), 2 * self.width)
        found = self._leaves.values("enclosure", len(low), 2 * self.count, ends)
        return found[:, 0::2], found[:, 1::2]
