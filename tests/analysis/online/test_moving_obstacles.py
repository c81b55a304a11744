"""Obstacles that a filter is told of at run time: where they are near, what is asked, what is kept."""

from __future__ import annotations

import copy
import ctypes
import pickle

import numpy as np
import pytest
import shapely
import sympy as sp
from shapely.affinity import rotate, translate

import holdfast as hf
from holdfast.analysis.online.obstacle_slots import DISC, ObstacleSlots, hull_numbers
from holdfast.errors import HoldfastError, SimulationError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.control.moving_obstacles import NUMBERS, PAIR, pair_conditions
from holdfast.maths.control.parameter_box import ParameterBox
from holdfast.maths.definitions.law import FoundPairs, Repeated
from tests.c_code import built, needs_gcc

RECTANGLE = [(0.5, 0.3), (-0.5, 0.3), (-0.5, -0.3), (0.5, -0.3)]


@pytest.fixture(scope="module")
def robot():
    return hf.systems.unicycle()


@pytest.fixture(scope="module")
def boat():
    return hf.systems.marine_vehicle("videoray_pro_iii")


@pytest.fixture(scope="module")
def guard(robot):
    return hf.SafetyFilter(robot, obstacles=hf.Obstacles(3, lead=0.25), gains=(1, 4))


def outline(random, count, size=1.0):
    """The corners of a random convex polygon around the origin."""
    points = random.normal(size=(count + 6, 2)) * size
    return list(shapely.convex_hull(shapely.MultiPoint(points)).exterior.coords)[:-1]


# -- where two bodies are near ----------------------------------------------------------------


def slots_of(system, hull):
    """The places of the pairs of a hull, without a filter."""
    clearing = hf.Obstacles(1, hull=hull)
    psi = system.states[2].symbol
    pose = (*(q.symbol for q in system.states[:2]), sp.cos(psi), sp.sin(psi))
    found = FoundPairs(pose, tuple(hull_numbers(clearing)), len(clearing.parts), 0.0, first=True)
    return ObstacleSlots(system, Repeated((), (), (), 40, found))


def test_the_gap_is_the_distance_of_the_hulls(robot):
    """Against Shapely, which knows nothing of pairs of discs; the discs touch where the hulls do."""
    random, apart = np.random.default_rng(3), 0
    for _ in range(200):
        hull, shape = outline(random, 4, 0.5), outline(random, 5)
        state = random.uniform(-4, 4, 3)
        body = translate(
            rotate(shapely.Polygon(hull), state[2], origin=(0, 0), use_radians=True), *state[:2]
        )
        distance = body.distance(shapely.Polygon(shape))
        slots = slots_of(robot, hull)
        count = slots.fill(state, [hf.Obstacle.polygon(shape)])
        gaps = slots.near.reshape(-1, 2)[:count, 0]
        pairs = slots.pairs.reshape(-1, len(PAIR))[:count]
        c, s = np.cos(state[2]), np.sin(state[2])
        x = state[0] + pairs[:, 1] * c - pairs[:, 2] * s - pairs[:, 3]
        y = state[1] + pairs[:, 1] * s + pairs[:, 2] * c - pairs[:, 4]
        assert np.hypot(x, y) - pairs[:, 5] == pytest.approx(gaps, abs=1e-8)
        if distance > 0:
            apart += 1
            assert gaps.min() == pytest.approx(distance, abs=1e-9)
        else:
            assert gaps.min() <= 1e-9
    assert apart > 100


