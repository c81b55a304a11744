"""Expressions that jump, as cases that do not."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import select, sgn
from holdfast.maths.expressions.traversal import exchanged, parts

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
    found: list[Branch] = []
    while waiting:
        if len(waiting) + len(found) > MOST:
            raise DefinitionError(f"expressions with more than {MOST} cases of select and sgn")
        conditions, now = waiting.pop()
        at = _first_level(now)
        if at is None:
            found.append((conditions, now))
            continue
        for sign, more in ((1, (-at,)), (-1, (at,)), (0, (at, -at))):
            jumps = [p for p in parts(now) if isinstance(p, JUMPS) and p.args[0] == at]
            if sign or any(isinstance(p, sp.sign) for p in jumps):
                values = {p: _value(p, sign) for p in jumps}
                waiting.append(((*conditions, *more), exchanged(now, values)))
    return found


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
