"""Chapter 6: a follower keeps its leader in view, by range and bearing alone."""

import inspect
import itertools
import math
from functools import cache

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.catalogue.laws.follow_leader import SEEN
from holdfast.maths.definitions.system import by_measurements
from holdfast.maths.expressions.functions import sgn
from holdfast.maths.formations.footprint import polygon
from tests.conftest import number_at

X, Y, BETA = (hf.symbol(n) for n in ("x", "y", "beta"))
UF, WF, UL, WL = (hf.symbol(n) for n in ("uF", "wF", "uL", "wL"))
RANGE, BEARING = hf.symbol("range"), hf.symbol("bearing")
FOLLOWERS = (hf.laws.approach_leader, hf.laws.follow_leader, hf.laws.keep_footprint)


@pytest.fixture(scope="module")
def pair():
    return hf.systems.leader_follower(leader_speed=0.25, leader_turn=2.0)


@pytest.fixture(scope="module")
def view():
    return hf.regions.leader_in_view()


def seen(distance, bearing, direction):
    """The state (x, y, beta) in which the follower sees that, `direction` being phi_p."""
    x, y = -distance * np.cos(direction), -distance * np.sin(direction)
    return np.stack(np.broadcast_arrays(x, y, direction - bearing), axis=-1)


# -- the system and the region ----------------------------------------------------------------


@pytest.mark.smoke
def test_relative_kinematics_6_7_follow_from_two_unicycles(pair):
    assert pair.rates["x"] == UF * sp.cos(BETA) - UL + Y * WL
    assert pair.rates["y"] == UF * sp.sin(BETA) - X * WL
    assert pair.rates["beta"] == WF - WL


def test_a_pair_that_is_simulated_in_the_world_moves_as_6_7_says(pair):
    """Two unicycles side by side, and the relative system, with the same inputs for ten seconds."""
    names = {"x": "xL", "y": "yL", "psi": "thetaL", "v": "uL", "r": "wL"}
    leader = hf.renamed(hf.systems.unicycle(), names, "leader")
    follower = hf.renamed(hf.systems.unicycle(), {k: v[:-1] + "F" for k, v in names.items()})
    world = hf.side_by_side(leader, follower, name="two robots")
    inputs = {"uL": 0.2 * sp.sin(hf.TIME), "wL": 0.4 * sp.cos(0.7 * hf.TIME)}
    inputs |= {"uF": 0.3 * sp.cos(hf.TIME), "wF": -0.5 * sp.sin(0.3 * hf.TIME)}
    settings = {"horizon": 10.0, "sample_time": 0.02, "substeps": 2, "record_every": 0.5}
    settings |= {"continuous": True}
    start = np.array([[0.4, -0.3, 0.7, -1.0, 0.5, 2.0]])
    law = hf.Law("given", world.states, inputs)
    one = hf.simulate(world, law, starts=start, **settings).dataset["state"].values[0].T
    theta, ahead, aside = one[2], one[3] - one[0], one[4] - one[1]
    x = np.cos(theta) * ahead + np.sin(theta) * aside
    y = -np.sin(theta) * ahead + np.cos(theta) * aside
    law = hf.Law("given", pair.states, {n: inputs[n] for n in ("uF", "wF")})
    two = hf.simulate(
        pair, law, starts=[[x[0], y[0], one[5, 0] - theta[0]]],
        disturbance={n: inputs[n] for n in ("uL", "wL")}, **settings,
    ).dataset["state"].values[0].T  # fmt: skip
    assert two == pytest.approx(np.array([x, y, one[5] - theta]), abs=1e-8)


@pytest.mark.smoke
def test_vehicles_that_do_not_move_alike_everywhere_have_no_relative_kinematics():
    follower = hf.systems.unicycle()
    names = {"x": "xL", "y": "yL", "psi": "thetaL", "v": "uL", "r": "wL"}
    rates = dict(follower.rates) | {"x": follower.rates["x"] * (1 + 2 * X**2)}
    odd = hf.System("river", follower.states, follower.inputs, rates)
    leader = hf.renamed(hf.systems.unicycle(), names)
    poses = (("xL", "yL", "thetaL"), odd, ("x", "y", "psi"))
    with pytest.raises(DefinitionError, match="the rate of 'a' depends on where the leader is"):
        hf.seen_from(leader, *poses, pose=("a", "b", "c"))
    with pytest.raises(DefinitionError, match="has no 'z'"):
        hf.renamed(leader, {"z": "y"})


