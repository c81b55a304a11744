"""Inputs and accelerations that change no faster than they may."""

import math

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError
from tests.c_code import answers_of_c, needs_gcc
from tests.conftest import constant_law


def test_input_ramps_to_a_constant_command(double_integrator):
    """a(k) = min(0.8, 0.5 k h) from rest, in closed form."""
    law = hf.limit_rates(double_integrator, constant_law(double_integrator, 0.8), {"a": 0.5})
    data = hf.simulate(
        double_integrator, law, starts=[[0, 0]], horizon=3.0, record_every=0.02
    ).dataset
    steps = np.arange(len(data["time"]))
    wanted = np.minimum(0.8, 0.5 * 0.02 * (steps + 1))
    assert data["input"].values[0, :, 0] == pytest.approx(wanted, abs=1e-12)
    assert data["overruled"].values[0] == 0, "a limit of the inputs is no condition"


@pytest.mark.few("True")
@pytest.mark.parametrize("guarded", [False, True])
def test_no_input_and_no_acceleration_is_faster_than_it_may_be(vehicle, guarded):
    view = hf.regions.camera_view()
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})
    if guarded:
        law = hf.safeguard(vehicle, law, view, gains=(1.5, 8))
    limited = hf.limit_rates(vehicle, law, {"tau_u": 4.0, "tau_r": 1.0, "u": 0.2})
    starts = hf.Starts(random=50, box={"x": (-2, -0.5), "y": (-0.8, 0.8), "psi": (-0.8, 0.8)})
    common = {"starts": starts, "region": view, "horizon": 10.0, "record_every": 0.02, "seed": 4}
    data = hf.simulate(vehicle, limited, **common).dataset
    free = hf.simulate(vehicle, law, **common).dataset
    changes = np.abs(np.diff(data["input"].values, axis=1, prepend=0.0)).reshape(-1, 2).max(axis=0)
    assert (changes <= np.array([4.0, 1.0]) * 0.02 * (1 + 1e-9)).all()
    assert np.abs(np.diff(free["input"].values, axis=1)).max() > 0.1, "the law alone is faster"
    u = data["state"].sel(state_name="u").values
    kept = data["largest_slack"].values == 0
    assert kept.sum() > 30
    assert np.abs(np.diff(u[kept], axis=1)).max() <= 0.2 * 0.02 * 1.02
    assert (
        np.abs(np.diff(free["state"].sel(state_name="u").values, axis=1)).max() > 0.2 * 0.02 * 1.5
    )


def test_filter_with_rates_remembers_its_last_input(double_integrator, wall):
    keep = hf.SafetyFilter(double_integrator, wall, rates={"a": 5.0}, fallback=[-0.3])
    assert keep.step([0.0, 0.0], [1.0]).input.tolist() == [0.1]
    second = keep.step([0.0, 0.0], [1.0])
    assert second.input == pytest.approx([0.2])
    assert second.status is hf.Status.CHANGED
    assert "or changes faster than they may" in second.why
    assert keep.step([math.nan, 0.0], [1.0]).input.tolist() == [-0.3]
    assert keep.step([0.0, 0.0], [1.0]).input == pytest.approx([-0.2]), "from the fallback"
    keep.reset()
    assert keep.step([0.0, 0.0], [1.0]).input.tolist() == [0.1]


def test_acceleration_that_the_command_asks_for_is_named(vehicle):
    keep = hf.SafetyFilter(vehicle, hf.regions.camera_view(), rates={"u": 0.05})
    decision = keep.step([-1.0, 0, 0, 0, 0, 0], [8.0, 0.0])
    assert decision.overruled
    assert "the rate of u would be beyond its limit" in decision.why
    assert 0 < decision.input[0] < 8.0
    plant = hf.Plant(vehicle, [-1.0, 0, 0, 0, 0, 0])
    assert plant.step(decision.input)[3] / 0.02 == pytest.approx(0.05, rel=1e-2)


def test_limited_and_observed_law_has_both_memories(vehicle):
    view = hf.regions.camera_view()
    keep = hf.SafetyFilter(
        vehicle, view, rates={"tau_u": 5.0}, states=("x", "y", "psi"), bandwidth=3.0
    )
    first = keep.step([-1.0, 0.1, 0.0], [3.0, 0.0])
    assert first.input[0] == pytest.approx(0.1)
    assert keep.step([-1.0, 0.1, 0.0], [3.0, 0.0]).input[0] == pytest.approx(0.2)


@needs_gcc
def test_rates_in_c_have_the_same_bits(double_integrator, wall, tmp_path):
    keep = hf.SafetyFilter(double_integrator, wall, rates={"a": 5.0})
    rng = np.random.default_rng(0)
    states, commands = rng.normal(size=(300, 2)) * 0.3, rng.normal(size=(300, 1))
    answers = answers_of_c(tmp_path, keep, states, commands)
    ours = [
        keep.step(q, w, k * 0.02).input[0]
        for k, (q, w) in enumerate(zip(states, commands, strict=True))
    ]
    assert answers.tolist() == ours


@pytest.mark.parametrize(
    ("rates", "said"),
    [
        ({}, "there are no rates"),
        ({"b": 1.0}, "rate of 'b', which is neither an input nor a state"),
        ({"a": 0.0}, "rate of 'a' is 0"),
        ({"a": math.nan}, "rate of 'a' is nan"),
        ({"a": True}, "rate of 'a' is True"),
        ({"x": 1.0}, "no input is in the rate of 'x'"),
    ],
)
def test_what_cannot_be_limited_is_refused(double_integrator, rates, said):
    with pytest.raises(DefinitionError, match=said):
        hf.limit_rates(double_integrator, constant_law(double_integrator, 0.0), rates)
