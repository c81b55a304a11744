"""[obstacles] of a scenario: what the filter counts with, what the runs meet, who touches it."""

import json

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate, translate

import holdfast as hf
from holdfast.errors import ScenarioError
from holdfast.planning.encounters import gaps

SHORT = """
[scenario]
title = "A robot, a buoy that comes, and a wall"
[system]
name = "unicycle"
[law]
name = "straight_on"
outputs = { v = "0.8", r = "0" }
[law.parameters]
[obstacles]
most = 4
hull = 0.2
lead = "40 cm"
speed = "0.4 m/s"
[obstacles.moving.buoy]
disc = [3, 0.1, "30 cm"]
velocity = [-0.3, 0]
[obstacles.moving.wall]
polygon = [[5, -3], [5.2, -3], [5.2, 3], [5, 3]]
radius = 0.1
[starts]
states = [{ x = 0, y = 0, psi = 0 }, { x = 0, y = 0.4, psi = 0.1 }]
[run]
horizon = 6
"""


@pytest.fixture
def short(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def load(text=SHORT, *overrides):
        (tmp_path / "short.toml").write_text(text)
        return hf.load_scenario("short.toml", overrides)

    return load


def test_runs_among_what_moves_are_clear_of_it_and_without_the_filter_are_lost(short):
    result = short().run()
    data = result.arrays
    assert data["constraint_name"].values.tolist() == ["moving_obstacles"]
    assert result.viable == 2
    assert data["worst_constraint"].values.max() < 0
    assert result.summary()["worst_constraint"]["moving_obstacles"] < 0
    alone = short(SHORT, "obstacles.most=0").run()
    assert (alone.viable, alone.outcomes["left region"]) == (0, 2)
    # the buoy and the robot meet at 1.1 m/s: .5 m apart at 2.27 s from the first start
    exact = (3 - np.sqrt(0.5**2 - 0.1**2)) / 1.1
    assert alone.arrays["exit_time"].values[0] == pytest.approx(exact, abs=0.021)
    assert alone.arrays["exit_constraint"].values.tolist() == [0, 0]


def test_the_depth_is_that_of_the_distance_at_every_record(short):
    """Worked out anew from the states of the file and the ways as they are written."""
    data = short(SHORT, "obstacles.hull=[[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]]",
                 "obstacles.lead=").run().arrays  # fmt: skip
    hull = shapely.Polygon([(0.3, 0.2), (-0.3, 0.2), (-0.3, -0.2), (0.3, -0.2)])
    wall = shapely.Polygon([(5, -3), (5.2, -3), (5.2, 3), (5, 3)])
    for k in range(0, len(data["time"].values), 7):
        t, (x, y, psi) = data["time"].values[k], data["state"].values[1, k]
        body = translate(rotate(hull, psi, origin=(0, 0), use_radians=True), x, y)
        away = min(body.distance(shapely.Point(3 - 0.3 * t, 0.1)) - 0.3, body.distance(wall) - 0.1)
        assert -data["constraint"].values[1, k, 0] == pytest.approx(away, abs=1e-9)


def test_overlapping_hulls_have_a_depth():
    """A point in a polygon, and two bars that cross without a corner inside."""
    pose, way = np.array([[0.0], [0.0], [0.0]]), np.zeros((1, 2))
    square = (((-1.0, -2.0), (1.0, -2.0), (1.0, 2.0), (-1.0, 2.0)), 0.1)
    assert gaps(pose, way, ((((0.0, 0.0),), 0.3),), square) == pytest.approx([-1.4])
    bar = ((((3.0, 0.5), (-3.0, 0.5), (-3.0, -0.5), (3.0, -0.5)), 0.0),)
    assert gaps(pose, way, bar, square)[0] == pytest.approx(-np.sqrt(2.0) - 0.1)
    assert np.isnan(gaps(np.full((3, 1), np.nan), way, bar, square)).all()


def test_the_velocity_is_the_derivative_of_the_way(short):
    path = 'path = ["0.5*cos(0.4*t)", "-0.2*t"]'
    loaded = short(SHORT.replace("velocity = [-0.3, 0]", path))
    (buoy, wall), t = loaded.surroundings.moving, 1.7
    seen = buoy.seen(t)
    ((place,), _) = seen.bodies[0]
    assert place == pytest.approx((3 + 0.5 * np.cos(0.4 * t), 0.1 - 0.2 * t))
    assert seen.velocity == pytest.approx((-0.2 * np.sin(0.4 * t), -0.2))
    assert seen.acceleration == pytest.approx(0.08 * abs(np.cos(0.4 * t)))
    assert (wall.seen(t).velocity, wall.seen(t).acceleration) == ((0.0, 0.0), 0.0)
    bounded = short(SHORT.replace("velocity = [-0.3, 0]", path + "\nacceleration = 0.3"))
    assert bounded.surroundings.moving[0].seen(t).acceleration == 0.3


def test_the_filter_of_a_file_counts_with_its_obstacles(short):
    """The decisions of `safety_filter` on what a run met are the inputs of that run."""
    external = SHORT.replace('name = "straight_on"\noutputs = { v = "0.8", r = "0" }',
                             "external = true").replace("[law.parameters]\n", "")  # fmt: skip
    loaded = short(external)
    keep = loaded.safety_filter()
    assert (keep.clearing.most, keep.clearing.lead, keep.clearing.clearance) == (4, 0.4, 0.0)
    data = short().run().arrays
    moving, statuses = loaded.surroundings.moving, set()
    for k in range(0, 60, 6):
        t = float(data["time"].values[k])
        around = [o.seen(t) for o in moving]
        decision = keep.step(data["state"].values[0, k], [0.8, 0.0], obstacles=around)
        wanted = pytest.approx(data["input"].values[0, k], abs=1e-12)  # t is k h, or a sum of h
        assert wanted == decision.input
        statuses.add(decision.status)
    assert statuses == {hf.Status.PASSED, hf.Status.CHANGED}


def test_a_region_is_kept_besides(short):
    text = (
        SHORT
        + """
[region]
constraints = { lane = { expression = "y - 0.6", unit = "m" } }
[safeguard]
gains = [1, 4]
margins = { lane = "1 cm" }
"""
    )
    result = short(text).run()
    assert result.arrays["constraint_name"].values.tolist() == ["lane", "moving_obstacles"]
    assert result.viable == 2


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (("most = 4", "most = -1"), "obstacles.most: got -1"),
        (('speed = "0.4 m/s"', 'speed = "0.4 m"'), "obstacles.speed"),
        (("hull = 0.2", "hull = [[0, 0], [1, 1]]"), "obstacles: the hull is"),
        (("disc = [3, 0.1, ", 'disc = [3, "nan", '), "obstacles.moving.buoy"),
        (("disc = [3, 0.1, ", "disc = [3, "), "obstacles.moving.buoy.disc"),
        (("velocity = [-0.3, 0]", 'path = ["t", "q"]'), "obstacles.moving.buoy"),
        (("velocity = [-0.3, 0]", 'velocity = [0, 0]\npath = ["t", "t"]'), "velocity and path"),
        (("velocity = [-0.3, 0]", 'path = ["1/(t - 2)", "0"]'), "not finite"),
        (("velocity = [-0.3, 0]", "share = 2"), "share of an obstacle is 2"),
        (("velocity = [-0.3, 0]", "speed = 2"), "obstacles.moving.buoy.speed: unknown key"),
        (("radius = 0.1", "radius = 0.1\ndisc = [1, 2, 3]"), "disc and polygon"),
        (("horizon = 6", "horizon = 6\ncontinuous = true"), "continuous control"),
        (('lead = "40 cm"', "lead = 0.1"), "faster than"),
    ],
)
def test_obstacles_that_are_none_are_refused_with_their_key(short, change, cause):
    before, after = change
    assert before in SHORT
    with pytest.raises(ScenarioError, match=cause):
        short(SHORT.replace(before, after)).run()


@pytest.mark.heavy
def test_crossing_boats_are_kept_clear_of_from_200_starts(tmp_path, monkeypatch):
    """60 s from the box of the file: none touches; without the filter every run does."""
    scenario = hf.load_scenario("crossing-boats")
    result = scenario.run()
    data = result.arrays
    assert data.sizes["run"] == result.viable == 200
    assert result.outcomes["reached goal"] == 198
    least = -data["worst_constraint"].values[:, 0].max()
    assert least == pytest.approx(0.061, abs=5e-4)
    assert json.loads(json.dumps(result.summary()))["safeguard"]["runs_relaxed"] == 39
    alone = hf.load_scenario("crossing-boats", ["obstacles.most=0"]).run()
    assert alone.outcomes["left region"] == 200
    scenario.drawn(result, tmp_path, None)
    assert {p.name for p in tmp_path.iterdir()} >= {"paths.png", "histories.png"}