def test_view_is_the_triangle_of_6_8(view):
    generator = np.random.default_rng(1)
    states = generator.uniform([-3, -3, -np.pi], [3, 3, np.pi], (5000, 3))
    bearing = np.angle(np.exp(1j * (np.arctan2(-states[:, 1], -states[:, 0]) - states[:, 2])))
    distance = np.hypot(states[:, 0], states[:, 1])
    alpha, reach = math.radians(35), 2.5
    printed = (np.abs(bearing) <= alpha) & (distance <= reach * np.cos(alpha) / np.cos(bearing))
    check = Evaluator([c.expression for c in view.inequalities[:2]], [X, Y, BETA], view.parameters)
    assert ((check.values(states) <= 0).all(axis=1) == printed).all()
    assert 100 < printed.sum() < 2000
    footprint = hf.regions.leader_in_footprint()
    sides = Evaluator(
        [c.expression for c in footprint.inequalities], [X, Y, BETA], footprint.parameters
    )
    assert ((sides.values(states) <= 0).all(axis=1) == printed).all()


def test_rates_6_21_and_6_22_of_the_constraints(pair, view):
    """(6.21) is right; (6.22) has |.| uL, an upper bound, where the term itself belongs."""
    rates = hf.outward_rates(pair, view)
    reach, alpha = hf.symbol("range_max"), hf.symbol("half_angle")
    printed = UF / (X**2 + Y**2) * (X * sp.sin(BETA) - Y * sp.cos(BETA)) - WF
    printed += Y * UL / (X**2 + Y**2)
    r, phi = sp.symbols("r phi", positive=True)
    # d/dt of r - Ls cos(alpha) / cos(phi) by the polar form of the spec
    turning = (UF * sp.sin(phi) - UL * sp.sin(phi + BETA)) / r - WF
    receding = -UF * sp.cos(phi) + UL * sp.cos(phi + BETA)
    second = receding - reach * sp.cos(alpha) * sp.tan(phi) / sp.cos(phi) * turning
    exact = -(X / r + Y * reach * sp.cos(alpha) * sp.tan(phi) / (r**2 * sp.cos(phi))) * UL
    generator = np.random.default_rng(2)
    for _ in range(20):
        bearing, direction = generator.uniform(0.01, 0.6), generator.uniform(-3, 3)
        distance = 2.5 * math.cos(0.6) / math.cos(bearing)
        x, y, beta = seen(distance, bearing, direction)
        at = {X: x, Y: y, BETA: beta, reach: 2.5, alpha: 0.6, r: distance, phi: bearing}
        at |= {s: generator.uniform(-1, 1) for s in (UF, WF, UL, WL)}
        assert number_at(rates["bearing"], at) == pytest.approx(number_at(printed, at), rel=1e-5)
        # h2 = r cos(phi) - Ls cos(alpha) is the printed one times cos(phi) where both are 0
        mine, theirs = number_at(rates["range"], at), number_at(second, at)
        assert mine == pytest.approx(theirs * math.cos(bearing), abs=1e-12)
        still = number_at(second, at | {UL: 0})
        assert theirs - still == pytest.approx(number_at(exact, at), abs=1e-12)


# -- what a follower may know -----------------------------------------------------------------


