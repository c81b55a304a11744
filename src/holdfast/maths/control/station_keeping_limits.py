"""Limits of ball, gains and sample time for station keeping in a bounded current (chapter 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from holdfast.arguments import checked
from holdfast.errors import DefinitionError


@dataclass(frozen=True)
class StationKeepingLimits:
    """Proved requirements of `hold_station`, and its measured accuracy.

    least_k1: for the radius r0, (3.7) holds for every direction of the current and every
    |r| >= r0 exactly when k1 is above this [1/s]. least_r0: for the gain k1, the smallest such
    radius [m]; 0 if any radius is enough. longest_sample_time: k2 times it is 0.5 [s]. excess: the
    approximate distance by which the vehicle leaves the ball, 0.03 / k2 [m]: measured in the
    current of the thesis with r1 = r0, up to five times that in other directions (the thesis says
    'arbitrarily small').
    """

    least_k1: float
    least_r0: float
    longest_sample_time: float
    excess: float


@checked
def station_keeping_limits(
    speed_bound: float, lam: float = 3.0, *, k1: float = 1.5, r0: float = 0.1, k2: float = 5.0
) -> StationKeepingLimits:
    """The limits of `hold_station` for a current of at most `speed_bound` [m/s].

        k1 > sup_(r >= r0) |v| (lam r^2 - 2 w) / (r (lam r^2 - w)),   w = 1 - exp(-r^2)

    the supremum of (3.7) over all directions of the current; (3.6) holds always for lam >= 2.
    Sufficient, not necessary: smaller k1 were seen to enter the ball too. k1, k2 in 1/s, r0 in
    m. Raises `DefinitionError` for a speed, gain or radius that is not positive, or lam < 2.
    """
    for name, value in (("speed_bound", speed_bound), ("k1", k1), ("r0", r0), ("k2", k2)):
        if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
            raise DefinitionError(f"{name} is {value!r}", expected="a number above 0")
    if not (math.isfinite(lam) and lam >= 2):
        raise DefinitionError(f"lam is {lam}", expected="2 or more")
    return StationKeepingLimits(
        least_k1=speed_bound * _worst_beyond(r0, lam),
        least_r0=_least_radius(k1 / speed_bound, lam),
        longest_sample_time=0.5 / k2,
        excess=0.03 / k2,
    )


def _need(r: float, lam: float) -> float:
    """k1 / |v| required by (3.7) at the distance r, over all directions [1/m]."""
    w = -math.expm1(-(r**2))
    return (lam * r**2 - 2 * w) / (r * (lam * r**2 - w))


@lru_cache(maxsize=4096)
def _worst_beyond(r0: float, lam: float) -> float:
    """The supremum of the need over r >= r0; it has at most one maximum and falls as 1/r."""
    low, high = math.log(r0), math.log(max(r0, 1.0)) + 5.0
    grid = [low + (high - low) * i / 400 for i in range(401)]
    best = max(range(401), key=lambda i: _need(math.exp(grid[i]), lam))
    a, b = grid[max(best - 1, 0)], grid[min(best + 1, 400)]
    for _ in range(100):  # ternary search within one cell either side
        c, d = a + (b - a) / 3, b - (b - a) / 3
        if _need(math.exp(c), lam) < _need(math.exp(d), lam):
            a = c
        else:
            b = d
    return max(_need(math.exp(a), lam), _need(r0, lam))


def _least_radius(gain: float, lam: float) -> float:
    smallest = 1e-6
    if _worst_beyond(smallest, lam) < gain:
        return 0.0
    low, high = math.log(smallest), math.log(1e6)
    for _ in range(80):
        middle = (low + high) / 2
        if _worst_beyond(math.exp(middle), lam) < gain:
            high = middle
        else:
            low = middle
    return math.exp(high)
