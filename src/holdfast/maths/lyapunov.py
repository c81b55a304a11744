"""Lyapunov-like functions, and gain conditions: for which gains a law converges."""

from __future__ import annotations

import sympy as sp

from holdfast.maths.functions import least, select, wrap


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


def docking_metric(x: sp.Expr, y: sp.Expr, misalignment: sp.Expr) -> sp.Expr:
    """V_mu = rho^2 / (2 cos^2(arctan(y / x))) + s^2 / 2 = rho^4 / (2 x^2) + s^2 / 2  (4.36)

    in which the thesis measures the approach of `project_marine`: its gradient in (x, y) is
    (rho^2 / x^3) F, along the field F = (x^2 - y^2, 2 x y). Infinite on x = 0, where a run may
    see it rise at first. x, y in m, the misalignment s = psi - phi in rad (wrapped here).
    """
    return (x**2 + y**2) ** 2 / (2 * x**2) + wrap(misalignment) ** 2 / 2
