"""A vehicle of another system is data alone."""

import pytest

import holdfast as hf
from holdfast.errors import HoldfastError, ScenarioError
from holdfast.scenario.files import load_system
from holdfast.studies.catalogue import catalogue_lines, describe

ROBOT = """
title = "a robot"
system = "{system}"
[parameters]
{name} = {{ value = {value}, unit = "{unit}", source = "measured" }}
"""


def robot(folder, system="car", name="wheelbase", value=25, unit="cm"):
    file = folder / "robot.toml"
    file.write_text(ROBOT.format(system=system, name=name, value=value, unit=unit))
    return str(file)


def test_file_gives_the_system_its_numbers_and_their_sources(tmp_path):
    found = hf.load_vehicle(robot(tmp_path))
    (wheelbase,) = found.parameters
    assert (found.name, wheelbase.value, wheelbase.source) == ("car", 0.25, "measured")
    assert found.rates == hf.systems.car().rates
    assert hf.load_vehicle(robot(tmp_path), wheelbase=1.0).parameters[0].value == 1.0


def test_scenario_takes_the_vehicle_and_lets_its_numbers_be_set(tmp_path):
    table = [f"vehicle='{robot(tmp_path)}'"]
    assert load_system("car", table).parameters[0].value == 0.25
    assert load_system("car", [*table, "wheelbase='30 cm'"]).parameters[0].value == 0.3
    two = robot(tmp_path, "tractor_trailer", "length_1", 0.4, "m")
    assert load_system("tractor_trailer", [f"vehicle='{two}'"]).parameters[0].value == 0.4


def test_shipped_robot_drives_no_faster_than_its_motors():
    found = hf.load_vehicle("turtlebot3_burger")
    assert found.input_bounds.at({p.symbol: p.value for p in found.parameters}).contains(
        [0.22, 2.84]
    )
    assert any("turtlebot3_burger" in line for line in catalogue_lines())
    assert "for system unicycle" in describe("turtlebot3_burger")


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"system": "cart"}, "is for system 'cart'; did you mean 'car'"),
        ({"name": "wheel"}, "unknown parameter 'wheel'"),
        ({"unit": "kg"}, "does not fit"),
        ({"value": -1}, "above 0"),
    ],
)
def test_file_that_does_not_fit_its_system_is_refused(more, told, tmp_path):
    with pytest.raises(HoldfastError, match=told):
        hf.load_vehicle(robot(tmp_path, **more))


def test_vehicle_of_another_system_and_unknown_numbers_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match="is for system 'unicycle'; expected 'car'"):
        load_system("car", ["vehicle='turtlebot3_burger'"])
    with pytest.raises(ScenarioError, match="no parameter 'mass'"):
        hf.load_vehicle("turtlebot3_burger", mass=1.0)
