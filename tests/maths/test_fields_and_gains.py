"""The dipolar field, its direction, and the gain condition derived from the closed loop."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.control.gain_conditions import surge_gain_limit
from holdfast.maths.reference_fields.dipole import dipolar_field, field_angle
from tests.conftest import number_at

X, Y, LAM = (hf.symbol(n) for n in ("x", "y", "lam"))


def test_gradient_of_the_direction_is_the_closed_form_away_from_the_zero():
    """grad phi = K (-y, x), K = lam ((lam-1) x^2 + y^2) / (rho^2 ((lam-1)^2 x^2 + y^2))."""
    phi = field_angle(dipolar_field((X, Y), LAM, (1, 0)))
    rho2 = X**2 + Y**2
    k = LAM * ((LAM - 1) * X**2 + Y**2) / (rho2 * ((LAM - 1) ** 2 * X**2 + Y**2))
    generator = np.random.default_rng(0)
    for _ in range(50):
        x, y = generator.uniform(-2, 2, 2)
        point = {X: x, Y: y, LAM: generator.uniform(1.5, 4)}
        for slope, expected in ((phi.diff(X), -k * Y), (phi.diff(Y), k * X)):
            assert number_at(slope, point) == pytest.approx(number_at(expected, point), rel=1e-6)


def test_radial_part_of_the_field_points_along_the_moment():
    """r . F = (lam - 1) (p . r) |r|^2."""
    field = dipolar_field((X, Y), LAM, (1, 0))
    assert sp.simplify(X * field[0] + Y * field[1] - (LAM - 1) * X * (X**2 + Y**2)) == 0


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (((X, Y), sp.Integer(1), (1, 0)), "lambda > 1"),
        (((X, Y), LAM, (0, 0)), "moment p is zero"),
        (((X, Y), LAM, (1, 0, 0)), "equal dimensions"),
    ],
)
def test_field_without_a_rose_is_refused(arguments, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        dipolar_field(*arguments)


@pytest.mark.parametrize(("exponent", "limit"), [(3, 0.3508), (2, 0.3999)])
def test_gain_limit_of_the_videoray_is_the_reference_number(exponent, limit):
    """E6: m11 = 7.34, m22 = 11.45, Yv = -5.87."""
    value = surge_gain_limit(sp.Float(-5.87), sp.Float(7.34), sp.Float(11.45), sp.Integer(exponent))
    assert float(value) == pytest.approx(limit, abs=1e-4)


@pytest.mark.few("3.0", "5.0")
@pytest.mark.parametrize("exponent", [1.5, 2.0, 3.0, 5.0])
def test_gain_limit_is_where_the_linearised_closed_loop_loses_stability(vehicle, exponent):
    """Independent of the formula: the Jacobian of the promoted system in (y1/x1, v/x1)."""
    limit = float(
        surge_gain_limit(sp.Float(-5.87), sp.Float(7.34), sp.Float(11.45), sp.Float(exponent))
    )
    assert growth(vehicle, 0.97 * limit, exponent) < 0 < growth(vehicle, 1.03 * limit, exponent)


def growth(vehicle, a, exponent):
    """Largest real part of the linearisation of the aligned closed loop near the goal."""
    kinematic = hf.promote(vehicle, ("u", "r"))
    law = hf.laws.steer_marine(vehicle, k1=1.0, mu=a, lam=exponent)
    values = {p.symbol: p.value for p in (*vehicle.parameters, *law.parameters)}
    s, w, scale = sp.symbols("s w scale", real=True)
    closed = {hf.symbol(n): law.outputs[n] for n in ("u", "r")} | {
        hf.symbol("Vx"): 0,
        hf.symbol("Vy"): 0,
    }
    x1 = -scale
    state = {"x": x1 - 0.5, "y": s * x1, "v": w * x1}
    phi = sp.atan2(exponent * x1 * (s * x1), (exponent - 1) * x1**2 - (s * x1) ** 2)
    rates = {n: kinematic.rates[n].subs(closed).subs(values) for n in ("x", "y", "v")}

    def derivative(s_value, w_value):
        point = {hf.symbol(n): e for n, e in state.items()} | {hf.symbol("psi"): phi}
        f = [
            float(rates[n].subs(point).subs({s: s_value, w: w_value, scale: 0.02}))
            for n in ("x", "y", "v")
        ]
        return np.array([(f[1] - s_value * f[0]) / -0.02, (f[2] - w_value * f[0]) / -0.02])

    h = 1e-5
    jacobian = np.column_stack(
        [
            (derivative(h, 0) - derivative(-h, 0)) / (2 * h),
            (derivative(0, h) - derivative(0, -h)) / (2 * h),
        ]
    )
    return np.linalg.eigvals(jacobian).real.max()


def test_gains_beyond_the_limit_are_reported_with_both_numbers(vehicle):
    law = hf.laws.steer_marine(vehicle, k1=0.3, mu=1.5)
    values = {p.symbol: p.value for p in (*law.parameters, *vehicle.parameters)}
    message = law.conditions[0].violation(values)
    assert "0.45" in message
    assert "0.3508" in message
    fine = hf.laws.steer_marine(vehicle)
    values = {p.symbol: p.value for p in (*fine.parameters, *vehicle.parameters)}
    assert fine.conditions[0].violation(values) is None
