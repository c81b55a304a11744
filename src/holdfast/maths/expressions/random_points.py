"""Expressions at random points, to fifty digits: whether they vanish, the rank of matrices.

A number that comes out of terms that cancel is known to within the rounding of those terms, and
counts as zero below that. Every number here is evaluated together with the size of the terms that
cancel in it (`measured`), and only this decides whether it is zero: a vector is never rescaled
before its zeros are told from its small entries.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache

import mpmath
import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import Frozen, RealFunction, select
from holdfast.maths.expressions.traversal import parts, symbols_of

_DIGITS = 50
_TRIALS, _WANTED = 60, 6
_EXACT, _DECIMAL = 1e-35, 1e-13
"""Thresholds of rounding, relative to the terms that cancel: for exact expressions at fifty digits,
and for expressions that contain a decimal number."""


class Sampler:
    """Evaluates expressions at random values of their symbols, in a fixed sequence.

    `fixed` holds the symbols with given values. `about` holds the expressions under test: if one
    contains a decimal number, the rounding threshold is larger. An analytic
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
        raise DefinitionError(f"{what} is not a number near the origin", expected="numbers")

    def vanishes(self, expression: sp.Expr) -> bool:
        """Whether the expression is zero at all random points where it is a number.

        False where it is a number at too few of them.
        """
        free = sp.sympify(expression).free_symbols
        tested = 0
        for number in range(_TRIALS):
            value, size = measured(expression, self.point(free, number))
            if not mpmath.isfinite(value):
                continue
            if abs(value) > self.rounding * size:
                return False
            tested += 1
            if tested == _WANTED:
                return True
        return False

    def nonzero(self, expression: sp.Expr, at: Mapping[sp.Symbol, sp.Expr]) -> bool:
        """Whether the value there is a number and not zero."""
        value, size = measured(expression, at)
        return bool(mpmath.isfinite(value)) and bool(abs(value) > self.rounding * size)

    def row(
        self, expressions: Iterable[sp.Expr], at: Mapping[sp.Symbol, sp.Expr]
    ) -> list[Bounded] | None:
        """The values there, each with a bound of its error; None if one is not a number."""
        bounded = [measured(e, at) for e in expressions]
        if not all(mpmath.isfinite(value) for value, _ in bounded):
            return None
        return [(value, self.rounding * size) for value, size in bounded]

    def rank(self, rows: Iterable[Iterable[sp.Expr]], at: Mapping[sp.Symbol, sp.Expr]) -> int:
        """The rank there of the rows that are numbers there, whatever their scales."""
        evaluated = [self.row(expressions, at) for expressions in rows]
        return rank([row for row in evaluated if row is not None])


def is_zero(expression: sp.Expr) -> bool:
    """Whether the expression is zero for all values of its symbols.

    Random points where it is not zero decide at once; else `simplify` does, which takes long. There
    what is `Frozen` may be any number, and where it decides, both branches of a `select` count.
    """
    if expression.is_Number:
        return bool(expression == 0)
    tried = _of_all_branches(expression)
    sampler, free = Sampler({}, [tried]), symbols_of([tried])
    if any(sampler.nonzero(tried, sampler.point(free, k)) for k in range(_WANTED)):
        return False
    return sp.simplify(expression) == 0


def _of_all_branches(expression: sp.Expr) -> sp.Expr:
    """With a number in the place of what is frozen, and a sum of the branches that it decides.

    The weights are above 0, and those of the same condition are the same.
    """
    weights: dict[sp.Basic, list[sp.Expr]] = {}
    memo: dict[sp.Basic, sp.Basic] = {}

    def made(e: sp.Basic) -> sp.Basic:
        if isinstance(e, Frozen):
            return sp.Dummy(real=True)
        if isinstance(e, select) and any(isinstance(p, Frozen) for p in parts([e.args[0]])):
            condition, *cases = e.args
            if condition not in weights:
                weights[condition] = [sp.Dummy(real=True) ** 2 for _ in cases]
            pairs = zip(weights[condition], map(replaced, cases), strict=True)
            return sp.Add(*(w * case for w, case in pairs))
        arguments = [replaced(a) for a in e.args]
        same = all(a is b for a, b in zip(arguments, e.args, strict=True))
        return e if same else e.func(*arguments)

    def replaced(e: sp.Basic) -> sp.Basic:
        if e not in memo:
            memo[e] = made(e)
        return memo[e]

    return sp.sympify(replaced(expression))


@lru_cache(maxsize=256)
def full_rank(matrix: sp.ImmutableMatrix) -> bool:
    """Whether the rows of a matrix are independent for some values of its symbols.

    A random point where they are decides at once; else SymPy does, which takes longer.
    """
    sampler = Sampler({}, matrix)
    rows = [list(matrix.row(i)) for i in range(matrix.rows)]
    if sampler.rank(rows, sampler.point(matrix.free_symbols)) == matrix.rows:
        return True
    return bool(matrix.rank() == matrix.rows)


Bounded = tuple[mpmath.mpf, mpmath.mpf]
"""A value and a bound of its error."""


def measured(expression: sp.Expr, at: Mapping[sp.Symbol, sp.Expr]) -> Bounded:
    """The value of an expression at a point, and the size of the terms that cancel in it.

    The size is the error of the value per unit of relative rounding of every operation:
    |a| + |b| for a + b, however small the sum. Both are nan if the value is not a real number.
    """
    memo: dict[sp.Basic, Bounded] = {}
    with mpmath.workdps(_DIGITS):
        return _measured(sp.sympify(expression), at, memo)


