"""Polygons as obstacles: Shapely's distances, exact derivatives, and vehicles that hit none."""

import math

import numpy as np
import pytest
import shapely

import holdfast as hf
from holdfast.errors import DefinitionError, ScenarioError
from holdfast.execution.leaf import Evaluator
from tests.c_code import built, needs_gcc, pointer

L_SHAPE = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
CLOCKWISE = [(4, 4), (3.5, 5), (3, 3.5)]
STAR = [
    (5 + (1.5 if k % 2 else 0.6) * math.cos(k * math.pi / 5), (1.5 if k % 2 else 0.6) * math.sin(k * math.pi / 5))
    for k in range(10)
]  # fmt: skip
ROOM = [(-3, -3), (7, -3), (8, 7), (-3, 6)]
POINTS = np.random.default_rng(0).uniform(-4, 9, (50_000, 2))


@pytest.fixture(scope="module")
def robot():
    return hf.systems.unicycle()


@pytest.fixture(scope="module")
def harbour(robot):
    polygons = {"pier": L_SHAPE, "rock": CLOCKWISE, "star": STAR}
    return hf.obstacles(robot, polygons, room=ROOM, clearance=0.2)


def signed(corners, points):
    """By Shapely: negative inside."""
    polygon = shapely.Polygon(corners)
    inside = shapely.contains_xy(polygon, *points.T)
    return shapely.distance(shapely.points(points), polygon.exterior) * np.where(inside, -1, 1)


@pytest.mark.heavy
def test_distances_are_those_of_shapely(harbour):
    """The largest over the convex parts of a polygon, outside of it; of the room, its sides."""
    x, y = (q.symbol for q in harbour.reads)
    of = Evaluator([c.expression for c in harbour.inequalities], [x, y], harbour.parameters)
    found = dict(zip(harbour.inequality_names, of.values(POINTS).T, strict=True))
    for name, corners in (("pier", L_SHAPE), ("rock", CLOCKWISE), ("star", STAR)):
        parts = [v for n, v in found.items() if n.startswith(name)]
        assert len(parts) == {"pier": 2, "rock": 1, "star": 4}[name]
        away = signed(corners, POINTS)
        outside = away > 0
        assert np.max(parts, axis=0)[outside] == pytest.approx(0.2 - away[outside], abs=1e-13)
        assert (np.max(parts, axis=0)[~outside] >= 0.2).all()
    sides = np.max([v for n, v in found.items() if n.startswith("room")], axis=0)
    within = shapely.contains_xy(shapely.Polygon(ROOM), *POINTS.T)
    assert sides[within] == pytest.approx(0.2 + signed(ROOM, POINTS)[within], abs=1e-13)
    assert (sides[~within] >= 0.2 - 1e-12).all()


def test_a_room_with_a_niche_is_its_hull_without_an_obstacle(robot):
    niche = [(0, 0), (6, 0), (6, 4), (3, 1), (0, 4)]
    region = hf.obstacles(robot, {}, room=niche, clearance=0.1)
    assert region.inequality_names[-1] == "room_niche_1"
    x, y = (q.symbol for q in region.reads)
    of = Evaluator([c.expression for c in region.inequalities], [x, y], region.parameters)
    worst = of.values(POINTS).max(axis=1)
    away = signed(niche, POINTS)
    assert ((worst <= 0) == (away <= -0.1))[abs(away + 0.1) > 1e-9].all()


def test_first_and_second_derivatives_are_those_of_the_nearest_side_or_corner(harbour):
    """Against differences, where no other side or corner is as near."""
    x, y = (q.symbol for q in harbour.reads)
    rock = harbour.inequality("rock").expression
    wanted = [
        rock, *(rock.diff(s) for s in (x, y)), *(rock.diff(s, r) for s in (x, y) for r in (x, y))
    ]  # fmt: skip
    of = Evaluator(wanted, [x, y], harbour.parameters)
    h, bad, some = 1e-5, 0, POINTS[:5000]
    here = of.values(some)
    for i in range(2):
        step = np.eye(2)[i] * h
        ahead, behind = (of.values(some + s * step) for s in (1, -1))
        slope = (ahead[:, 0] - behind[:, 0]) / (2 * h)
        curves = (ahead[:, 1:3] - behind[:, 1:3]) / (2 * h)
        bad += (abs(slope - here[:, 1 + i]) > 1e-7).sum()
        bad += (abs(curves - here[:, [3 + i, 5 + i]]) > 1e-5).sum()
    assert bad < 30, "of 30,000, next to places where two are as near"


