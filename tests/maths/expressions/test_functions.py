"""Values, kinks and derivatives of the functions that SymPy lacks."""

import math

import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from holdfast.maths.expressions.functions import (
    angle,
    clip,
    greatest,
    least,
    length,
    select,
    sgn,
    wrap,
)

X, Y = sp.symbols("x y", real=True)
reals = st.floats(-20, 20, allow_nan=False).map(lambda v: round(v, 6))


def at(expression, x, y=0.0):
    return float(expression.subs({X: sp.Float(x), Y: sp.Float(y)}))


def test_sign_of_zero_is_plus_one():
    assert (at(sgn(X), 0.0), at(sgn(X), -1e-300), at(sgn(X), 2.0)) == (1, -1, 1)


def test_sign_and_turns_are_frozen_when_differentiated():
    assert sgn(X**3).diff(X) == 0
    assert wrap(3 * X).diff(X) == 3


@given(reals)
def test_wrapped_angle_lies_in_the_half_open_turn_and_is_the_same_direction(value):
    wrapped = at(wrap(X), value)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(value), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(value), abs=1e-9)


@given(reals, reals)
def test_min_max_select_and_clip_take_the_branch_python_takes(x, y):
    assert at(least(X, Y), x, y) == min(x, y)
    assert at(greatest(X, Y), x, y) == max(x, y)
    assert at(select(X, Y, -Y), x, y) == (y if x >= 0 else -y)
    assert at(clip(X, -2, 3), x) == min(max(x, -2), 3)


@pytest.mark.few("expression3")
@pytest.mark.parametrize(
    "expression",
    [
        angle(Y * sp.sin(X) + 2, X + Y, 0),
        length(X - Y, X * Y + 1, 0),
        select(X - 1, X**2 * Y, sp.sin(X)),
        least(X * Y, X + Y),
        greatest(X**2, sp.exp(Y / 10)),
        clip(X * Y, -3, 3),
        wrap(X**2 + Y) * sgn(Y + 7),
        sp.tanh(length(X, Y, 0)) * angle(X * Y, X**2 + 1, 0),
    ],
)
@given(st.floats(0.3, 2.9), st.floats(0.3, 2.9))
def test_derivative_is_the_limit_of_the_difference_quotient(expression, x, y):
    h = 1e-6
    left, right = at(expression, x - h, y), at(expression, x + h, y)
    middle = at(expression, x, y)
    # skip the kinks: there the two one-sided quotients differ
    if abs((right - middle) - (middle - left)) > 1e-8:
        return
    slope = at(expression.diff(X), x, y)
    assert slope == pytest.approx((right - left) / (2 * h), rel=1e-4, abs=1e-4)


def test_gradient_of_a_direction_is_bounded_at_the_origin_and_exact_away_from_it():
    guarded, exact = angle(Y, X, 1e-6), angle(Y, X, 0)
    assert at(guarded.diff(X), 0.0, 0.0) == 0.0
    assert at(guarded.diff(X), 0.3, -0.4) == pytest.approx(at(exact.diff(X), 0.3, -0.4), rel=1e-5)


def test_gradient_of_a_length_is_zero_at_the_origin():
    assert at(length(X, Y, 1e-6).diff(X), 0.0, 0.0) == 0.0