def test_capsules_ellipses_and_rounded_polygons_have_their_distances(guard):
    lead = shapely.Point(0.25, 0)
    for obstacle, shape in (
        (hf.Obstacle.capsule((2, -1), (2, 3), 0.2), shapely.LineString([(2, -1), (2, 3)])),
        (hf.Obstacle.polygon([(2, 1), (3, 1), (3, 2)], 0.2),
         shapely.Polygon([(2, 1), (3, 1), (3, 2)])),
    ):  # fmt: skip
        gap = guard.step([0, 0, 0], [0, 0], obstacles=[obstacle]).clearances["obstacle 1"]
        assert gap == pytest.approx(shape.distance(lead) - 0.2 - 0.25, abs=1e-12)
    ellipse = hf.Obstacle.ellipse((3, 0), (2, 0.5), heading=0.4)
    turns = np.linspace(0, 2 * np.pi, 4000)
    x, y = 2 * np.cos(turns), 0.5 * np.sin(turns)
    rim = np.stack([3 + x * np.cos(0.4) - y * np.sin(0.4), x * np.sin(0.4) + y * np.cos(0.4)], 1)
    ((corners, _),) = ellipse.bodies
    around = shapely.Polygon(corners)
    assert all(around.covers(shapely.MultiPoint(rim)) for _ in range(1))
    assert around.hausdorff_distance(shapely.Polygon(rim)) < 0.01 * 2


def test_an_old_measurement_has_moved_on_and_grown(guard):
    fresh = hf.Obstacle.disc((3, 0), 0.4, velocity=(-0.5, 0), acceleration=0.2)
    late = hf.Obstacle.disc(
        (3, 0), 0.4, velocity=(-0.5, 0), acceleration=0.2, velocity_error=0.1, age=2.0
    )
    gaps = [
        guard.step([0, 0, 0], [0, 0], obstacles=[o]).clearances["obstacle 1"] for o in (fresh, late)
    ]
    grown = 0.2 * 2.0**2 / 2 + 0.1 * 2.0
    assert gaps[0] - gaps[1] == pytest.approx(0.5 * 2.0 + grown, abs=1e-12)


# -- what is asked of the inputs --------------------------------------------------------------


def conditions(system, **how):
    told = pair_conditions(
        system, ("x", "y"), "psi", worst=(), disturbance_measured=False, box=ParameterBox()
    )
    return told


@pytest.mark.parametrize("vehicle", ["robot", "boat"])
def test_the_condition_is_that_of_the_distance_along_the_motion(vehicle, request):
    """n . u - b against derivatives of the distance by differences along the exact motion."""
    system = request.getfixturevalue(vehicle)
    each = conditions(system)
    ((normal, offset),) = each.rows
    order = each.orders[0]
    random = np.random.default_rng(7)
    names = [q.symbol for q in system.states]
    given = [*names, *NUMBERS.values(), *sp.symbols("kappa1 kappa2 sample_time", real=True)]
    still = {q.symbol: 0 for q in system.disturbances}
    rows = Evaluator([e.xreplace(still) for e in (*normal, offset)], given, system.parameters)
    for _ in range(5):
        q = random.normal(size=len(names)) * 0.3
        u = random.uniform(-0.4, 0.4, len(system.inputs))
        pair = dict(zip(PAIR, [1.0, 0.4, 0.2, 2.0, 1.0, 0.6, *random.normal(size=2) * 0.3,
                               0.0, 0.0, 1.0], strict=True))  # fmt: skip
        k1, k2, h = 0.7, 2.1, 1e-3

        def level(t, q=q, u=u, pair=pair):
            moved = q
            if t:
                plant = hf.Plant(system, q, sample_time=abs(t), substeps=4)
                moved = plant.step(u) if t > 0 else moved
            x, y, psi = moved[0], moved[1], moved[2]
            px = x + pair["ahead"] * np.cos(psi) - pair["left"] * np.sin(psi)
            py = y + pair["ahead"] * np.sin(psi) + pair["left"] * np.cos(psi)
            away = np.hypot(px - pair["x"] - pair["vx"] * t, py - pair["y"] - pair["vy"] * t)
            return pair["reach"] - away

        c = [level(k * h) for k in range(4)]
        first = (-11 * c[0] + 18 * c[1] - 9 * c[2] + 2 * c[3]) / (6 * h)
        second = (2 * c[0] - 5 * c[1] + 4 * c[2] - c[3]) / h**2
        asked = first + k1 * c[0] if order == 1 else second + (k1 + k2) * first + k1 * k2 * c[0]
        (values,) = rows.values(np.array([[*q, *pair.values(), k1, k2, 0.02]]))
        assert values[:-1] @ u - values[-1] == pytest.approx(
            asked, abs=2e-3 if order == 2 else 1e-6
        )


