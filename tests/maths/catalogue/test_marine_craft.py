"""Marine craft by their matrices, beside independent models; thrusters, their sets and their lag."""

import math
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import fsolve, linprog

import holdfast as hf
from holdfast.errors import DefinitionError, HoldfastError, ScenarioError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.catalogue.actuators.thruster import thruster as fixed_thruster
from holdfast.maths.catalogue.vehicles import vehicle_of
from holdfast.maths.definitions.actuator import actuation
from holdfast.maths.definitions.bounds import AllocatedImage

FILES = Path(hf.__file__).parent / "vehicles"
S = 'source = "s"'


def accelerations(craft, nu, tau):
    """nudot in still water, from compiled code."""
    symbols = [q.symbol for q in (*craft.states, *craft.inputs, *craft.disturbances)]
    rates = Evaluator([craft.rates[n] for n in "uvr"], symbols, craft.parameters)
    return rates.values(np.array([[0, 0, 0, *nu, *tau, 0, 0]]))[0]


def written(folder, name, old="", new="", more=""):
    """A copy of a shipped file with something replaced, and something added."""
    text = (FILES / f"{name}.toml").read_text()
    assert old in text
    path = folder / "mine.toml"
    path.write_text((text.replace(old, new, 1) if old else text) + more)
    return str(path)


def thruster(name, x, y, degrees, force=5.0):
    return (
        f'[thrusters.{name}]\nx = {{ value = {x}, unit = "m", {S} }}\n'
        f'y = {{ value = {y}, unit = "m", {S} }}\n'
        f'direction = {{ value = {degrees}, unit = "deg", {S} }}\n'
        f'ahead = {{ value = {force}, unit = "N", {S} }}\n'
        f'astern = {{ value = {force}, unit = "N", {S} }}\n'
    )


def hull_with(folder, *thrusters):
    """The hull of the Otter with other thrusters."""
    text = (FILES / "otter.toml").read_text()
    path = folder / "mine.toml"
    path.write_text(text[: text.index("[thrusters")] + "".join(thruster(*t) for t in thrusters))
    return str(path)


# accelerations by Fossen's Python Vehicle Simulator, otter.py: its 6-by-6 matrices, rows and columns
# of surge, sway and yaw, and its cross-flow strips
OTTER = [
    ((1.2, 0.4, 0), (60, 10), (-0.38672887506480047, -0.5725835813887792, -0.4676476658273053)),
    ((1.5, 0, 0.3), (150, -20), (0.406676625467245, -0.09356780464336942, -1.8996107547308139)),
    ((-0.7, -0.4, 0.0), (-90, 5), (-0.4176830100133694, 0.6512055942664553, -0.5752974029581951)),
    ((2.1, 0, -0.2), (0, 30), (-1.8991147126499506, 0.11175691392735215, 1.4489388968820636)),
]


@pytest.mark.parametrize(("nu", "tau", "expected"), OTTER)
def test_otter_accelerates_as_in_the_simulator_it_is_taken_from(nu, tau, expected):
    """To rounding in pure sway or pure yaw; with both, its strips have products left out here."""
    found = accelerations(hf.load_vehicle("otter"), nu, tau)
    assert found == pytest.approx(expected, rel=1e-8)


def test_cross_flow_of_sway_and_yaw_together_is_what_the_otter_leaves_out():
    """At 0.4 m/s of sway and 0.3 rad/s: 0.02 m/s^2 of sway and 0.3 rad/s^2 of yaw."""
    expected = [-0.1457639627840987, -0.6760175259963418, -2.176853514965768]
    found = accelerations(hf.load_vehicle("otter"), (1.2, 0.4, 0.3), (60, 10))
    assert abs(found - expected).round(2).tolist() == [0.0, 0.02, 0.3]


