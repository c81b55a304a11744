"""A flat output in a file: the law of a user's own system follows from it."""

import pytest

import holdfast as hf
from holdfast.errors import HoldfastError

FRONT_AXLE = """
[scenario]
title = "A car by its front axle, written here"

[system]
states = { x = { unit = "m" }, y = { unit = "m" }, psi = { unit = "rad", angle = true }, delta = { unit = "rad", angle = true } }
inputs = { v = { unit = "m/s" }, w = { unit = "rad/s" } }
parameters = { base = { value = 0.5, unit = "m" } }
rates = { x = "v*cos(psi + delta)", y = "v*sin(psi + delta)", psi = "v*sin(delta)/base", delta = "w" }
flat_output = { first = "x - base*cos(psi) + base", last = ["tan(delta)/(base*cos(psi)**3)", "tan(psi)", "y - base*sin(psi)"] }
pfaffian = [{ coefficients = { x = "-sin(psi + delta)", y = "cos(psi + delta)" } }, { coefficients = { x = "-sin(psi)", y = "cos(psi)", psi = "-base" } }]

[law]
name = "steer_by_chained_form"
k1 = 0.5
poles = -1.0

[goal]
name = "near_origin"

[starts]
states = [{ x = -3, y = 0.8, psi = 0.3 }, { x = 3, y = 0.8 }]

[run]
horizon = 40
sample_time = 0.01
record_every = 40
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "car.toml"
    path.write_text(FRONT_AXLE)
    return str(path)


def test_flat_output_of_a_file_steers_the_car_by_its_front_axle_home(file):
    scenario = hf.load_scenario(file)
    declared = hf.systems.front_axle_car().flat_output
    base, wheelbase = hf.symbol("base"), hf.symbol("wheelbase")
    own = scenario.system.flat_output
    assert own.first.xreplace({base: wheelbase}) == declared.first
    assert tuple(e.xreplace({base: wheelbase}) for e in own.last) == declared.last
    assert scenario.run().outcomes["reached goal"] == 2


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ("flat_output={ first = 'q', last = ['y'] }", r"flat_output\.first: unknown name 'q'"),
        (
            "flat_output={ first = 'x', last = ['y', 'q'] }",
            r"flat_output\.last\.1: unknown name 'q'",
        ),
        ("flat_output={ first = 'x', last = [] }", "a flat output has no last coordinate"),
        ("flat_output={ first = 'x', last = ['v'] }", "undeclared name 'v'"),
        ("flat_output={ first = 'x', end = ['y'] }", "end"),
    ],
)
def test_flat_output_that_is_none_is_refused_with_its_key(file, change, complaint):
    with pytest.raises(HoldfastError, match=complaint):
        hf.load_scenario(file, [f"system.{change}"])
