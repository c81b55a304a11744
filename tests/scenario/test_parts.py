"""Scenario files of sets that are put together."""

import json

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.decomposition.parts_law import box_of_starts
from holdfast.errors import ScenarioError
from holdfast.scenario.load import load_scenario
from holdfast.studies.catalogue import describe
from tests.command_line import called

LATE = """
[scenario]
title = "A cart whose force lags"
kind = "viability-kernel"

[system]
name = "cart"
states = { x = { unit = "m" }, v = { unit = "m/s" } }
inputs = { a = { unit = "m/s^2", bounds = [-1, 1] } }
rates = { x = "v", v = "a" }
lag = { a = "0.2 s" }

[region]
constraints = { left = { expression = "-1 - x", unit = "m" }, right = { expression = "x - 1", unit = "m" } }

[decompose]
lag_share = 0.6

[grid]
nodes = 61
box = { x = [-1.5, "150 cm"], v = [-2, 2] }

[march]
horizon = 4

[promise]
runs = 100
margin = 0.08
sample_time = "10 ms"
"""


@pytest.fixture
def late(tmp_path):
    file = tmp_path / "late.toml"
    file.write_text(LATE)
    return str(file)


def test_a_set_put_together_is_marched_tried_and_written(late, tmp_path):
    scenario = load_scenario(late)
    answer = scenario.run()
    assert scenario.complaints(answer) == []
    files = scenario.write(answer, tmp_path / "out")
    assert {f.name for f in files} == {"result.nc", "set_1.png", "set_1.svg", "summary.json"}
    text = scenario.report(answer, files)
    assert "inner: the set put together is inner" in text
    assert "100 of 100 stay for 4 s, with inputs held for 10 ms" in text
    said = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert said["verdict"] == "inner"
    assert said["promise"]["held"]
    assert 0.3 < said["promise"]["promised"]["rate"] < 0.9
    found = hf.load(tmp_path / "out" / "result.nc")
    assert found.names == ("x", "v", "actual_a")
    assert found.values[0].report.title == "A cart whose force lags"
    assert found.decomposition.verdict == "inner"


@pytest.mark.heavy
def test_the_command_writes_figures_too(late, tmp_path):
    done = called("run", late, "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert {p.name for p in tmp_path.iterdir()} >= {"result.nc", "set_1.png", "summary.json"}


def test_show_tells_the_parts(late):
    text = describe(late)
    assert text.startswith(LATE.rstrip())
    assert "# part (predicted x = 0.15*v + x, predicted v = 0.15*actual_a + v) by a: " in text
    assert "# holds where actual_a is in [-0.6, 0.6] m/s^2\n" in text
    assert "# inner: " in text


def test_states_that_are_cut_off_are_named_in_the_file(late):
    changes = ["decompose.cut.actual_a=kept", "decompose.lag_share=0.6"]
    with pytest.raises(ScenarioError, match="'actual_a' is not a state"):
        load_scenario(late, changes).decomposition  # noqa: B018


def test_a_set_put_together_is_no_kernel_on_one_grid(late):
    with pytest.raises(ScenarioError, match="no grid of all its states"):
        hf.explore(late)
    with pytest.raises(ScenarioError, match="no grid of all its states"):
        hf.disturbance_margin(late, of="march.horizon", between=(1, 2))


@pytest.mark.heavy
def test_the_vehicle_with_propeller_lag_has_an_inner_kernel_of_its_eight_states():
    """On a coarse grid: what it promises is kept, from thrusts at the ends of their share."""
    scenario = load_scenario("late-propellers")
    whole = scenario.decomposition
    assert len(whole.system.states) == 8
    assert whole.most_states == 6
    assert whole.verdict == "inner"
    assert whole.prediction.intervals == ((-0.5, 0.5), (-0.5, 0.5))
    assert whole.prediction.gain == pytest.approx(5.5)
    answer = scenario.run()
    assert answer.promise.held
    assert answer.promise.inside.total > 100
    assert answer.promise.edge.value == 1.0
    assert answer.promise.promised.value == pytest.approx(0.0055, abs=0.001)
    box = box_of_starts(answer.value)
    low, high = np.array([box[n] for n in whole.system.state_names]).T
    drawn = np.random.default_rng(0).uniform(low, high, (2_000_000, 8))
    drawn[:, 6:] = np.where(drawn[:, 6:] > 0, 0.5, -0.5)
    starts = drawn[answer.value.contains(drawn)]
    rest = hf.Law("rest", whole.system.states, {"tau_u": 0, "tau_r": 0})

    def stay(law):
        found = hf.simulate(
            whole.system, law, starts=starts, region=scenario.region, horizon=3.0,
            sample_time=0.01, record_every=3.0,
        )  # fmt: skip
        return (found.arrays["outcome"].values == 0).mean()

    assert len(starts) > 1000
    assert 0.999 < stay(hf.parts_law(answer.value)) < 1.0  # one of them, at the edge
    assert stay(rest) == pytest.approx(0.8, abs=0.05)