@pytest.mark.parametrize("function", FOLLOWERS)
@pytest.mark.parametrize("turn", ["bearing", "line_of_sight"])
def test_no_law_reads_more_than_range_and_bearing(pair, function, turn):
    """Wherever the leader looks: the same range and bearing, the same inputs."""
    options = {"turn": turn} if "turn" in inspect.signature(function).parameters else {}
    law = function(**options)
    assert law.reads == SEEN
    assert [(m.name, m.unit) for m in pair.measurements] == [(q.name, q.unit) for q in SEEN]
    about_the_leader = {p.name for p in law.parameters} & {"leader_speed", "leader_turn"}
    assert about_the_leader <= {"leader_speed"}, "its largest speed and nothing else"
    on_states = by_measurements(pair, law)
    assert on_states.reads == pair.states
    generator = np.random.default_rng(3)
    distance, bearing = generator.uniform(0.3, 2.4, 50), generator.uniform(-0.6, 0.6, 50)
    asked = Evaluator(list(on_states.outputs.values()), [X, Y, BETA], law.parameters)
    one, other = (
        asked.values(seen(distance, bearing, generator.uniform(-3, 3, 50))) for _ in range(2)
    )
    assert one == pytest.approx(other, abs=1e-12)
    direct = Evaluator(list(law.outputs.values()), [RANGE, BEARING], law.parameters)
    assert one == pytest.approx(direct.values(np.stack([distance, bearing], axis=1)), abs=1e-12)


@pytest.mark.smoke
def test_a_law_that_reads_more_than_it_says_is_refused():
    with pytest.raises(DefinitionError, match="'beta'"):
        hf.Law("spy", SEEN, {"uF": RANGE, "wF": BETA})


# -- gains ------------------------------------------------------------------------------------


@cache
def boundary_rates(nominal, turn):
    """The rates of both constraints by x, y, beta, uL, wL, whatever the numbers."""
    pair, view = hf.systems.leader_follower(), hf.regions.leader_in_view()
    law = hf.laws.approach_leader(turn=turn) if nominal else hf.laws.follow_leader(turn=turn)
    closed = hf.outward_rates(pair, view, by_measurements(pair, law))
    given = [*pair.parameters, *law.parameters, *view.parameters]
    parameters = tuple({p.name: p for p in given}.values())
    rates = [closed[n] for n in ("bearing", "range")]
    return Evaluator(rates, [X, Y, BETA, UL, WL], parameters)


def worst_rates(turn, values, nearest):
    """The largest outward rate at the sides and at the far end, over boundary and leader."""
    speed, alpha, reach = (values[n] for n in ("leader_speed", "half_angle", "range_max"))
    rates = boundary_rates(speed == 0, turn)
    directions = np.linspace(-np.pi, np.pi, 145)
    bearings = np.linspace(-alpha, alpha, 801)
    sides = (np.linspace(nearest, reach, 1501), np.full(1501, alpha))
    end = (reach * np.cos(alpha) / np.cos(bearings), bearings)
    found = []
    for k, (distance, bearing) in enumerate((sides, end)):
        worst = -np.inf
        for direction, leader in itertools.product(directions, (-speed, speed)):
            states = seen(distance, bearing, direction)
            inputs = np.broadcast_to([leader, 2.0 * np.sign(direction)], (len(states), 2))
            worst = max(worst, rates.values(np.hstack([states, inputs]), values)[:, k].max())
        found.append(float(worst))
    return found


CASES = [
    ("bearing", 30, 1.0, 0.5, 0.3, 0.0),
    ("line_of_sight", 50, 3.0, 1.0, 0.3, 0.0),
    ("bearing", 35, 2.5, 1.0, 0.6, 0.3),
    ("bearing", 25, 2.5, 1.0, 0.6, 0.3),
    ("line_of_sight", 35, 2.5, 1.0, 1.2, 0.2),
    ("bearing", 35, 1.3, 1.0, 0.6, 0.1),
]


