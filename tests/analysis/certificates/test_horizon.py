"""A horizon is kept for no less than was asked, and a target reached in no more."""

import pytest

import holdfast as hf
from holdfast.errors import SimulationError
from tests.carts import STATES, WALLS, X, cart

MIDDLE = hf.Region("middle", STATES, (hf.Inequality("near", abs(X) - 0.3, "m"),))


def claimed(horizon, sample_time, **options):
    """How long, and how many samples."""
    found = hf.certify(
        cart(), WALLS, box={"x": (-1, 1), "v": (-2, 2)}, cells=31, inputs=3, horizon=horizon,
        sample_time=sample_time, **options,
    )  # fmt: skip
    return found.kept.holds * found.hold


@pytest.mark.slow("1.0-0.3-0.9", "0.6-0.2-0.6")
@pytest.mark.parametrize(
    ("horizon", "sample_time", "within"),
    [(1.0, 0.3, 0.9), (0.25, 0.2, 0.2), (0.2, 0.2, 0.2), (0.6, 0.2, 0.6), (0.7, 0.1, 0.7)],
)
def test_target_is_reached_within_the_horizon(horizon, sample_time, within):
    assert claimed(horizon, sample_time, target=MIDDLE) <= within + 1e-12 <= horizon + 1e-9


@pytest.mark.parametrize(("horizon", "sample_time", "for_"), [(1.0, 0.3, 1.2), (0.6, 0.2, 0.6)])
def test_set_is_kept_for_the_horizon(horizon, sample_time, for_):
    assert claimed(horizon, sample_time) == pytest.approx(for_)


def test_horizon_without_a_whole_sample_has_no_way_to_a_target():
    with pytest.raises(SimulationError, match=r"0\.05 s with a sample time of 0\.2 s; expected at"):
        claimed(0.05, 0.2, target=MIDDLE)
