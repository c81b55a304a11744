"""Where a system can rest in a region, under a constant disturbance."""

import math

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator

NEAR = {"x": (-2, -0.3), "y": (-1.5, 1.5), "u": (-0.3, 0.3)}


@pytest.fixture(scope="module")
def vehicle():
    return hf.systems.marine_vehicle(thrust_limit=5.0)


@pytest.fixture(scope="module")
def view():
    return hf.regions.camera_view()


def test_vehicle_rests_along_the_current_with_the_drag_as_its_thrust(vehicle, view):
    p = {q.name: q.value for q in vehicle.parameters}
    for theta, side in ((0.4, 1), (0.4 + math.pi, -1)):
        d = {"Vx": 0.1 * math.cos(theta), "Vy": 0.1 * math.sin(theta)}
        found = hf.resting_state(vehicle, view, d, box=NEAR)
        assert found.exists
        assert found.disturbance == d
        u = -0.1 * side
        wanted = {"psi": 0.4, "u": u, "v": 0, "r": 0}
        for name, value in wanted.items():
            assert found.state[name] == pytest.approx(value, abs=1e-6), name
        assert found.inputs["tau_u"] == pytest.approx(
            -p["Xu"] * u - p["Xuu"] * abs(u) * u, abs=1e-6
        )
        assert found.margin > 0.3


def test_view_has_an_equilibrium_in_every_current_but_those_along_the_wall(vehicle, view):
    """Every 30 degrees; along the wall the margin is exactly none, on the edge and not inside."""
    found = hf.resting_directions(vehicle, view, 0.2, count=12, box=NEAR)
    assert [k for k, f in enumerate(found) if not f.exists] == [3, 9]
    assert all("on the edge of the region" in found[k].missing for k in (3, 9))
    margins = np.array([f.margin for f in found])
    assert sorted(np.argsort(margins)[:2]) == [3, 9]
    assert np.abs(margins[[3, 9]]).max() < 1e-6
    assert (np.delete(margins, [3, 9]) > 0.1).all()
    for f, theta in zip(found, 2 * np.pi * np.arange(12) / 12, strict=True):
        assert abs(math.sin(f.state["psi"] - theta)) < 1e-6


@pytest.mark.heavy
def test_margins_of_every_degree_are_those_of_the_derivation(vehicle, view):
    margins = np.array([f.margin for f in hf.resting_directions(vehicle, view, 0.2, box=NEAR)])
    assert len(margins) == 360
    assert [(margins > m).sum() for m in (0.05, 0.1)] == [346, 334]
    np.testing.assert_allclose(margins[[80, 85, 88]], [0.14, 0.07, 0.03], atol=0.005)
    assert margins[83] == pytest.approx(0.1005, abs=1e-4)
    assert margins[86] > 0.05


def test_goal_of_the_law_for_a_current_is_at_rest_where_the_search_finds_it(vehicle, view):
    for degrees in (20, 75, 130, 200, 310):
        theta = math.radians(degrees)
        d = {"Vx": 0.1 * math.cos(theta), "Vy": 0.1 * math.sin(theta)}
        found = hf.resting_state(vehicle, view, d, box=NEAR)
        along = math.atan2(math.sin(theta), math.cos(theta))
        along = along if math.cos(theta) > 0 else math.atan(math.tan(theta))
        assert math.sin(found.state["psi"] - along) == pytest.approx(0, abs=1e-6)
        assert math.cos(found.state["psi"]) > 0


