"""Expressions of SymPy as steps of arithmetic, in one order for every target."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.execution.arithmetic import basics, elementary
from holdfast.execution.arithmetic.steps import FLOAT, Function, Steps, Value, root
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.maths.expressions.traversal import symbols_of

MOST_FACTORS = 8
"""Powers of larger whole numbers are computed by logarithms."""


def lowered(
    steps: Steps, expressions: Sequence[Any], inputs: Mapping[sp.Symbol, Value]
) -> list[Value]:
    """The values of the expressions, as steps that follow those of the inputs.

    Sums and products are taken from left to right in SymPy's printing order. A quotient is a
    product with the inverse, which all quotients with the same divisor share: a division takes as
    long as sixteen products, and derivatives divide by the same thing many times. Only a quotient
    of two symbols is divided, so that x/L is 1 where x is L; others may differ from it by a unit in
    the last place, and a divisor below 6e-309 gives an infinite inverse. Raises
    `DefinitionError` for a function without steps, and for a symbol that is not an input.
    """
    exact = [sp.sympify(e) for e in expressions]
    if unknown := symbols_of(exact) - set(inputs):
        raise DefinitionError(f"the expression uses '{min(map(str, unknown))}'")
    lowering = Lowering(steps, inputs)
    return [lowering.value(e) for e in exact]


def leaf_of(
    arrays: Mapping[str, Sequence[sp.Symbol]],
    results: Sequence[Any],
    uniform: Sequence[str] = (),
    steps: Steps | None = None,
) -> Leaf:
    """The leaf of these expressions; the symbols are the rows of its argument arrays.

    steps: those of other leaves, if values may be shared with them.
    """
    steps = steps or Steps(expanded=True)
    rows = {name: [f"{name}{i}" for i in range(len(symbols))] for name, symbols in arrays.items()}
    inputs = {
        symbol: steps.input(row)
        for name, symbols in arrays.items()
        for symbol, row in zip(symbols, rows[name], strict=True)
    }
    return Leaf(steps, rows, lowered(steps, results, inputs), frozenset(uniform))


def is_algebraic(expressions: Sequence[sp.Expr]) -> bool:
    """Whether the expressions are made of arithmetic, roots and comparisons alone."""
    parts = {part for e in expressions for part in sp.preorder_traversal(e)}
    powers = (p.exp for p in parts if isinstance(p, sp.Pow))
    functions = (p for p in parts if p.args and not p.is_Add and not p.is_Mul and not p.is_Pow)
    return all((2 * e).is_Integer and abs(e) <= MOST_FACTORS for e in powers) and all(
        type(p).__name__ in _ALGEBRAIC for p in functions
    )


class Lowering:
    """Values of expressions; a subclass has another arithmetic."""

    def __init__(self, steps: Steps, inputs: Mapping[sp.Symbol, Value]) -> None:
        self.steps = steps
        self.known: dict[sp.Basic, Value] = dict(inputs)

    def value(self, e: sp.Basic) -> Value:
        """The value of an expression, each part of which is lowered once."""
        if e not in self.known:
            self.known[e] = self._new(e)
        return self.known[e]

    def _new(self, e: sp.Basic) -> Value:
        if e.is_Number or e.is_NumberSymbol:
            return self._number(e)
        if e.is_Symbol:
            raise DefinitionError(f"the expression uses '{e}'")
        if isinstance(e, sp.Add):
            return self._sum(e)
        if isinstance(e, sp.Mul):
            return self._product(e)
        if isinstance(e, sp.Pow):
            return self._power(*e.as_base_exp())
        name = type(e).__name__
        if name in _PICKED:
            function = _PICKED[name]
            values = [self.value(a) for a in e.args[1:]]
            if self.steps.expanded:
                return function(*values)[int(e.args[0])]
            immediate = (name, function.points, int(e.args[0]))
            return self.steps.step(WALLS, *values, immediate=immediate, kind=FLOAT)
        arguments = e.args[:2] if name in _GUARDED else e.args
        return self._function(name, e)(*map(self.value, arguments))

    def _function(self, name: str, e: sp.Basic) -> Callable[..., Any]:
        if name not in _FUNCTIONS:
            raise DefinitionError(f"function '{name}' cannot be compiled: {e}")
        return _FUNCTIONS[name]

    def _number(self, e: sp.Basic) -> Any:
        return self.steps.constant(float(e), FLOAT)

    def _sum(self, e: sp.Add) -> Value:
        first, *rest = e.as_ordered_terms()
        total = self.value(first)
        for term in rest:
            if term.could_extract_minus_sign():
                total = total - self.value(-term)
            else:
                total = total + self.value(term)
        return total

    def _product(self, e: sp.Mul) -> Value:
        if len(e.args) == 2 and sum(a.is_Symbol for a in e.args) == 1:
            (inverse,) = (a for a in e.args if not a.is_Symbol)
            if isinstance(inverse, sp.Pow) and inverse.exp == -1 and inverse.base.is_Symbol:
                (above,) = (a for a in e.args if a.is_Symbol)
                return self.value(above) / self.value(inverse.base)
        factors: list[Value] = []
        minus = False
        for factor in e.as_ordered_factors():
            if factor == -1:
                minus = True
            elif factor.is_Number and factor < 0:
                minus = True
                factors.append(self._number(-factor))
            else:
                factors.append(self.value(factor))
        product = _in_turn(factors)
        return -product if minus else product

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> Value:
        value, size = self.value(base), abs(exponent) if exponent.is_Number else exponent
        whole, half = divmod(2 * size, 2) if (2 * size).is_Integer else (None, None)
        if whole is None or whole > MOST_FACTORS:
            return _value(elementary.power(value, self.value(exponent)))
        if exponent >= 0:
            return _in_turn([value] * int(whole) + ([root(value)] if half else []))
        if half:  # the inverse of the root, for every odd number of halves
            return _in_turn([1.0 / root(value)] * int(2 * size))
        return _in_turn([1.0 / value] * int(whole))


def _in_turn(factors: Sequence[Value]) -> Value:
    product = factors[0]
    for factor in factors[1:]:
        product = product * factor
    return product


def _value(value: Any) -> Value:
    assert isinstance(value, Value)
    return value


_GUARDED = ("angle", "length")
"""Functions with a third argument that only their derivatives use."""

WALLS = "walls"
"""The operation of a function of walls where it is called and not expanded."""

_ALGEBRAIC = frozenset(
    ("Abs", "magnitude", "Min", "Max", "sgn", "sign", "select", "least", "greatest", "length")
)

_PICKED = {
    function.name: function
    for function in (basics.nearest_on_walls, basics.nearest_to_sight, basics.nearest_face)
}
"""Functions of some coordinates and of walls, of whose results the first argument picks one."""

FUNCTIONS: tuple[Function | basics.OverWalls, ...] = (
    basics.wrap, basics.least, basics.greatest, basics.sgn, basics.sign, basics.select,
    basics.length, elementary.sine_and_cosine, elementary.tangent, elementary.arctangent,
    elementary.arcsine, elementary.arccosine, elementary.angle_of,
    elementary.REDUCED_BY_DIGITS, elementary.exponential, elementary.logarithm,
    elementary.power, elementary.hyperbolic_sine, elementary.hyperbolic_cosine,
    elementary.hyperbolic_tangent, basics.foot, basics.turn,
    *(f.one for f in _PICKED.values()), *_PICKED.values(),
)  # fmt: skip
"""All functions that steps may call."""

_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": lambda x: elementary.sine_and_cosine(x)[0],
    "cos": lambda x: elementary.sine_and_cosine(x)[1],
    "tan": elementary.tangent,
    "asin": elementary.arcsine,
    "acos": elementary.arccosine,
    "atan": elementary.arctangent,
    "atan2": elementary.angle_of,
    "angle": elementary.angle_of,
    "exp": elementary.exponential,
    "log": elementary.logarithm,
    "sinh": elementary.hyperbolic_sine,
    "cosh": elementary.hyperbolic_cosine,
    "tanh": elementary.hyperbolic_tangent,
    "Abs": abs,
    "magnitude": abs,
    "Min": lambda *a: _folded(basics.least, a),
    "Max": lambda *a: _folded(basics.greatest, a),
    "sgn": basics.sgn,
    "sign": basics.sign,
    "wrap": basics.wrap,
    "select": basics.select,
    "least": basics.least,
    "greatest": basics.greatest,
    "length": basics.length,
}


def _folded(function: Callable[..., Any], values: Sequence[Value]) -> Value:
    folded = values[0]
    for value in values[1:]:
        folded = _value(function(folded, value))
    return folded