def test_what_an_obstacle_may_do_is_counted(guard, robot):
    """The worst velocity that it may have is never worse than what is asked for all."""
    random = np.random.default_rng(1)
    for _ in range(20):
        place = random.normal(size=2) * 0.3 + [1.2, 0]
        told = {"velocity": (-0.2, 0.1), "acceleration": 0.3}
        careful = guard.step([0, 0, 0], [1, 0], obstacles=[hf.Obstacle.disc(place, 0.3, **told)])
        row = careful.conditions[4 * 3 : 5 * 3]
        for turn in np.linspace(0, 2 * np.pi, 12):
            other = np.array(told["velocity"]) + 0.3 * 0.01 * np.array([np.cos(turn), np.sin(turn)])
            sure = hf.Obstacle.disc(place, 0.3, velocity=tuple(other))
            exact = guard.step([0, 0, 0], [1, 0], obstacles=[sure]).conditions[4 * 3 : 5 * 3]
            assert row[:2] == pytest.approx(exact[:2])
            assert row[2] <= exact[2] + 1e-12


def test_two_halves_are_the_whole_condition(robot):
    """What each of two vehicles is asked with a half adds up to what one is asked with all."""
    each = conditions(robot)
    ((normal, offset),) = each.rows
    n = NUMBERS
    half, whole = offset.subs(n["share"], sp.Rational(1, 2)), offset.subs(n["share"], 1)
    still = {n["vx"]: 0, n["vy"]: 0, n["change"]: 0, n["unsure"]: 0}
    assert sp.simplify((2 * half - whole).subs(still)) == 0
    assert all(n["share"] not in e.free_symbols for e in normal)


# -- in the loop ------------------------------------------------------------------------------


def drive_ahead(t, states):
    return np.stack([np.ones(len(states)), np.clip(-1.5 * states[:, 2], -2, 2)], axis=1)


def test_no_disc_is_hit_that_is_hit_without_the_filter(robot):
    random = np.random.default_rng(5)
    place = random.uniform(-6, 6, (8, 20, 2))
    place[np.linalg.norm(place, axis=2) < 2] += 4
    velocity = random.uniform(-0.25, 0.25, (8, 20, 2))

    def discs(t, states):
        shape = (*place.shape[:2], 1)
        return np.concatenate([place + t * velocity, np.full(shape, 0.4), velocity], axis=2)

    keep = hf.SafetyFilter(robot, obstacles=hf.Obstacles(8, lead=0.25, clearance=0.03))
    drive = keep.among(drive_ahead, discs)
    result = hf.simulate(robot, keep.law, command=drive, starts=np.zeros((8, 3)), horizon=12.0)
    assert result.arrays["infeasible"].values.sum() == 0
    assert drive.least.min() > 0
    at = np.asarray(result.arrays["time"].values)
    gap = [
        np.linalg.norm(result.arrays["state"].values[:, i, np.newaxis, :2] - place - t * velocity,
                       axis=2).min() - 0.4
        for i, t in enumerate(at)
    ]  # fmt: skip
    assert min(gap) > 0.03  # the truth, beside what the filter was told
    alone = hf.simulate(robot, hf.commanded(robot), command=drive_ahead, starts=np.zeros((8, 3)),
                        horizon=12.0)  # fmt: skip
    hit = [
        np.linalg.norm(alone.arrays["state"].values[:, i, np.newaxis, :2] - place - t * velocity,
                       axis=2).min(axis=1) < 0.4
        for i, t in enumerate(at)
    ]  # fmt: skip
    assert np.any(hit, axis=0).sum() >= 3