def test_cybership_accelerates_by_the_matrices_of_its_paper():
    """Skjetne, Smogeli, Fossen 2004: M, C_RB, C_A and D written out, to rounding."""
    m, iz, xg = 23.8, 1.76, 0.046
    craft = hf.load_vehicle("cybership_ii_full")
    for u, v, r in np.random.default_rng(0).uniform(-1, 1, (50, 3)) * (0.5, 0.3, 0.4):
        tau = np.array([1.0, -0.1, 0.2])
        mass = np.array([[m + 2, 0, 0], [0, m + 10, m * xg], [0, m * xg, iz + 1]])
        rigid = np.array([[0, 0, -m * (xg * r + v)], [0, 0, m * u], [m * (xg * r + v), -m * u, 0]])
        added = np.array([[0, 0, -10 * v], [0, 0, 2 * u], [10 * v, -2 * u, 0]])
        damping = np.array([
            [0.72253 + 1.32742 * abs(u) + 5.86643 * u * u, 0, 0],
            [0, 0.88965 + 36.47287 * abs(v) + 0.805 * abs(r), 7.25 + 0.845 * abs(v) + 3.45 * abs(r)],
            [0, -0.0313 - 3.95645 * abs(v) - 0.13 * abs(r), 1.9 - 0.08 * abs(v) + 0.75 * abs(r)],
        ])  # fmt: skip
        expected = np.linalg.solve(mass, tau - (rigid + added + damping) @ (u, v, r))
        assert accelerations(craft, (u, v, r), tau) == pytest.approx(expected, rel=1e-11)


def test_supply_vessel_has_the_matrices_of_bis_scaling():
    """At small speeds, where the Coriolis force that its source leaves out is small."""
    length, mass, unit = 76.2, 6e6, math.sqrt(9.81 / 76.2)
    scale = np.diag([1, 1, length])
    inertia = mass * scale @ [[1.1274, 0, 0], [0, 1.8902, -0.0744], [0, -0.0744, 0.1278]] @ scale
    drag = (
        mass * unit * scale @ [[0.0358, 0, 0], [0, 0.1183, -0.0124], [0, -0.0041, 0.0308]] @ scale
    )
    nu, tau = np.array([1e-9, -2e-9, 1e-11]), np.zeros(3)
    found = accelerations(hf.load_vehicle("supply_vessel"), nu, tau)
    assert found == pytest.approx(np.linalg.solve(inertia, tau - drag @ nu), rel=1e-6)


def test_marine_vehicle_is_a_marine_craft_with_two_thrusters_and_no_cross_terms(tmp_path):
    plain = hf.systems.marine_vehicle()
    n = {p.name: p for p in plain.parameters}
    numbers = "".join(
        f'{name} = {{ value = {p.value}, unit = "{p.unit}", {S} }}\n'
        for name, p in n.items() if not name.startswith("thrust")
    )  # fmt: skip
    path = tmp_path / "videoray.toml"
    path.write_text(
        f'title = "t"\nsystem = "marine_craft"\n[parameters]\n{numbers}'
        + thruster("port", 0, 0.1, 0) + thruster("starboard", 0, -0.1, 0)
    )  # fmt: skip
    craft = hf.load_vehicle(str(path))
    assert {k: sp.srepr(e) for k, e in craft.rates.items()} == {
        k: sp.srepr(e) for k, e in plain.rates.items()
    }
    assert (craft.states, craft.inputs, craft.actuators) == (
        plain.states, plain.inputs, plain.actuators,
    )  # fmt: skip
    values = {p.symbol: p.value for p in (*plain.parameters, *craft.parameters)}
    ways = [[1.0, 3.0], [-2.0, 5.0]]
    sets = [s.input_bounds.at(values) for s in (plain, craft)]
    assert [s.support_value(w) for s in sets[:1] for w in ways] == pytest.approx(
        [s.support_value(w) for s in sets[1:] for w in ways]
    )


def test_sway_force_that_comes_with_the_moment_drives_the_sway(tmp_path):
    """One propeller and a tunnel 0.8 m ahead: tau_v = tau_r / 0.8, without a choice."""
    craft = hf.load_vehicle(hull_with(tmp_path, ("main", -1, 0, 0), ("tunnel", 0.8, 0, 90)))
    assert craft.input_names == ("tau_u", "tau_r")
    whole = hf.load_vehicle(
        hull_with(tmp_path, ("main", -1, 0, 0), ("tunnel", 0.8, 0, 90), ("aft", -0.5, 0, 90))
    )
    assert whole.input_names == ("tau_u", "tau_v", "tau_r")
    nu = (0.5, -0.2, 0.1)
    assert accelerations(craft, nu, (3, 2)) == pytest.approx(
        accelerations(whole, nu, (3, 2 / 0.8, 2)), rel=1e-12
    )


