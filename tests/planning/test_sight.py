"""Targets in view among obstacles: Shapely's distances, and vehicles that lose sight of none."""

import math

import numpy as np
import pytest
import shapely

import holdfast as hf
from holdfast.errors import DefinitionError, ScenarioError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.expressions.random_points import is_zero
from holdfast.maths.formations.walls import passing_distance, separation
from tests.c_code import built, needs_gcc, pointer

WALL = [(0, 0.8), (2, 0.8), (2, 1.1), (0.3, 1.1), (0.3, 2.3), (0, 2.3)]
PILLAR = [(0.6, -1.1), (1.4, -1.1), (1.4, -0.3), (0.6, -0.3)]
STAR = [
    (-1 + (0.9 if k % 2 else 0.3) * math.cos(k * math.pi / 5), -2 + (0.9 if k % 2 else 0.3) * math.sin(k * math.pi / 5))
    for k in range(10)
]  # fmt: skip
YARD = {"wall": WALL, "pillar": PILLAR, "star": STAR}
LAMP = (4.0, 0.0)
PLACES = np.random.default_rng(0).uniform(-4, 5, (10_000, 2))


@pytest.fixture(scope="module")
def robot():
    return hf.systems.unicycle()


def values_of(region, states):
    symbols = [q.symbol for q in region.reads]
    of = Evaluator([c.expression for c in region.inequalities], symbols, region.parameters)
    return of.values(states)


def from_places(places, target):
    return shapely.linestrings(np.stack([places, np.broadcast_to(target, places.shape)], axis=1))


def test_a_lamp_is_in_view_where_shapely_says_so_at_its_distance(robot):
    """At 10,000 places, past obstacles that are not convex; the lamp's own distance does not count."""
    region = hf.targets_in_view(robot, {"lamp": LAMP}, YARD, clearance=0.1)
    worst = values_of(region, PLACES).max(axis=1)
    every = shapely.union_all([shapely.Polygon(p) for p in YARD.values()])
    distance = shapely.distance(from_places(PLACES, LAMP), every)
    free = distance > 0
    assert 0.2 < free.mean() < 0.8
    assert (worst[~free] >= 0.1).all()
    nearest = np.minimum(0.1 - worst, shapely.distance(shapely.Point(LAMP), every))
    assert nearest[free] == pytest.approx(distance[free], abs=1e-12)


def test_the_depth_behind_an_obstacle_is_the_least_displacement_that_separates(robot):
    """Of a convex one: moved by it, and by no less, in some direction, the line of sight is free."""
    region = hf.targets_in_view(robot, {"lamp": LAMP}, {"pillar": PILLAR})
    depth = values_of(region, PLACES)[:, 0]
    pillar = shapely.Polygon(PILLAR)
    hidden = np.flatnonzero(depth > 0)[:300]
    angles = np.linspace(0, 2 * math.pi, 721)[:-1]
    off = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for k in hidden:
        for share, separates in ((0.995, False), (1.005, True)):
            moved = share * depth[k] * off
            ends = np.stack([PLACES[k] + moved, LAMP + moved], axis=1)
            crossed = shapely.intersects(shapely.linestrings(ends), pillar)
            assert (not crossed.all()) == separates


def test_pieces_have_exact_derivatives_and_their_largest_has_its_short_form(robot):
    ends = [hf.symbol(n) for n in ("ax", "ay", "bx", "by")]
    sides = [c for a, b in zip(PILLAR, PILLAR[1:] + PILLAR[:1], strict=True) for c in (*a, *b)]
    numbers = [float(c) for c in sides]
    vehicle, target = tuple(ends[:2]), tuple(ends[2:])
    gap = separation(vehicle, target, numbers)
    slopes = [gap.diff(e) for e in ends]
    of = Evaluator([gap, passing_distance(vehicle, target, numbers), *slopes], ends, ())
    lines = np.random.default_rng(1).uniform(-1, 3, (10_000, 4))
    gap_there, passing_there, *slope = of.values(lines).T
    pillar = shapely.Polygon(PILLAR)
    drawn = shapely.linestrings(lines.reshape(-1, 2, 2))
    assert ((gap_there < 0) == shapely.intersects(drawn, pillar)).all()
    distance = shapely.distance(drawn, pillar)
    own = shapely.distance(shapely.points(lines[:, 2:]), pillar)
    free = gap_there >= 0
    assert (gap_there <= distance + 1e-12)[free].all()
    assert np.minimum(passing_there, own)[free] == pytest.approx(distance[free], abs=1e-12)
    assert passing_there[~free] == pytest.approx(gap_there[~free], abs=1e-12)
    h, away = 1e-6, 0
    for i in range(4):
        step = h * np.eye(4)[i]
        ahead, behind = (of.values(lines + s * step)[:, 0] for s in (1, -1))
        away += (abs((ahead - behind) / (2 * h) - slope[i]) > 1e-6).sum()
    assert away < 20, "of 40,000, beside places where two separate as well"


