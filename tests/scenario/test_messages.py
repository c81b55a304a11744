"""What is said of a file that does not fit: the key as the file has it, and the remedy."""

import re

import pytest

from holdfast.errors import RenamedWarning, ScenarioError
from holdfast.scenario.load import load_scenario

SLED = """
[scenario]
title = "sled"
[system]
states = { x = { unit = "m" } }
inputs = { u = { unit = "m/s" } }
disturbances = { d = { unit = "m/s" } }
rates = { x = "u + d" }
MEASUREMENTS
[law]
outputs = { u = "-d" }
reads = ["x", "d"]
[region]
constraints = { near = { expression = "x - 1", unit = "m" } }
[starts]
states = [{ x = 0 }]
[run]
horizon = 1
"""


@pytest.fixture
def load(tmp_path):
    """Load the sled with more tables and changes."""

    def load(more="", changes=(), measurements=""):
        path = tmp_path / "sled.toml"
        path.write_text(SLED.replace("MEASUREMENTS", measurements) + more)
        return load_scenario(str(path), list(changes))

    return load


@pytest.mark.parametrize("empty", ["error_bounds", "rate_bounds"])
def test_empty_bounds_of_an_observer_are_none(load, empty):
    observer = "[observer]\nbandwidth = 3\n"
    with_empty = load(f"{observer}{empty} = {{}}\n")
    assert with_empty.law == load(observer).law
    assert with_empty.filtering == load(observer).filtering


def test_measurement_needs_an_expression(load):
    with pytest.raises(ScenarioError, match=r"system\.measurements\.z\.expression: missing key"):
        load(measurements='measurements = { z = { unit = "m" } }')
    assert load(measurements='measurements = { z = { expression = "2*x" } }').model.measurements


@pytest.mark.parametrize(
    "key",
    [
        "varied.values.d",
        "varied.plant.d",
        "law.outputs.u",
        "law.definitions.e",
        "region.constraints.near.expression",
        "system.rates.x",
        "reference.x",
    ],
)
def test_process_is_of_a_disturbance_alone(load, key):
    assert "wiener" in str(load(changes=["disturbance.d=0.1 + wiener(0.2)"]).disturbance["d"])
    refused = rf"{re.escape(key)}: the function 'wiener' is not allowed .*only \[disturbance\] of"
    with pytest.raises(ScenarioError, match=refused):
        load(changes=[f"{key}=wiener(0.2)"])
    with pytest.raises(ScenarioError, match=r"unknown name|not allowed") as unknown:
        load(changes=[f"{key}=zzzz(0.2)"])
    assert "wiener" not in str(unknown.value)
    assert "hypot" in str(unknown.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "region.constraints.wall=2 min",
            r"region\.constraints\.wall: '2 min' is not an expression",
        ),
        ("region.constraints.near.expression=2 min", r"constraints\.near\.expression: '2 min'"),
        ("law.parameters.k=x", r"law\.parameters\.k: got 'x'"),
        ("law.parameters={k={value='x'}}", r"law\.parameters\.k\.value: got 'x'"),
    ],
)
def test_key_of_a_message_is_in_the_file(load, change, said):
    with pytest.raises(ScenarioError, match=said):
        load(changes=[change])


def test_tag_of_a_union_is_no_key():
    with pytest.raises(ScenarioError, match=r"certificate\.cells\.x: got {}; expected"):
        load_scenario("ferry-banks", ["certificate.cells={x={}}"])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("control = 'continuous'", r"sled\.toml: the key 'control'"),
        ("[safeguard]\nmeasured = true", r"sled\.toml: .*the key 'measured'"),
    ],
)
def test_warning_of_a_former_key_names_the_file(load, more, said):
    with pytest.warns(RenamedWarning, match=said):
        load(more)
