"""Inputs that are states: constraints on inputs and accelerations, in a region."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError

x, u = hf.symbol("x"), hf.symbol("u")


def track(bounds=None):
    return hf.System(
        "track", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s", "speed"),), {"x": u},
        input_bounds=bounds or hf.Box((-1,), (1,)),
    )  # fmt: skip


def walls():
    sides = (hf.Inequality("left", -1 - x, "m"), hf.Inequality("right", x - 1, "m"))
    return hf.Region("walls", track().states, sides)


def test_acceleration_is_the_rate_of_a_velocity_that_was_an_input():
    found = hf.dynamic_extension(track(), ("u",), hf.Box((-0.5,), (0.5,)))
    assert found.state_names == ("x", "u")
    assert [(q.name, q.unit) for q in found.inputs] == [("u_rate", "m/s^2")]
    assert found.rates == {"x": u, "u": hf.symbol("u_rate")}
    limits = hf.input_limits(track())
    assert {c.name: c.expression for c in limits.inequalities} == {"u_high": u - 1, "u_low": -u - 1}


def test_kernel_with_bounded_acceleration_is_the_one_of_the_braking_distance():
    """x + u^2 / (2 a) <= 1 for u > 0, and |u| <= 1, the bound that u had as an input."""
    system = hf.dynamic_extension(track(), ("u",), hf.Box((-1,), (1,)))
    region = hf.both(walls(), hf.input_limits(track()))
    grid = hf.grid(system, {"x": (-1.2, 1.2), "u": (-1.3, 1.3)}, nodes=81)
    kernel = hf.viability_kernel(system, region, grid, horizon=4)
    for speed in (0.2, 0.5, 0.8):
        stop = 1 - speed**2 / 2
        assert kernel.contains([[stop - 0.05, speed], [-stop + 0.05, -speed]]).all()
        assert not kernel.contains([[stop + 0.05, speed], [-stop - 0.05, -speed]]).any()
    assert not kernel.contains([[0.0, 1.05], [0.0, -1.05]]).any()


def test_thrusters_that_are_states_keep_their_limits_and_their_rate():
    vehicle = hf.systems.marine_vehicle()
    found = hf.dynamic_extension(vehicle, ("tau_u", "tau_r"), hf.Box((-20, -4), (20, 4)))
    limits = hf.input_limits(vehicle)
    values = {p.symbol: p.value for p in vehicle.parameters}
    arm = values[hf.symbol("thruster_arm")]

    def worst(port, starboard):
        at = {hf.symbol("tau_u"): port + starboard, hf.symbol("tau_r"): arm * (starboard - port)}
        return float(limits.worst.xreplace(at).xreplace(values).evalf())

    generator = np.random.default_rng(1)
    for pair in generator.uniform(-8, 8, (40, 2)):
        assert worst(*pair) == pytest.approx(max(abs(pair)) - 5.0)
    assert found.input_names == ("tau_u_rate", "tau_r_rate")


def test_scenario_extends_and_keeps_the_limits_in_its_region(tmp_path):
    file = tmp_path / "track.toml"
    file.write_text("""
[scenario]
title = "a cart whose acceleration is bounded"
kind = "viability-kernel"
[system]
states = { x = { unit = "m" } }
inputs = { u = { unit = "m/s", bounds = [-1, 1] } }
rates = { x = "u" }
extend = { u = [-0.5, "50 cm/s^2"] }
[region]
constraints = { left = "-1 - x", right = "x - 1" }
[grid]
nodes = 41
box = { x = [-1.2, 1.2], u = [-1.3, 1.3] }
[march]
horizon = 4
""")
    scenario = hf.load_scenario(str(file))
    assert scenario.region.inequality_names == ("left", "right", "u_high", "u_low")
    kernel = scenario.solve()
    assert kernel.contains([[0.0, 0.9]]).all()
    assert not kernel.contains([[0.5, 0.9], [0.0, 1.05]]).any()


def test_rates_belong_to_the_inputs_in_the_order_in_which_these_are_named():
    wheels = hf.systems.unicycle()
    found = hf.dynamic_extension(wheels, ("r", "v"), hf.Box((-9, -1), (9, 1)))
    bounds = dict(zip(found.input_names, found.input_bounds.ranges(), strict=True))
    assert bounds == {"r_rate": (-9, 9), "v_rate": (-1, 1)}


def test_bounds_of_the_other_inputs_stay_where_the_rate_has_none():
    found = hf.dynamic_extension(hf.systems.unicycle(), ("v",))
    limit = hf.symbol("turn_limit")
    oo = float("inf")
    assert found.input_names == ("r", "v_rate")
    assert found.input_bounds.ranges() == [(-limit, limit), (-oo, oo)]


def test_inputs_that_cannot_be_extended_are_refused():
    ball = hf.System(
        "sled", (hf.Quantity("x"),), (hf.Quantity("u"), hf.Quantity("w")),
        {"x": u + hf.symbol("w")}, input_bounds=hf.Ball(1, 2),
    )  # fmt: skip
    with pytest.raises(DefinitionError, match="depend on each other"):
        hf.dynamic_extension(ball, ("u",))
    with pytest.raises(DefinitionError, match="not a polytope"):
        hf.input_limits(ball)
    with pytest.raises(DefinitionError, match="'v' is not an input"):
        hf.dynamic_extension(track(), ("v",))
    free = hf.System("free", track().states, track().inputs, {"x": u})
    with pytest.raises(DefinitionError, match="have no bounds"):
        hf.input_limits(free)