def test_current_beyond_the_thrust_is_named_and_so_is_one_along_a_wall_with_stand_off(
    vehicle, view
):
    weak = hf.systems.marine_vehicle(thrust_limit=0.05)
    found = hf.resting_state(weak, view, {"Vx": 0.4, "Vy": 0.0}, box=NEAR)
    assert not found.exists
    assert "the inputs exceed their bounds" in found.missing
    p = {q.name: q.value for q in weak.parameters}
    drag = -p["Xu"] * 0.4 - p["Xuu"] * 0.4**2
    assert abs(found.inputs["tau_u"]) == pytest.approx(drag, abs=1e-6)
    off = hf.regions.camera_and_lasers()
    along = hf.resting_state(vehicle, off, {"Vx": 0.0, "Vy": 0.1}, box=NEAR)
    assert not along.exists
    assert "is violated by" in along.missing
    assert hf.resting_state(vehicle, off, {"Vx": -0.1, "Vy": 0.02}, box=NEAR).exists


def test_craft_that_moves_sideways_rests_at_the_best_pose_in_any_current():
    """A fully actuated ship holds what the still vehicle would: the margin knows no direction."""
    ship = hf.load_vehicle("cybership_ii_full")
    view = hf.regions.camera_view()
    box = {"x": (-2, -0.3), "y": (-1, 1), "psi": (-1, 1), "u": (-0.1, 0.1), "v": (-0.1, 0.1)}
    margins = [
        hf.resting_state(ship, view, {"Vx": 0.05 * c, "Vy": 0.05 * s}, box=box).margin
        for c, s in ((1, 0), (0, 1), (-0.6, 0.8))
    ]
    np.testing.assert_allclose(margins, margins[0], atol=1e-3)
    assert margins[0] > 0.4


def test_otter_rests_in_a_view_of_ten_metres():
    craft = hf.load_vehicle("otter")
    view = hf.regions.camera_view(target_half_width=0.5, range_min=1.75, range_max=10.0)
    found = hf.resting_state(
        craft, view, {"Vx": 0.2, "Vy": 0.2}, box={"x": (-10, -2), "y": (-8, 8), "u": (-0.4, 0.4)}
    )
    assert found.exists
    assert found.state["psi"] == pytest.approx(math.pi / 4, abs=1e-6)
    assert found.residual < 1e-6


def test_unicycle_rests_anywhere_and_best_in_the_middle():
    region = hf.Region(
        "room", (hf.Quantity("x", "m"),),
        (hf.Inequality("left", -hf.symbol("x") - 1, "m"), hf.Inequality("right", hf.symbol("x") - 3, "m")),
    )  # fmt: skip
    found = hf.resting_state(hf.systems.unicycle(), region)
    assert found.margin == pytest.approx(2.0, abs=1e-5)
    assert found.state["x"] == pytest.approx(1.0, abs=1e-5)


def test_current_that_is_held_ends_where_the_drag_is_the_thrust_of_both_thrusters(vehicle, view):
    p = {q.name: q.value for q in vehicle.parameters}
    linear, square = -p["Xu"], -p["Xuu"]
    fastest = (math.sqrt(linear**2 + 4 * square * 2 * p["thrust_limit"]) - linear) / (2 * square)
    for share, held in ((0.999, True), (1.001, False)):
        found = hf.resting_state(vehicle, view, {"Vx": share * fastest}, box=NEAR)
        assert found.exists == held, found.missing


def test_car_without_bounds_of_its_inputs_rests_anywhere(view):
    found = hf.resting_state(hf.systems.car(), view, box={"x": (-2, -0.3), "delta": (-0.5, 0.5)})
    assert found.exists
    assert found.margin > 0.4


@pytest.mark.parametrize("name", ["marine_vehicle", "drifting_unicycle", "unicycle"])
def test_half_plane_has_no_place_farthest_inside(name):
    x = hf.symbol("x")
    half = hf.Region("half", (hf.Quantity("x", "m"),), (hf.Inequality("wall", x, "m"),))
    found = hf.resting_state(getattr(hf.systems, name)(), half, searches=4)
    assert not found.exists
    assert "unbounded" in found.missing


