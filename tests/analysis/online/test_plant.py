"""A plant in a loop of one's own makes the steps of `simulate`."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import HoldfastError


def test_plant_under_a_controller_is_the_closed_loop_bit_for_bit():
    scenario = hf.load_scenario(
        "ch3-known-current", ["run.horizon=4", "run.record_every=0.005"], runs=1
    )
    data = scenario.run().dataset
    felt = {name: float(value) for name, value in scenario.disturbance.items()}
    steps = {name: scenario.settings[name] for name in ("sample_time", "substeps")}
    plant = hf.Plant(scenario.system, data["state"].values[0, 0], **steps)
    controller = hf.Controller(scenario)
    told = {n: felt[n] for n in controller.measured}
    for k, t in enumerate(data["time"].values[:-1]):
        assert plant.t == pytest.approx(t, abs=1e-12)
        command = controller.step(plant.state, t, told or None)
        plant.step(command.input, felt)
        assert np.array_equal(plant.state, data["state"].values[0, k + 1])


def test_inputs_beyond_their_bounds_are_limited(vehicle):
    start = np.zeros(6)
    one, other = hf.Plant(vehicle, start), hf.Plant(vehicle, start)
    assert np.array_equal(one.step([10.0, 0.0]), other.step([100.0, 0.0]))
    assert one.t == 0.02
    one.reset([1.0, 0, 0, 0, 0, 0])
    assert (one.t, one.state[0]) == (0.0, 1.0)
    by_name = other.step({"tau_r": 0.1, "tau_u": 0.2}, {"Vy": 0.1, "Vx": 0.0})
    assert by_name[1] > 0


def test_what_is_not_a_number_does_not_move_it(vehicle):
    plant = hf.Plant(vehicle, np.zeros(6))
    for input, disturbance, said in (
        ([np.nan, 0.0], None, "the input is"),
        ([0.0, 0.0], [np.inf, 0.0], "the disturbance is"),
        ([0.0], None, "the input has the shape"),
        ({"tau": 0.0}, None, "unknown input 'tau'; did you mean 'tau_u'"),
    ):
        with pytest.raises(HoldfastError, match=said):
            plant.step(input, disturbance)
    assert plant.t == 0.0
    with pytest.raises(HoldfastError, match="start has the shape"):
        hf.Plant(vehicle, [0.0])
    with pytest.raises(HoldfastError, match="sample_time is 0"):
        hf.Plant(vehicle, np.zeros(6), sample_time=0.0)


def test_plant_that_diverges_says_so_and_stays_where_it_was(vehicle):
    plant = hf.Plant(vehicle, [0, 0, 0, 1e200, 0, 0])
    with pytest.raises(HoldfastError, match="the plant diverges at 0 s"):
        plant.step([1.0, 0.0])
    assert plant.state[3] == 1e200
    plant.reset(np.zeros(6))
    assert np.array_equal(plant.step([5.0, 1.0]), hf.Plant(vehicle, np.zeros(6)).step([5.0, 1.0]))
    plant.state[0] = 7.0
    assert plant.state[0] < 1, "a copy"
