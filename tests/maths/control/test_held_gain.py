"""A gain that is held and late: the limit of k (Ts + delay), from the recursion it stands for."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.maths.control.gain_conditions import held_gain, surge_gain_limit


def errors(gain, late, steps=40_000):
    """e(i+1) = e(i) - gain e(i - late), from e = 1 until then."""
    e = np.ones(late + 1 + steps)
    for i in range(late, late + steps):
        e[i + 1] = e[i] - gain * e[i - late]
    return e


@pytest.mark.parametrize("late", [0, 1, 2, 3, 5, 10, 40])
def test_error_overshoots_by_at_most_four_per_cent_at_the_limit(late):
    overshoot = -errors(0.5 / (late + 1), late).min()
    assert overshoot <= (1e-12 if late < 2 else 0.04)


@pytest.mark.parametrize("late", [0, 1, 2, 3, 10])
def test_error_is_stable_exactly_below_the_bound_of_levin_and_may(late):
    bound = 2 * math.sin(math.pi / (4 * late + 2))
    assert bound * (late + 1) > 1.57
    assert abs(errors(0.98 * bound, late)[-late - 1 :]).max() < 1e-3
    assert abs(errors(1.02 * bound, late, 10_000)[-late - 1 :]).max() > 1e3


@pytest.mark.parametrize("late", [1, 2, 3, 10])
def test_error_does_not_overshoot_up_to_the_bound_of_levin_and_may(late):
    bound = late**late / (late + 1) ** (late + 1)
    assert errors(bound, late).min() > -1e-12
    assert errors(1.05 * bound, late).min() < 0


def test_simulated_heading_overshoots_only_beyond_the_limit():
    """The closed loop of a unicycle that turns on the spot, 0.2 s late, sampled at 0.1 s."""
    law = hf.laws.steer_unicycle
    unicycle = hf.systems.unicycle()

    def lowest(k):
        run = hf.simulate(
            unicycle, law(unicycle, k=k, freeze=1.0), starts=[[0.0, 0.0, 0.1]], horizon=20.0,
            sample_time=0.1, delay=0.2, record_every=0.1,
        )  # fmt: skip
        return run.arrays["state"].values[0, :, 2].min()

    assert lowest(0.5 / 0.3) > -0.004
    with pytest.warns(hf.GainWarning, match=r"k\*\(delay \+ sample_time\) = 0.9 is above"):
        assert lowest(3.0) < -0.02


def test_delay_that_is_not_given_is_none():
    (condition,) = held_gain("k")
    values = {hf.symbol("k"): 5.0, hf.SAMPLE_TIME: 0.1}
    assert condition.violation(values) is None
    assert "is above its limit" in condition.violation({**values, hf.DELAY: 0.01})


# -- inspect_target: its conditions, which stood in its docstring alone


@pytest.mark.parametrize("exponent", [1.2, 1.5, 2.0, 3.0])
def test_limit_of_the_legs_is_that_of_the_dipolar_lines_they_end_on(exponent):
    """lambda = n / (n - 1); 0.351 1/s for the VideoRay at n = 1.5."""
    vehicle = hf.systems.marine_vehicle()
    law = hf.laws.inspect_target(vehicle, exponent=exponent)
    values = {p.symbol: sp.Float(p.value) for p in law.parameters}
    mass, drag = hf.symbol("mass"), hf.symbol("Yv")
    along, across = mass - hf.symbol("Xudot"), mass - hf.symbol("Yvdot")
    limit = surge_gain_limit(drag, along, across, sp.Float(exponent / (exponent - 1)))
    found = float(law.conditions[0].limit.xreplace(values))
    assert found == pytest.approx(float(limit.xreplace(values)), rel=1e-12)
    if exponent == 1.5:
        assert found == pytest.approx(0.351, abs=1e-3)


def test_turn_between_two_legs_loses_no_more_bearing_than_its_condition_says():
    """beta' = -u sin(delta) / R with delta from leg to -leg as exp(-kv t), at u = k1, R = distance."""
    k1, kv, distance, leg = 0.2, 2.0, 0.5, 0.3
    t = np.linspace(0, math.log(2) / kv, 20_001)
    offset = leg * (2 * np.exp(-kv * t) - 1)
    lost = np.trapezoid(k1 * np.sin(offset) / distance, t)
    bound = (1 - math.log(2)) * k1 * leg / (kv * distance)
    assert 0.98 * bound < lost <= bound


def test_legs_of_a_vehicle_without_a_hull_have_no_condition_on_sway():
    unicycle = hf.systems.drifting_unicycle()
    law = hf.laws.inspect_target(unicycle)
    assert not any(hf.symbol("mu") in c.value.free_symbols for c in law.conditions)


def test_legs_beyond_their_conditions_are_warned_of():
    vehicle = hf.systems.marine_vehicle()
    law = hf.laws.inspect_target(vehicle, k1=0.6, mu=0.9, kv=0.3)
    values = {p.symbol: p.value for p in law.parameters} | {hf.SAMPLE_TIME: 2.0}
    said = [c.violation(values) for c in law.conditions]
    assert all(said)
    assert "loses more bearing" in said[-1]
