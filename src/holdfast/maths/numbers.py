"""Expressions at random points: whether they vanish, and the rank of their matrices."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence

import sympy as sp

_TRIALS, _WANTED = 40, 6


class Sampler:
    """Evaluates expressions at random values of their symbols, in a fixed sequence.

    `fixed` holds the symbols with given values. An analytic expression that vanishes at
    random points to rounding vanishes identically; this decides in milliseconds what a
    symbolic simplification may not decide at all.
    """

    def __init__(self, fixed: Mapping[sp.Symbol, float], reach: float = 0.7) -> None:
        self.fixed = {s: sp.Float(v) for s, v in fixed.items()}
        self.reach = reach

    def point(self, symbols: Sequence[sp.Symbol], number: int = 0) -> dict[sp.Symbol, sp.Expr]:
        """The `number`-th random point of the symbols, with the fixed values."""
        generator = random.Random(1000 + number)
        drawn = {s: generator.uniform(-self.reach, self.reach) for s in sorted(symbols, key=str)}
        return {s: sp.Float(v) for s, v in drawn.items()} | self.fixed

    def vanishes(self, expression: sp.Expr) -> bool:
        """Whether the expression is zero at all random points where it is a number.

        False where it is a number at too few of them.
        """
        terms = sp.Add.make_args(sp.sympify(expression))
        free = sorted(set().union(*(t.free_symbols for t in terms)), key=str)
        tested = 0
        for number in range(_TRIALS):
            at = self.point(free, number)
            values = [value_at(t, at) for t in terms]
            if not all(math.isfinite(v) for v in values):
                continue
            if abs(math.fsum(values)) > 1e-9 * max(1.0, *(abs(v) for v in values)):
                return False
            tested += 1
            if tested == _WANTED:
                return True
        return False


def value_at(expression: sp.Expr, at: Mapping[sp.Symbol, sp.Expr]) -> float:
    """The value of an expression with all its symbols replaced; nan where it is no real number."""
    number = complex(sp.N(expression.xreplace(dict(at))))
    return number.real if abs(number.imag) < 1e-12 * max(1.0, abs(number.real)) else math.nan


def rank(rows: Sequence[Sequence[float]]) -> int:
    """The rank of a matrix of numbers, by elimination with complete pivoting."""
    matrix = [list(row) for row in rows]
    size = max((abs(v) for row in matrix for v in row), default=0.0)
    found = 0
    while matrix and size > 0:
        i, j = max(
            ((i, j) for i in range(len(matrix)) for j in range(len(matrix[i]))),
            key=lambda ij: abs(matrix[ij[0]][ij[1]]),
        )
        pivot = matrix[i][j]
        if abs(pivot) <= 1e-9 * size:
            break
        found += 1
        top = matrix.pop(i)
        matrix = [[a - row[j] / pivot * b for a, b in zip(row, top, strict=True)] for row in matrix]
    return found
