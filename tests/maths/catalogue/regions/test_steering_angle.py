"""The steering angle of a car, and the safety filter that bounds it."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError


@pytest.mark.heavy
def test_filter_keeps_the_steering_angle_while_every_car_arrives():
    """Scenario `car-limits`: 502 of 502 within 35 deg, 1 m/s and 1 rad/s; the law alone 452."""
    scenario = hf.load_scenario("car-limits")
    result = scenario.run()
    data = result.dataset
    assert result.viable == result.outcomes["reached goal"] == data.sizes["run"] == 502
    assert np.abs(data["state"].sel(state_name="delta")).max() < np.radians(35)
    assert np.abs(data["input"].values).max(axis=(0, 1)) == pytest.approx([1, 1])
    assert data["infeasible"].values.max() == 0
    alone = hf.load_scenario("car-limits", ["safeguard="]).run()
    assert alone.viable == alone.outcomes["reached goal"] == 452
    assert alone.summary()["worst_constraint"]["steering"] == pytest.approx(0.219, abs=5e-4)


@pytest.mark.parametrize("limit", [-0.1, 0.0, 1.6])
def test_limit_that_is_no_steering_angle_is_refused(limit):
    with pytest.raises(DefinitionError, match="expected an angle between 0 and pi/2 rad"):
        hf.regions.steering_angle(steering_limit=limit)