def test_thruster_at_an_angle_has_the_effect_of_its_components():
    for degrees in (0, 30, 45, 90, 135, 180, -90, 17.3):
        cos, sin, moment = fixed_thruster("a", 2.0, 0.5, math.radians(degrees), 1.0, 1.0).effects[0]
        a = math.radians(degrees)
        assert [float(cos), float(sin)] == pytest.approx([math.cos(a), math.sin(a)], abs=1e-15)
        assert float(moment) == pytest.approx(2 * math.sin(a) - 0.5 * math.cos(a), abs=1e-15)


@pytest.mark.parametrize(
    ("thrusters", "complaint"),
    [
        ([("main", -1, 0, 0)], "independently"),
        ([("a", -1, 0, 0), ("b", 1, 0, 0)], "independently"),
        ([("a", 0.5, 0, 90), ("b", -0.5, 0, 90)], "independently"),
    ],
)
def test_thrusters_without_surge_or_moment_are_refused(tmp_path, thrusters, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.load_vehicle(hull_with(tmp_path, *thrusters))


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("[thrusters.port]", "[sails.port]", "unknown key 'sails'"),
        ("[thrusters.port]", "[rudders.port]", "unknown parameter 'y' of rudders.port"),
        ("direction =", "angle =", "unknown parameter 'angle' of thrusters.port"),
        ('x = { value = 0.0, unit = "m"', 'x = { value = 0.0, unit = "kg"', "does not fit"),
        (
            "ahead = { value = 119.682",
            "ahead = { value = 0.0",
            r"mine\.toml: thrusters\.port\.ahead: parameter 'ahead' is 0; expected above 0",
        ),
        ('title = "', 'x = 1\ntitle = "', r"'x'; expected title, .*, thrusters, .*rudders"),
        ('title = "', 'rudders = 3\ntitle = "', r"rudders is 3; expected \[rudders\.NAME\]"),
        ("[thrusters.port]", "[thrusters.mass]", "'mass' cannot name an actuator"),
        ("[thrusters.port]", "[thrusters.'aft port']", "cannot name"),
        ("Iz = { value = 16.97788086", "Iz = { value = -40", "above 0"),
        ("x_g = { value = 0.153125", "x_g = { value = 2.0", "not positive definite"),
        ("Xu = {", "Xw = {", "unknown parameter 'Xw'"),
        ('system = "marine_craft"', 'system = "marine_vehicle"', "unknown parameter|unknown key"),
    ],
)
def test_broken_craft_file_is_refused_with_the_key(tmp_path, old, new, complaint):
    path = written(tmp_path, "otter", old, new)
    with pytest.raises(HoldfastError, match=complaint):
        hf.load_vehicle(path)


def test_file_without_thrusters_and_thrusters_of_another_system_are_refused(tmp_path):
    text = (FILES / "otter.toml").read_text()
    path = tmp_path / "bare.toml"
    path.write_text(text[: text.index("[thrusters")])
    with pytest.raises(ScenarioError, match="needs actuators"):
        hf.load_vehicle(str(path))
    with pytest.raises(ScenarioError, match="unknown key 'thrusters'"):
        hf.load_vehicle(written(tmp_path, "turtlebot3_burger", more=thruster("a", 0, 0, 0)))
    path.write_text("thrusters = {}\n" + path.read_text())
    with pytest.raises(ScenarioError, match="thrusters is"):
        vehicle_of(str(path))


def test_numbers_are_replaced_by_name():
    weak = hf.load_vehicle("otter", port_ahead=50.0, Yr=-3.0)
    values = {p.name: p.value for p in weak.parameters}
    assert (values["port_ahead"], values["starboard_ahead"], values["Yr"]) == (50.0, 119.682, -3.0)
    assert hf.symbol("Yr") in weak.rates["v"].free_symbols
    with pytest.raises(ScenarioError, match="no parameter 'port_y'"):
        hf.load_vehicle("otter", port_y=1.0)


