"""An observer derived from a system: what it estimates, and that a law can live on it."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from tests.drifts import drifting, told


@pytest.fixture(scope="module", name="drifting")
def one_that_drifts():
    return drifting()


def test_drift_is_found_at_the_rate_of_the_bandwidth(drifting):
    """e'' + 2 w e' + w^2 e = 0: both poles at -w, up to the Euler step."""
    law = hf.observe(drifting, told(drifting), bandwidth=2.0)
    data = hf.simulate(
        drifting, law, starts=[[0.5]], disturbance={"d": 0.4}, horizon=8.0, sample_time=0.01,
        record_every=0.01,
    ).dataset  # fmt: skip
    time, found = data["time"].values, data["signal"].values[0, :, 0]
    expected = 0.4 * (1 - (1 + 2 * time) * np.exp(-2 * time))
    assert np.abs(found - expected).max() < 0.01
    assert found[-1] == pytest.approx(0.4, abs=1e-5)
    assert data["state"].values[0, -1, 0] == pytest.approx(0.0, abs=1e-3)


def test_estimate_keeps_within_the_known_bound(drifting):
    law = hf.observe(drifting, told(drifting), bandwidth=2.0)
    data = hf.simulate(
        drifting, law, starts=[[0.0]], disturbance={"d": 1.0}, horizon=6.0, record_every=0.02,
        noise_normal={"x": 0.3},
    ).dataset  # fmt: skip
    found = np.abs(data["signal"].values)
    assert found.max() <= 1.0 + 1e-12
    assert found.max() > 0.99


def test_memory_holds_the_formula_of_the_docstring(drifting):
    memory = hf.observe(drifting, told(drifting), bandwidth=3.0).memory
    x, u = hf.symbol("x"), hf.symbol("u")
    x_hat, d_hat, w = (hf.symbol(n) for n in ("x_hat", "d_hat", "observer_bandwidth"))
    step = hf.SAMPLE_TIME
    wanted = x_hat + step * (u + d_hat + 2 * w * (x - x_hat))
    assert sp.expand(memory.following["x_hat"] - wanted) == 0
    inside = d_hat + step * w**2 * (x - x_hat)
    at = {x: 0.01, x_hat: 0.0, d_hat: 0.1, w: 3.0, step: 0.01}
    assert float(memory.following["d_hat"].subs(at)) == pytest.approx(float(inside.subs(at)))
    assert memory.initial == {"x_hat": x, "d_hat": 0}


@pytest.fixture(scope="module")
def guarded(vehicle):
    law = hf.track_velocity(vehicle, hf.laws.inspect_target(vehicle), {"u": 5.0, "r": 10.0})
    view = hf.regions.camera_view()
    margins = {"edge_low": 0.02, "edge_high": 0.02, "too_near": 0.01, "too_far": 0.02}
    return view, hf.safeguard(
        vehicle, law, view, gains=(2, 6), margins=margins, disturbance_measured=True
    )


