"""The law that comes to rest in a current, on the ray through the target along it."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from tests.runs_at_rest import LIMIT, settled

ROOT = Path(__file__).parents[4]
SWIFT = "inspection-swift-current"


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def rest(theta):
    """The heading along the current that sees the wall: psi*."""
    return wrapped(theta if np.cos(theta) > 0 else theta + np.pi)


@pytest.fixture(scope="module")
def vehicle():
    return hf.systems.marine_vehicle(thrust_limit=5.0, current_limit=0.2)


@pytest.fixture(scope="module")
def rates(vehicle):
    numbers = {p.symbol: p.value for p in vehicle.parameters}
    names = (*vehicle.states, *vehicle.inputs, *vehicle.disturbances)
    return sp.lambdify(
        [q.symbol for q in names],
        [vehicle.rates[n].xreplace(numbers).doit() for n in vehicle.state_names],
        [{"magnitude": abs}, "math"],
    )


def test_place_on_the_ray_along_the_current_is_an_equilibrium_in_every_direction(vehicle, rates):
    p = {q.name: q.value for q in vehicle.parameters}
    for theta in np.radians(np.arange(0, 360)):
        psi, v = rest(theta), 0.2
        u = -v * np.cos(theta - psi)
        thrust = -p["Xu"] * u - p["Xuu"] * abs(u) * u
        place = (-1.2 * np.cos(psi), -1.2 * np.sin(psi), psi, u, 0.0, 0.0)
        moved = rates(*place, thrust, 0.0, v * np.cos(theta), v * np.sin(theta))
        assert np.abs(moved).max() < 1e-12
        assert abs(thrust) < 2 * p["thrust_limit"]


def test_current_carries_a_bow_to_the_ray_and_a_stern_away_from_it(rates):
    """At constant range, facing the target: beta' = V sin(beta - theta) / R, by the plant's rates."""
    for theta, beta in np.random.default_rng(1).uniform(-1.2, 1.2, (200, 2)):
        for direction, away in ((theta, 1), (theta + np.pi, -1)):
            psi, v, radius = rest(direction), 0.1, 1.2
            vx, vy = v * np.cos(direction), v * np.sin(direction)
            x, y = -radius * np.cos(beta), -radius * np.sin(beta)
            u = -(vx * np.cos(beta) + vy * np.sin(beta))
            dx, dy, *_ = rates(x, y, beta, u, 0.0, 0.0, 0.0, 0.0, vx, vy)
            turning = (x * dy - y * dx) / radius**2
            assert (x * dx + y * dy) / radius == pytest.approx(0, abs=1e-12)
            assert turning == pytest.approx(v * np.sin(beta - direction) / radius, abs=1e-12)
            error = wrapped(beta - psi)
            assert error * turning * away >= -1e-12


def test_goal_of_the_law_is_the_equilibrium_or_the_nearest_bearing_allowed(vehicle):
    law = hf.laws.rest_in_current(vehicle, bearing_max=LIMIT)
    error = law.modes["home"].signals["bearing_error"]
    seen = Evaluator([error], [hf.symbol(n) for n in ("x", "y", "Vx", "Vy")], law.parameters)
    theta = np.radians(np.arange(0, 360) + 0.5)
    ahead = np.full(360, -1.0), np.zeros(360)
    goals = -seen.values(np.stack([*ahead, 0.1 * np.cos(theta), 0.1 * np.sin(theta)], 1))[:, 0]
    wanted = np.clip([rest(t) for t in theta], -LIMIT, LIMIT)
    np.testing.assert_allclose(goals, wanted, atol=1e-9)
    assert seen.values(np.array([[-1.0, 0.0, 0.0, 0.009]])) == pytest.approx(0)  # still water


@pytest.mark.heavy
@pytest.mark.parametrize("scenario", ["inspection-current", SWIFT])
def test_every_start_with_the_bow_to_the_current_comes_to_rest(scenario):
    """With the stern to it, some drift along the wall instead, downstream of the ray."""
    for speed in (0.05, 0.1, 0.15, 0.2):
        overrides = [f"varied.draws.speed.range=[{speed}, {speed}]", "run.record_every=150"]
        data = hf.load_scenario(scenario, overrides).run().dataset
        theta = data["varied"].sel(varied_name="direction").values
        bow = (np.cos(theta) < 0) & (np.abs(np.arctan(np.tan(theta))) < LIMIT)
        assert bow.sum() > 250
        missing = data["outcome"].values != hf.Outcome.REACHED
        assert missing[bow].sum() == 0


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("speed", "horizon", "counts"),
    [
        (0.1, 150, (599, 564, 556, 553)),
        *(
            pytest.param(*case, marks=pytest.mark.heavy)
            for case in (
                (0.02, 150, (598, 542, 556, 535)),
                (0.02, 300, (598, 560, 556, 548)),
                (0.05, 150, (600, 570, 556, 556)),
                (0.15, 150, (599, 556, 556, 545)),
                (0.2, 150, (598, 524, 556, 515)),
            )
        ),
    ],
)
def test_starts_that_come_to_rest_in_a_current_of_any_direction(speed, horizon, counts):
    assert settled(speed, f"run.horizon={horizon}", f"run.record_every={horizon}") == counts


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("speed", "horizon", "counts"),
    [
        (0.02, 150, (600, 558, 556, 547)),
        (0.02, 300, (600, 566, 556, 553)),
        (0.05, 150, (600, 567, 556, 555)),
        (0.1, 150, (599, 562, 556, 552)),
        (0.15, 150, (598, 564, 556, 556)),
        (0.2, 150, (598, 543, 556, 534)),
    ],
)
def test_starts_that_come_to_rest_in_a_swift_current(speed, horizon, counts):
    changes = f"run.horizon={horizon}", f"run.record_every={horizon}"
    assert settled(speed, *changes, scenario=SWIFT) == counts


@pytest.mark.heavy
@pytest.mark.parametrize(("seed", "counts"), [(4, (599, 539, 556, 535)), (5, (595, 542, 557, 538))])
def test_other_starts_that_come_to_rest_in_a_swift_current(seed, counts):
    """None of them was among those by which the numbers of the law were found (seeds 1 to 3)."""
    changes = f"run.seed={seed}", "run.record_every=150"
    assert settled(0.2, *changes, scenario=SWIFT) == counts


@pytest.mark.heavy
def test_starts_with_a_place_at_least_five_centimetres_inside():
    """Up to 3.5 degrees from the wall; the law goes there up to 7 degrees from it."""
    inside = math.radians(86.5)
    for scenario, counts in (
        ("inspection-current", (567, 564, 556, 524)),
        (SWIFT, (567, 562, 564, 543)),
    ):
        for speed, count in zip((0.05, 0.1, 0.15, 0.2), counts, strict=True):
            found = settled(speed, "run.record_every=150", limit=inside, scenario=scenario)
            assert found[2:] == (582, count)


POSE = 'observer={ measured = ["x", "y", "psi"], bandwidth = 20.0 }'
STATES = "observer={ bandwidth = 5.0 }"
SET = (
    'observer={measured=["x","y","psi"],bandwidth=40,error_bounds='
    '{x="1 mm",y="1 mm",psi="1 mrad",u=0.005,v=0.005,r=0.1}}'
)
WIDE = (
    'observer={measured=["x","y","psi"],bandwidth=40,error_bounds='
    '{x="2 mm",y="2 mm",psi="2 mrad",u=0.01,v=0.01,r=0.3}}'
)
TIGHT = SET.replace("r=0.1", "r=0.02").replace("0.005", "0.001")
"""Bounds that do not hold in these runs."""
UNIFORM = 'noise.uniform={x="1 mm",y="1 mm",psi="1 mrad"}'
NOISE = 'noise={ normal = { x=0.005, y=0.005, psi="0.5 deg", u=0.01, v=0.01, r=0.02 } }'


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("speed", "changes", "counts"),
    [
        (0.1, [STATES], (600, 565, 556, 554)),
        *(
            pytest.param(*case, marks=pytest.mark.heavy)
            for case in (
                (0.05, [STATES], (600, 565, 556, 552)),
                (0.2, [STATES], (596, 515, 556, 508)),
                (0.1, [STATES, NOISE], (599, 255, 556, 253)),
                (0.05, [POSE], (536, 469, 556, 459)),
                (0.1, [POSE], (518, 471, 556, 466)),
                (0.2, [POSE], (377, 298, 556, 296)),
                (0.1, [POSE, UNIFORM], (523, 129, 556, 129)),
                (0.05, [SET], (600, 549, 556, 549)),
                (0.1, [SET], (600, 542, 556, 542)),
                (0.15, [SET], (588, 529, 556, 529)),
                (0.2, [SET], (518, 466, 556, 466)),
                (0.1, [WIDE, UNIFORM], (600, 279, 556, 279)),
                (0.2, [TIGHT], (556, 519, 556, 510)),
            )
        ),
    ],
)
def test_starts_that_come_to_rest_with_an_estimated_current(speed, changes, counts):
    assert settled(speed, *changes, "run.record_every=150") == counts


@pytest.mark.heavy
def test_noise_costs_starts_with_the_numbers_for_a_swift_current():
    found = settled(0.1, STATES, NOISE, "run.record_every=150", scenario=SWIFT)
    assert found == (589, 162, 556, 156)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("speed", "counts"),
    [
        (0.05, (600, 547, 556, 539)),
        (0.1, (600, 560, 556, 551)),
        (0.2, (600, 555, 556, 545)),
        (0.3, (599, 543, 556, 534)),
    ],
)
def test_otter_stays_in_view_and_comes_to_rest_from_most_starts(speed, counts):
    """In 300 s; where the current pushes to the wall, a slow yaw does not always suffice."""
    assert settled(speed, "run.record_every=300", scenario="otter-current") == counts


@pytest.mark.heavy
def test_otter_comes_to_rest_in_a_slow_current_with_more_time():
    longer = "run.horizon=600", "run.record_every=600"
    assert settled(0.05, *longer, scenario="otter-current") == (600, 559, 556, 548)


@pytest.mark.heavy
def test_long_legs_and_a_heading_that_leads_bring_the_otter_upstream():
    """What is missing has a current along the wall, but for two starts."""
    fast = "varied.draws.speed.range=[0.3, 0.3]"
    data = hf.load_scenario("otter-current", [fast, "run.record_every=300"]).run().dataset
    off = np.abs(np.arctan(np.tan(data["varied"].sel(varied_name="direction").values)))
    missing = (off < LIMIT) & (data["outcome"].values != hf.Outcome.REACHED)
    assert missing.sum() == 22
    assert (missing & (off > math.radians(72))).sum() == 20
    without = ("law.lead=0", "law.far_share=1", "run.record_every=300")
    assert settled(0.3, *without, scenario="otter-current") == (599, 387, 556, 379)


@pytest.mark.heavy
def test_starts_that_a_basin_without_sway_excludes_are_those_of_the_record():
    """The basin is `benchmarks/current_basin.py`; what becomes of its starts is simulated here."""
    record = json.loads((ROOT / "benchmarks" / "current_basin.json").read_text("utf-8"))
    basin = record["inspection-current 0.2 m/s"]
    fast = "varied.draws.speed.range=[0.2, 0.2]"
    data = hf.load_scenario("inspection-current", [fast, "run.record_every=150"]).run().dataset
    theta = data["varied"].sel(varied_name="direction").values
    at_rest = data["outcome"].values == hf.Outcome.REACHED
    off = np.abs(np.arctan(np.tan(theta)))
    flat = (np.cos(theta) > 0) & (off < math.radians(60))
    chosen = basin["excluded_up_to_60_deg"]
    assert flat[chosen].all()
    counts = {
        "astern": flat.sum(),
        "rest": (flat & at_rest).sum(),
        "excluded": len(chosen),
        "rest_though_excluded": at_rest[chosen].sum(),
    }
    assert basin["up_to_60_deg"] == counts
    assert counts == {"astern": 221, "rest": 185, "excluded": 14, "rest_though_excluded": 1}
    swift = hf.load_scenario(SWIFT, [fast, "run.record_every=150"]).run().dataset
    now = swift["outcome"].values == hf.Outcome.REACHED
    assert (now[chosen].sum(), (flat & ~now).sum()) == (3, 22)
    beyond = basin["beyond"]
    assert (beyond["excluded"], beyond["rest_though_excluded"]) == (20, 19)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("case", "other", "counts"),
    [
        ("inspection-swift-current 0.2 m/s", "law.leg_speed=0.78", (534, 22, 5, 0)),
        ("otter-current 0.3 m/s", "law.near_margin=0.8", (534, 22, 2, 4)),
    ],
)
def test_starts_with_a_trajectory_to_rest_are_those_of_the_record(case, other, counts):
    """The trajectories are those of `benchmarks/current_reach.py`; the law's runs are made here."""
    reach = json.loads((ROOT / "benchmarks" / "current_reach.json").read_text("utf-8"))[case]
    scenario = case.split()[0]
    plain, changed = (
        hf.load_scenario(scenario, ["run.record_every=150", *changes]).run().dataset
        for changes in ([], [other])
    )
    theta = plain["varied"].sel(varied_name="direction").values
    at_rest, at_rest_too = (d["outcome"].values == hf.Outcome.REACHED for d in (plain, changed))
    place = np.abs(np.arctan(np.tan(theta))) < LIMIT
    rows = reach["starts"]
    assert [row["start"] for row in rows] == np.flatnonzero(place & ~at_rest).tolist()
    assert [row["direction"] for row in rows] == pytest.approx(
        np.degrees(theta[place & ~at_rest]), abs=0.051
    )
    assert all(at_rest_too[row["start"]] for row in rows if row["by"] == other)
    found = [sum(row["found"] == how for row in rows) for how in ("the law", "optimisation")]
    assert found == [reach["by_law"], reach["by_optimisation"]]
    assert ((place & at_rest).sum(), len(rows), *found) == counts


