"""Support functions of the sets of inputs and disturbances, and the slopes that they can have."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.maths.definitions.bounds import Ball, Bounds, Box, LinearImage, Product
from holdfast.maths.expressions.functions import greatest, least, magnitude, select, sgn


def ends(bounds: Bounds) -> tuple[sp.Expr, ...]:
    """What is infinite where the set is not bounded."""
    if isinstance(bounds, Product):
        return tuple(e for part in bounds.parts for e in ends(part))
    of = bounds.of if isinstance(bounds, LinearImage) else bounds
    if isinstance(of, Ball):
        return (of.radius,)
    assert isinstance(of, Box)
    return (*of.lower, *of.upper)


def reach(
    bounds: Bounds, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int
) -> tuple[list[sp.Expr], ...]:
    n = gain.rows
    if isinstance(bounds, Product):
        columns = [gain.col(j) for j in range(gain.cols)]
        found = [
            reach(part, sp.Matrix.hstack(*mine), p, spread, sign)
            for part, mine in bounds.split(columns)
        ]
        return tuple([sum(e) for e in zip(*same, strict=True)] for same in zip(*found, strict=True))
    if isinstance(bounds, LinearImage):
        return reach(bounds.of, gain * bounds.matrix, p, spread, sign)
    if isinstance(bounds, Ball):
        width = [bounds.radius * sp.sqrt(sum(e**2 for e in gain.row(i))) for i in range(n)]
        return [sp.S.Zero] * n, width, *_turned(bounds, gain, p, spread, sign, width)
    assert isinstance(bounds, Box)
    low, high = bounds.lower, bounds.upper
    middle = sp.Matrix([(a + b) / 2 for a, b in zip(low, high, strict=True)])
    half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
    sizes = gain.applyfunc(magnitude)
    weights, ranges = gain.T * p, sizes.T * spread
    # where no p within the spread changes the sign of a weight, that input does not switch
    fixed = [
        select(magnitude(w) - r, sp.S.One, sp.S.Zero) for w, r in zip(weights, ranges, strict=True)
    ]
    held = sp.Matrix([sign * h * f * sgn(w) for h, f, w in zip(half, fixed, weights, strict=True)])
    loose = sp.Matrix([h * (1 - f) for h, f in zip(half, fixed, strict=True)])
    centre = gain * middle
    return (
        list(centre),
        list(sizes * sp.Matrix(half)),
        list(centre + gain * held),
        list(sizes * loose),
    )


def _turned(
    ball: Ball, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int, width: list[sp.Expr]
) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Centre and half-width of r G w/|w| for w = G'p, with p within the spread.

    w changes by at most d = |G|' dp. With s = |d|/|w| < 1 its direction turns by at most asin s,
    and w/|w| by 2 sin(asin(s)/2) = s sqrt(2 / (1 + sqrt(1 - s^2))); else it may be any.
    """
    weights, change = gain.T * p, gain.applyfunc(magnitude).T * spread
    size, swing = (sp.sqrt(sum(e**2 for e in v)) for v in (weights, change))
    tiny = sp.Float(1e-300)
    share = least(swing / (size + tiny), sp.S.One)
    turn = share * sp.sqrt(2 / (1 + sp.sqrt(1 - share**2)))
    best = gain * weights * (sign * ball.radius / (size + tiny))
    near, narrow = [], []
    for middle, most in zip(best, width, strict=True):
        low, high = greatest(middle - most * turn, -most), least(middle + most * turn, most)
        near.append(select(size - swing, (low + high) / 2, sp.S.Zero))
        narrow.append(select(size - swing, (high - low) / 2, most))
    return near, narrow


def support(
    bounds: Bounds | None, weights: Sequence[sp.Expr], sign: int
) -> tuple[sp.Expr, list[sp.Expr]]:
    if isinstance(bounds, Product):
        found = [support(part, mine, sign) for part, mine in bounds.split(list(weights))]
        return sum((v for v, _ in found), start=sp.S.Zero), [e for _, best in found for e in best]
    if isinstance(bounds, LinearImage):
        value, best = support(bounds.of, list(bounds.matrix.T * sp.Matrix(weights)), sign)
        return value, list(bounds.produce(best))
    if isinstance(bounds, Ball):
        size = sp.sqrt(sum((w**2 for w in weights), start=sp.S.Zero))
        return sign * bounds.radius * size, [
            sign * bounds.radius * w / (size + sp.Float(1e-300)) for w in weights
        ]
    assert isinstance(bounds, Box)
    pairs = list(zip(bounds.lower, bounds.upper, strict=True))
    middle, half = [(a + b) / 2 for a, b in pairs], [(b - a) / 2 for a, b in pairs]
    terms = [m * w + sign * h * magnitude(w) for m, h, w in zip(middle, half, weights, strict=True)]
    best = [m + sign * h * sgn(w) for m, h, w in zip(middle, half, weights, strict=True)]
    return sum(terms, start=sp.S.Zero), best
