"""The methods by which values are marched: their order, their length, and what they keep."""

import math

import numpy as np
import pytest

from holdfast.execution.level_set.march import METHODS, second_order


def taken(method, rate, value, time, dt):
    """A step, as the stages of a march take it."""
    new = value
    for weight, share in method.stages:
        euler = new + dt * method.share * rate(time + share * dt, new)
        new = value + weight * (euler - value)
    return new


def error(method, steps):
    """After 2 s of y' = y cos t - y^2 / 2 from 1, beside many steps of the method of third order."""

    def rate(t, y):
        return y * math.cos(t) - 0.5 * y**2

    def end(method, steps):
        value, dt = 1.0, 2.0 / steps
        for k in range(steps):
            value = taken(method, rate, value, k * dt, dt)
        return value

    return abs(end(method, steps) - end(METHODS[3], 4000))


@pytest.mark.parametrize(
    ("order", "method"), [*METHODS.items(), (2, second_order(2)), (2, second_order(5))]
)
def test_error_falls_with_the_order(order, method):
    coarse, fine = error(method, 40), error(method, 80)
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize("order", METHODS)
def test_step_is_a_convex_combination_of_euler_steps(order):
    """With as long Euler steps as keep the order of values for x' = 1 - x, the whole step keeps it."""
    method = METHODS[order]
    assert all(0 < weight <= 1 for weight, _ in method.stages)
    start = np.linspace(0, 1, 101)
    end = taken(method, lambda _, x: 1 - x, start, 0.0, method.lengths * 1.0)
    assert (np.diff(end) >= 0).all(), "the order of two values"
    assert end.min() >= 0
    assert end.max() <= 1


def test_stages_and_lengths_are_those_of_the_page():
    """docs/kernels.md."""
    sizes = {order: (len(m.stages), m.lengths) for order, m in METHODS.items()}
    assert sizes == {1: (1, 1), 2: (3, 2), 3: (4, 2)}
