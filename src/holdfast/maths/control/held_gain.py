"""Gains against sampling and delay: a rate that is held and late must not overshoot."""

from __future__ import annotations

import sympy as sp

from holdfast.maths.definitions.law import GainCondition
from holdfast.maths.definitions.quantity import DELAY, SAMPLE_TIME, symbol

MOST = sp.Rational(1, 2)
"""Limit of k (Ts + delay)."""


def held_gain(
    *gains: str,
    consequence: str = "a turn rate that is held and late overshoots, and at 2 diverges",
) -> tuple[GainCondition, ...]:
    """k (Ts + delay) <= 1/2 for every gain k [1/s] of e' = -k e, held for Ts and late by `delay`.

    With d samples of delay the error obeys e(i+1) = e(i) - k Ts e(i-d). It is stable exactly for
    k Ts < 2 sin(pi / (4 d + 2)) and does not overshoot for k Ts <= d^d / (d+1)^(d+1)
    (S. A. Levin and R. M. May, Theor. Popul. Biol. 9, 1976). Times d + 1 these bounds are 2 and 1
    without a delay, 2 and 1/2 with one sample, and fall to pi/2 and 1/e: at 1/2 the error
    overshoots by at most 4 % at any delay, and the gain may be three times as large before it
    diverges.
    """
    return tuple(
        GainCondition(
            value=symbol(gain) * (SAMPLE_TIME + DELAY),
            limit=MOST,
            consequence=consequence,
            source="derived for e' = -k e, held and late; measured for station keeping",
            closed=True,
        )
        for gain in gains
    )
