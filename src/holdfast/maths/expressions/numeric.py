"""Numerical values of expressions, for numerical code: numbers, array functions, norms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import sympy as sp

from holdfast.maths.definitions.quantity import symbol

Expression = sp.Expr
Values = Mapping[sp.Symbol, float]


def parameter_values(parameters: Mapping[str, float] | None) -> dict[sp.Symbol, float]:
    """The values of parameters by their symbols."""
    return {symbol(k): v for k, v in (parameters or {}).items()}


def evaluated(expressions: Iterable[Any], values: Values) -> list[float]:
    """One number for each expression; NaN where an expression has no real value."""
    numbers = {s: sp.sympify(v) for s, v in values.items()}
    results = [complex(sp.N(sp.sympify(e).xreplace(numbers))) for e in expressions]
    return [z.real if z.imag == 0 else math.nan for z in results]


def array_function(arguments: Any, expressions: Any, values: Values | None = None) -> Callable:  # type: ignore[type-arg]
    """A NumPy function of the arguments, in their order, for one expression or for several."""
    numbers = dict(values or {})
    if isinstance(expressions, Sequence):
        fixed: Any = [sp.sympify(e).xreplace(numbers) for e in expressions]
    else:
        fixed = sp.sympify(expressions).xreplace(numbers)
    compiled: Callable[..., Any] = sp.lambdify(arguments, fixed, "numpy")
    return compiled


def constant(expression: Any) -> float | None:
    """The value of an expression without symbols, to 15 digits; None for one with symbols."""
    exact = sp.sympify(expression)
    return float(sp.N(exact)) if exact.is_number else None


def norm(vector: Iterable[Any]) -> sp.Expr:
    """The Euclidean norm, simplified."""
    return sp.sqrt(sp.simplify(sum(sp.sympify(e) ** 2 for e in vector)))


def multiple_of_name(expression: sp.Expr) -> tuple[float, str] | None:
    """(a, name) where the expression is a |name| or a name with a > 0; else None."""
    factor, rest = expression.as_independent(*expression.free_symbols, as_Add=False)
    rest = rest.args[0] if isinstance(rest, sp.Abs) else rest
    return (float(factor), rest.name) if rest.is_Symbol and factor > 0 else None