def test_along_a_side_the_distance_has_no_curvature(harbour):
    x, y = (q.symbol for q in harbour.reads)
    block = hf.obstacles(
        hf.systems.unicycle(), {"block": [(0, 0), (2, 0), (2, 1), (0, 1)]}
    ).inequalities[0].expression  # fmt: skip
    of = Evaluator(
        [block.diff(x, x), block.diff(y)], [x, y], [hf.Parameter("clearance_block", "m", value=0.0)]
    )
    for px in (0.1, 0.7, 1.9):
        assert of.values(np.array([[px, -0.5]])).tolist() == [[0.0, 1.0]]


U_SHAPE = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]


@pytest.mark.few("into a corner")
@pytest.mark.parametrize(
    ("start", "options"),
    [
        ([1.5, 4.0, -math.pi / 2], {"polygons": {"dock": U_SHAPE}}),
        ([-2.0, 1.75, 0.0], {"polygons": {}, "room": [(-4, -2), (4, -2), (4, 2), (-4, 2)], "clearance": 0.0}),
        ([-2.0, 1.5, 0.1], {"polygons": {}, "room": [(-4, -2), (4, -2), (4, 2), (-4, 2)]}),
    ],
    ids=["into a notch", "along a wall", "into a corner"],
)  # fmt: skip
def test_corners_of_rooms_and_notches_are_kept_away_from(start, options):
    """A vehicle with inertia at full thrust: all sides at once, none is cut."""
    vehicle = hf.systems.marine_vehicle()
    region = hf.obstacles(vehicle, **{"clearance": 0.2, **options})
    keep = hf.SafetyFilter(vehicle, region)
    boat = hf.Plant(vehicle, [*start, 0, 0, 0])
    least, infeasible = math.inf, 0
    for k in range(1500):
        decision = keep.step(boat.state, [8.0, 0.05 * math.sin(0.01 * k)])
        least = min(least, decision.value)
        infeasible += decision.status is hf.Status.INFEASIBLE
        boat.step(decision.input)
    assert least > -1e-4
    assert infeasible == 0


@pytest.mark.heavy
@pytest.mark.parametrize("system", ["unicycle", "marine_vehicle"])
def test_no_vehicle_touches_an_obstacle_whatever_it_is_commanded(system):
    """Of relative degree 1 and 2: 100 of each from rest, pushed towards the middle of the piers."""
    vehicle = getattr(hf.systems, system)()
    region = hf.obstacles(vehicle, {"pier": L_SHAPE}, room=ROOM, clearance=0.2)
    filtered = hf.SafetyFilter(vehicle, region, gains=(1.0, 4.0))

    def head_for_the_pier(t, q):
        off = np.arctan2(0.5 - q[:, 1], 0.5 - q[:, 0]) - q[:, 2]
        off = np.arctan2(np.sin(off), np.cos(off))
        return np.stack([np.full(len(q), 2.0), 1.5 * off], axis=1)

    box = {"x": (-2.5, 6), "y": (-2.5, 5), "psi": (-3, 3)}
    shared = {
        "starts": hf.Starts(random=100, box=box), "region": region, "horizon": 15.0, "seed": 3,
        "command": head_for_the_pier, "tolerance": 1e-3, "sample_time": 0.02,
    }  # fmt: skip
    alone = hf.simulate(vehicle, hf.commanded(vehicle), **shared)
    kept = hf.simulate(vehicle, filtered.law, **shared)
    assert alone.viable < 60
    assert kept.viable == 100
    assert kept.summary()["safeguard"]["runs_overruled"] > 60


@pytest.mark.heavy
@needs_gcc
def test_filter_among_obstacles_in_c_has_the_same_bits(harbour, robot, tmp_path):
    keep = hf.SafetyFilter(robot, harbour)
    states = np.column_stack([POINTS[:3000], np.linspace(-9, 9, 3000)])
    commands = np.random.default_rng(1).normal(size=(3000, 2))
    found = keep.step_many(states, commands)
    c = built(tmp_path, keep.export_c("keep") + ONE, "keep")
    for k in range(3000):
        answer = np.zeros(4)
        c.one(pointer(states[k].copy()), pointer(commands[k].copy()), pointer(answer))
        assert answer[:2].tolist() == found.input[k].tolist()


ONE = """
void one(const double *seen, const double *handed, double *answer) {
    keep_state s;
    keep_start(&s);
    keep_step(&s, 0.0, 0.02, seen, handed, keep_parameters, answer, answer + 2);
}
"""