def test_heading_that_leads_turns_at_the_rate_of_the_bearing(vehicle):
    """On the leg's heading the yaw rate is d/dt atan2(-y, -x), by differences of the positions."""
    law = hf.laws.rest_in_current(vehicle, lead=1.0)
    back, names = law.modes["back"], ("x", "y", "psi", "Vx", "Vy")
    told = Evaluator(
        [back.outputs["u"], back.outputs["r"]], [hf.symbol(n) for n in names], law.parameters
    )
    plain = hf.laws.rest_in_current(vehicle)
    lagging = Evaluator(
        [plain.modes["back"].outputs["r"]], [hf.symbol(n) for n in names], plain.parameters
    )
    for point in np.random.default_rng(2).uniform(
        (-1.8, -1, -0.5, -0.2, -0.2), (-0.8, 1, 0.5, 0.2, 0.2), (50, 5)
    ):
        x, y, psi, vx, vy = point
        u, r = told.values(point[None])[0]
        step = 1e-6
        moved = (x + step * (u * np.cos(psi) + vx), y + step * (u * np.sin(psi) + vy))
        rate = wrapped(np.arctan2(-moved[1], -moved[0]) - np.arctan2(-y, -x)) / step
        assert r - lagging.values(point[None])[0, 0] == pytest.approx(rate, abs=1e-5)


def test_bad_numbers_and_systems_without_a_current_are_refused(vehicle):
    for wrong, match in (
        ({"exponent": 1.0}, "exponent"),
        ({"target_half_width": 1.0}, "no room in the view"),
        ({"distance": 0.4}, "out of range"),
        ({"distance": 1.95}, "out of range"),
    ):
        with pytest.raises(DefinitionError, match=match):
            hf.laws.rest_in_current(vehicle, **wrong)
    with pytest.raises(DefinitionError, match="has to measure the current"):
        hf.laws.rest_in_current(hf.systems.unicycle())


def test_leg_slower_than_the_current_is_warned_of(vehicle):
    law = hf.track_velocity(
        vehicle, hf.laws.rest_in_current(vehicle, leg_speed=0.15), {"u": 5.0, "r": 20.0}
    )
    with pytest.warns(hf.GainWarning, match="makes no way"):
        hf.simulate(vehicle, law, starts=[[-1.2, 0, 0, 0, 0, 0]], horizon=1, sample_time=0.02)
