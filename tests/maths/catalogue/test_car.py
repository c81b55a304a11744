"""The car and the limits of its drive and of its steering gear."""

import pytest

import holdfast as hf
from holdfast.errors import DefinitionError


@pytest.mark.parametrize("car", [hf.systems.car, hf.systems.front_axle_car])
def test_limits_that_are_not_given_are_no_parameters(car):
    assert car().input_bounds is None
    assert [p.name for p in car().parameters] == ["wheelbase"]
    limited = car(speed_limit=1.0, steering_rate_limit=2.0)
    assert limited.rates == car().rates
    assert limited.input_bounds.at({p.symbol: p.value for p in limited.parameters}).text() == (
        "[-1, 1] x [-2, 2]"
    )
    one = car(steering_rate_limit=2.0).input_bounds.half_spaces()
    assert [normal for normal, _ in one] == [(0, 1), (0, -1)]


@pytest.mark.parametrize(
    ("limits", "complaint"),
    [
        ({"speed_least": 0.5}, "speed_least is 0.5 m/s with speed_limit no largest"),
        ({"speed_least": 2.0, "speed_limit": 1.0}, "expected a speed_limit above speed_least"),
        ({"speed_limit": -1.0}, "'speed_limit' is -1; expected above 0"),
    ],
)
def test_limits_that_leave_no_speed_are_refused(limits, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.systems.car(**limits)
