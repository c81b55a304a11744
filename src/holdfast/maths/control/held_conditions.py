"""Gains of a region's safety filter against sampling: what an input that is held can bear.

A condition of the filter bounds a derivative of a constraint c at a sample, and the input is held
until the next, T later. Where that derivative does not change meanwhile,

    dc/dt <= -k c                         c(i+1) <= (1 - k T) c(i),
    d2c/dt2 <= -(k1 + k2) dc/dt - k1 k2 c      a sampled double integrator,

and the condition keeps c <= 0, from c <= 0 and dc/dt + k1 c <= 0, at every instant, whatever else
the input does, exactly for

    k T <= 1                                                          order one
    s (s + r) T^2 - 2 r T - 2 <= 0,  s = k1 + k2,  r^2 = k1^2 + k2^2       order two

The second is the hold after the one that begins on the limit, at any speed inwards: its parabola
touches c = 0. All states that follow from the start are in the cone between these two, and an
input that does more than the condition asks only lowers c. For k1 -> 0 it is
k2 T <= (1 + 5^(1/2)) / 2, for equal gains k T <= .787. A condition that is kept possible for later
inputs (`later_inputs.py`) has both, and k T <= 1 for each gain.

With a measurement that is late as well no margin helps beyond a delay at which the loop of the
condition, d2c/dt2 = -(k1 + k2) dc/dt - k1 k2 c or dc/dt = -k c, diverges: a held input counts as
half a sample late.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import GainCondition
from holdfast.maths.definitions.quantity import DELAY, SAMPLE_TIME, symbol

USUAL = (1.0, 4.0)
"""Gains of a safety filter [1/s] where none are given and the sample time bears them."""

K1, K2 = symbol("kappa1"), symbol("kappa2")
ROUNDING = 1e-9  # of a hold that is exactly the longest


@dataclass(frozen=True)
class HeldGains(GainCondition):
    """A condition on the gains of a safety filter.

    orders: of the conditions that have the gains.
    """

    orders: tuple[int, ...] = ()

    def violation(self, parameters: Mapping[sp.Symbol, float]) -> str | None:
        values = {DELAY: 0.0, **parameters}
        value, limit = (float(e.subs(values)) for e in (self.value, self.limit))
        if value <= limit * (1.0 + ROUNDING):
            return None
        gains = [float(values[k]) for k in ((K1, K2) if self.orders != (1,) else (K1,))]
        shown = " and ".join(f"{k:g}" for k in gains)
        if not self.refused:
            late = f"late by {values[DELAY]:g} s and held for {values[SAMPLE_TIME]:g} s"
            return (
                f"gains of {shown} 1/s of the safety filter, {late}: {self.consequence}, beyond a "
                f"delay of {limit - values[SAMPLE_TIME] / 2:.3g} s ({self.source})"
            )
        share = limit / value
        most = " and ".join(f"{_rounded_down(k * share)}" for k in gains)
        return (
            f"gains of {shown} 1/s of the safety filter, held for {value:g} s: {self.consequence}; "
            f"expected at most {most} 1/s, or a sample time of at most {_rounded_down(limit)} s"
        )


def conditions(orders: Iterable[tuple[int, ...]]) -> tuple[HeldGains, ...]:
    """The conditions on the gains.

    orders: of the conditions of every constraint, (1,), (2,), or (1, 2) with later inputs.
    """
    crossed = "a constraint is crossed between two samples although its condition is kept"
    found = []
    for kind in sorted(set(orders)):
        found += [
            HeldGains(
                value=SAMPLE_TIME, limit=_longest(kind), consequence=crossed, closed=True,
                source="derived for a held input", refused=True, orders=kind,
            ),
            HeldGains(
                value=DELAY + SAMPLE_TIME / 2, limit=_latest(kind), closed=True, orders=kind,
                consequence="a constraint is crossed ever further, whatever its margin",
                source="phase margin of the condition",
            ),
        ]  # fmt: skip
    return tuple(found)


def check_held(found: Sequence[HeldGains], gains: tuple[float, float], sample_time: float) -> None:
    """Raises `DefinitionError` for gains that a sample time does not bear."""
    values = {K1: gains[0], K2: gains[1], SAMPLE_TIME: sample_time}
    crossed = [c for c in found if c.refused and c.violation(values)]
    if crossed:  # what the shortest hold asks is enough for the others
        shortest = min(crossed, key=lambda c: float(c.limit.subs(values)))
        of_all = replace(shortest, orders=max(c.orders for c in found))
        raise DefinitionError(of_all.violation(values) or "")


def longest_hold(gains: tuple[float, float], orders: tuple[int, ...]) -> float:
    """The longest sample time that bears the gains [s]; orders: see `conditions`."""
    return float(_longest(orders).subs({K1: gains[0], K2: gains[1]}))


def usual_gains(sample_time: float | None) -> tuple[float, float]:
    """`USUAL`, or as many times less as the faster one is above 1 / sample_time."""
    share = 1.0 if sample_time is None else min(1.0, 1.0 / (USUAL[1] * sample_time))
    return USUAL[0] * share, USUAL[1] * share


def _longest(orders: tuple[int, ...]) -> sp.Expr:
    """The longest hold [s]."""
    if orders == (1,):
        return 1 / K1
    s, r = K1 + K2, sp.sqrt(K1**2 + K2**2)
    second = (r + sp.sqrt(r**2 + 2 * s * (s + r))) / (s * (s + r))
    return second if orders == (2,) else sp.Min(second, 1 / K1, 1 / K2)


def _latest(orders: tuple[int, ...]) -> sp.Expr:
    """The delay at which the loop of the condition neither grows nor decays [s]."""
    if orders == (1,):
        return sp.pi / (2 * K1)
    s, p = K1 + K2, K1 * K2
    w = sp.sqrt((s**2 + sp.sqrt(s**4 + 4 * p**2)) / 2)
    return sp.atan(s * w / p) / w


def _rounded_down(value: float) -> str:
    """Four digits that are not above the value."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.floor(value / unit * (1 + 1e-12)) * unit:.4g}"
