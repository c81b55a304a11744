"""ENO of third order (Osher, Shu 1991)."""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import Value, choose
from holdfast.execution.level_set.schemes import Scheme, no_larger, same_way, smaller


def one_side(a: Value, b: Value, c: Value, d: Value, e: Value) -> Value:
    """The derivative between b and c from five successive first differences, c being upwind's."""
    d1, d2, d3, d4 = b - a, c - b, d - c, e - d
    below = c + 0.5 * d2 + smaller(d2 - d1, d3 - d2) * (1.0 / 3.0)
    above = c + 0.5 * d3 - smaller(d3 - d2, d4 - d3) * (1.0 / 6.0)
    return choose(no_larger(d2, d3), below, above)


def slopes(a: Value, b: Value, c: Value, d: Value, e: Value) -> tuple[Value, Value]:
    """The smoothest of three stencils."""
    return same_way(one_side(a, b, c, d, e), c), same_way(one_side(e, d, c, b, a), c)


SCHEME = Scheme("eno3", ghosts=3, order=3, slopes=slopes)
