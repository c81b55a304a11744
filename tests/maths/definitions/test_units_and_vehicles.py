"""Numbers with units, and vehicle files with a source for every number."""

import pint
import pytest

from holdfast.errors import HoldfastError, ScenarioError
from holdfast.maths.catalogue.systems.marine_vehicle import PARAMETERS
from holdfast.maths.catalogue.vehicles import vehicle_of
from holdfast.maths.definitions.quantity import (
    _FACTORS,
    UnitError,
    check_unit,
    in_base_units,
    to_si,
)
from holdfast.maths.definitions.vehicle_file import vehicle_for, vehicle_names


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (2, "m", 2.0),
        ("2", "m", 2.0),
        ("2 m", "m", 2.0),
        ("180 deg", "rad", 3.14159265),
        ("40 cm", "m", 0.4),
        ("-1.5e-2 m/s", "m/s", -0.015),
        ("1 knot", "m/s", 0.514444),
        ("3 N*s/m", "N s/m", 3.0),
        ("50 %", "1", 0.5),
    ],
)
def test_text_with_a_unit_becomes_a_number_in_si(value, unit, expected):
    assert to_si(value, unit) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("value", "unit", "complaint"),
    [
        ("0.5 kg", "m", "'kg' does not fit"),
        ("fast", "m/s", "got 'fast'"),
        (True, "m", "got True"),
        (None, "m", "got None"),
        ("3 flurbs", "m", "not a unit"),
        (float("inf"), "m", "finite"),
        ("1e999 m", "m", "finite"),
        ([1], "m", "got [1]"),
    ],
)
def test_wrong_units_and_non_numbers_are_refused(value, unit, complaint):
    with pytest.raises(UnitError) as caught:
        to_si(value, unit)
    assert complaint in str(caught.value)


@pytest.mark.few("min", "g")
@pytest.mark.parametrize("given", _FACTORS)
def test_common_units_are_those_of_the_unit_library(given):
    registry, unit = pint.UnitRegistry(), _FACTORS[given][0]
    for number in (0.0, 1.0, -3.0, 0.1, 17.3, 1e-7, 12345.678):
        same = registry.Quantity(number, given)
        assert to_si(f"{number!r} {given}", unit) == same.to(unit).magnitude
        assert in_base_units(f"{number!r} {given}") == same.to_base_units().magnitude


def test_a_unit_that_is_none_is_refused():
    check_unit("N m s")
    with pytest.raises(UnitError, match="'flurb' is not a unit"):
        check_unit("flurb")


@pytest.mark.parametrize("name", vehicle_names())
def test_every_shipped_vehicle_gives_unit_and_source_for_every_number(name):
    vehicle = vehicle_of(name)
    for parameter in vehicle.parameters.values():
        assert parameter.source
        assert parameter.assumed == (parameter.source == "assumption")
    for drag in ("Xu", "Yv", "Nr", "Xuu", "Yvv", "Nrr", "Xudot", "Yvdot", "Nrdot"):
        if vehicle.system != "marine_vehicle":
            break
        assert vehicle.parameters[drag].value < 0


GOOD = """
title = "t"
system = "marine_vehicle"
[parameters]
""" + "\n".join(
    f'{name} = {{ value = 1.0, unit = "{unit}", source = "s" }}'
    for name, (unit, _, _) in PARAMETERS.items()
)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('mass = { value = 1.0, unit = "kg"', 'mass = { value = 1.0, unit = "m"', "does not fit"),
        ('mass = { value = 1.0, unit = "kg"', 'mass = { unit = "kg"', "missing key 'value'"),
        (', source = "s" }', " }", "missing key 'source'"),
        ("mass =", "masss =", "did you mean 'mass'?"),
        ('title = "t"', "", "missing key 'title'"),
        ('title = "t"', 'titel = "t"', "unknown key 'titel'"),
        ("[parameters]", "[parameters", "not a TOML file"),
        ("mass = { value = 1.0,", "mass = { value = 'heavy',", "got 'heavy'"),
    ],
)
def test_broken_vehicle_file_is_refused_with_the_key(tmp_path, old, new, complaint):
    assert old in GOOD
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(HoldfastError) as caught:
        vehicle_for(str(path), PARAMETERS)
    assert complaint in str(caught.value)


def test_grams_are_converted(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        GOOD.replace('mass = { value = 1.0, unit = "kg"', 'mass = { value = 5400, unit = "g"')
    )
    assert vehicle_for(str(path), PARAMETERS).parameters["mass"].value == pytest.approx(5.4)


def test_unknown_or_unreadable_vehicle_is_refused():
    with pytest.raises(ScenarioError, match="did you mean 'bluerov2'"):
        vehicle_for("bluerov", PARAMETERS)
    with pytest.raises(ScenarioError, match="cannot be read"):
        vehicle_for("nowhere.toml", PARAMETERS)