def test_a_rectangle_stays_clear_of_a_corridor_of_1_2_widths(robot):
    keep = hf.SafetyFilter(
        robot, obstacles=hf.Obstacles(2, hull=RECTANGLE, clearance=0.005), gains=(2, 4)
    )
    sides = [[(1, 0.36), (4, 0.36), (4, 2), (1, 2)], [(1, -2), (4, -2), (4, -0.36), (1, -0.36)]]
    walls = [hf.Obstacle.polygon(side) for side in sides]
    shapes = [shapely.Polygon(side) for side in sides]
    plant = hf.Plant(robot, [-0.8, 0.0, 0.0])
    for i in range(300):
        x, y, psi = plant.state
        body = translate(
            rotate(shapely.Polygon(RECTANGLE), psi, origin=(0, 0), use_radians=True), x, y
        )
        assert min(body.distance(shape) for shape in shapes) > 0.003
        wiggle = 1.5 * np.sin(0.1 * i) if x > 0.7 else 0.0
        plant.step(keep.step(plant.state, [0.9, wiggle - 2 * y - 3 * psi], obstacles=walls).input)
    assert plant.state[0] > 3  # it came through


def test_many_vehicles_decide_as_each_alone(guard):
    states, commands = [[0, 0, 0], [0.2, 0.1, 0.5]], [[1, 0], [1, 0.5]]
    around = [[hf.Obstacle.disc((1, 0.1), 0.4)], []]
    many = guard.step_many(states, commands, obstacles=around)
    for k in range(2):
        alone = guard.step(states[k], commands[k], obstacles=around[k])
        assert many.input[k] == pytest.approx(alone.input, abs=0)
        assert many.status[k] == alone.status
    faulty = [[hf.Obstacle.disc((np.inf, 0.1), 0.4)], []]
    status = guard.step_many(states, commands, obstacles=faulty).status
    assert [s.value for s in status] == ["not a number", "passed"]


def test_discs_may_be_rows_of_an_array(guard):
    disc = hf.Obstacle.disc((1, 0.1), 0.4, velocity=(0.1, 0), acceleration=0.2)
    by_name = guard.step([0, 0, 0], [1, 0], obstacles=[disc])
    row = np.array([[1, 0.1, 0.4, 0.1, 0, 0.2]])
    assert guard.step([0, 0, 0], [1, 0], obstacles=row).input == pytest.approx(by_name.input, abs=0)
    with pytest.raises(SimulationError, match=r"shape \(1, 2\)"):
        guard.step([0, 0, 0], [1, 0], obstacles=row[:, :2])


@needs_gcc
@pytest.mark.parametrize("vehicle", ["robot", "boat"])
def test_the_filter_in_c_gives_the_same_bits(vehicle, request, tmp_path):
    system = request.getfixturevalue(vehicle)
    keep = hf.SafetyFilter(system, obstacles=hf.Obstacles(5, lead=0.3), gains=(0.6, 3.0))
    library = built(tmp_path, keep.export_c("keep"), "keep")
    library.keep_obstacles.restype = ctypes.c_long
    memory, random = np.zeros(64), np.random.default_rng(2)
    n, m = len(system.states), len(system.inputs)
    p = ctypes.addressof(ctypes.c_double.in_dll(library, "keep_parameters"))

    def at(array):
        return ctypes.c_void_p(array.ctypes.data)

    library.keep_start(at(memory))
    for i in range(50):
        state, command = random.normal(size=n), 2 * random.normal(size=m)
        around = [
            hf.Obstacle.disc(4 * random.normal(size=2), 0.4, velocity=(0.1, -0.1), acceleration=0.1)
            for _ in range(8)
        ]
        around.append(hf.Obstacle.polygon([(2, 2), (3, 2), (3, 4)], velocity=(0.1, 0)))
        told = keep.step(state, command, obstacles=around)
        records = np.frombuffer(b"".join(o.records for o in around)).copy()
        handed, out, actuators = np.zeros(m + 5 * len(PAIR)), np.zeros(m), np.zeros(8)
        handed[:m] = command
        pairs = library.keep_obstacles(
            at(state), at(records), ctypes.c_long(len(records)), at(handed)
        )
        assert pairs == len(around)
        library.keep_step(
            at(memory), ctypes.c_double(0.02 * i), ctypes.c_double(0.02), at(state), at(handed),
            ctypes.c_void_p(p), at(out), at(actuators),
        )  # fmt: skip
        assert np.array_equal(out, told.input)


# -- what is said -----------------------------------------------------------------------------


