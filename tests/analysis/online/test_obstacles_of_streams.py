"""Obstacles that come in a stream of their own: how old they are, when they cease, what is none."""

import json
import math

import pytest

import holdfast as hf
from holdfast.analysis.online.relay import SampleLines
from holdfast.errors import DefinitionError, SimulationError

PATIENCE = 0.2
BUOY = {"disc": [1.2, 0.0, 0.4], "velocity": [-0.2, 0.0], "name": "buoy"}


@pytest.fixture(scope="module")
def guard():
    robot = hf.systems.unicycle()
    return hf.SafetyFilter(robot, obstacles=hf.Obstacles(3, lead=0.3), gains=(1, 4))


@pytest.fixture
def relay(guard):
    return hf.Relay(guard, patience=PATIENCE)


def told(relay, now, state=(0, 0, 0), command=(1, 0)):
    relay.measured(state, now)
    relay.commanded(command, now)


def test_obstacles_grow_older_between_two_lists(relay, guard):
    """A list counts on, moved by its velocities: the decision is that on obstacles of that age."""
    buoy = hf.Obstacle.of_table({**BUOY, "velocity_error": 0.1})
    relay.surrounded([buoy], 5.0)
    for k in range(5):
        now = 5.0 + 0.04 * k
        told(relay, now)
        record = relay.decide(now)
        fresh = guard.step((0, 0, 0), (1, 0), obstacles=[buoy.aged(0.04 * k)])
        assert list(record.input.values()) == pytest.approx(fresh.input.tolist(), abs=1e-12)
    assert record.status == "changed"


def test_without_a_list_in_time_nothing_is_promised(relay):
    told(relay, 0.0)
    first = relay.decide(0.0)
    assert (first.status, first.lost) == ("no measurement", "list of obstacles")
    assert "no list of obstacles yet: the input is the fallback" in first.why
    assert set(first.input.values()) == {0.0}
    relay.surrounded([], 0.02)
    told(relay, 0.02)
    assert relay.decide(0.02).status == "passed"
    told(relay, 0.25)
    late = relay.decide(0.25)
    assert (late.status, late.lost) == ("no measurement", "list of obstacles")
    relay.surrounded([], 0.26)
    assert relay.decide(0.26).lost == ""
    assert hf.DecisionRecord.read(late.line()).lost == late.lost


def test_a_list_that_is_none_is_refused(relay):
    with pytest.raises(SimulationError, match=r"the obstacles are \[1, 2\]"):
        relay.surrounded([1, 2], 0.0)
    with pytest.raises(SimulationError, match="the obstacles are 'buoy'"):
        relay.surrounded("buoy", 0.0)
    robot = hf.systems.unicycle()
    room = hf.obstacles(robot, {}, room=[[-3, -3], [3, -3], [3, 3], [-3, 3]])
    alone = hf.Relay(hf.SafetyFilter(robot, room, gains=(1, 4)))
    with pytest.raises(SimulationError, match="without room for any"):
        alone.surrounded([], 0.0)


# -- tables -------------------------------------------------------------------------------------


def test_tables_are_the_obstacles_that_their_shapes_make():
    made = hf.Obstacle.of_table
    moving = {"velocity": [0.1, -0.2], "acceleration": 0.05, "velocity_error": 0.01, "age": 0.3,
              "share": 0.5, "name": "tug"}  # fmt: skip
    kinds = {"velocity": (0.1, -0.2), "acceleration": 0.05, "velocity_error": 0.01, "age": 0.3,
             "share": 0.5, "name": "tug"}  # fmt: skip
    assert made({"disc": [1, 2, 0.5], **moving}) == hf.Obstacle.disc((1, 2), 0.5, **kinds)
    assert made({"capsule": [0, 0, 2, 0, 0.1]}) == hf.Obstacle.capsule((0, 0), (2, 0), 0.1)
    assert made({"ellipse": [4, 0, 2, 1, 0.3]}) == hf.Obstacle.ellipse((4, 0), (2, 1), 0.3)
    corners = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
    assert made({"polygon": corners, "radius": 0.2}) == hf.Obstacle.polygon(corners, 0.2)
    assert math.isnan(made({"disc": [None, 2, 0.5]}).bodies[0][0][0][0])


@pytest.mark.parametrize(
    ("table", "cause"),
    [
        ([1, 2], "an obstacle is"),
        ({}, "an obstacle has no shape"),
        ({"disc": [1, 2, 0.5], "capsule": [0, 0, 1, 0, 1]}, "disc and capsule"),
        ({"disc": [1, 2]}, "disc of an obstacle is"),
        ({"disc": "1 2 3"}, "disc of an obstacle is"),
        ({"disc": [1, 2, True]}, "disc of an obstacle is True"),
        ({"disc": [1, 2, -1]}, "below 0"),
        ({"disc": [1, 2, 1], "radius": 1}, "radius beside a disc"),
        ({"disc": [1, 2, 1], "speed": 1}, "unknown key 'speed'"),
        ({"disc": [1, 2, 1], "velocity": 1}, "velocity of an obstacle is 1"),
        ({"disc": [1, 2, 1], "share": 2}, "share of an obstacle is 2"),
        ({"disc": [1, 2, 1], "name": 3}, "the name is 3"),
        ({"polygon": [[0, 0], [1, 1]]}, "the polygon is"),
        ({"polygon": [[0, 0], [2, 2], [2, 0], [0, 2]]}, "obstacle"),
    ],
)
def test_a_table_that_is_no_obstacle_is_refused(table, cause):
    with pytest.raises(DefinitionError, match=cause):
        hf.Obstacle.of_table(table)


# -- lines --------------------------------------------------------------------------------------


def test_a_line_has_its_obstacles_and_the_newest_list_counts_on(guard):
    names = guard.system.state_names, guard.system.input_names
    samples = SampleLines(guard, patience=PATIENCE, obstacle=hf.Obstacle.of_table)
    state, command = (dict.fromkeys(n, 0.0) for n in names)
    command[names[1][0]] = 1.0

    def answer(**said):
        return samples.answer(json.dumps({"state": state, "command": command, **said}).encode())

    assert answer(t=0, obstacles=[BUOY]).status == "changed"
    assert answer(t=0.1).status == "changed"
    assert answer(t=0.15, obstacles=[]).status == "passed"
    assert answer(t=0.3).status == "passed"
    assert answer(t=0.4).lost == "list of obstacles"
    assert answer(t=0.41, obstacles=[{"disc": [1, 0, None]}]).status == "not a number"
    for wrong in ("buoy", [{"disc": [1]}], [{}], 3):
        bad = answer(t=0.42, obstacles=wrong)
        assert bad.status == "not a number"
        assert "is no sample" in bad.why
        assert samples.refused.startswith(f"line {samples.count} is no sample: ")
    fine = SampleLines(guard, obstacle=hf.Obstacle.of_table)
    assert fine.answer(fine.example().encode()).lost == ""


def test_a_filter_without_obstacles_refuses_a_list():
    robot = hf.systems.unicycle()
    room = hf.obstacles(robot, {}, room=[[-3, -3], [3, -3], [3, 3], [-3, 3]])
    samples = SampleLines(hf.SafetyFilter(robot, room, gains=(1, 4)))
    said = json.loads(samples.example()) | {"obstacles": []}
    with pytest.raises(SimulationError, match="keeps clear of no obstacles"):
        samples.answer(json.dumps(said).encode())