def test_slopes_of_frozen_functions_vanish_only_if_every_branch_does(robot):
    region = hf.targets_in_view(robot, {"lamp": LAMP}, {"pillar": PILLAR})
    x, psi = hf.symbol("x"), hf.symbol("psi")
    assert not is_zero(region.inequalities[0].expression.diff(x))
    assert is_zero(region.inequalities[0].expression.diff(psi))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_at_least_so_many_targets_are_in_view_where_shapely_counts_as_many(robot, count):
    lamps = {"east": LAMP, "west": (-3.5, 1.0), "north": (2.5, 3.5)}
    yard = {"wall": WALL, "pillar": PILLAR}
    region = hf.targets_in_view(robot, lamps, yard, at_least=count, half_angle=1.0, range_max=6.0)
    headings = np.random.default_rng(2).uniform(-math.pi, math.pi, 10_000)
    states = np.column_stack([PLACES, headings])
    assert [q.name for q in region.reads] == ["x", "y", "psi"]
    seen = values_of(region, states).max(axis=1) <= 0
    every = shapely.union_all([shapely.Polygon(p) for p in yard.values()])
    in_view = np.zeros(len(states), dtype=int)
    for lamp in lamps.values():
        dx, dy = (np.array(lamp) - PLACES).T
        off = np.arctan2(dy, dx) - headings
        off = abs(np.arctan2(np.sin(off), np.cos(off)))
        free = ~shapely.intersects(from_places(PLACES, lamp), every)
        in_view += free & (off <= 1.0) & (np.hypot(dx, dy) <= 6.0)
    assert (seen == (in_view >= count)).all()
    assert seen.sum() > {1: 1000, 2: 100, 3: 0}[count]


def test_the_worst_of_a_choice_is_continuous(robot):
    """Where another target takes the place of one, the depth does not jump."""
    lamps = {"east": LAMP, "west": (-3.5, 1.0), "north": (2.5, 3.5)}
    region = hf.targets_in_view(
        robot, lamps, {"wall": WALL, "pillar": PILLAR}, at_least=2, half_angle=1.0, range_max=6.0
    )
    symbols = [q.symbol for q in region.reads]
    of = Evaluator([region.worst], symbols, region.parameters)
    line = np.linspace(0, 1, 20_001)[:, None]
    for k in range(8):
        a, b = np.random.default_rng(k).uniform([-4, -3, -3], [4, 3, 3], (2, 3))
        worst = of.values(a + line * (b - a))[:, 0]
        assert np.abs(np.diff(worst)).max() < 0.01


def test_a_moving_target_is_in_view_past_obstacles():
    """A leader of a chain: expressions of its place, at 10,000 pairs of places."""
    pair = hf.systems.chain(1)
    region = hf.targets_in_view(
        pair, {"leader": ("xL", "yL")}, {"wall": WALL}, position=("x1", "y1")
    )
    ends = np.random.default_rng(4).uniform(-3, 4, (10_000, 4))
    assert [q.name for q in region.reads] == ["xL", "yL", "x1", "y1"]
    hidden = values_of(region, ends).max(axis=1) > 0
    crossed = shapely.intersects(shapely.linestrings(ends.reshape(-1, 2, 2)), shapely.Polygon(WALL))
    assert (hidden == crossed).all()


def test_a_niche_of_a_room_hides_a_target(robot):
    room = [(-3, -3), (3, -3), (3, 0), (0, 0), (0, 3), (-3, 3)]
    region = hf.targets_in_view(robot, {"lamp": (2.0, -1.0)}, room=room)
    assert region.inequality_names == ("lamp_past_room_niche_1",)
    around = shapely.Polygon(room)
    inside = PLACES[shapely.contains_xy(around, *PLACES.T)]
    seen = values_of(region, inside).max(axis=1) <= 0
    assert (seen == shapely.covers(around, from_places(inside, (2.0, -1.0)))).all()