@pytest.mark.few("supply_vessel")
@pytest.mark.parametrize("name", ["bluerov2_planar", "supply_vessel"])
def test_allocated_set_of_more_thrusters_than_inputs_is_that_of_a_linear_programme(name):
    """Its support function and the point where it is; the image of the box is up to a fifth larger."""
    craft = hf.load_vehicle(name)
    values = {p.symbol: p.value for p in craft.parameters}
    bounds = craft.input_bounds.at(values)
    assert isinstance(bounds, AllocatedImage)
    matrix = np.array(bounds.matrix.evalf().tolist(), dtype=float)
    shares = np.linalg.pinv(matrix)
    low, high = (np.array([float(e) for e in side]) for side in (bounds.of.lower, bounds.of.upper))
    larger = []
    for way in np.random.default_rng(0).normal(size=(10, 3)) / abs(matrix).max(axis=1):
        exact = -linprog(
            -way,
            A_ub=np.vstack([shares, -shares]),
            b_ub=np.r_[high, -low],
            bounds=[(None, None)] * 3,
        ).fun
        assert bounds.support_value(way) == pytest.approx(exact, rel=1e-9)
        best = np.array([float(e) for e in bounds.support([sp.Float(w) for w in way], 1)[1]])
        assert way @ best == pytest.approx(exact, rel=1e-9)
        assert bounds.contains(list(best), 1e-7)
        assert [float(e) for e in bounds.saturate(best)] == pytest.approx(list(best), rel=1e-9)
        larger.append(np.maximum(way @ matrix * low, way @ matrix * high).sum() / exact)
    assert 1.05 < max(larger) < 1.25
    normals = [([float(e) for e in row], float(limit)) for row, limit in bounds.half_spaces()]
    for corner in bounds.corners():
        at = [float(e) for e in corner]
        assert all(np.dot(n, at) <= limit * (1 + 1e-9) for n, limit in normals)


def test_lag_and_slew_act_on_every_thruster():
    """A step of surge and yaw: each force is that of first order, at most the slew at a time."""
    craft = hf.load_vehicle("otter", port_lag=0.4, starboard_lag=1.0)
    late = hf.lagged(craft)
    assert late.state_names[6:] == ("actual_port", "actual_starboard")
    assert (late.input_names, late.input_bounds) == (craft.input_names, craft.input_bounds)
    law = hf.Law("step", (), {"tau_u": sp.Float(60), "tau_r": sp.Float(7.9)})
    data = hf.simulate(
        late, law, starts=[[0.0] * 8], horizon=4.0, sample_time=0.01, record_every=0.01
    ).dataset
    t, forces = data["time"].values, data["state"].values[0, :, 6:]
    for force, end, lag in zip(forces.T, (20.0, 40.0), (0.4, 1.0), strict=True):
        assert force == pytest.approx(end * (1 - np.exp(-t / lag)), abs=1e-6)
    slow = hf.lagged(craft, {"port": 0.05, "starboard": 0.05}, {"port": 10.0})
    forces = hf.simulate(
        slow, law, starts=[[0.0] * 8], horizon=1.5, sample_time=0.01, record_every=0.01
    ).dataset["state"].values[0, :, 6:]  # fmt: skip
    rising = np.arange(151) * 0.01
    assert forces[:, 0] == pytest.approx(10 * rising, abs=1e-9)
    assert forces[-1, 1] == pytest.approx(40, abs=1e-6)


def test_lag_that_cannot_be_is_refused():
    craft, plain = hf.load_vehicle("otter"), hf.systems.marine_vehicle()
    with pytest.raises(DefinitionError, match="declares no lag"):
        hf.lagged(plain)
    with pytest.raises(DefinitionError, match="one or the other"):
        hf.lagged(craft, {"port": 0.1, "tau_u": 0.1})
    with pytest.raises(DefinitionError, match="slew without a lag"):
        hf.lagged(craft, slew={"port": 1.0})
    with pytest.raises(DefinitionError, match="fully actuated"):
        hf.laws.hold_pose(craft)
    with pytest.raises(ScenarioError, match="'vehicle'"):
        hf.load_scenario("craft-berth", ["system.lag=3"])
    slower = hf.load_scenario("craft-berth", ["system.bow_lag=1.0"])
    assert {p.name: p.value for p in slower.system.parameters}["bow_lag"] == 1.0


def test_three_rows_that_depend_are_no_choice_of_sway():
    """A pair of thrusters at the same angle on the centre line: sway is a part of surge and yaw."""
    pair = [
        fixed_thruster("a", 1.0, 0.2, 0.5, 1.0, 1.0),
        fixed_thruster("b", -1.0, -0.2, 0.5, 1.0, 1.0),
    ]
    found = actuation(pair)
    assert [q.name for q in found.inputs] == ["tau_u", "tau_r"]
    along, turn = (q.symbol for q in found.inputs)
    for a, b in ((1.0, 0.0), (0.3, -2.0)):
        effects = [[float(e) for e in t.effects[0]] for t in pair]
        surge, sway, yaw = (a * p + b * q for p, q in zip(*effects, strict=True))
        assert float(found.force[1].xreplace({along: surge, turn: yaw})) == pytest.approx(sway)


