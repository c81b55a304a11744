"""ENO of second order (Osher, Shu 1991)."""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import Value
from holdfast.execution.level_set.schemes.base import Scheme, same_way, smaller


def slopes(a: Value, b: Value, c: Value) -> tuple[Value, Value]:
    """The first derivative, corrected by the smaller of two second differences."""
    bend = 0.5 * smaller(b - a, c - b)
    return same_way(b + bend, b), same_way(b - bend, b)


SCHEME = Scheme("eno2", ghosts=2, order=2, slopes=slopes)