@pytest.mark.parametrize(
    ("polygons", "options", "said"),
    [
        ({"a": [(0, 0), (1, 0)]}, {}, "polygon 'a' has 2 corners"),
        ({"a": [(0, 0), (1, 0), (1,)]}, {}, "polygon 'a' has 3 corners; expected three or more of"),
        ({"a": [(0, 0), (1, 0), (math.nan, 1)]}, {}, "a corner of polygon 'a' is not finite"),
        ({"a": [(0, 0), (2, 2), (2, 0), (0, 1)]}, {}, "polygon 'a': self-intersection"),
        ({"a": [(0, 0), (1, 0), (1, 1), (0, 0)]}, {}, "polygon 'a' has a corner twice"),
        ({"a": [(0, 0), (1, 0), (2, 0)]}, {}, "polygon 'a' has no area"),
        ({"room": L_SHAPE}, {"room": ROOM}, "a polygon is named 'room' beside room="),
        ({}, {}, "neither a polygon nor a room"),
        ({"a": L_SHAPE}, {"clearance": -1.0}, "clearance is -1"),
        ({"a": L_SHAPE}, {"position": ("x", "z")}, "'z' is not a state"),
        ({"a": L_SHAPE}, {"room": [(0, 0), (1, 1)]}, "polygon 'room' has 2 corners"),
    ],
)
def test_what_is_no_polygon_is_refused(robot, polygons, options, said):
    with pytest.raises(DefinitionError, match=said):
        hf.obstacles(robot, polygons, **options)


SCENARIO = """
[scenario]
title = "A boat among piers"
[system]
name = "marine_vehicle"
[law]
outputs = { tau_u = "4*(3 - x)/(1 + hypot(3 - x, y)) - 3*u", tau_r = "0.8*wrap(atan2(-y, 3 - x) - psi) - 0.5*r" }
[region]
obstacles = { pier = [[-0.5, -2], [0, -2], [0, 0.6], ["-50 cm", 0.6]] }
room = [[-4, -3], [5, -3], [5, 3], [-4, 3]]
clearance = "20 cm"
[safeguard]
[starts]
random = 40
box = { x = [-3, -1.2], y = [-1.5, 1.5], psi = [-0.8, 0.8] }
[run]
horizon = 20
tolerance = 1e-3
"""


@pytest.mark.heavy
def test_scenario_with_polygons_keeps_clear_of_them(tmp_path):
    path = tmp_path / "harbour.toml"
    path.write_text(SCENARIO)
    kept = hf.load_scenario(str(path))
    assert kept.region.inequality_names == ("pier", "room_1", "room_2", "room_3", "room_4")
    assert kept.run().viable == 40
    assert hf.load_scenario(str(path), ["safeguard="]).run().viable < 10
    assert hf.load_scenario(str(path), ["region.clearance=0"]).run().viable == 40
    with pytest.raises(ScenarioError, match=r"region: polygon 'pier' has a corner twice"):
        hf.load_scenario(str(path), ["region.obstacles.pier=[[0, 0], [1, 0], [0, 0]]"])
    with pytest.raises(ScenarioError, match="region"):
        hf.load_scenario(str(path), ["region.clearance='2 kg'"])


def test_polygons_join_a_region_of_the_catalogue_and_have_kernels(tmp_path):
    """x' = u, |u| <= 1, on a line between a wall and a polygon: everything outside is viable."""
    path = tmp_path / "line.toml"
    path.write_text("""
[scenario]
title = "a point among polygons"
kind = "viability-kernel"
[system]
states = { x = { unit = "m" }, y = { unit = "m" } }
inputs = { u = { unit = "m/s", bounds = [-1, 1] }, w = { unit = "m/s", bounds = [-1, 1] } }
rates = { x = "u", y = "w" }
[region]
constraints = { near = { expression = "hypot(x, y) - 2", unit = "m" } }
obstacles = { block = [[0, 0], [1, 0], [1, 1], [0, 1]] }
[grid]
nodes = 81
box = { x = [-2.2, 2.2], y = [-2.2, 2.2] }
[march]
horizon = 1
""")
    value = hf.load_scenario(str(path)).solve()
    inside = value.at(np.array([[0.5, 0.5], [-1.0, 0.0], [1.5, 1.5]]))
    assert inside[0] == pytest.approx(-0.5, abs=0.06)
    assert inside[1] == pytest.approx(1.0, abs=0.06)
    assert inside[2] == pytest.approx(2 - math.hypot(1.5, 1.5), abs=0.06)
