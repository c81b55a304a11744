"""What a result says of the disturbance: its values where it varies in a run."""

import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.maths.definitions.variation import Varied

X, Y = hf.symbol("x"), hf.symbol("y")


def runs(disturbance, **settings):
    system = hf.systems.drifting_unicycle(speed_limit=1.0, current_limit=3.0)
    law = hf.Law("idle", system.states, {"u": sp.Float(0.1), "r": sp.Float(0.2)})
    starts = np.random.default_rng(0).uniform(-1, 1, (30, 3))
    given = {"starts": starts, "horizon": 3.0, "record_every": 0.5, "seed": 4}
    return hf.simulate(system, law, disturbance=disturbance, **given | settings).dataset


def test_disturbance_is_recorded_where_the_vehicle_is_with_the_numbers_of_its_run():
    size = hf.symbol("size")
    varied = Varied({"size": (0.1, 1.0)}, {}, {}, {"size": "m/s"})
    field = {"Vx": size * sp.cos(1.0 * Y + hf.TIME), "Vy": size * sp.sin(1.0 * X)}
    data = runs(field, varied=varied)
    size = data["varied"].values
    q, t = data["state"].values, data["time"].values
    assert np.ptp(size) > 0.5
    wanted = [size * np.cos(q[..., 1] + t), size * np.sin(q[..., 0])]
    np.testing.assert_allclose(np.moveaxis(data["disturbance"].values, -1, 0), wanted, atol=1e-12)
    assert list(data["disturbance_name"].values) == ["Vx", "Vy"]
    assert list(data["disturbance_unit"].values) == ["m/s", "m/s"]


def test_constant_disturbance_is_not_recorded_and_one_of_time_is():
    assert "disturbance" not in runs({"Vx": 0.3})
    veering = runs({"Vx": 0.3 * sp.cos(hf.TIME)})
    wanted = np.tile(0.3 * np.cos(veering["time"].values), (30, 1))
    np.testing.assert_allclose(veering["disturbance"].values[..., 0], wanted, atol=1e-12)
    assert not veering["disturbance"].values[..., 1].any()


def test_nothing_is_recorded_after_a_run_has_diverged():
    """x' = x^2 + d is infinite before t = 1 s, unless it begins below 0."""
    bursting = hf.System(
        name="bursting",
        states=(hf.Quantity("x"),),
        inputs=(hf.Quantity("push"),),
        disturbances=(hf.Quantity("d"),),
        rates={"x": X**2 + hf.symbol("d") + hf.symbol("push")},
    )
    law = hf.Law("idle", bursting.states, {"push": sp.S.Zero})
    field = {"d": 0.1 * sp.cos(X)}
    data = hf.simulate(
        bursting, law, starts=[[1.2], [-1.0]], disturbance=field, horizon=2.0, record_every=0.5
    ).dataset
    felt, state = data["disturbance"].values[..., 0], data["state"].values[..., 0]
    assert (
        np.isnan(felt[0]).tolist()
        == np.isnan(state[0]).tolist()
        == [False, False, True, True, True]
    )
    np.testing.assert_allclose(felt[1], 0.1 * np.cos(state[1]), atol=1e-12)
