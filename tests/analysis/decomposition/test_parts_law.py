"""Laws of sets that are put together, in closed loop on the whole system."""

from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.decomposition.parts_law import check_parts
from holdfast.errors import SimulationError
from tests.parted_systems import box, late_cart, plane, towed, walls


@cache
def predicted_cart(share=0.6):
    parted = hf.decompose(late_cart(0.2), walls("x"), lag_share=share, box=box("x", "v", at=1.5))
    return hf.solve_parts(parted, None, 121, 4.0)


def starts(value, intervals, margin, count=400):
    low, high = np.array(list(intervals.values())).T
    drawn = np.random.default_rng(1).uniform(low, high, (60 * count, len(low)))
    return drawn[value.contains(drawn, margin)][:count]


def stayed(system, law, begun):
    result = hf.simulate(
        system, law, starts=begun, region=walls("x"), horizon=4.0, sample_time=0.01
    )
    return float((result.arrays["outcome"].values == 0).mean())


def test_the_optimal_inputs_keep_a_cart_that_lags_from_its_promised_states():
    value = predicted_cart()
    begun = starts(value, {"x": (-1, 1), "v": (-2, 2), "actual_u": (-0.6, 0.6)}, 0.06)
    assert len(begun) == 400
    assert stayed(late_cart(0.2), hf.parts_law(value), begun) == 1.0


def test_the_actuators_at_the_ends_of_their_share_are_kept_too():
    value = predicted_cart()
    begun = starts(value, {"x": (-1, 1), "v": (-2, 2), "actual_u": (-0.6, 0.6)}, 0.06)
    begun[:, 2] = np.where(begun[:, 2] > 0, 0.6, -0.6)
    begun = begun[value.contains(begun, 0.06)]
    assert len(begun) > 100
    assert stayed(late_cart(0.2), hf.parts_law(value), begun) == 1.0


@pytest.mark.heavy
def test_a_law_that_would_leave_is_kept_safe():
    value = predicted_cart()
    system = late_cart(0.2)
    push = hf.Law("push", system.states[:2], {"u": 0.9 + 0 * hf.symbol("x")})
    begun = starts(value, {"x": (-1, 1), "v": (-2, 2), "actual_u": (-0.6, 0.6)}, 0.1)
    assert stayed(system, push, begun) == 0.0
    assert stayed(system, hf.parts_law(value, push, sample_time=0.01), begun) == 1.0


def test_the_command_leaves_the_actuator_within_its_share():
    value = predicted_cart()
    begun = starts(value, {"x": (-1, 1), "v": (-2, 2), "actual_u": (-0.6, 0.6)}, 0.06)
    result = hf.simulate(
        late_cart(0.2), hf.parts_law(value), starts=begun, horizon=4.0, sample_time=0.01
    )
    assert np.abs(result.arrays["state"].values[:, :, 2]).max() <= 0.6 + 1e-9


def test_the_cart_that_a_winch_pulls_is_kept_whatever_the_winch_does():
    value = hf.solve_parts(
        hf.decompose(towed(), walls("x"), cut={"w": None}), box("x", "v"), 61, 4.0
    )
    law = hf.parts_law(value)
    w = hf.symbol("w")
    begun = starts(value, {"x": (-1, 1), "v": (-2, 2), "w": (-0.9, 0.9)}, 0.06)
    for end in (-0.9, 0.9):
        held = hf.Law(
            "held", law.reads, {**law.outputs, "c": end + 0 * w}, law.parameters,
            lookup=law.lookup, signals=law.signals,
        )  # fmt: skip
        assert stayed(towed(), held, begun) == 1.0


def test_a_promise_needs_starts_of_the_whole_system():
    with pytest.raises(SimulationError, match="no interval for 'v'"):
        check_parts(predicted_cart(), walls("x"), {"x": (-1, 1)}, runs=10)


def test_a_promise_counts_what_is_promised_kept_and_given_away():
    over = {"x": (-1.0, 1.0), "v": (-2.0, 2.0), "actual_u": (-0.6, 0.6)}
    found = check_parts(
        predicted_cart(), walls("x"), over, runs=100, margin=0.06, horizon=4.0, sample_time=0.01
    )
    assert found.held
    assert found.verdict == ""
    assert 0.3 < found.promised.value < 0.8
    assert 0 < found.outside.count < found.outside.total


def test_several_parts_have_laws_of_their_own():
    value = hf.solve_parts(
        hf.decompose(plane(), walls("x", "y")), box("x", "vx", "y", "vy"), 15, 0.5
    )
    with pytest.raises(SimulationError, match="safety_law of each part"):
        hf.parts_law(value)