def test_bad_input_is_refused(vehicle, view):
    for call, match in (
        (lambda: hf.resting_state(vehicle, view, {"Vz": 0.1}), "not a disturbance"),
        (lambda: hf.resting_state(vehicle, view, {"Vx": math.nan}), "finite"),
        (lambda: hf.resting_state(vehicle, view, box={"z": (0, 1)}), "not a state"),
        (lambda: hf.resting_state(vehicle, view, box={"x": (1, 0)}), "lowest"),
        (lambda: hf.resting_state(vehicle, view, searches=0), "at least 1"),
        (lambda: hf.resting_directions(hf.systems.unicycle(), view, 0.1), "two, as a current"),
        (lambda: hf.resting_directions(vehicle, view, -0.1), "0 or more"),
        (lambda: hf.resting_directions(vehicle, view, 0.1, count=0), "at least 1"),
    ):
        with pytest.raises(DefinitionError, match=match):
            call()


def test_best_place_in_still_water_is_the_same_from_any_starts(vehicle, view):
    """The region is symmetric: two places, one on either side, the same margin."""
    found = [hf.resting_state(vehicle, view, box=NEAR, seed=seed) for seed in range(6)]
    margins = np.array([f.margin for f in found])
    np.testing.assert_allclose(margins, 0.474884, atol=1e-6)
    assert {round(abs(f.state["y"]), 4) for f in found} == {0.9677}
    view_of = Evaluator(
        [c.expression for c in view.inequalities],
        [hf.symbol(n) for n in ("x", "y", "psi")],
        view.parameters,
    )
    axes = [np.linspace(-2, -0.3, 41), np.linspace(-2, 2, 81), np.linspace(-1.3, 1.3, 81)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    sampled = -view_of.values(points).max(axis=1).min()
    assert margins[0] - 0.02 < sampled < margins[0]


def test_place_at_rest_in_an_eddy_is_still_in_a_simulation_and_feels_the_current_of_that_place(
    vehicle, view
):
    x, y = hf.symbol("x"), hf.symbol("y")
    eddy = {"Vx": 0.12 - 0.1 * y, "Vy": 0.1 * (x + 1)}
    found = hf.resting_state(vehicle, view, eddy, box=NEAR)
    assert found.exists
    at = found.state
    assert found.disturbance == pytest.approx(
        {"Vx": 0.12 - 0.1 * at["y"], "Vy": 0.1 * (at["x"] + 1)}
    )
    assert math.sin(at["psi"] - math.atan2(*reversed(found.disturbance.values()))) == pytest.approx(
        0, abs=1e-6
    )
    law = hf.Law("held", vehicle.states, found.inputs)
    start = [at[n] for n in vehicle.state_names]
    data = hf.simulate(vehicle, law, starts=[start], disturbance=eddy, horizon=2.0).dataset
    assert np.abs(data["state"].values[0] - start).max() < 1e-6


def test_field_that_pushes_to_the_wall_everywhere_and_one_of_time_have_no_place_at_rest(
    vehicle, view
):
    weak = hf.systems.marine_vehicle(thrust_limit=0.05)
    shear = {"Vx": 0.4 + 0.05 * hf.symbol("y")}
    assert "exceed their bounds" in hf.resting_state(weak, view, shear, box=NEAR).missing
    with pytest.raises(DefinitionError, match="depends on time"):
        hf.resting_state(vehicle, view, {"Vx": 0.1 * hf.symbol("x") * hf.TIME})
    with pytest.raises(DefinitionError, match="finite number"):
        hf.resting_state(vehicle, view, {"Vx": math.inf})


def test_system_without_inputs_rests_where_its_rates_vanish():
    x = hf.symbol("x")
    ball = hf.System("ball", (hf.Quantity("x"),), (), {"x": 0.25 - x})
    near = hf.Region("near", ball.states, (hf.Inequality("far", x - 1),))
    rest = hf.resting_state(ball, near)
    assert rest.exists
    assert rest.state["x"] == pytest.approx(0.25)
    assert rest.margin == pytest.approx(0.75)
