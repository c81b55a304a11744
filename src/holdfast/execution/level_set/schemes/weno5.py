"""WENO of fifth order (Jiang, Peng 2000)."""

from __future__ import annotations

from holdfast.execution.arithmetic.steps import Value
from holdfast.execution.level_set.schemes import Scheme, about_inverse, same_way

BEND = 13.0 / 3.0


def slopes(a: Value, b: Value, c: Value, d: Value, e: Value) -> tuple[Value, Value]:
    """Fifth order where the value is smooth and has no extremum.

    Three third-order derivatives, weighted by the smoothness of their stencils, which is the same
    for the slopes at both ends of an interval. It is measured by the sum of all three and of the
    plain difference, so that no product is too small or too large for single precision, and the
    weights are multiplied out.
    """
    d1, d2, d3, d4 = b - a, c - b, d - c, e - d
    t1, t2, t3 = 3.0 * d2 - d1, d2 + d3, 3.0 * d3 - d4
    s1 = BEND * (d2 - d1) * (d2 - d1) + t1 * t1
    s2 = BEND * (d3 - d2) * (d3 - d2) + t2 * t2
    s3 = BEND * (d4 - d3) * (d4 - d3) + t3 * t3
    whole = c * c + s1 + s2 + s3 + 1e-34
    scale = 1e3 * about_inverse(whole)
    least = 1e-6 * (scale * whole)
    s1, s2, s3 = scale * s1 + least, scale * s2 + least, scale * s3 + least
    s1, s2, s3 = s1 * s1, s2 * s2, s3 * s3
    w1, w2, w3 = s2 * s3, 6.0 * (s1 * s3), s1 * s2
    from_left, from_right = w1 + w2 + 3.0 * w3, 3.0 * w1 + w2 + w3
    rise = w1 * (2.0 * t1 - d2) + w2 * (t2 + d3) + 3.0 * w3 * (t3 + d3)
    fall = w3 * (2.0 * t3 - d3) + w2 * (t2 + d2) + 3.0 * w1 * (t1 + d2)
    sixth = (1.0 / 6.0) / (from_left * from_right)
    left, right = c + rise * (from_right * sixth), c - fall * (from_left * sixth)
    return same_way(left, c), same_way(right, c)


SCHEME = Scheme("weno5", ghosts=3, order=3, slopes=slopes)
