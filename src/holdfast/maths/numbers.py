"""Expressions at random points, to fifty digits: whether they vanish, the rank of matrices."""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping, Sequence

import mpmath
import sympy as sp

from holdfast.errors import DefinitionError

_DIGITS = 50
_TRIALS, _WANTED = 60, 6
_EXACT, _DECIMAL = 1e-35, 1e-13
"""What counts as rounding, relative to the terms: of exact expressions at fifty digits, and of
expressions in which someone wrote a decimal number."""


class Sampler:
    """Evaluates expressions at random values of their symbols, in a fixed sequence.

    `fixed` holds the symbols with given values; `about` are the expressions that the answers
    are about: where one contains a decimal number, more counts as rounding. An analytic
    expression that vanishes at random points to rounding vanishes identically; this decides in
    milliseconds what a symbolic simplification may not decide at all.
    """

    def __init__(
        self,
        fixed: Mapping[sp.Symbol, float],
        about: Iterable[sp.Basic] = (),
        reach: float = 0.7,
    ) -> None:
        self.fixed = {s: sp.Float(sp.Rational(v), _DIGITS) for s, v in fixed.items()}
        self.rounding = _DECIMAL if any(e.has(sp.Float) for e in about) else _EXACT
        self.reach = reach

    def point(self, symbols: Iterable[sp.Symbol], number: int = 0) -> dict[sp.Symbol, sp.Expr]:
        """The `number`-th random point of the symbols, with the fixed values."""
        generator = random.Random(1000 + number)
        drawn = {s: generator.uniform(-self.reach, self.reach) for s in sorted(symbols, key=str)}
        return {s: sp.Float(sp.Rational(v), _DIGITS) for s, v in drawn.items()} | self.fixed

    def origin(self, symbols: Iterable[sp.Symbol]) -> dict[sp.Symbol, sp.Expr]:
        """The symbols at zero, with the fixed values."""
        return dict.fromkeys(symbols, sp.S.Zero) | self.fixed

    def generic_point(
        self, symbols: Sequence[sp.Symbol], expressions: Iterable[sp.Expr], what: str
    ) -> dict[sp.Symbol, sp.Expr]:
        """The first random point where all expressions are numbers; `DefinitionError` if none."""
        listed = list(expressions)
        for number in range(_TRIALS):
            at = self.point(symbols, number)
            if all(mpmath.isfinite(value_at(e, at)) for e in listed):
                return at
        raise DefinitionError(f"{what} is no number near the origin", expected="numbers")

    def vanishes(self, expression: sp.Expr) -> bool:
        """Whether the expression is zero at all random points where it is a number.

        False where it is a number at too few of them.
        """
        terms = sp.Add.make_args(sp.sympify(expression))
        free = set().union(*(t.free_symbols for t in terms))
        tested = 0
        for number in range(_TRIALS):
            at = self.point(free, number)
            values = [value_at(t, at) for t in terms]
            if not all(map(mpmath.isfinite, values)):
                continue
            if not self._nothing(mpmath.fsum(values), max(map(abs, values))):
                return False
            tested += 1
            if tested == _WANTED:
                return True
        return False

    def nonzero(self, expression: sp.Expr, at: Mapping[sp.Symbol, sp.Expr]) -> bool:
        """Whether the value there is a number and not zero, on the expression's own scale."""
        value = value_at(expression, at)
        points = (self.point(set(expression.free_symbols), number) for number in range(4))
        sizes = [abs(v) for v in (value_at(expression, p) for p in points) if mpmath.isfinite(v)]
        return bool(mpmath.isfinite(value)) and not self._nothing(value, max(sizes, default=1.0))

    def rank(self, rows: Sequence[Sequence[mpmath.mpf]]) -> int:
        """The rank of a matrix of numbers, whatever the scales of its rows and columns."""
        return rank(rows, self.rounding)

    def _nothing(self, value: mpmath.mpf, scale: mpmath.mpf) -> bool:
        return bool(abs(value) <= max(self.rounding * scale, 1e-38))


def value_at(expression: sp.Expr, at: Mapping[sp.Symbol, sp.Expr]) -> mpmath.mpf:
    """The value of an expression with all its symbols replaced; nan where it is no real number."""
    number = sp.N(sp.sympify(expression).xreplace(dict(at)), _DIGITS)
    if not number.is_number or number.has(sp.nan, sp.zoo, sp.oo, -sp.oo):
        return mpmath.mpf("nan")
    real, imaginary = number.as_real_imag()
    if abs(imaginary) > 1e-30 * (1 + abs(real)):
        return mpmath.mpf("nan")
    with mpmath.workdps(_DIGITS):
        return +real._to_mpmath(mpmath.mp.prec)


def rank(rows: Sequence[Sequence[mpmath.mpf]], rounding: float = _DECIMAL) -> int:
    """The rank of a matrix of numbers, by elimination with complete pivoting.

    Rows and columns are brought to one scale first; entries below `rounding` of their row
    count as zero.
    """
    with mpmath.workdps(_DIGITS):
        matrix = [list(map(mpmath.mpf, row)) for row in rows]
        for _ in range(2):
            matrix = [_scaled(row, rounding) for row in matrix]
            columns = [_scaled(list(c), 0.0) for c in zip(*matrix, strict=True)]
            matrix = [list(row) for row in zip(*columns, strict=True)]
        found, least = 0, mpmath.sqrt(rounding)
        while matrix and matrix[0]:
            places = ((i, j) for i in range(len(matrix)) for j in range(len(matrix[0])))
            i, j = max(places, key=lambda ij: abs(matrix[ij[0]][ij[1]]))
            pivot = matrix[i][j]
            if abs(pivot) <= least:
                break
            found += 1
            top = matrix.pop(i)
            matrix = [
                [a - row[j] / pivot * b for a, b in zip(row, top, strict=True)] for row in matrix
            ]
        return found


def _scaled(values: list[mpmath.mpf], rounding: float) -> list[mpmath.mpf]:
    size = max(map(abs, values), default=mpmath.mpf(0))
    if size <= 0:
        return values
    return [v / size if abs(v) > rounding * size else mpmath.mpf(0) for v in values]