@pytest.mark.parametrize(("turn", "degrees", "reach", "distance", "k1", "speed"), CASES)
def test_window_of_gains_is_exactly_where_no_boundary_state_leaves(
    turn, degrees, reach, distance, k1, speed
):
    given = {
        "k1": k1,
        "distance": distance,
        "range_max": reach,
        "half_angle": math.radians(degrees),
    }
    given["leader_speed"] = speed
    window = hf.visibility_gains(turn=turn, **given)
    assert not window.empty

    def rates(k2):
        values = given | {"k2": k2}
        if speed:
            values["softness"] = 0.05
        return worst_rates(turn, values, window.nearest)

    if window.low > 0:
        assert abs(rates(window.low)[0]) < 2e-4
        assert rates(0.98 * window.low)[0] > 0
    assert abs(rates(window.high)[1]) < 2e-4
    assert rates(1.02 * window.high)[1] > 0
    middle = (window.low + window.high) / 2
    assert max(rates(middle)) < 0
    assert middle in window
    assert 1.1 * window.high not in window


@pytest.mark.parametrize(
    ("degrees", "reach", "distance", "low", "high", "thesis"),
    [(30, 1.0, 0.5, 0.5, 2.05, 2.73), (30, 2.0, 0.5, 0.5, 2.0, 2.23), (50, 3.0, 1.0, 0.8, 1.3, 1.17)],
)  # fmt: skip
def test_simulated_windows_of_the_nominal_law_are_those_computed_not_those_of_6_18(
    pair, degrees, reach, distance, low, high, thesis
):
    """X = k2 alpha / (k1 (1 - rd / Ls)): sin(alpha) to 1 / sin(alpha), not 1 to (Ls + tan) / Ls tan.

    From the corner and eleven other states of the boundary, gains on either side of the ends.
    """
    alpha, k1 = math.radians(degrees), 0.3
    region = hf.regions.leader_in_view(range_max=reach, half_angle=alpha, robot_radius=0.01)
    unit = k1 * (1 - distance / reach) / alpha
    bearings = np.linspace(0, alpha, 7)
    sides = np.linspace(distance, reach, 6)[:-1]
    far = reach * math.cos(alpha) / np.cos(bearings)
    starts = np.vstack([seen(far, bearings, 0.4), seen(sides, np.full(5, alpha), 0.4)])

    def kept(share):
        law = hf.laws.approach_leader(k1=k1, k2=share * unit, distance=distance)
        found = hf.simulate(
            pair, law, starts=starts, region=region, horizon=30.0, sample_time=0.005, substeps=1,
            record_every=30.0, tolerance=1e-5, start_outside=True,
        )  # fmt: skip
        return bool((found.dataset["outcome"].values == hf.Outcome.STAYED).all())

    assert [kept(s) for s in (low - 0.055, low + 0.005, high - 0.055, high + 0.055)] == [
        False, True, True, False,
    ]  # fmt: skip
    window = hf.visibility_gains(k1=k1, distance=distance, range_max=reach, half_angle=alpha)
    assert window.low / unit == pytest.approx(math.sin(alpha))
    assert window.high / unit == pytest.approx(1 / math.sin(alpha))
    assert (reach + math.tan(alpha)) / (reach * math.tan(alpha)) == pytest.approx(thesis, abs=0.01)
    assert not kept(thesis) or thesis < high - 0.1


def test_lower_gain_of_section_6_4_2_loses_the_leader():
    """Ls = 2.5, rd = 1, uLM = 0.3, k1 = 0.6, alpha = 35 degrees: the thesis allows 0.56 to 1.03."""
    alpha = math.radians(35)
    pair = hf.systems.leader_follower(leader_speed=0.3)
    given = {"k1": 0.6, "distance": 1.0, "leader_speed": 0.3}
    window = hf.visibility_gains(range_max=2.5, half_angle=alpha, softness=1e-6, **given)
    assert (window.low, window.high) == pytest.approx((0.773, 1.027), abs=1e-3)
    corner = 0.6 * (1 - 1 / 2.5) * math.sin(alpha) + 0.3 * math.sin(alpha) / 2.5
    assert corner / alpha < 0.6 < window.low
    region = hf.regions.leader_in_view(robot_radius=0.01)
    starts = [seen(1.06, alpha - 1e-4, math.pi / 2)]  # the leader drives off across its view
    for k2, outcome in ((0.6, hf.Outcome.LEFT), (0.8, hf.Outcome.STAYED)):
        found = hf.simulate(
            pair, hf.laws.follow_leader(k2=k2, softness=0.01, **given), starts=starts, region=region,
            disturbance={"uL": -0.3}, horizon=5.0, sample_time=0.002, substeps=1, record_every=5.0,
        )  # fmt: skip
        assert found.dataset["outcome"].values[0] == outcome


