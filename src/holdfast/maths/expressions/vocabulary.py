"""The functions that text expressions may call, and the constructs they may not use."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable

import sympy as sp

from holdfast.maths.expressions.functions import (
    angle,
    clip,
    greatest,
    least,
    length,
    magnitude,
    select,
    sgn,
    wrap,
)

_EPS = sp.Float(1e-12)


def pairwise(function: Callable[..., sp.Expr]) -> Callable[..., sp.Expr]:
    """Extend a function of two arguments to any number of them."""

    def fold(first: sp.Expr, *rest: sp.Expr) -> sp.Expr:
        for value in rest:
            first = function(first, value)
        return first

    return fold


FUNCTIONS: dict[str, tuple[int, int, Callable[..., sp.Expr]]] = {
    "sin": (1, 1, sp.sin),
    "cos": (1, 1, sp.cos),
    "tan": (1, 1, sp.tan),
    "asin": (1, 1, sp.asin),
    "acos": (1, 1, sp.acos),
    "atan": (1, 1, sp.atan),
    "sinh": (1, 1, sp.sinh),
    "cosh": (1, 1, sp.cosh),
    "tanh": (1, 1, sp.tanh),
    "exp": (1, 1, sp.exp),
    "log": (1, 1, sp.log),
    "sqrt": (1, 1, sp.sqrt),
    "abs": (1, 1, magnitude),
    "sgn": (1, 1, sgn),
    "wrap": (1, 1, wrap),
    "atan2": (2, 2, lambda y, x: angle(y, x, _EPS)),
    "hypot": (2, 2, lambda x, y: length(x, y, _EPS)),
    "clip": (3, 3, clip),
    "select": (3, 3, select),
    "min": (2, 8, pairwise(least)),
    "max": (2, 8, pairwise(greatest)),
}
"""Name -> (fewest arguments, most arguments, the function).

`diff(expression, name)`, the partial derivative, is handled apart."""

NUMERIC: dict[str, Callable[[float], float]] = {
    name: getattr(math, name)
    for name in [
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "sinh",
        "cosh",
        "tanh",
        "exp",
        "log",
        "sqrt",
    ]
}
"""Functions of numbers are folded in floating point: SymPy would try to be exact."""

FORBIDDEN = {
    ast.Attribute: "attribute access",
    ast.Subscript: "indexing",
    ast.Lambda: "a lambda",
    ast.List: "a list",
    ast.Tuple: "a tuple",
    ast.Dict: "a dictionary",
    ast.Set: "a set",
    ast.ListComp: "a comprehension",
    ast.GeneratorExp: "a comprehension",
    ast.JoinedStr: "a string",
    ast.Starred: "an unpacked argument",
    ast.NamedExpr: "an assignment",
    ast.Await: "await",
}