def test_a_camera_pans_by_an_input_of_its_own(robot):
    panned = hf.panning(robot, math.pi / 2)
    assert panned.state_names == ("x", "y", "psi", "pan")
    assert panned.input_names == ("v", "r", "pan_rate")
    region = hf.targets_in_view(
        panned, {"lamp": LAMP}, half_angle=0.5, pan="pan", pan_limit=2.0, range_min=0.5
    )
    assert region.inequality_names == (
        "lamp_left",
        "lamp_right",
        "lamp_near",
        "pan_left",
        "pan_right",
    )
    keep = hf.SafetyFilter(panned, region, gains=(4.0, 8.0), sample_time=0.01)
    state, most = np.array([0.0, 0.5, 0.0, 0.0]), 0.0
    for _ in range(300):  # turned away from the lamp at 1 rad/s until the camera is at its limit
        decision = keep.step(state, [0.0, 1.0, 0.0])
        assert decision.status is not hf.Status.INFEASIBLE
        v, r, rate = decision.input
        assert abs(rate) <= math.pi / 2 + 1e-12
        state = state + 0.01 * np.array([v * math.cos(state[2]), v * math.sin(state[2]), r, rate])
        off = math.atan2(-state[1], 4 - state[0]) - state[2] - state[3]
        most = max(most, abs(off), abs(state[3]) - 1.5)
    assert most <= 0.5 + 1e-9
    assert state[2] > 1.0  # with a fixed camera 0.62: the half angle and the bearing
    assert hf.panning(hf.panning(robot, 1.0), 1.0, name="stern").input_names[-1] == "stern_rate"


@pytest.mark.parametrize(
    ("targets", "options", "said"),
    [
        ({}, {}, "there is no target"),
        ({"a": (1.0, -0.7)}, {}, "target 'a' is inside polygon 'pillar', or on it"),
        ({"a": (1.0, -0.25)}, {"clearance": 0.1}, "target 'a' is 0.05 m from polygon 'pillar', less"),
        ({"a": LAMP}, {"at_least": 2}, "at_least is 2; expected a whole number from 1 to 1"),
        ({"a": LAMP}, {"at_least": 0}, "at_least is 0"),
        ({"a": (1.0,)}, {}, "target 'a' has 1 coordinates"),
        ({"a": (math.inf, 0.0)}, {}, "a coordinate of target 'a' is not finite"),
        ({"a": ("x + z", 0.0)}, {}, "target 'a' is at 'z', which is not a state of system 'unicycle'"),
        ({"a": LAMP}, {"clearance": -0.1}, "clearance is -0.1"),
        ({"a": LAMP}, {"half_angle": 4.0}, "half_angle is 4 rad; expected less than pi"),
        ({"a": LAMP}, {"range_min": 2.0, "range_max": 1.0}, "range_min 2 m is not below range_max 1 m"),
        ({"a": LAMP}, {"range_max": 0.0}, "range_max is 0"),
        ({"a": LAMP}, {"pan": "psi"}, "pan 'psi' without half_angle"),
        ({"a": LAMP}, {"pan_limit": 1.0}, "pan_limit without pan"),
        ({"a": LAMP}, {"half_angle": 0.5, "heading": "theta"}, "'theta' is not a state"),
        ({"a": LAMP}, {"polygons": {}}, "nothing limits the view"),
        ({"a": LAMP}, {"polygons": {"bow": [(0, 0), (2, 2), (2, 0), (0, 1)]}}, "self-intersection"),
        (
            {"a": LAMP},
            {"polygons": {"disc": [(math.cos(k / 12), math.sin(k / 12)) for k in range(75)]}},
            "polygon 'disc' has a convex part of 75 corners; expected at most 63",
        ),
    ],
)  # fmt: skip
def test_a_view_that_is_none_is_refused(robot, targets, options, said):
    with pytest.raises(DefinitionError, match=said):
        hf.targets_in_view(robot, targets, **{"polygons": {"pillar": PILLAR}, **options})


def test_a_camera_that_cannot_pan_is_refused(robot):
    with pytest.raises(DefinitionError, match="rate of 'pan' is 0"):
        hf.panning(robot, 0.0)
    with pytest.raises(
        DefinitionError, match="has a quantity 'psi' already; give the camera another"
    ):
        hf.panning(robot, 1.0, name="psi")


# -- closed loops -----------------------------------------------------------------------------------


