"""Inputs slowed by one factor: the path of a car or a trailer stays, within its limits."""

import numpy as np
import pytest
import sympy as sp
from scipy.spatial import cKDTree

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.nonholonomic.chained_feedback import slowed_down

CAR = {"k1": 0.5, "poles": -1.0, "threshold": 3.0, "escape_speed": 0.2, "escape_time": 15.0}
TRAILER = {
    "k1": 0.2, "poles": -0.4, "threshold": 2.0, "escape_speed": 0.5, "escape_time": 16.0, "stop": 1e-3,
}  # fmt: skip


def arrived(system, law, box, horizon, runs):
    result = hf.simulate(
        system, law, goal=hf.regions.near_origin(system), starts=hf.Starts(random=runs, box=box),
        horizon=horizon, sample_time=0.01, substeps=1, record_every=1, seed=1,
    )  # fmt: skip
    return result.outcomes["reached goal"], np.abs(result.dataset["input"].values).max(axis=(0, 1))


def test_largest_input_is_at_its_bound_and_the_others_keep_their_ratio():
    car = hf.systems.car(speed_limit=1.0, steering_rate_limit=2.0)
    given = {p.symbol: p.value for p in car.parameters}
    for wanted, found in (
        ((0.5, -1.0), (0.5, -1.0)),
        ((4.0, -1.0), (1.0, -0.25)),
        ((-3.0, 8.0), (-0.75, 2.0)),
        ((0.0, 0.0), (0.0, 0.0)),
    ):
        inputs = dict(zip(car.input_names, map(sp.Float, wanted), strict=True))
        slow = [float(e.xreplace(given).evalf()) for e in slowed_down(car, inputs).values()]
        assert slow == pytest.approx(found)


def test_bound_of_one_input_alone_leaves_the_other_unbounded_but_slows_it():
    car = hf.systems.car(steering_rate_limit=2.0)
    given = {p.symbol: p.value for p in car.parameters}
    slow = slowed_down(car, {"v": sp.Float(6.0), "w": sp.Float(4.0)})
    assert float(slow["v"].xreplace(given).evalf()) == pytest.approx(3.0)


def test_slowed_car_drives_the_path_of_the_unlimited_one():
    """Every state of it is within 2 mm and 2 mrad of a state of the path without limits."""
    paths = []
    for limits, horizon in (({}, 18.0), ({"speed_limit": 0.4, "steering_rate_limit": 0.4}, 20.0)):
        car = hf.systems.car(**limits)
        law = hf.laws.steer_by_chained_form(car, k1=0.5, poles=-1.0, threshold=0.1)
        run = hf.simulate(
            car, law, starts=[[-3.0, 1.0, 0.3, 0.2]], horizon=horizon, sample_time=1e-3,
            substeps=1, record_every=1e-3,
        )  # fmt: skip
        paths.append(run.dataset["state"].values[0])
        peaks = np.abs(run.dataset["input"].values).max(axis=(0, 1))
    assert peaks == pytest.approx([0.4, 0.4])
    apart, _ = cKDTree(paths[0]).query(paths[1][::100])
    assert apart.max() < 2e-3


def test_every_start_of_a_slow_car_arrives_and_not_if_each_input_is_limited_by_itself():
    """0.3 m/s and 0.3 rad/s: 200 of 200, and 154 with the law of a car without limits."""
    slow = hf.systems.car(speed_limit=0.3, steering_rate_limit=0.3)
    box = {"x": (-4, 4), "y": (-1, 1), "psi": (-0.7, 0.7), "delta": (-0.4, 0.4)}
    counts = []
    for known in (slow, hf.systems.car()):
        law = hf.laws.steer_by_chained_form(known, **CAR)
        count, peaks = arrived(slow, law, box, 80, 200)
        assert (peaks <= 0.3 + 1e-12).all()
        counts.append(count)
    assert counts == [200, 154]


@pytest.mark.heavy
def test_every_start_of_a_slow_tractor_brings_its_trailer_home():
    """0.25 m/s and 0.25 rad/s: 500 of 500, and 493 where each input is limited by itself."""
    limits = {"speed_limit": 0.25, "turn_limit": 0.25}
    slow = hf.systems.tractor_trailer(1, hitch_1=0.2, **limits)
    box = {"x": (-6, 6), "y": (-1, 1), "psi1": (-0.3, 0.3), "psi0": (-0.3, 0.3)}
    counts = []
    for known in (slow, hf.systems.tractor_trailer(1, hitch_1=0.2)):
        law = hf.laws.steer_by_chained_form(known, **TRAILER)
        counts.append(arrived(slow, law, box, 400, 500)[0])
    assert counts == [500, 493]


def test_car_that_cannot_stop_is_not_slowed_down():
    car = hf.systems.car(speed_limit=1.0, speed_least=0.5)
    with pytest.raises(
        DefinitionError, match="cannot be slowed down; expected bounds with 0 inside"
    ):
        hf.laws.steer_by_chained_form(car)
    assert "leave no rest" in hf.explain(car).text()