def test_who_pinches_is_named_before_anything_is_hit(guard):
    sides = [hf.Obstacle.disc((0.3, s * 0.9), 0.4, velocity=(0, -0.9 * s), name=f"from {w}")
             for s, w in ((1, "port"), (-1, "starboard"))]  # fmt: skip
    told = guard.step([0, 0, 0], [1, 0], obstacles=sides)
    assert told.status.value == "infeasible"
    assert told.why.startswith("pinched by 'from port' and 'from starboard'")
    assert min(told.clearances.values()) > 0.2
    assert set(told.gave_way) == {"from port", "from starboard"}
    assert told.too_fast == ("from port", "from starboard")


def test_of_more_obstacles_the_nearest_count(guard):
    row = [hf.Obstacle.disc((1.5 + k, 0), 0.3, name=f"buoy {k}") for k in range(5)]
    told = guard.step([0, 0, 0], [1, 0], obstacles=row[::-1])
    assert sorted(told.clearances) == ["buoy 0", "buoy 1", "buoy 2"]
    assert sorted(told.left_out) == ["buoy 3", "buoy 4"]
    assert "2 more are farther away" in told.why
    assert guard.step([0, 0, 0], [0.2, 0], obstacles=[]).why.endswith("no obstacle is there")


def test_a_faulty_obstacle_is_a_status(guard):
    nowhere = hf.Obstacle.disc((float("nan"), 0), 0.4, name="buoy")
    told = guard.step([0, 0, 0], [1, 0], obstacles=[hf.Obstacle.disc((3, 0), 0.1), nowhere])
    assert told.status.value == "not a number"
    assert told.why == "a number of 'buoy' is not finite, so that the input is the fallback"
    assert guard.step([0, 0, 0], [1, 0], obstacles=[]).status.value == "passed"


@pytest.mark.parametrize("column", ["radius", "acceleration", "share", "age", "velocity_error"])
def test_a_disc_of_an_array_that_cannot_be_is_a_status_and_not_left_out(guard, column):
    """A share of 0 would take the disc out of the conditions without a word."""
    row = dict(zip(DISC, [0.6, 0.0, 0.3, 0.0, 0.0, 0.1, 1.0, 0.0, 0.0], strict=True))
    fine = guard.step([0, 0, 0], [1, 0], obstacles=np.array([[*row.values()]]))
    assert fine.overruled
    row[column] = 0.0 if column == "share" else -0.1
    told = guard.step([0, 0, 0], [1, 0], obstacles=np.array([[*row.values()]]))
    assert told.status.value == "not a number"
    assert told.why.startswith("a number of 'obstacle 1' cannot be: a share is above 0")


