"""Gain conditions: for which gains a law converges, by a Lyapunov-like function, also when held.

Against sampling and delay a rate that is held and late must not overshoot.
"""

from __future__ import annotations

import math

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import GainCondition
from holdfast.maths.definitions.quantity import DELAY, SAMPLE_TIME, symbol
from holdfast.maths.expressions.functions import least, select, wrap


def surge_gain_limit(
    sway_drag: sp.Expr, surge_inertia: sp.Expr, sway_inertia: sp.Expr, exponent: sp.Expr
) -> sp.Expr:
    """The largest k1 mu for which (5.18) brings the sway of a marine vehicle to rest.

    Near the goal, with the heading on the field and s = y1/x1, w = v/x1, the closed loop is

        ds/dt = -a s / (lambda - 1) + w
        dw/dt = -m a^2 lambda s / (lambda - 1)^2 + (m a lambda / (lambda - 1) + a - d) w

    where a = k1 mu [1/s], m = m11/m22 and d = |Yv|/m22. It is stable exactly when

        a < min( |Yv| / m22,  |Yv| (lambda - 1) / ((lambda - 2) m22 + lambda m11) ),

    the second only where its denominator is positive.

    The thesis (Theorem 1, Lemma 2) claims convergence for every k1, mu > 0; without this
    condition v/rho does not vanish and the heading does not converge.

    `sway_drag` is Yv (negative, N s/m), inertias in kg. Returns 1/s.
    """
    drag = -sway_drag
    weight = (exponent - 2) * sway_inertia + exponent * surge_inertia
    sideways = drag / sway_inertia
    return select(-weight, sideways, least(sideways, drag * (exponent - 1) / weight))


@checked
def ultimate_bound(k1: float, mu: float, current: float) -> float:
    """The distance from the goal where (5.31) leaves a vehicle in a current: artanh(current/k1)/mu.

    Thesis (5.35). In a constant current of any direction it is exact: the surge k1 tanh(mu rho)
    that holds the vehicle against the current is that of rho. There are two such points, where
    the field runs along the current and against it, and the vehicle ends at one of them, heading
    so (Lemma 4, modulo pi). Measured: in a current that turns slowly the vehicle goes up to 6 %
    farther (12 % if its law does not measure the turn), in one that jumps about 1.5 times as far.

    k1 [m/s]: the top surge speed. mu [1/m]: the steepness. current [m/s]: the speed of the current,
    or a bound of it.

    Raises `DefinitionError` for a current that the vehicle cannot overcome, current >= k1, and for
    numbers below zero.

    >>> round(hf.ultimate_bound(0.16, 1.5, 0.05), 3)
    0.216
    """
    for name, value in (("k1", k1), ("mu", mu)):
        if not 0 < value < math.inf:
            raise DefinitionError(f"{name} is {value:g}", expected="a finite number above 0")
    if not current >= 0:
        raise DefinitionError(f"the current is {current:g} m/s", expected="a speed, 0 or more")
    if current >= k1:
        raise DefinitionError(
            f"a current of {current:g} m/s carries away a vehicle whose surge is at most "
            f"k1 = {k1:g} m/s: no bound exists",
            expected="a current below k1",
        )
    return math.atanh(current / k1) / mu


def docking_metric(x: sp.Expr, y: sp.Expr, misalignment: sp.Expr) -> sp.Expr:
    """V_mu = rho^2 / (2 cos^2(arctan(y / x))) + s^2 / 2 = rho^4 / (2 x^2) + s^2 / 2  (4.36)

    in which the thesis measures the approach of `project_marine`: its gradient in (x, y) is
    (rho^2 / x^3) F, along the field F = (x^2 - y^2, 2 x y). Infinite on x = 0, where a run may
    see it rise at first. x, y in m, the misalignment s = psi - phi in rad (wrapped here).
    """
    return (x**2 + y**2) ** 2 / (2 * x**2) + wrap(misalignment) ** 2 / 2


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
