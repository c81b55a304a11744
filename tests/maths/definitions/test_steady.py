"""Velocities that the inputs can hold: exact roots, the closed loop at full thrust, refusals."""

import math

import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError

v, w, a = (hf.symbol(n) for n in ("v", "w", "a"))


def cart(rate, bounds, **more):
    """A cart in multiples of a speed and of the time in which drag stops it."""
    return hf.System(
        "cart", (hf.Quantity("v", "1"), hf.Quantity("w", "1")), (hf.Quantity("a", "1"),),
        {"v": rate, "w": -w}, input_bounds=bounds, **more,
    )  # fmt: skip


@pytest.mark.parametrize("limit", [0.3, 1.0, 5.0])
def test_thrust_holds_the_roots_of_the_quadratic_drag(limit):
    """-Xu s - Xuu s^2 = 2 F, and -Nr s - Nrr s^2 = 2 F b, in closed form."""
    vehicle = hf.systems.marine_vehicle(thrust_limit=limit)
    p = {q.name: q.value for q in vehicle.parameters}
    found = hf.steady_bounds(vehicle, ("u", "r"))
    for i, (linear, square, force) in enumerate(
        ((p["Xu"], p["Xuu"], 2 * limit), (p["Nr"], p["Nrr"], 2 * limit * p["thruster_arm"]))
    ):
        exact = (linear + math.sqrt(linear**2 - 4 * square * force)) / (-2 * square)
        assert float(found.upper[i]) == pytest.approx(exact, rel=1e-12)
        assert float(found.lower[i]) == pytest.approx(-exact, rel=1e-12)


@pytest.mark.parametrize(("asked", "name"), [((100, 0), "u"), ((0, 100), "r")])
def test_full_thrust_comes_to_rest_at_the_bound(asked, name):
    vehicle = hf.systems.marine_vehicle(thrust_limit=1.0)
    outputs = dict(zip(vehicle.input_names, map(sp.Integer, asked), strict=True))
    run = hf.simulate(
        vehicle, hf.Law("full", vehicle.states, outputs), starts=[[0.0] * 6], horizon=120
    )
    reached = run.dataset["state"].sel(state_name=name).values[0, -1]
    assert reached == pytest.approx(float(hf.steady_bounds(vehicle, (name,)).upper[0]), rel=1e-6)


def test_sides_differ_and_the_first_value_that_cannot_be_held_ends_the_interval():
    """v is held by a = v - v^3/8 in [-3, 1]: ahead up to 1.236, where a is 1; beyond 2 it would do
    again. Astern a is negative until v^3/8 = v + 1."""
    found = hf.steady_bounds(cart(a - v + (v / 2) ** 3, hf.Box((-3,), (1,))), ("v",))
    assert float(found.upper[0]) == pytest.approx(math.sqrt(5) - 1, rel=1e-9)
    assert float(found.lower[0]) == pytest.approx(-math.sqrt(5) - 1, rel=1e-9)


@pytest.mark.parametrize(
    ("system", "states", "told"),
    [
        (cart(a - v, None), ("v",), "no bounds for its inputs"),
        (cart(a - v, hf.Box((-1,), (1,))), ("u",), "'u' is not a state"),
        (cart(a**2 - v, hf.Box((-1,), (1,))), ("v",), "not affine"),
        (cart(a + 2 - v, hf.Box((-1,), (1,))), ("v",), "cannot hold 'v' at 0"),
        (cart(a - v * hf.TIME, hf.Box((-1,), (1,))), ("v",), "depends on time"),
        (cart(a, hf.Box((-1,), (1,))), ("v",), "hold every value of 'v'"),
    ],
)
def test_what_has_no_steady_bounds_is_refused(system, states, told):
    with pytest.raises(DefinitionError, match=told):
        hf.steady_bounds(system, states)


def test_thrusters_may_be_weaker_astern():
    """119.7 N ahead and 66.7 N astern: the bounds, the steady speeds and the limited thrusts differ."""
    vehicle = hf.systems.marine_vehicle(thrust_limit=119.7, thrust_astern=66.7)
    p = {q.name: q.value for q in vehicle.parameters}
    found = hf.steady_bounds(vehicle, ("u",))
    for side, force in ((found.upper[0], 2 * 119.7), (-found.lower[0], 2 * 66.7)):
        exact = (p["Xu"] + math.sqrt(p["Xu"] ** 2 - 4 * p["Xuu"] * force)) / (-2 * p["Xuu"])
        assert float(side) == pytest.approx(exact, rel=1e-12)
    for asked, (port, starboard) in (
        ((-1000, 0), (-66.7, -66.7)),
        ((1000, 0), (119.7, 119.7)),
        ((0, 1000), (-66.7, 119.7)),
    ):
        outputs = dict(zip(vehicle.input_names, map(sp.Integer, asked), strict=True))
        run = hf.simulate(
            vehicle, hf.Law("full", vehicle.states, outputs), starts=[[0.0] * 6], horizon=1
        )
        thrusts = run.dataset["actuator"].values[0, 0]
        assert thrusts.tolist() == [port, starboard]
    assert "thrust_astern" not in {q.name for q in hf.systems.marine_vehicle().parameters}


def test_vehicle_file_may_give_the_thrust_astern(tmp_path):
    from importlib import resources

    text = (resources.files("holdfast.vehicles") / "cybership_ii.toml").read_text()
    more = 'thrust_astern = { value = 1.5, unit = "N", source = "a test" }\n'
    (tmp_path / "boat.toml").write_text(text + more)
    vehicle = hf.load_vehicle(str(tmp_path / "boat.toml"))
    assert float(hf.steady_bounds(vehicle, ("u",)).lower[0]) == pytest.approx(
        -float(
            hf.steady_bounds(
                hf.systems.marine_vehicle("cybership_ii", thrust_limit=1.5), ("u",)
            ).upper[0]
        )
    )