@pytest.mark.smoke
def test_window_says_when_it_is_empty_and_what_to_change():
    given = {"distance": 1.0, "range_max": 2.5, "half_angle": math.radians(35)}
    empty = hf.visibility_gains(k1=0.2, leader_speed=0.3, **given)
    assert empty.empty
    assert 0.8 not in empty
    assert "at least 0.7449 1/s at the sides of the view" in str(empty)
    for remedy, changed in (
        ("k1 of at least 0.4413 1/s", {"k1": 0.442, "leader_speed": 0.3}),
        ("leader_speed of at most 0.136 m/s", {"k1": 0.2, "leader_speed": 0.1359}),
    ):
        assert remedy in empty.remedy
        assert not hf.visibility_gains(**changed, **given).empty
    near = hf.visibility_gains(k1=0.05, leader_speed=0.4, robot_radius=0.2, **given)
    assert "may come as near as" in near.reason


@pytest.mark.smoke
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"range_max": 1.2}, "the view ends 0.983 m ahead"),
        ({"robot_radius": 0.6}, "two robots of radius 0.6 m touch"),
        ({"half_angle": 1.6}, "below pi/2"),
        ({"k1": 0.0}, "k1 is 0.0"),
        ({"k1": math.nan}, "k1 is nan"),
        ({"leader_speed": -0.1}, "leader_speed is -0.1"),
        ({"turn": "left"}, "turn is 'left'"),
    ],
)
def test_numbers_that_make_no_sense_have_no_window(change, message):
    given = {"k1": 0.6, "distance": 1.0, "range_max": 2.5, "half_angle": math.radians(35)}
    with pytest.raises(DefinitionError, match=message):
        hf.visibility_gains(**given | change)


# -- the loop ---------------------------------------------------------------------------------


def chased(pair, law, hides, **settings):
    """The pair with a leader whose speed is always such that d/dt `hides` is the largest."""
    free = hf.System(
        "pair", pair.states, (*pair.inputs, *pair.disturbances), pair.rates,
        parameters=pair.parameters, measurements=pair.measurements,
    )  # fmt: skip
    follower = by_measurements(pair, law)
    fastest = hf.symbol("leader_speed") * sgn(pair.derivative(hides).diff(UL))
    outputs = {**follower.outputs, "uL": fastest, "wL": sp.S.Zero}
    parameters = {p.name: p for p in (*follower.parameters, *pair.parameters)}
    joint = hf.Law("chase", pair.states, outputs, parameters=tuple(parameters.values()))
    return hf.simulate(free, joint, horizon=30.0, substeps=1, record_every=30.0, **settings).dataset


def everywhere(count, seed, least=0.95, most=2.0):
    generator = np.random.default_rng(seed)
    distance, bearing = generator.uniform(least, most, count), generator.uniform(-0.6, 0.6, count)
    return seen(distance, bearing, generator.uniform(-np.pi, np.pi, count))


@pytest.mark.parametrize("aim", ["out of the side", "out of range"])
def test_a_leader_that_wants_to_hide_cannot(pair, view, aim):
    bearing = next(m.expression for m in pair.measurements if m.name == "bearing")
    ahead = -X * sp.cos(BETA) - Y * sp.sin(BETA)
    hides = bearing**2 / 2 if aim == "out of the side" else ahead
    law = hf.laws.follow_leader(k1=0.6, k2=0.8, leader_speed=0.25)
    starts = everywhere(300, seed=4)
    data = chased(pair, law, hides, starts=starts, region=view, sample_time=0.005)
    assert (data["outcome"].values == hf.Outcome.STAYED).all()
    lazy = hf.laws.follow_leader(k1=0.6, k2=0.3, leader_speed=0.25)
    data = chased(pair, lazy, bearing**2 / 2, starts=starts, region=view, sample_time=0.005)
    assert (data["outcome"].values == hf.Outcome.LEFT).mean() > 0.2, "below the window"