def test_a_filter_with_obstacles_is_a_value(guard):
    for twin in (pickle.loads(pickle.dumps(guard)), copy.deepcopy(guard)):
        assert twin == guard
        buoy = [hf.Obstacle.disc((1, 0.1), 0.4)]
        ways = [f.step([0, 0, 0], [1, 0], obstacles=buoy).input for f in (twin, guard)]
        assert np.array_equal(*ways)
    assert "clear of up to 3 obstacles" in str(guard)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda r: hf.SafetyFilter(r, obstacles=0), "0 obstacles; expected a number from 1 to"),
        (lambda r: hf.SafetyFilter(r), "nothing to keep; expected a region, a kernel, or obstacles"),
        (lambda r: hf.SafetyFilter(r, obstacles=hf.Obstacles(2, lead=0)), "give a lead"),
        (lambda r: hf.SafetyFilter(r, obstacles=hf.Obstacles(2, lead=0.2, speed=0.5)),
         "obstacles of 0.5 m/s are faster than the 0.4 m/s"),
        (lambda r: hf.Obstacles(2, hull=[(0, 0), (1, 1), (1, 0), (0, 1)]), "'hull': self-intersection"),
        (lambda r: hf.Obstacles(2, hull=[(0, 0), (1, 1)]), "a radius, three or more corners"),
        (lambda r: hf.Obstacles(2, hull=-1.0), "the radius of the hull is -1 m"),
        (lambda r: hf.Obstacles(2, clearance=float("nan")), "clearance is nan"),
        (lambda r: hf.SafetyFilter(r, obstacles=hf.Obstacles(2, position=("x", "z"), lead=1)),
         "'z' is no state of 'unicycle'"),
        (lambda r: hf.SafetyFilter(r, obstacles=2, delay=0.1), "beside obstacles that move"),
        (lambda r: hf.Obstacle.disc((1, 2, 3), 1), "a point is (1, 2, 3); expected (x, y)"),
        (lambda r: hf.Obstacle.disc((1, 2), 1, share=0), "share of an obstacle is 0"),
        (lambda r: hf.Obstacle.disc((1, 2), 1, age=-1), "age of an obstacle is -1"),
        (lambda r: hf.Obstacle.disc((1, 2), -1), "radius of an obstacle is below 0"),
        (lambda r: hf.Obstacle.ellipse((1, 2), (-1, 1)), "half axes are -1 and 1"),
        (lambda r: hf.Obstacle.polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "self-intersection"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line(robot, make, says):
    with pytest.raises(HoldfastError) as refused:
        make(robot)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_wrong_obstacles_at_a_sample_are_one_line(robot, guard):
    region = hf.obstacles(robot, {"pier": [(1, 0), (2, 0), (2, 1)]})
    with pytest.raises(SimulationError, match="without room for any"):
        hf.SafetyFilter(robot, region).step([0, 0, 0], [1, 0], obstacles=[])
    with pytest.raises(SimulationError, match="the obstacles are None"):
        guard.step([0, 0, 0], [1, 0])
    with pytest.raises(SimulationError, match="expected a list of"):
        guard.step([0, 0, 0], [1, 0], obstacles=[3])
    with pytest.raises(SimulationError, match="obstacles of 1 vehicles; expected of 2"):
        guard.step_many([[0, 0, 0]] * 2, [[1, 0]] * 2, obstacles=[[]])


def test_obstacles_come_before_regions(robot):
    """Where not both can be kept the region gives way."""
    pier = hf.obstacles(robot, {"pier": [(-2, -1), (-1, -1), (-1, 1), (-2, 1)]}, clearance=0.3)
    keep = hf.SafetyFilter(robot, pier, obstacles=hf.Obstacles(2, lead=0.25), gains=(1, 4))
    pushed = hf.Obstacle.disc((0.75, 0), 0.3, velocity=(-0.9, 0), name="tug")
    told = keep.step([-0.65, 0, 0], [0, 0], obstacles=[pushed])
    assert told.status.value in ("infeasible", "changed")
    if told.gave_way:
        assert "tug" not in told.gave_way


# -- a region that moves ----------------------------------------------------------------------

SPEED = hf.Parameter("closing", "m/s", value=0.2)


def closing_gate(system, at=2.0):
    """x <= 2 m - .2 m/s t: a gate that comes."""
    level = hf.symbol("x") - (at - SPEED.symbol * hf.TIME)
    return hf.Region("gate", system.states, (hf.Inequality("gate", level, "m"),), (SPEED,))


@pytest.mark.parametrize("vehicle", ["robot", "boat"])
def test_a_region_that_moves_is_kept(vehicle, request):
    """Held back by the gate, which pushes the vehicle; the loop looks between samples too."""
    system = request.getfixturevalue(vehicle)
    gate, gains = closing_gate(system), (0.6, 3.0)
    keep = hf.SafetyFilter(system, gate, gains=gains)
    full = {"robot": 1.0, "boat": 8.0}[vehicle]
    starts = np.zeros((1, len(system.states)))

    def ahead(t, states):
        return np.tile([full, 0.0], (len(states), 1))

    kept = hf.simulate(system, keep.law, command=ahead, starts=starts, region=gate, horizon=12.0)
    assert kept.viable == 1
    assert -0.05 < kept.arrays["worst_constraint"].values[0, 0] < 1e-4
    lost = hf.simulate(
        system, hf.commanded(system), command=ahead, starts=starts, region=gate, horizon=12.0
    )
    assert lost.viable == 0


def test_when_a_region_that_moves_is_left_is_exact(robot):
    """x = t and x = 2 - .2 t meet at 2 / 1.2 s, between two samples."""

    def ahead(t, states):
        return np.tile([1.0, 0.0], (len(states), 1))

    result = hf.simulate(
        robot, hf.commanded(robot), command=ahead, starts=[[0, 0, 0], [0.5, 0, 0]],
        region=closing_gate(robot), horizon=5.0,
    )  # fmt: skip
    assert result.arrays["exit_time"].values == pytest.approx([2 / 1.2, 1.5 / 1.2], abs=1e-9)


def test_what_is_said_of_a_region_that_moves_is_of_the_time(robot):
    keep = hf.SafetyFilter(robot, closing_gate(robot), gains=(1, 4))
    early = keep.step([0, 0, 0], [1, 0], t=0.0)
    late = keep.step([0, 0, 0], [1, 0], t=8.0)
    assert early.value == pytest.approx(2.0)
    assert late.value == pytest.approx(0.4)
    assert "0.4 m away; with the command held it would have been violated in 0.33 s" in late.why


# -- beside the other options of a filter -----------------------------------------------------

BUOY = hf.Obstacle.disc((1.0, 0.1), 0.4, name="buoy")


def test_a_current_that_is_not_known_is_counted_with_its_worst():
    """Between what is asked in still water and in the worst current lies what it may do."""
    boat, clear = hf.systems.drifting_unicycle(), hf.Obstacles(2, lead=0.25)
    still = hf.SafetyFilter(boat, obstacles=clear)
    careful = hf.SafetyFilter(boat, obstacles=clear, worst=boat.disturbance_names)
    told = hf.SafetyFilter(boat, obstacles=clear, disturbance_measured=True)
    rows = [
        f.step([0, 0, 0], [1, 0], obstacles=[BUOY], **more).conditions[12:15]
        for f, more in ((still, {}), (careful, {}), (told, {"disturbance": (0.3, -0.4)}))
    ]
    normal = rows[0][:2]
    assert all(row[:2] == pytest.approx(normal) for row in rows)
    assert rows[0][2] - rows[1][2] == pytest.approx(0.5)  # |current| <= .5 m/s, along the normal
    assert abs(rows[2][2] - rows[0][2]) <= 0.5


def test_limits_of_rates_are_harder_than_what_moves(robot):
    keep = hf.SafetyFilter(robot, obstacles=hf.Obstacles(2, lead=0.25), rates={"v": 1.0})
    first = keep.step([0, 0, 0], [1, 0], obstacles=[BUOY])
    second = keep.step([0, 0, 0], [1, 0], obstacles=[BUOY])
    assert abs(first.input[0]) <= 0.02 + 1e-12
    assert abs(second.input[0] - first.input[0]) <= 0.02 + 1e-12


def test_the_velocities_may_be_estimated_and_the_pose_may_not(boat):
    clear = hf.Obstacles(2, lead=0.3)
    keep = hf.SafetyFilter(
        boat, obstacles=clear, gains=(0.6, 3), states=("x", "y", "psi"), bandwidth=4.0
    )
    assert keep.step([0, 0, 0], [1, 0], obstacles=[BUOY]).status.value == "changed"
    point = hf.System(
        "point", (hf.Quantity("x"), hf.Quantity("y")), (hf.Quantity("u"), hf.Quantity("w")),
        {"x": hf.symbol("u"), "y": hf.symbol("w")},
    )  # fmt: skip
    with pytest.raises(HoldfastError, match="'y' is not measured, and obstacles are kept clear of"):
        hf.SafetyFilter(point, obstacles=2, states=("x",))


def test_a_point_without_a_heading_needs_no_lead():
    point = hf.System(
        "point", (hf.Quantity("x"), hf.Quantity("y")), (hf.Quantity("u"), hf.Quantity("w")),
        {"x": hf.symbol("u"), "y": hf.symbol("w")}, input_bounds=hf.Box((-1, -1), (1, 1)),
    )  # fmt: skip
    keep = hf.SafetyFilter(point, obstacles=hf.Obstacles(2, clearance=0.1), gains=(1, 4))
    told = keep.step([0, 0], [1, 0], obstacles=[hf.Obstacle.disc((1, 0), 0.4)])
    assert told.clearances["obstacle 1"] == pytest.approx(0.5)
    assert told.input == pytest.approx([0.5, 0])
    assert told.too_fast == ()