def test_a_filter_that_asks_for_the_best_target_may_doubt_where_another_is_kept():
    """A stream of 1 m/s carries a raft from one lamp to another: it is in range of the first, and
    nearer to it, but cannot stay there. The status says so, although the set is kept."""
    b = hf.symbol("b")
    raft = hf.System(
        "raft",
        (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("b", "m/s"),),
        {"x": hf.symbol("stream"), "y": b},
        parameters=(hf.Parameter("stream", "m/s", value=1.0),),
        input_bounds=hf.Box((-1,), (1,)),
    )
    lamps = {"first": (-1.5, 0.0), "second": (1.6, 0.0)}
    region = hf.targets_in_view(raft, lamps, at_least=1, range_max=2.0)
    keep = hf.SafetyFilter(raft, region, gains=(1.0, 4.0), sample_time=0.02)
    boat, statuses, values = hf.Plant(raft, [0.0, 0.0]), [], []
    for _ in range(100):
        decision = keep.step(boat.state, [0.0])
        statuses.append(decision.status)
        values.append(decision.value)
        boat.step(decision.input)
    assert statuses[0] is hf.Status.INFEASIBLE
    assert statuses[-1] is hf.Status.PASSED
    assert min(values) > 0


@pytest.mark.heavy
@needs_gcc
def test_the_filter_of_a_view_in_c_has_the_same_bits(robot, tmp_path):
    view = hf.targets_in_view(
        robot, {"a": LAMP, "b": (-3.0, 1.0)}, {"pillar": PILLAR}, at_least=1, half_angle=1.0
    )
    keep = hf.SafetyFilter(robot, view)
    states = np.column_stack([PLACES[:1000], np.linspace(-9, 9, 1000)])
    commands = np.random.default_rng(1).normal(size=(1000, 2))
    decided = keep.step_many(states, commands)
    c = built(tmp_path, keep.export_c("keep") + ONE, "keep")
    for k in range(1000):
        answer = np.zeros(4)
        c.one(pointer(states[k].copy()), pointer(commands[k].copy()), pointer(answer))
        assert answer[:2].tolist() == decided.input[k].tolist()


ONE = """
void one(const double *seen, const double *handed, double *answer) {
    keep_state s;
    keep_start(&s);
    keep_step(&s, 0.0, 0.02, seen, handed, keep_parameters, answer, answer + 2);
}
"""


def test_keys_of_a_view_are_those_of_the_function_and_refusals_name_their_place():
    plain = hf.load_scenario("sight-pillars", ["safeguard="])
    assert plain.region.inequality_names[:2] == ("lamp_past_pillar", "lamp_past_wall_1")
    with pytest.raises(
        ScenarioError, match=r"region.view: target 'lamp' is inside polygon 'pillar'"
    ):
        hf.load_scenario("sight-pillars", ["region.view.targets.lamp=[1, -1]"])
    with pytest.raises(ScenarioError, match=r"region.view: at_least is 2; expected a whole number"):
        hf.load_scenario("sight-pillars", ["region.view.at_least=2"])
    with pytest.raises(ScenarioError, match=r"system.pan: rate of 'pan' is -1"):
        hf.load_scenario("sight-landmarks", ["system.pan=-1"])
    moved = hf.load_scenario(
        "sight-pillars", ["safeguard=", 'region.view.targets.lamp=["410 cm", "0"]']
    )
    assert moved.region.inequality_names == plain.region.inequality_names


@pytest.mark.heavy
def test_a_robot_behind_a_pillar_keeps_its_lamp_from_200_of_200_starts():
    result = hf.load_scenario("sight-pillars").run()
    assert result.viable == 200
    assert result.summary()["safeguard"]["runs_relaxed"] == 0
    assert hf.load_scenario("sight-pillars", ["safeguard="]).run().viable == 0


@pytest.mark.heavy
def test_a_camera_that_pans_keeps_two_of_three_landmarks_from_200_of_200_starts():
    result = hf.load_scenario("sight-landmarks").run()
    assert result.viable == 200
    assert result.summary()["safeguard"]["runs_relaxed"] == 0
    assert hf.load_scenario("sight-landmarks", ["safeguard="]).run().viable == 6


@pytest.mark.heavy
def test_a_craft_that_cannot_stop_keeps_its_lamp_from_all_of_450_starts_a_cell_inside():
    summary = hf.load_scenario("sight-kernel").run().summary()["promise"]
    assert summary["outcome"] == "confirmed from inside"
    (deep,), (inside, edge) = summary["inside"], summary["layers"]
    assert (deep["count"], deep["runs"]) == (300, 300)
    assert (inside["count"], inside["runs"]) == (150, 150)
    assert (edge["count"], edge["runs"]) == (149, 150)