def test_vehicle_that_knows_its_pose_alone_finds_the_current_and_keeps_the_view(vehicle, guarded):
    view, law = guarded
    names = ("x", "y", "psi")
    law = hf.observe(vehicle, law, measured=names, bandwidth=5.0)
    assert {q.name for q in law.reads} <= {
        *names,
        *(f"{n}_hat" for n in ("u", "v", "r", "Vx", "Vy")),
    }
    result = hf.simulate(
        vehicle, law, region=view, goal=hf.regions.near_pose(), horizon=100.0, tolerance=1e-3,
        starts=[[-1.5, 0.3, -0.2, 0, 0, 0], [-1.2, -0.4, 0.3, 0, 0, 0]],
        disturbance={"Vx": -0.03, "Vy": 0.0},
    )  # fmt: skip
    assert result.viable == 2
    still = hf.simulate(
        vehicle, law, region=view, goal=hf.regions.near_pose(), horizon=100.0, tolerance=1e-3,
        starts=[[-1.5, 0.3, -0.2, 0, 0, 0]],
    )  # fmt: skip
    assert still.outcomes["reached goal"] == 1


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"measured": ("x", "z")}, "'z' is not a state"),
        ({"bandwidth": 0.0}, "bandwidth is 0.0; expected above 0"),
        ({"bandwidth": True}, "expected above 0"),
        ({"measured": ()}, "moves none of the measured states"),
    ],
)
def test_observers_that_cannot_be_are_refused(drifting, options, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.observe(drifting, told(drifting), **options)


def test_a_law_that_remembers_already_is_refused(drifting):
    once = hf.observe(drifting, told(drifting))
    with pytest.raises(DefinitionError, match="already has a memory"):
        hf.observe(drifting, once)


def varying(slope, name="b", value=1.0):
    """x' = slope d, with the slope an expression of x, u and a parameter."""
    x, u, d = (hf.symbol(n) for n in "xud")
    b = hf.Parameter(name, value=value)
    return hf.System(
        "varying", (hf.Quantity("x"),), (hf.Quantity("u"),),
        {"x": u + slope(x, u, b.symbol) * d}, parameters=(b,),
        disturbances=(hf.Quantity("d"),), disturbance_bounds=hf.Box((-9,), (9,)),
    )  # fmt: skip


@pytest.mark.parametrize(
    "slope",
    [lambda x, u, b: u, lambda x, u, b: b, lambda x, u, b: b * sp.sin(x), lambda x, u, b: x / (x + b)],
    ids=["an input", "a parameter", "vanishing at 0", "a quotient"],
)  # fmt: skip
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_estimate_is_finite_where_the_disturbance_has_no_effect(slope, value):
    system = varying(slope, value=value)
    x, d = hf.symbol("x"), hf.symbol("d")
    swing = hf.parse_expression("0.3*sin(t)", {"t": hf.TIME})
    law = hf.Law("told", (*system.states, *system.disturbances), {"u": swing - x}, signals={"d": d})
    data = hf.simulate(
        system, hf.observe(system, law), starts=[[0.2]], disturbance={"d": 0.1}, horizon=5.0
    ).dataset
    assert np.isfinite(data["signal"].values).all()
    assert np.isfinite(data["state"].values).all()


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_varying_slope_has_the_bandwidth_of_the_origin_in_any_unit(unit):
    """x' = u + unit (1 + cos(x)/2) d, with d in that unit: it is found as fast in all of them."""
    slope = unit * (1 + sp.cos(hf.symbol("x")) / 2)
    x, u, d = (hf.symbol(n) for n in "xud")
    system = hf.System(
        "varying", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": u + slope * d},
        disturbances=(hf.Quantity("d"),), disturbance_bounds=hf.Box((-1 / unit,), (1 / unit,)),
    )  # fmt: skip
    reads = (*system.states, *system.disturbances)
    law = hf.Law("told", reads, {"u": -x - slope * d}, signals={"d": unit * d})
    data = hf.simulate(
        system, hf.observe(system, law), starts=[[0.5]], disturbance={"d": 0.4 / unit}, horizon=8.0
    ).dataset
    assert data["signal"].values[0, -1, 0] == pytest.approx(0.4, abs=1e-3)


def test_bandwidth_beyond_the_sample_time_is_refused(drifting):
    law = hf.observe(drifting, told(drifting), bandwidth=50.0)
    with pytest.raises(SimulationError, match=r"50 1/s at samples of 0\.02 s"):
        hf.simulate(drifting, law, starts=[[0.5]], horizon=1.0, sample_time=0.02)
    with pytest.raises(SimulationError, match="bandwidth"):
        hf.Controller(drifting, law, sample_time=0.02)
    end = hf.Region("end", drifting.states, (hf.Inequality("end", hf.symbol("x") - 1),))
    with pytest.raises(SimulationError, match="bandwidth"):
        hf.SafetyFilter(drifting, end, states=("x",), bandwidth=60.0, sample_time=0.02)
    assert hf.simulate(drifting, law, starts=[[0.5]], horizon=1.0, sample_time=0.01).viable == 1
