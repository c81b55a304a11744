"""Sums and products with their rounding errors: pairs of floats that are exact."""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import Operand, Value, bits, choose, from_bits

SPLIT = 134217729.0
"""2^27 + 1 (T. J. Dekker, Numer. Math. 18, 1971)."""

Pair = tuple[Value, Value]


def exact_sum(a: Value, b: Value) -> Pair:
    """(s, e): s = a + b rounded, s + e = a + b exactly (D. E. Knuth)."""
    s = a + b
    c = s - a
    return s, (a - (s - c)) + (b - c)


def ordered_sum(a: Value, b: Value) -> Pair:
    """`exact_sum` of |a| >= |b|."""
    s = a + b
    return s, b - (s - a)


def halves(a: Value) -> Pair:
    """Two floats of 26 bits whose sum is a."""
    c = a * SPLIT
    high = c - (c - a)
    return high, a - high


def exact_product(a: Value, b: Value) -> Pair:
    """(p, e): p = a b rounded, p + e = a b exactly, where nothing underflows (Dekker)."""
    p = a * b
    a1, a2 = halves(a)
    b1, b2 = halves(b)
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


def with_sign_of(a: Value, b: Value) -> Value:
    """a >= 0 with the sign of b, also that of a zero."""
    return from_bits(bits(a) | (bits(b) & SIGN))


def least_of(a: Value, b: Operand) -> Value:
    """The smaller of two; b if a is NaN."""
    return choose(a < b, a, b)


def greatest_of(a: Value, b: Operand) -> Value:
    """The larger of two; b if a is NaN."""
    return choose(a > b, a, b)


SIGN = 1 << 63
