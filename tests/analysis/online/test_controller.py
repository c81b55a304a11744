"""A law called sample by sample gives what `simulate` computes, with its modes and its memory."""

import math

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import HoldfastError, SimulationError


@pytest.mark.few("ch3-unknown-current-settings1")
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("inspection", []),
        ("ch3-unknown-current", []),
        ("ch5-viable-goal-set", []),
    ],
)
def test_controller_gives_the_commands_of_the_closed_loop(name, settings):
    scenario = hf.load_scenario(name, ["run.horizon=6", *settings], runs=2).kept()
    data = hf.simulate(
        scenario.system, scenario.law, starts=scenario.starts, region=scenario.region,
        disturbance=scenario.disturbance,
        **scenario.settings | {"record_every": scenario.settings["sample_time"]},
    ).dataset  # fmt: skip
    controller = hf.Controller(scenario)
    felt = {n: float(v) for n, v in scenario.disturbance.items() if n in controller.measured}
    modes = set()
    for run in range(data.sizes["run"]):
        controller.reset()
        for k, t in enumerate(data["time"].values):
            q = data["state"].values[run, k]
            if not np.isfinite(q).all():
                break
            found = controller.step(q, t, felt or None)
            assert found.valid
            if scenario.system.actuators:
                assert np.array_equal(found.actuators, data["actuator"].values[run, k])
            assert np.array_equal(found.input, data["input"].values[run, k])
            assert controller.modes.index(found.mode) == data["mode"].values[run, k]
            modes.add(found.mode)
    assert modes


@pytest.mark.heavy
def test_controller_of_a_kernel_tells_its_value_and_where_its_grid_ends():
    boat = hf.systems.drifting_unicycle()
    room = hf.Region(
        "room", boat.states[:2], (hf.Inequality("far", hf.symbol("x") ** 2 - 1, "m^2"),)
    )  # fmt: skip
    over = hf.grid(boat, {"x": (-1.3, 1.3), "y": (-2, 2), "psi": (-math.pi, math.pi)}, 15)
    value = hf.discriminating_kernel(boat, room, over, 0.2)
    controller = hf.Controller(boat, hf.safety_law(boat, value))
    inside = controller.step([0.3, 0.1, 0.5])
    assert inside.value == pytest.approx(value.at([[0.3, 0.1, 0.5]])[0], abs=1e-12)
    assert not inside.outside
    assert controller.step([1.5, 0.1, 0.5]).outside
    assert not controller.step([0.3, 0.1, 0.5]).outside


def test_controller_of_a_law_counts_its_own_samples(vehicle):
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})
    controller = hf.Controller(vehicle, law, sample_time=0.05)
    state = [-1.0, 0.2, 0.1, 0.0, 0.0, 0.0]
    first, second = controller.step(state), controller.step(state)
    assert np.array_equal(first.input, second.input)
    assert (first.slack, first.outside) == (0.0, False)
    assert math.isnan(first.value)
    named = dict(zip(vehicle.state_names, state, strict=True))
    assert np.array_equal(controller.step(named).input, first.input)


def test_measurement_that_is_not_finite_gives_nothing_and_is_forgotten(vehicle):
    scenario = hf.load_scenario("ch3-unknown-current")
    controller, other = hf.Controller(scenario), hf.Controller(scenario)
    state = [1.0, 0.5, 0.2]
    for t in (0.0, 0.02, 0.04):
        lost = controller.step([math.nan, 0.0, 0.0], t)
        assert not lost.valid
        assert np.isnan(lost.input).all()
        assert lost.mode == ""
        assert np.array_equal(controller.step(state, t).input, other.step(state, t).input)


def test_wrong_arguments_are_refused(vehicle):
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})
    scenario = hf.load_scenario("inspection")
    for arguments, options, said in (
        ((vehicle,), {}, "a system without a law"),
        ((scenario, law), {}, "a scenario has its own law"),
        ((vehicle, law), {"sample_time": -1.0}, "sample_time is -1"),
        ((vehicle, hf.laws.steer_marine(vehicle)), {}, "gives u, r"),
        ((7,), {}, "of is 7; expected a scenario"),
    ):
        with pytest.raises(HoldfastError, match=said):
            hf.Controller(*arguments, **options)
    with pytest.raises(SimulationError, match="the state lacks"):
        hf.Controller(vehicle, law).step({"x": 1.0})
