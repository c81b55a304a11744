"""Actuators that act late: the exact step response, and laws that know nothing of it."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError, ModelWarning, ScenarioError


def point():
    return hf.System(
        "point", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": hf.symbol("u")},
        input_bounds=hf.Box((-2,), (2,)),
    )  # fmt: skip


def stepped(plant, seconds):
    law = hf.Law("step", (), {"u": hf.parse_expression("1", {})})
    return hf.simulate(
        plant, law, starts=[[0.0, 0.0]], horizon=seconds, sample_time=0.01, record_every=0.01
    ).dataset


def test_step_response_is_that_of_first_order():
    data = stepped(hf.lagged(point(), {"u": 0.3}), 2.0)
    t, (x, actual) = data["time"].values, data["state"].values[0].T
    assert np.abs(actual - (1 - np.exp(-t / 0.3))).max() < 1e-7
    assert np.abs(x - (t - 0.3 * (1 - np.exp(-t / 0.3)))).max() < 1e-7


def test_slew_limits_how_fast_the_actuator_follows():
    data = stepped(hf.lagged(point(), {"u": 0.05}, {"u": 0.5}), 3.0)
    t, actual = data["time"].values, data["state"].values[0, :, 1]
    rising = t < 1.9
    assert np.abs(actual - 0.5 * t)[rising].max() < 1e-9
    assert actual[-1] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.heavy
def test_law_of_the_vehicle_without_lag_runs_on_the_one_with_it():
    """The legs with 0.1 s of lag: 40 of 40 starts stay, 20 s; the filter's own lag would be worse."""
    scenario = hf.load_scenario(
        "inspection", ["system.lag={ tau_u = '100 ms', tau_r = 0.1 }", "run.horizon=20"], runs=40
    )
    assert scenario.system.state_names[-2:] == ("actual_tau_u", "actual_tau_r")
    assert scenario.model.state_names == hf.systems.marine_vehicle().state_names
    result = scenario.run()
    assert result.viable == 40
    controller = hf.Controller(scenario)
    assert controller.system is scenario.model
    state = result.dataset["state"].values[3]
    found = controller.step(state[0][:6])
    assert found.input == pytest.approx(result.dataset["input"].values[3, 0], abs=0)


def test_filter_names_the_lag_that_it_does_not_know():
    vehicle = hf.systems.marine_vehicle()
    with pytest.warns(ModelWarning, match="actual_tau_u"):
        hf.SafetyFilter(
            vehicle, hf.regions.camera_view(), around=hf.lagged(vehicle, {"tau_u": 0.1})
        )


@pytest.mark.heavy
def test_what_cannot_be_is_refused():
    for lag, slew, complaint in (
        ({"push": 0.1}, None, "not an input"),
        ({"u": 0.0}, None, "above 0"),
        ({"u": float("nan")}, None, "above 0"),
        ({}, None, "lag is empty"),
        ({"u": 0.1}, {"u": -1.0}, "above 0"),
    ):
        with pytest.raises(DefinitionError, match=complaint):
            hf.lagged(point(), lag, slew)
    for sets, complaint in (
        ("system.lag={ push = 0.1 }", "unknown name"),
        ("system.lag={ tau_u = '1 m' }", "m"),
        ("system.slew={ tau_u = 3 }", "lag"),
        ("system.lag=3", "got 3"),
    ):
        with pytest.raises(ScenarioError, match=complaint):
            hf.load_scenario("inspection", [sets])


def test_explain_knows_the_keys_of_a_system():
    from holdfast.scenario.files import load_system

    plain = load_system("inspection", [])
    late = load_system(
        "inspection", ["system.lag={ tau_u = 0.1 }", "system.unmodelled={ v = [-1, 1] }"]
    )
    assert late.state_names == (*plain.state_names, "actual_tau_u")
    assert late.disturbance_names == (*plain.disturbance_names, "unmodelled_v")
