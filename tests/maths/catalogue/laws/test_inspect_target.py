"""The law that goes to its pose by legs along the edge of the view."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator


@pytest.fixture(scope="module")
def inspection():
    return hf.load_scenario("inspection", ["system.thrust_limit=1.0"], runs=63)


@pytest.fixture(scope="module")
def data(inspection):
    return inspection.run().dataset


@pytest.mark.heavy
def test_every_start_arrives_at_the_pose_with_a_fifth_of_the_thrust(data):
    assert (data["outcome"].values == hf.Outcome.REACHED).all()
    assert np.abs(data["state"].values[:, -1, :2] - [-0.5, 0.0]).max() < 0.03


def test_an_input_is_admissible_everywhere_but_at_a_start_on_two_limits(data):
    """The margin of 3 cm asks for 0.36 m/s^2 at once where two 1 N thrusters give 0.27."""
    samples = data["infeasible"].values
    assert np.flatnonzero(samples).tolist() == [1]
    assert samples[1] <= 5


def test_view_is_kept_by_the_margins_from_starts_that_have_them(data):
    worst, at_start = data["worst_constraint"].values, data["constraint"].values[:, 0]
    margins = np.array([0.02, 0.02, 0.01, 0.03])
    inside = (at_start <= -margins).all(axis=1)
    assert inside.sum() > 40
    assert (worst[inside] <= -margins + 2e-3).all()


def test_vehicle_changes_its_leg_six_times_at_most(data):
    assert data["switches"].values.max() <= 6


# -- the whole of K: any pose in view within 4 m along the wall, at any heading below 90 degrees

WHOLE = [
    "starts.states=[]",
    "starts.box={x = [-2, 0], y = [-4, 4], psi = ['-90 deg', '90 deg']}",
    "run.record_every=150.0",
]


@pytest.fixture(scope="module", params=["5.0", "0.3"])
def whole(request):
    """600 starts of the whole of K under the law of `inspection`, with and without its limit of
    the heading. With 0.3 N the filter counts on its model: a box of parameters asks for more."""
    changes = [*WHOLE, f"system.thrust_limit={request.param}"]
    changes += ["safeguard.uncertain="] if request.param == "0.3" else []
    return [
        hf.load_scenario("inspection", [*changes, *more], runs=600).run()
        for more in ([], ["safeguard.constraints="])
    ]


@pytest.mark.heavy
def test_no_start_of_the_whole_of_k_chatters(whole):
    """At headings of 80 to 90 degrees both guards held at once: hundreds of changes of mode."""
    for result in whole:
        assert np.abs(result.dataset["state"].values[:, 0, 2]).max() > np.radians(85)
        assert result.outcomes["chattered"] == 0
        assert result.dataset["switches"].values.max() <= 10
        assert result.summary()["switching"]["shortest_dwell"] > 1.0


@pytest.mark.heavy
def test_every_start_of_the_whole_of_k_arrives_without_a_limit_of_the_heading(whole):
    _, free = whole
    assert free.outcomes["reached goal"] == 600
    assert free.dataset["infeasible"].values.max() == 0


@pytest.mark.heavy
def test_limit_of_the_heading_costs_one_start_beyond_it(whole):
    """Two centimetres from the wall, at 86 degrees: too near by up to 2 cm."""
    limited, _ = whole
    lost = limited.dataset["outcome"].values == hf.Outcome.LEFT
    within = np.abs(limited.dataset["state"].values[:, 0, 2]) <= 1.4
    assert lost.sum() == 1
    assert not (lost & within).any()
    assert limited.dataset["infeasible"].values[within].max() == 0
    assert within.sum() == 588
    assert limited.summary()["worst_constraint"]["too_near"] < 0.02


def test_guards_of_the_two_legs_never_hold_at_once(vehicle):
    """At 20,000 poses of any heading."""
    law = hf.laws.inspect_target(vehicle)
    poses = [q.symbol for q in vehicle.states[:3]]
    guards = Evaluator([t.when for t in law.transitions], poses, law.parameters)
    values = guards.values(
        np.random.default_rng(0).uniform([-2, -4, -np.pi], [0, 4, np.pi], (20000, 3))
    )
    assert (values.min(axis=1) < 0).all()
    assert ((values > 0).mean(axis=0) > 0.05).all()


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