_NONE = (mpmath.mpf("nan"), mpmath.mpf("nan"))


def _measured(
    e: sp.Basic, at: Mapping[sp.Symbol, sp.Expr], memo: dict[sp.Basic, Bounded]
) -> Bounded:
    if not isinstance(e, sp.Expr) or isinstance(e, sp.Piecewise):
        return _NONE  # a condition
    if e not in memo:
        parts = [_measured(a, at, memo) for a in e.args]
        if any(not mpmath.isfinite(value) for value, _ in parts):
            memo[e] = _NONE
        elif isinstance(e, sp.Add):
            memo[e] = mpmath.fsum(v for v, _ in parts), mpmath.fsum(s for _, s in parts)
        elif isinstance(e, sp.Mul):
            memo[e] = _product(parts)
        else:
            memo[e] = _applied(e, parts, at)
    return memo[e]


def _product(parts: Sequence[Bounded]) -> Bounded:
    value, size = mpmath.mpf(1), mpmath.mpf(0)
    for v, s in parts:
        value, size = value * v, size * abs(v) + abs(value) * s
    return value, size


def _applied(e: sp.Basic, parts: Sequence[Bounded], at: Mapping[sp.Symbol, sp.Expr]) -> Bounded:
    """The value and size of a symbol, a number, or a function of known arguments."""
    if not parts:
        value = value_at(e, at)
        return value, abs(value)
    # the derivatives are evaluated at the values of the arguments
    if type(e).__name__ in _JUMPING and abs(parts[0][0]) <= JUMP * parts[0][1]:
        return _NONE  # rounding would decide
    arguments = [sp.Dummy(real=True) for _ in parts]
    f = e.func(*arguments)
    here = {a: sp.Float(v, _DIGITS) for a, (v, _) in zip(arguments, parts, strict=True)}
    value = value_at(e.func(*(here[a] for a in arguments)), {})
    if not mpmath.isfinite(value):
        return _NONE
    size = abs(value)
    for i, (argument, part, (_, s)) in enumerate(zip(arguments, e.args, parts, strict=True)):
        if s != 0 and not part.is_number:
            unit = [sp.Integer(j == i) for j in range(len(parts))]
            slope = f.slope(unit) if isinstance(f, RealFunction) else f.diff(argument)
            if slope.has(sp.Derivative, sp.Subs):
                return _NONE
            size += abs(value_at(slope, here)) * s
    return value, size


_JUMPING = ("select", "sgn", "sign")
JUMP = mpmath.mpf(10) ** (10 - _DIGITS)
"""Functions that jump where the first argument is zero, and when it is as good as zero."""


def value_at(expression: sp.Expr, at: Mapping[sp.Symbol, sp.Expr]) -> mpmath.mpf:
    """The value of an expression with all its symbols replaced; nan if it is not real."""
    number = sp.N(sp.sympify(expression).xreplace(dict(at)), _DIGITS)
    if not number.is_number or number.has(sp.nan, sp.zoo, sp.oo, -sp.oo):
        return mpmath.mpf("nan")
    real, imaginary = number.as_real_imag()
    if not (real.is_Number and imaginary.is_Number):  # a function without a numerical value
        return mpmath.mpf("nan")
    if abs(imaginary) > 1e-30 * (1 + abs(real)):
        return mpmath.mpf("nan")
    with mpmath.workdps(_DIGITS):
        return +real._to_mpmath(mpmath.mp.prec)


def rank(rows: Sequence[Sequence[Bounded]]) -> int:
    """The rank of a matrix of numbers with bounds of their errors, by complete pivoting.

    A pivot counts if it is above its own error, which the elimination propagates. Rows and
    columns are scaled, with their errors, only for the choice of the pivots.
    """
    with mpmath.workdps(_DIGITS):
        matrix = [list(row) for row in rows]
        for _ in range(2):
            matrix = [_scaled(row) for row in matrix]
            columns = [_scaled(column) for column in zip(*matrix, strict=True)]
            matrix = [list(row) for row in zip(*columns, strict=True)]
        pivots = 0
        while matrix and matrix[0]:
            places = [(i, j) for i in range(len(matrix)) for j in range(len(matrix[0]))]
            i, j = max(places, key=lambda ij: _known(matrix[ij[0]][ij[1]]))
            if _known(matrix[i][j]) == 0:
                break
            pivots += 1
            top = matrix.pop(i)
            matrix = [
                [_reduced(a, row[j], top[j], b) for a, b in zip(row, top, strict=True)]
                for row in matrix
            ]
            for row in matrix:
                del row[j]
        return pivots


def _known(entry: Bounded) -> mpmath.mpf:
    """The size of an entry, 0 where it is within its error."""
    value, error = entry
    return abs(value) if abs(value) > error else mpmath.mpf(0)


def _reduced(a: Bounded, beside: Bounded, pivot: Bounded, above: Bounded) -> Bounded:
    """a - (beside / pivot) above, and the bound of its error."""
    share, value = beside[0] / pivot[0], above[0] / pivot[0]
    error = a[1] + abs(share) * above[1] + abs(value) * (beside[1] + abs(share) * pivot[1])
    return a[0] - share * above[0], error


def _scaled(entries: Sequence[Bounded]) -> list[Bounded]:
    size = max(map(_known, entries), default=mpmath.mpf(0))
    if size <= 0:
        return list(entries)
    return [(value / size, error / size) for value, error in entries]
