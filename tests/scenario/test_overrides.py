"""An override that nothing depends on is refused, wherever scenarios are composed."""

import pytest

import holdfast as hf
from holdfast.errors import ScenarioError
from holdfast.studies.sweep import sweep

UNUSED = "nothing depends on 'thrust_limit'"


def test_typed_interval_refuses_the_thrust_that_it_does_not_depend_on():
    with pytest.raises(ScenarioError, match=UNUSED):
        hf.load_scenario("ch7-hold-goal", ["system.thrust_limit=1"])


@pytest.mark.slow("5")
@pytest.mark.parametrize("limit", ["1", "5", '"1 N"'])
def test_steady_interval_follows_the_thrust(limit):
    """The value of the vehicle itself is an override too, and not refused."""
    bounds = hf.load_scenario("ch7-discriminating", [f"system.thrust_limit={limit}"]).system
    vehicle = hf.systems.marine_vehicle(thrust_limit=float(limit.strip('"').split()[0]))
    assert bounds.input_bounds == hf.steady_bounds(vehicle, ("u", "r"))


def test_number_that_stands_in_an_expression_is_taken():
    loaded = hf.load_scenario("inspection", ["system.thrust_limit=1", "law.k1=0.12"])
    assert {q.name: q.value for q in loaded.system.parameters}["thrust_limit"] == 1.0


SLED = """
[scenario]
title = "a sled"
[system]
states = { x = { unit = "m" } }
inputs = { v = { unit = "m/s" } }
rates = { x = "v" }
parameters = { idle = { unit = "m", value = 1 }, fast = { unit = "m/s", value = 1 } }
[law]
empirical = "numbers"
outputs = { v = "-x" }
[region]
constraints = { near = { expression = "x - 2", unit = "m" } }
[starts]
states = [{ x = 1 }]
[run]
horizon = 1
[compare.laws.quick]
without = ["law"]
law = { empirical = "numbers", outputs = { v = "-fast*x" } }
"""


def test_sweep_refuses_it_before_a_cell_is_run():
    with pytest.raises(ScenarioError, match=UNUSED):
        sweep("ch7-hold-goal", ["system.thrust_limit=1,2"])


def test_comparison_refuses_what_no_law_and_no_case_depends_on(tmp_path):
    file = tmp_path / "sled.toml"
    file.write_text(SLED)
    with pytest.raises(ScenarioError, match="nothing depends on 'idle'"):
        hf.compare(str(file), overrides=["system.parameters.idle.value=3"])
    with pytest.raises(ScenarioError, match="nothing depends on 'fast'"):
        hf.load_scenario(str(file), ["system.parameters.fast.value=3"])
    found = hf.compare(str(file), overrides=["system.parameters.fast.value=3"])
    assert set(found.laws) == {"sled", "quick"}
