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
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import sympy as sp
from sympy.logic.boolalg import Boolean

from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import greatest, least, magnitude, select
from holdfast.maths.expressions.traversal import parts
from holdfast.maths.expressions.vocabulary import FUNCTIONS, pairwise


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
    found, _ = pairs[-1]
    for value, condition in reversed(pairs[:-1]):
        found = _chosen(condition, value, found)
    return found


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

    def own(part: sp.Basic) -> sp.Basic:
        if part not in exchanged:
            arguments = [own(a) for a in part.args]
            if type(part) in OWN:
                exchanged[part] = sp.sympify(OWN[type(part)](*arguments))
            else:
                same = all(a is b for a, b in zip(arguments, part.args, strict=True))
                exchanged[part] = part if same else part.func(*arguments)
        return exchanged[part]

    return own(e)
