"""An observer derived from a system: what it estimates, and that a law can live on it."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError


@pytest.fixture(scope="module")
def drifting():
    """xdot = u + d: one measured state, one unknown drift of at most 1 m/s."""
    u, d = hf.symbol("u"), hf.symbol("d")
    return hf.System(
        name="drifting",
        states=(hf.Quantity("x", "m"),),
        inputs=(hf.Quantity("u", "m/s"),),
        disturbances=(hf.Quantity("d", "m/s"),),
        rates={"x": u + d},
        disturbance_bounds=hf.Ball(1, 1),
    )


def told(system):
    """u = -x - d by a law that is told the drift, recorded as a signal."""
    x, d = hf.symbol("x"), hf.symbol("d")
    reads = (*system.states, *system.disturbances)
    return hf.Law("told", reads, {"u": -x - d}, signals={"drift": d})


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
    return view, hf.safeguard(vehicle, law, view, gains=(2, 6), margins=margins, measured=True)


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
