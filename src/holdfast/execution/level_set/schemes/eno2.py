"""ENO of second order (Osher, Shu 1991)."""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import Value
from holdfast.execution.level_set.schemes import Scheme, same_way, smaller


def slopes(a: Value, b: Value, c: Value) -> tuple[Value, Value]:
    """The first derivative, corrected by the smaller of two second differences."""
    before, behind = b - a, c - b
    upper, lower = b + 0.5 * smaller(before, behind), b - 0.5 * smaller(behind, before)
    return same_way(upper, b), same_way(lower, b)


SCHEME = Scheme("eno2", ghosts=2, order=2, slopes=slopes)