def test_file_of_the_page_is_a_craft(tmp_path):
    page = (Path(__file__).parents[3] / "docs/craft.md").read_text("utf-8")
    path = tmp_path / "my_boat.toml"
    path.write_text(page.split("```toml\n")[1].split("```")[0])
    boat = hf.load_vehicle(str(path))
    assert {p.name: p.value for p in boat.parameters}["x_g"] == pytest.approx(0.1)
    late = hf.lagged(boat)
    assert late.state_names[6:] == ("actual_port", "actual_starboard")
    assert boat.input_names == ("tau_u", "tau_r")


# -- actuators whose direction is an input


def turned(u, v, r, delta, thrust=3.86):
    """The rates of REMUS 100 in the plane, by the coefficients of Prestero's thesis as printed.

    z down, y to starboard; with the combined coefficients of lift and added mass.
    """
    m, iz = 30.48, 3.45
    surge = thrust - 1.62 * u * abs(u) + (35.5 + m) * v * r - 1.93 * r * r
    sway = (
        -1310 * v * abs(v) + 0.632 * r * abs(r) - 28.6 * u * v + (5.22 - m) * u * r
        + 9.64 * u * u * delta
    )  # fmt: skip
    yaw = -3.18 * v * abs(v) - 94.0 * r * abs(r) - 24.0 * u * v - 2.0 * u * r - 6.15 * u * u * delta
    inertia = [[m + 0.93, 0, 0], [0, m + 35.5, -1.93], [0, -1.93, iz + 4.88]]
    return np.linalg.solve(inertia, [surge, sway, yaw])


def test_remus_accelerates_by_the_coefficients_of_its_source():
    """The mirror of z down changes the signs of v, r and the angle."""
    craft = hf.load_vehicle("remus_100_rudder")
    for u, v, r, delta in np.random.default_rng(0).uniform(-1, 1, (50, 4)) * (0.5, 0.2, 0.3, 0.23):
        du, dv, dr = turned(1.5 + u, -v, -r, -delta)
        mine = accelerations(craft, (1.5 + u, v, r), (3.86, delta))
        assert mine == pytest.approx([du, -dv, -dr], rel=1e-9, abs=1e-12)


def test_remus_goes_as_fast_and_turns_as_tightly_as_its_source_says():
    """1.54 m/s, three knots, at 1500 rpm; the turn at 13.6 degrees is where the printed forces balance."""
    craft = hf.load_vehicle("remus_100_rudder")

    def settled(angle):
        law = hf.Law("turn", (), {"propeller": sp.Float(3.86), "rudder": sp.Float(angle)})
        run = hf.simulate(craft, law, starts=[[0, 0, 0, 1.0, 0, 0]], horizon=200, record_every=1)
        return run.dataset["state"].values[0]

    straight, limit = settled(0.0), math.radians(13.6)
    assert straight[-1, 3] == pytest.approx(3 * 1852 / 3600, rel=1e-3)
    assert straight[-1, 3] == pytest.approx(1.54, abs=0.005)
    hard = settled(1.0)  # beyond the limit
    balance = fsolve(lambda q: turned(*q, limit), [1.3, 0.1, -0.2])
    assert hard[-1, 3:] == pytest.approx(balance, rel=1e-6)  # the mirror of z down, with its angle
    radius = math.hypot(balance[0], balance[1]) / abs(balance[2])
    circle = hard[-int(2 * math.pi / abs(balance[2])) - 1 :, :2]
    assert np.ptp(circle, axis=0) == pytest.approx([2 * radius] * 2, rel=0.02)
    assert radius == pytest.approx(6.04, abs=0.01)


def test_rudder_stays_within_its_limit_in_closed_loop_and_has_no_force_without_speed():
    result = hf.load_scenario("remus-channel").run()
    assert result.viable == result.outcomes["reached goal"] == 300
    asked = np.abs(result.dataset["input"].sel(input_name="rudder").values)
    actual = np.abs(result.dataset["state"].sel(state_name="actual_rudder").values)
    assert asked.max() == pytest.approx(math.radians(13.6), rel=1e-12)
    assert actual.max() <= math.radians(13.6)
    rest = accelerations(hf.load_vehicle("remus_100_rudder"), (0, 0, 0), (0, 0.2))
    assert (rest == 0).all()