def printed_6_19(pair, **gains):
    """(6.19b) asks for the turn rate of the line of sight in the leader's frame: it is told all."""
    follow = by_measurements(pair, hf.laws.follow_leader(as_printed=True, **gains))
    slope = (Y / (X**2 + Y**2), -X / (X**2 + Y**2))  # of atan2(-y, -x), negative
    turning = -sum(s * pair.rates[n] for s, n in zip(slope, ("x", "y"), strict=True))
    turning = turning.subs({UF: follow.outputs["uF"]})
    return hf.Law(
        "printed", (*pair.states, *pair.disturbances),
        {"uF": follow.outputs["uF"], "wF": follow.outputs["wF"] + turning},
        parameters=follow.parameters,
    )  # fmt: skip


def test_turn_rate_in_the_leaders_frame_loses_a_leader_that_spins_on_the_spot(pair, view):
    """The bearing goes to wL / k2, here 0.75 rad > alpha; without that term to 0."""
    gains = {"k1": 0.6, "k2": 0.8, "leader_speed": 0.25}
    settings = {
        "starts": [seen(1.05, 0.0, 0.3)], "region": view, "disturbance": {"uL": 0.0, "wL": 0.6},
        "horizon": 40.0, "sample_time": 0.005, "substeps": 1, "record_every": 40.0,
    }  # fmt: skip
    lost = hf.simulate(pair, printed_6_19(pair, **gains), **settings).dataset
    assert lost["outcome"].values[0] == hf.Outcome.LEFT
    end = lost["constraint"].values[0, -1, 0] + math.radians(35)
    assert end == pytest.approx(0.6 / 0.8, abs=0.01)
    kept = hf.simulate(pair, hf.laws.follow_leader(**gains), **settings).dataset
    assert kept["constraint"].values[0, -1, 0] == pytest.approx(-math.radians(35), abs=1e-6)


def test_bound_6_20_does_not_hold():
    """|r1| <= |wL| / sqrt(k1 k2) compares metres with radians: the leader goes round in a circle,
    stays in view, and stays farther from its place than that."""
    pair = hf.systems.leader_follower(leader_speed=0.94)
    law = printed_6_19(pair, k1=0.141, k2=0.33, distance=1.0, leader_speed=0.94)
    data = hf.simulate(
        pair, law, starts=everywhere(20, seed=6), disturbance={"uL": 0.94, "wL": 0.19},
        horizon=300.0, sample_time=0.005, substeps=1, record_every=0.5,
    ).dataset  # fmt: skip
    tail = np.hypot(data["state"].values[:, -100:, 0], data["state"].values[:, -100:, 1]) - 1.0
    promised = 0.19 / math.sqrt(0.141 * 0.33)
    assert tail.min(axis=1).max() > 1.2 * promised


FOOTPRINTS = {
    "triangle": None,
    "rectangle": [[0.1, -0.8], [2.0, -0.8], [2.0, 0.8], [0.1, 0.8]],
    "kite": [[0.05, 0.0], [1.2, -0.9], [2.4, 0.0], [1.2, 0.9]],
    "leaning": [[0.1, -0.2], [1.5, -1.2], [2.2, 0.9], [0.6, 0.7]],
    "hexagon": [[1.1 + math.cos(a), math.sin(a)] for a in np.arange(6) * math.pi / 3],
}


def from_inside(vertices, k1, leader_speed, firmness):
    """From random places of a footprint, the leader as fast as it may be, to and fro and turning."""
    pair = hf.systems.leader_follower(leader_speed=leader_speed, leader_turn=2.0)
    law = hf.laws.keep_footprint(
        k1=k1, firmness=firmness, leader_speed=leader_speed, vertices=vertices
    )
    region = hf.regions.leader_in_footprint(vertices=vertices)
    speed = hf.symbol("leader_speed")
    return simulated_in(
        pair, law, region, polygon(vertices), 60, sample_time=0.005,
        disturbance={"uL": speed * sgn(sp.sin(0.9 * hf.TIME)), "wL": 6 * speed * sp.cos(0.33 * hf.TIME)},
    )  # fmt: skip


