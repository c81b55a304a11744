"""The law that goes to its pose by legs along the edge of the view."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError


@pytest.fixture(scope="module")
def inspection():
    return hf.load_scenario("inspection", ["system.thrust_limit=1.0"], runs=63)


@pytest.fixture(scope="module")
def data(inspection):
    return inspection.run().dataset


def test_every_start_arrives_at_the_pose_with_a_fifth_of_the_thrust(data):
    assert (data["outcome"].values == hf.Outcome.REACHED).all()
    assert data["infeasible"].values.max() == 0
    assert np.abs(data["state"].values[:, -1, :2] - [-0.5, 0.0]).max() < 0.03


def test_view_is_kept_by_the_margins_from_starts_that_have_them(data):
    worst, at_start = data["worst_constraint"].values, data["constraint"].values[:, 0]
    margins = np.array([0.02, 0.02, 0.01, 0.02])
    inside = (at_start <= -margins).all(axis=1)
    assert inside.sum() > 40
    assert (worst[inside] <= -margins + 2e-3).all()


def test_vehicle_changes_its_leg_six_times_at_most(data):
    assert data["switches"].values.max() <= 6


def test_mirrored_start_gives_the_mirrored_run(inspection):
    starts = np.array([[-1.2, 0.7, -0.4, 0, 0, 0], [-1.2, -0.7, 0.4, 0, 0, 0]])
    runs = hf.simulate(
        inspection.system, inspection.law, starts=starts, region=inspection.region, horizon=40.0
    ).dataset["state"].values  # fmt: skip
    assert runs[1] == pytest.approx(runs[0] * [1, -1, -1, 1, -1, -1], abs=1e-6)


def test_bearing_follows_the_leg_in_log_polar_coordinates():
    """d beta / d ln R = tan(delta) for a vehicle that moves along its heading, exactly."""
    x, y, psi = (hf.symbol(n) for n in ("x", "y", "psi"))
    beta, radius = sp.atan2(-y, -x), sp.log(sp.sqrt(x**2 + y**2))
    motion = {x: sp.cos(psi), y: sp.sin(psi)}
    rates = [sum(e.diff(q) * v for q, v in motion.items()) for e in (beta, radius)]
    for at in ({x: -1.3, y: 0.4, psi: 0.2}, {x: -0.7, y: -0.9, psi: 1.1}):
        bearing, depth = (float(r.subs(at)) for r in rates)
        delta = at[psi] - float(beta.subs(at))
        assert bearing / depth == pytest.approx(np.tan(delta), rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"exponent": 1.0}, "exponent is 1; expected above 1"),
        ({"distance": 0.1}, "the target leaves no room in the view at 0.1 m"),
        ({"distance": 0.32}, "the pose at 0.32 m is out of range"),
        ({"distance": 1.9}, "expected between 0.35 m and 1.75 m"),
        ({"k1": -1.0}, "k1"),
    ],
)
def test_poses_and_gains_that_cannot_be_are_refused(vehicle, changes, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.laws.inspect_target(vehicle, **changes)
