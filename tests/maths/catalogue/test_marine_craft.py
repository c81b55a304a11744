"""Marine craft by their matrices, beside independent models; thrusters, their sets and their lag."""

import math
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import linprog

import holdfast as hf
from holdfast.errors import DefinitionError, HoldfastError, ScenarioError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.catalogue.vehicles import vehicle_of
from holdfast.maths.definitions.bounds import AllocatedImage
from holdfast.maths.definitions.thruster import Thruster, actuation

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
        cos, sin, moment = Thruster("a", 2.0, 0.5, math.radians(degrees), 1.0, 1.0).effect
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
        ("[thrusters.port]", "[rudders.port]", "unknown key 'rudders'"),
        ("direction =", "angle =", "unknown parameter 'angle' of thrusters.port"),
        ('x = { value = 0.0, unit = "m"', 'x = { value = 0.0, unit = "kg"', "does not fit"),
        ("ahead = { value = 119.682", "ahead = { value = 0.0", "above 0"),
        ("[thrusters.port]", "[thrusters.mass]", "'mass' cannot name a thruster"),
        ("[thrusters.port]", "[thrusters.'aft port']", "cannot name"),
        ("Iz = { value = 16.97788086", "Iz = { value = -40", "above 0"),
        ("x_g = { value = 0.153125", "x_g = { value = 2.0", "not positive definite"),
        ("Xu = {", "Xw = {", "unknown parameter 'Xw'"),
        ('system = "marine_craft"', 'system = "marine_vehicle"', "unknown parameter|takes no"),
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
    with pytest.raises(ScenarioError, match="needs 'thrusters'"):
        hf.load_vehicle(str(path))
    with pytest.raises(ScenarioError, match="takes no 'thrusters'"):
        hf.load_vehicle(written(tmp_path, "turtlebot3_burger", more=thruster("a", 0, 0, 0)))
    path.write_text("thrusters = 3\n" + path.read_text())
    with pytest.raises(ScenarioError, match="thrusters is"):
        vehicle_of(str(path))


def test_numbers_are_replaced_by_name():
    weak = hf.load_vehicle("otter", port_ahead=50.0, Yr=-3.0)
    values = {p.name: p.value for p in weak.parameters}
    assert (values["port_ahead"], values["starboard_ahead"], values["Yr"]) == (50.0, 119.682, -3.0)
    assert hf.symbol("Yr") in weak.rates["v"].free_symbols
    with pytest.raises(ScenarioError, match="no parameter 'port_y'"):
        hf.load_vehicle("otter", port_y=1.0)


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
    pair = [Thruster("a", 1.0, 0.2, 0.5, 1.0, 1.0), Thruster("b", -1.0, -0.2, 0.5, 1.0, 1.0)]
    found = actuation(pair)
    assert [q.name for q in found.inputs] == ["tau_u", "tau_r"]
    along, turn = (q.symbol for q in found.inputs)
    for a, b in ((1.0, 0.0), (0.3, -2.0)):
        effects = [[float(e) for e in t.effect] for t in pair]
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