@pytest.mark.parametrize("shape", FOOTPRINTS)
def test_any_convex_footprint_keeps_a_leader_that_stands_still(shape):
    """s' = -k1 (s - sd): from every state of it, at once and for all gains."""
    for k1 in (0.2, 0.6, 2.0):
        data = from_inside(FOOTPRINTS[shape], k1, leader_speed=1e-6, firmness=5.0)
        assert (data["outcome"].values == hf.Outcome.STAYED).all()
        end = data["state"].values[:, -1]
        assert np.hypot(end[:, 0], end[:, 1]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("shape", FOOTPRINTS)
def test_any_convex_footprint_keeps_a_leader_that_moves(shape):
    data = from_inside(FOOTPRINTS[shape], 0.6, leader_speed=0.25, firmness=1.0)
    assert (data["outcome"].values == hf.Outcome.STAYED).all()
    assert data["infeasible"].values.sum() == 0


def simulated_in(pair, law, region, corners, count, **settings):
    """From random places of the leader in a footprint, a centimetre inside it."""
    generator = np.random.default_rng(5)
    weights = generator.dirichlet(np.ones(len(corners)), count)
    places = weights @ np.array(corners)
    places = places.mean(axis=0) + 0.98 * (places - places.mean(axis=0))
    starts = seen(
        np.hypot(*places.T), np.arctan2(places[:, 1], places[:, 0]), generator.uniform(-3, 3, count)
    )
    return hf.simulate(
        pair, law, starts=starts, region=region, horizon=30.0, substeps=1, record_every=30.0,
        tolerance=1e-6, **settings,
    ).dataset  # fmt: skip


@pytest.mark.smoke
@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        ([[0, 0], [1, 1]], "has 2 vertices"),
        ([[0, 0], [2, 0], [1, 0.1], [0, 2]], r"not convex at \(1, 0.1\)"),
        ([[0, 0], [1, 0], [2, 0], [1, 1]], r"not convex at \(1, 0\)"),
        ([[0, 0], [1, 0], "corner"], "vertex 'corner'"),
        ([[0, 0], [1, 0], [math.inf, 1]], "two finite numbers"),
        ([[math.cos(a), math.sin(a)] for a in np.arange(5) * 0.8 * math.pi], "winds around twice"),
        ("triangle", "has 0 vertices"),
        (np.float64(3.0), "has 0 vertices"),
        (np.eye(3), "two finite numbers"),
        ([[1.5, -1], [2, -1], [2, 1], [1.5, 1]], "distance = 1 m is beyond side"),
    ],
)
def test_footprints_that_are_none_are_refused(vertices, message):
    with pytest.raises(DefinitionError, match=message):
        hf.laws.keep_footprint(vertices=vertices)


@pytest.mark.smoke
def test_turn_is_one_of_two():
    for law in (hf.laws.approach_leader, hf.laws.follow_leader):
        with pytest.raises(DefinitionError, match="'bearing' or 'line_of_sight'"):
            law(turn="left")
    with pytest.raises(DefinitionError, match="true or false"):
        hf.laws.follow_leader(as_printed="yes")


def test_shipped_scenarios_keep_every_leader_in_view():
    """200 starts from the far corners of the view; 1,000 leaders that move at random for a minute."""
    corners = hf.load_scenario("ch6-line-of-sight").run()
    assert corners.outcomes["reached goal"] == 200
    assert corners.dataset["worst_constraint"].values[:, :2].min() > -1e-6, "all begin on both"
    moving = hf.load_scenario("ch6-moving-leader").run()
    assert moving.outcomes["stayed"] == 1000
    nearest = moving.dataset["worst_constraint"].values[:, :2].max(axis=0)
    assert nearest == pytest.approx([-0.0019, -0.0016], abs=2e-4), "rad of a side, m of the far end"
