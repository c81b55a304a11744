"""The angles between a tractor and its trailers, and the safety filter that bounds them."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError


@pytest.mark.heavy
def test_filter_keeps_every_trailer_from_jack_knifing_and_the_law_alone_does_not():
    """Scenario `trailer-off-axle`: beyond 45 deg 0 of 302 with the filter, 21 of 302 without it."""
    scenario = hf.load_scenario("trailer-off-axle")
    filtered = scenario.run()
    arrived = filtered.dataset["outcome"].values == hf.Outcome.REACHED
    assert filtered.viable == len(arrived) == 302
    assert filtered.outcomes["reached goal"] == arrived.sum() == 292
    assert filtered.outcomes["stayed"] == 10
    assert filtered.dataset["infeasible"].values.max() == 0
    assert np.abs(filtered.dataset["input"].values[arrived, :, 0]).max() < 1.4
    # the others are at rest at the limit less its margin, where the filter takes all motion away
    ends = filtered.dataset["state"].values[~arrived, -1]
    assert np.abs(ends[:, 3] - ends[:, 2]) == pytest.approx(np.radians(45) - 0.01, abs=2e-3)
    assert np.abs(filtered.dataset["input"].values[~arrived, -20:]).max() < 1e-3
    law = hf.laws.steer_by_chained_form(
        scenario.model, k1=0.2, poles=-0.4, threshold=2.0, escape_speed=0.5, escape_time=8.0
    )
    alone = hf.simulate(
        scenario.system, law, starts=filtered.dataset["state"].values[:, 0], seed=1,
        region=scenario.region, goal=scenario.goal, horizon=80, sample_time=0.01, substeps=1, record_every=80,
    )  # fmt: skip
    assert alone.viable == alone.outcomes["reached goal"] == 281
    assert alone.outcomes["left region"] == 21


def test_hitch_angle_is_bounded_the_short_way_round():
    region = hf.regions.hitch_angles(hf.systems.tractor_trailer(2), hitch_limit=0.5)
    assert region.inequality_names == ("hitch_1", "hitch_2")
    at = {"psi0": np.pi - 0.1, "psi1": -np.pi + 0.1, "psi2": -np.pi + 0.7, "hitch_limit": 0.5}
    values = [
        float(c.expression.xreplace({hf.symbol(n): v for n, v in at.items()}))
        for c in region.inequalities
    ]
    assert values == pytest.approx([0.2 - 0.5, 0.6 - 0.5])


@pytest.mark.parametrize("limit", [-1.0, 0.0, 4.0])
def test_limit_that_is_no_hitch_angle_is_refused(limit):
    with pytest.raises(DefinitionError, match="expected an angle between 0 and pi rad"):
        hf.regions.hitch_angles(hf.systems.tractor_trailer(), hitch_limit=limit)


def test_system_without_a_trailer_has_no_hitch():
    with pytest.raises(DefinitionError, match="not made for system 'car'; expected the headings"):
        hf.regions.hitch_angles(hf.systems.car())
