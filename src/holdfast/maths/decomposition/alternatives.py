"""A region as a union of intersections: inequalities that are the least of several expressions.

min(a, b) <= 0   where   a <= 0 or b <= 0
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import sympy as sp

from holdfast.maths.definitions.region import Inequality
from holdfast.maths.expressions.functions import greatest, least

MOST = 16
"""More alternatives than these are not taken apart."""


def alternatives(inequalities: Sequence[Inequality]) -> list[tuple[Inequality, ...]]:
    """Lists of inequalities of which one holds altogether, exactly where all the given ones do."""
    rows = [_rows(c.expression) for c in inequalities]
    if math.prod(map(len, rows)) > MOST:
        return [tuple(inequalities)]
    found = []
    for chosen in itertools.product(*rows):
        parts = []
        for c, both in zip(inequalities, chosen, strict=True):
            for k, e in enumerate(both):
                name = c.name if len(both) == 1 else f"{c.name}_{k + 1}"
                parts.append(replace(c, name=name, expression=e))
        found.append(tuple(parts))
    return found


def _rows(e: sp.Expr) -> list[tuple[sp.Expr, ...]]:
    """Of e <= 0: the alternatives, each a list of expressions that are all to be <= 0."""
    if isinstance(e, (least, sp.Min)):
        return [row for a in e.args for row in _rows(a)]
    if isinstance(e, (greatest, sp.Max)):
        every = itertools.product(*(_rows(a) for a in e.args))
        return [tuple(itertools.chain(*one)) for one in every]
    return [(e,)]
