"""Functions of SymPy in the project's own, of which every derivative can be compiled.

SymPy differentiates `Max` and `Min` to `Heaviside`, `sign` to `DiracDelta`, and `atan2` to 0/0 at
the origin. A definition exchanges them once, where it takes an expression, so that whatever is
derived from it has the derivatives of `functions.py`:

| of SymPy | becomes |
|---|---|
| Abs, Max, Min | magnitude, greatest, least |
| sign(x) | select(x, select(-x, 0, 1), -1): 0 at 0, with the derivative 0 |
| Heaviside(x, h) | select(x, select(-x, h, 1), 0) |
| Piecewise | select of the difference in each comparison |
| atan2(y, x) | angle(y, x) |
| cot, sec, csc, coth, sech, csch | the inverses of tan, cos, sin, tanh, cosh, sinh |

Beside them stand the functions that text expressions may call, and the constructs they may not use.
An expression that jumps becomes cases that do not.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import sympy as sp
from sympy.logic.boolalg import Boolean

from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import (
    Process,
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
from holdfast.maths.expressions.traversal import exchanged, parts

_EPS = sp.Float(1e-12)


def pairwise(function: Callable[..., sp.Expr]) -> Callable[..., sp.Expr]:
    """Extend a function of two arguments to any number of them."""

    def fold(first: sp.Expr, *rest: sp.Expr) -> sp.Expr:
        for value in rest:
            first = function(first, value)
        return first

    return fold


PROCESSES = {p.__name__: p for p in Process.__subclasses__()}
"""Stochastic processes, which a disturbance alone may have."""

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
    **{name: (int(max(p.nargs)), int(max(p.nargs)), p) for name, p in PROCESSES.items()},
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


MOST = 256
"""Cases of one group of expressions."""

JUMPS = (select, sgn, sp.sign)

Branch = tuple[tuple[sp.Expr, ...], list[sp.Expr]]
"""Conditions that are all at most 0 there, and the expressions."""


def branches(expressions: Sequence[sp.Expr]) -> list[Branch]:
    """The expressions without `select`, `sgn` and `sign`: one case for each way these may go.

    Somewhere on the border of two cases both have their conditions. Raises `DefinitionError` for
    more than `MOST` cases.
    """
    waiting: list[Branch] = [((), list(expressions))]
    finished: list[Branch] = []
    while waiting:
        if len(waiting) + len(finished) > MOST:
            raise DefinitionError(f"expressions with more than {MOST} cases of select and sgn")
        conditions, now = waiting.pop()
        at = _first_level(now)
        if at is None:
            finished.append((conditions, now))
            continue
        for sign, more in ((1, (-at,)), (-1, (at,)), (0, (at, -at))):
            jumps = [p for p in parts(now) if isinstance(p, JUMPS) and p.args[0] == at]
            if sign or any(isinstance(p, sp.sign) for p in jumps):
                values = {p: _value(p, sign) for p in jumps}
                waiting.append(((*conditions, *more), exchanged(now, values)))
    return finished


def _first_level(expressions: Sequence[sp.Expr]) -> sp.Expr | None:
    """What a jump depends on, in which nothing jumps."""
    for part in parts(expressions):
        if isinstance(part, JUMPS) and not any(isinstance(p, JUMPS) for p in parts(part.args[:1])):
            level: sp.Expr = part.args[0]
            return level
    return None


def _value(jump: sp.Expr, sign: int) -> sp.Expr:
    if isinstance(jump, select):
        return jump.args[1] if sign >= 0 else jump.args[2]
    if isinstance(jump, sgn):
        return sp.Integer(1 if sign >= 0 else -1)
    return sp.Integer(sign)


def _sign(x: sp.Expr) -> sp.Expr:
    return select(x, select(-x, 0, 1), -1)


def _step(x: sp.Expr, half: sp.Expr) -> sp.Expr:
    return select(x, select(-x, half, 1), 0)


def _cases(*pairs: sp.Basic) -> sp.Expr:
    """The value of the first pair (value, condition) whose condition holds."""
    if sp.Or(*(condition for _, condition in pairs)) != sp.true:
        raise DefinitionError(
            f"Piecewise has no value where none of its conditions holds: {pairs[-1]}",
            remedy="end it with (value, True)",
        )
    nested, _ = pairs[-1]
    for value, condition in reversed(pairs[:-1]):
        nested = _chosen(condition, value, nested)
    return nested


def _chosen(condition: Boolean, then: sp.Expr, other: sp.Expr) -> sp.Expr:
    """`then` where the condition holds, `other` elsewhere."""
    if condition in (sp.true, sp.false):
        return then if condition == sp.true else other
    if isinstance(condition, sp.Not):
        return _chosen(condition.args[0], other, then)
    if isinstance(condition, sp.And):
        for part in condition.args:
            then = _chosen(part, then, other)
        return then
    if isinstance(condition, sp.Or):
        for part in condition.args:
            other = _chosen(part, then, other)
        return other
    if isinstance(condition, sp.Rel):
        difference = condition.lhs - condition.rhs
        match condition:
            case sp.Ge():
                return select(difference, then, other)
            case sp.Le():
                return select(-difference, then, other)
            case sp.Gt():
                return select(-difference, other, then)
            case sp.Lt():
                return select(difference, other, then)
            case sp.Eq():
                return select(difference, select(-difference, then, other), other)
            case sp.Ne():
                return select(difference, select(-difference, other, then), then)
    raise DefinitionError(
        f"the condition {condition} of Piecewise cannot be compiled",
        expected="comparisons, joined by And, Or and Not",
    )


OWN: Mapping[type, Callable[..., sp.Expr]] = {
    sp.Abs: magnitude,
    sp.Max: pairwise(greatest),
    sp.Min: pairwise(least),
    sp.sign: _sign,
    sp.Heaviside: _step,
    sp.Piecewise: _cases,
    sp.atan2: FUNCTIONS["atan2"][2],
    sp.cot: lambda x: 1 / sp.tan(x),
    sp.sec: lambda x: 1 / sp.cos(x),
    sp.csc: lambda x: 1 / sp.sin(x),
    sp.coth: lambda x: 1 / sp.tanh(x),
    sp.sech: lambda x: 1 / sp.cosh(x),
    sp.csch: lambda x: 1 / sp.sinh(x),
}
"""Function of SymPy -> the same of the project's own, from its arguments."""


def canonical(expression: Any) -> sp.Expr:
    """The expression with the project's own functions in place of those of SymPy in `OWN`.

    Raises `DefinitionError` for a Piecewise that has no value somewhere, or whose conditions are
    no comparisons.
    """
    e = sp.sympify(expression)
    if not isinstance(e, sp.Basic) or not any(type(p) in OWN for p in parts([e])):
        return e
    exchanged: dict[sp.Basic, sp.Basic] = {}

    def converted(part: sp.Basic) -> sp.Basic:
        if part not in exchanged:
            arguments = [converted(a) for a in part.args]
            if type(part) in OWN:
                exchanged[part] = sp.sympify(OWN[type(part)](*arguments))
            else:
                same = all(a is b for a, b in zip(arguments, part.args, strict=True))
                exchanged[part] = part if same else part.func(*arguments)
        return exchanged[part]

    return converted(e)