def test_ferry_accelerates_by_the_matrices_of_its_source():
    """Pedersen's M and D, the Coriolis force of M's symmetric part; two force vectors."""
    craft = hf.load_vehicle("milliampere")
    m = np.array([[2389.65702, 0, 0], [0, 2533.911, 62.386], [0, 28.141, 5068.91]])
    even = (m + m.T) / 2
    for u, v, r in np.random.default_rng(0).uniform(-1, 1, (50, 3)) * (1.5, 0.5, 0.3):
        bow, stern = np.array([300.0, -100.0]), np.array([120.0, 250.0])
        tau = [*(bow + stern), 1.8 * (bow[1] - stern[1])]
        p = even @ (u, v, r)
        d = np.array([
            [27.632 + 110.064 * abs(u) + 13.965 * u * u, 0, 0],
            [0, 52.947 + 116.486 * abs(v) + 24.313 * v * v + 1540.383 * abs(r),
             -24.732 - 572.141 * abs(v) + 115.457 * abs(r)],
            [0, -3.524 + 0.832 * abs(v) - 336.827 * abs(r),
             122.86 + 874.428 * abs(r) + 121.957 * abs(v)],
        ])  # fmt: skip
        force = tau + np.array([p[1] * r, -p[0] * r, p[0] * v - p[1] * u]) - d @ (u, v, r)
        mine = accelerations(craft, (u, v, r), (*bow, *stern))
        assert mine == pytest.approx(np.linalg.solve(m, force), rel=1e-10)


def test_azimuth_thruster_gives_any_force_of_its_disc_and_no_other():
    """A law that asks for too much: each force keeps its direction and has the size of the limit."""
    craft = hf.load_vehicle("milliampere", bow_limit=200.0)
    names = craft.input_names
    assert names == ("bow_x", "bow_y", "stern_x", "stern_y")
    law = hf.Law("much", (), dict(zip(names, map(sp.Float, (3e3, 4e3, -1e3, 0.0)), strict=True)))
    inputs = hf.simulate(craft, law, starts=[[0] * 6], horizon=0.2).dataset["input"].values[0, 0]
    assert inputs == pytest.approx([120.0, 160.0, -500.0, 0.0], rel=1e-12)
    values = {p.symbol: p.value for p in craft.parameters}
    bounds = craft.input_bounds.at(values)
    assert bounds.support_value([3.0, 4.0, 0.0, -2.0]) == pytest.approx(5 * 200 + 2 * 500)


def test_craft_of_a_rudder_without_a_propeller_is_refused_and_a_name_stands_once(tmp_path):
    text = (FILES / "remus_100_rudder.toml").read_text()
    path = tmp_path / "mine.toml"
    begin, end = text.index("[thrusters"), text.index("[rudders")
    path.write_text(text[:begin] + text[end:])
    with pytest.raises(DefinitionError, match="independently"):
        hf.load_vehicle(str(path))
    path.write_text(text.replace("[rudders.rudder]", "[rudders.propeller]"))
    with pytest.raises(ScenarioError, match="two actuators have the name 'propeller'"):
        hf.load_vehicle(str(path))


def test_each_of_more_inputs_than_velocities_has_its_share_by_least_squares():
    """The forces of two azimuth thrusters that track velocities are the smallest that do."""
    craft = hf.load_vehicle("milliampere")
    pose = hf.laws.hold_pose(craft)
    law = hf.track_velocity(craft, pose, {"u": 0.5, "v": 0.5, "r": 0.5})
    state = [3.0, -2.0, 0.4, 0.3, -0.1, 0.05]
    at = dict(zip((q.symbol for q in craft.states), state, strict=True))
    at |= {p.symbol: p.value for p in law.parameters}
    forces = np.array([float(law.outputs[n].xreplace(at)) for n in craft.input_names])
    effect = np.array([[1, 0, 1, 0], [0, 1, 0, 1], [0, 1.8, 0, -1.8]])
    assert forces == pytest.approx(np.linalg.pinv(effect) @ effect @ forces, rel=1e-9)
    with pytest.raises(DefinitionError, match="gives 3 velocities"):
        hf.track_velocity(hf.load_vehicle("otter"), pose, {"u": 0.5, "v": 0.5, "r": 0.5})
