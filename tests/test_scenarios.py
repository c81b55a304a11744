"""Every shipped scenario loads, runs, and keeps what its description promises."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.safety.validation import at_rest
from holdfast.errors import ScenarioError
from holdfast.maths.expressions.functions import (
    angle,
    greatest,
    least,
    length,
    magnitude,
    sgn,
    wrap,
)
from holdfast.scenario.files import scenario_names
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario
from tests.scenario_files import scenarios_of

CLOSED_LOOPS = scenarios_of("closed-loop")
"""Formations have one start; `tests/scenario/test_formation.py` runs them."""


def says_what_it_is(scenario):
    about = scenario.about if isinstance(scenario, KernelScenario) else scenario.region
    return scenario.title and scenario.source and (about or scenario.goal) is not None


@pytest.mark.parametrize("name", [n for n in scenario_names() if n not in CLOSED_LOOPS])
def test_every_kernel_and_formation_loads_and_says_what_it_is(name):
    assert says_what_it_is(load_scenario(name))


LEAVING = {
    "ch5-leaves-view": "what the convergent law alone does",
    "ch7-rescue": "thrusters off: the worst of the laws that are compared",
}
"""Scenarios that show how a region is left."""


@pytest.mark.slow(
    "berth-filter",
    "ch3-dynamic",
    "ch4-car",
    "ch5-any-current",
    "ch5-current",
    "ch5-rescue",
    "craft-berth",
    "crossing-boats",
    "ferry-quay",
    "inspection",
    "inspection-eddy",
    "inspection-swift-current",
    "inspection-tide",
    "otter-current",
    "trailer-off-axle",
)
@pytest.mark.parametrize("name", CLOSED_LOOPS)
def test_every_closed_loop_says_what_it_is_runs_and_keeps_its_constraints(name):
    """For ten seconds, from its first six starts, up to its own tolerance."""
    scenario = load_scenario(name, ["run.horizon=10"], runs=6)
    assert says_what_it_is(scenario)
    result = scenario.run()
    data = result.dataset
    assert data.sizes["run"] == 6
    assert np.isfinite(data["state"].values).all()
    worst = data["worst_constraint"].values.max(axis=1, initial=-np.inf)
    kept = worst <= scenario.settings.get("tolerance", 0.0)
    assert result.viable == kept.sum()
    assert kept.all() != (name in LEAVING)


def test_inspection_keeps_the_view_from_every_start_and_brings_each_to_the_pose():
    """203 starts at 5 N, two constraints active at one of them; at most two cusps on the way."""
    result = load_scenario("inspection").run()
    assert result.dataset.sizes["run"] == 203
    assert result.viable == result.outcomes["reached goal"] == 203
    assert result.dataset["infeasible"].values.max() == 0
    assert result.dataset["switches"].values.max() <= 4


def wrapped(angles):
    return (angles + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.thesis
def test_blending_reports_the_true_fraction_of_viable_starts():
    """203 starts at 5 N: the corrected blending keeps at least 197 and brings 93 % to the goal.

    What is reported is what the recorded states say of the constraints, run by run.
    """
    scenario = load_scenario("ch5-viable-goal-set")
    result = scenario.run()
    data = result.dataset
    assert data.sizes["run"] == 203
    x, y, psi = (data["state"].sel(state_name=n).values for n in ("x", "y", "psi"))
    rows = [
        wrapped(psi - np.arctan2(-0.1 - y, -x)) - np.pi / 6,
        wrapped(np.arctan2(0.1 - y, -x) - psi) - np.pi / 6,
        0.35 * np.cos(psi) + x,
        -x - 2.0 * np.cos(psi),
    ]
    tolerance = scenario.settings["tolerance"]
    kept = np.max(rows, axis=(0, 2)) <= tolerance
    assert result.viable == kept.sum() >= 197
    assert result.outcomes["diverged"] == 0
    assert result.outcomes["reached goal"] / 203 > 0.93
    worst = result.summary()["worst_constraint"]
    assert worst["too_far"] < 0.075, "every failure is at the far limit"
    assert max(v for k, v in worst.items() if k != "too_far") <= tolerance
    assert max(result.summary()["peak_actuator"].values()) <= 5.0 + 1e-9


def test_wheeled_robot_written_in_toml_keeps_the_beacon_in_view_from_every_start():
    result = load_scenario("wheeled_camera").run()
    assert result.viable == 103
    assert max(result.summary()["worst_constraint"].values()) < 0
    assert result.outcomes["reached goal"] >= 100


def robot_in_python():
    """System, law, region and goal of wheeled_camera.toml: the unicycle of the catalogue, r for w."""
    x, y, psi = (hf.symbol(n) for n in ("x", "y", "psi"))
    system = hf.systems.unicycle(speed_limit=0.4, turn_limit=1.5)
    guard, dock = sp.Float(1e-12), sp.Float(-0.8)
    bearing, distance = angle(-y, -x, guard), length(x, y, guard)
    view = hf.Region(
        "view", system.states,
        (
            hf.Inequality("left", wrap(bearing - psi) - math.radians(35), "rad"),
            hf.Inequality("right", wrap(psi - bearing) - math.radians(35), "rad"),
            hf.Inequality("near", 0.4 - distance, "m"),
            hf.Inequality("far", distance - 3, "m"),
        ),
    )  # fmt: skip
    ahead = x - dock
    field = angle(3 * ahead * y, 2 * ahead**2 - y**2, guard)
    speed = -sgn(ahead * sp.cos(psi) + y * sp.sin(psi)) * sp.tanh(1.5 * length(ahead, y, guard)) / 4
    along = speed * (sp.diff(field, x) * sp.cos(psi) + sp.diff(field, y) * sp.sin(psi))
    face = -2 * wrap(psi - bearing)
    circle = sp.tanh(1.5 * (distance + dock)) / 4

    def law(name, forward, turn):
        return hf.Law(name, system.states, {"v": forward, "r": turn})

    hold = law("hold", circle, face)
    blend = hf.redesign(
        law("go", speed, along - wrap(psi - field)), view,
        viable={
            "left": hold, "right": hold,
            "near": law("back", sp.Float(-0.05), face), "far": law("on", sp.Float(0.05), face),
        },
        layers=dict.fromkeys(("left", "right"), (-0.25, -0.08))
        | dict.fromkeys(("near", "far"), (-0.15, -0.05)),
        hold=hold, hold_when=0.03 - magnitude(distance + dock), goal={"x": -0.8},
    )  # fmt: skip
    at_dock = greatest(length(ahead, y, guard) / 0.03, magnitude(wrap(psi)) / 0.05)
    on_circle = greatest(magnitude(distance + dock) / 0.03, magnitude(wrap(psi - bearing)) / 0.05)
    goal = hf.Region("goal", system.states, (hf.Inequality("goal", least(at_dock, on_circle) - 1),))
    return system, blend, view, goal


def test_mechanism_of_the_toml_robot_is_that_of_the_catalogue():
    """The same unicycle, law and region written in Python give the same trajectories."""
    by_toml = load_scenario("wheeled_camera").run().dataset
    system, law, region, goal = robot_in_python()
    starts = by_toml["state"].values[:, 0]
    settings = {"horizon": 60.0, "sample_time": 0.02, "substeps": 1, "record_every": 0.1}
    by_python = hf.simulate(
        system, law, region=region, goal=goal, starts=starts, **settings
    ).dataset  # fmt: skip
    assert by_python["state"].values == pytest.approx(by_toml["state"].values, abs=1e-9)
    for name in ("outcome", "mode", "switches"):
        assert np.array_equal(by_python[name].values, by_toml[name].values)


def test_switching_law_can_be_written_in_a_file(tmp_path):
    text = """
[scenario]
title = "thermostat"
[system]
states = { T = { unit = "m" } }
inputs = { heat = { unit = "m/s", bounds = [0, 2] } }
rates = { T = "heat - k*T" }
parameters = { k = { value = 0.5, unit = "1/s" } }
[law]
parameters = { low = 1.0, high = 2.0 }
definitions = { middle = "(low + high)/2" }
signals = { error = "T - middle" }
modes = { on = { outputs = { heat = "2" } }, off = { outputs = { heat = "0" } } }
transitions = [{ from = "on", to = "off", when = "T > high" }, { from = "off", to = "on", when = "T < low and time_in_mode > 0.1" }]
[starts]
states = [{ T = 0 }]
[run]
horizon = 30
"""
    path = tmp_path / "thermostat.toml"
    path.write_text(text)
    data = load_scenario(str(path)).run().dataset
    temperature = data["state"].values[0, 100:, 0]
    assert temperature.min() == pytest.approx(1.0, abs=0.05)
    assert temperature.max() == pytest.approx(2.0, abs=0.05)
    assert data["switches"].values[0] > 5
    assert data["signal"].sel(signal_name="error").values[0, 0] == pytest.approx(-1.5)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('x = "v*cos(psi)"', 'x = "v*cos(pso)"', "system.rates.x: unknown name 'pso'"),
        ('x = "v*cos(psi)"', "", "'x' has no rate"),
        ("rhs = 0", 'rhs = "1"', "leave Pfaffian row 1"),
        (
            'near = { value = "40 cm"',
            'near = { value = "40 kg"',
            "region.parameters.near.value: the unit",
        ),
        (
            'near = { value = "40 cm", unit = "m"',
            'near = { value = 4, unit = "flurb"',
            "'flurb' is not a unit",
        ),
        (
            'unit = "rad", description = "heading"',
            'unit = "deg", description = "heading"',
            "has unit 'deg'",
        ),
        ('v = "forward"', 'vv = "forward"', "expected the outputs of 'follow_dipole': vv, w"),
        ('rho = "hypot(x, y)"', 'rho = "hypot(x, y"', "region.definitions.rho"),
        ('rho = "hypot(x, y)"', 'psi = "hypot(x, y)"', "'psi' is already declared"),
        ('phi = "atan2', 'sin = "atan2', "law.definitions.sin: 'sin' cannot name"),
        ("diff(phi, x)", "diff(phi, speed)", "'diff' by the definition 'speed'"),
        ('kind = "cone"', 'kind = "cube"', "region.scene.1.kind: got 'cube'"),
        ('apex = ["x", "y"]', "", "a cone needs 'apex'"),
        ("v_max = { value = 0.4,", "v_max = { valu = 0.4,", "valu"),
        ('bounds = ["-v_max", "v_max"]', 'bounds = ["v_max"]', "system.inputs.v.bounds"),
        ('bounds = ["-v_max", "v_max"]', 'bounds = ["-v_mix", "v_max"]', "did you mean 'v_max'"),
    ],
)
def test_mistake_in_a_users_own_definition_names_the_key(tmp_path, old, new, complaint):
    from holdfast.scenario.files import read_text

    text = read_text("wheeled_camera")[1]
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ScenarioError) as caught:
        load_scenario(str(path)).run()
    assert complaint in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_overrides_reach_parameters_that_laws_share():
    scenario = load_scenario(
        "ch5-viable-goal-set", ["law.k1=0.12", "redesign.parameters.distance=0.6"]
    )
    values = {p.name: p.value for p in scenario.law.parameters}
    assert values["k1"] == 0.12
    assert values["distance"] == 0.6
    assert {p.name: p.value for p in scenario.goal.parameters}["distance"] == 0.6


def test_runs_takes_the_given_states_first():
    scenario = load_scenario("inspection", runs=2)
    assert len(scenario.starts.states) == 2
    assert scenario.starts.random == 0
    assert load_scenario("inspection", runs=10).starts.random == 7


CHAPTERS_2_AND_4 = [n for n in scenario_names() if n.startswith(("ch2-", "ch4-"))]


@pytest.mark.thesis
@pytest.mark.parametrize("name", CHAPTERS_2_AND_4)
def test_steering_scenario_brings_every_start_to_the_origin(name):
    """500 random starts and the given ones; none leaves the region where its law is regular."""
    result = load_scenario(name).run()
    assert result.dataset.sizes["run"] >= 500
    assert result.summary()["success_fraction"] == 1.0
    assert result.outcomes["left region"] == result.outcomes["diverged"] == 0


@pytest.mark.thesis
@pytest.mark.parametrize("name", ["ch3-known-current", "ch3-unknown-current"])
def test_station_is_held_in_the_current_from_every_start(name):
    result = load_scenario(name).run()
    assert result.dataset.sizes["run"] == 501
    assert result.success_fraction == 1.0


@pytest.mark.parametrize("n", [4, *(pytest.param(n, marks=pytest.mark.heavy) for n in (3, 6, 8))])
def test_chained_form_of_any_dimension_is_one_override_away(n):
    result = load_scenario("ch4-chained-n", [f"system.n={n}"], runs=50).run()
    assert result.dataset.sizes["state_name"] == n
    assert result.success_fraction == 1.0


@pytest.mark.heavy
def test_chained_form_of_ten_states_needs_a_large_x1_and_steps_of_a_millisecond():
    far = [f"law.{k}" for k in ("threshold=10", "escape_speed=5", "escape_time=4")]
    changes = ["system.n=10", "run.sample_time=0.001", *far]
    assert load_scenario("ch4-chained-n", changes, runs=40).run().success_fraction == 1.0
    held_longer = load_scenario("ch4-chained-n", [*changes, "run.sample_time=0.01"], runs=40).run()
    assert held_longer.success_fraction < 0.5


def test_second_trailer_is_one_override_away():
    result = load_scenario("ch4-trailer", ["system.trailers=2"], runs=100).run()
    assert result.dataset.sizes["state_name"] == 5
    assert result.success_fraction == 1.0


@pytest.mark.parametrize(
    ("name", "change", "complaint"),
    [
        ("ch4-unicycle", "law.lam=1", "'lam' is 1; expected above 1"),
        (
            "ch4-chained-n",
            "system.n=2",
            "n of the chained form is 2; expected a whole number from 3",
        ),
        ("ch4-chained-n", "system.n=4.0", "n of the chained form is 4.0"),
        ("ch4-chained-n", "law.poles=[-1, -2]", "2 poles for 5 states; expected 4"),
        ("ch4-chained-n", "law.poles=1.0", "the pole 1.+ expected a negative real part"),
        ("ch4-chained-n", 'law.poles="fast"', "the poles are 'fast'"),
        ("ch4-chained-4", "law.gains=[200, 200, 200]", "eigenvalues 1.005.+ that does not decide"),
        ("ch4-chained-4", "law.gains=[1, 2]", "the gains are .+ expected 3 numbers"),
        ("ch4-chained-4", "system.n=5", "expected 4 numbers, k2 to k5"),
        ("ch4-integrator", "law.k1=0.5", "expected k1 > k2"),
        ("ch2-integrator", "law.k=2", "expected k > 2 k1"),
        ("ch4-marine", "law.k1=0.5", "side-slips into the origin"),
        ("ch4-chained-4", "law.poles=-1", "both poles and gains; expected one of them"),
        ("ch4-car", 'law.name="steer_unicycle"', "no such parameter|not made for system 'car'"),
        ("ch4-trailer", "system.trailers=9", "expected a whole number from 1 to 3"),
        ("ch4-chained-n", 'law.escape="run"', "expected 'steer' or 'coast'"),
        ("ch2-unicycle", 'law.output="x"', "expected 'h' or 'angle'"),
    ],
)
def test_bad_gains_and_dimensions_are_refused_with_the_reason(name, change, complaint):
    with pytest.raises(ScenarioError, match=complaint):
        load_scenario(name, [change])


def test_gains_are_judged_with_the_k1_that_is_given_beside_them():
    """k2 = 0.3 is right for k1 = 0.1 and wrong for the standard k1 = 1."""
    right = ["law.k1=0.1", "law.gains=[0.3, 0.4]"]
    assert load_scenario("ch4-chained-3", right).law.conditions
    with pytest.raises(ScenarioError, match="with k1 = 1 and gains"):
        load_scenario("ch4-chained-3", ["law.k1=1", right[1]])


def test_key_with_nothing_after_the_sign_is_taken_away():
    poles = load_scenario("ch4-chained-4", ["law.gains=", "law.poles=-1.5"])
    values = {p.name: p.value for p in poles.law.parameters}
    assert (values["k2"], values["k3"]) == (7.5, 27.25)


@pytest.mark.heavy
def test_safeguard_keeps_constraints_of_its_own_beside_those_of_the_region():
    """Four thruster limits, four constraints of the view, and |psi| <= 1.01 as its two pieces.

    Over the box of the model a constraint of the view has four conditions, a piece of psi's one.
    """
    own = ["safeguard.constraints.heading={expression='abs(psi) - 1.01', unit='rad'}"]
    scenario = load_scenario("inspection", own, runs=3)
    guard = next(iter(scenario.law.modes.values())).safeguard
    assert (guard.hard, len(guard.offsets)) == (4, 22)
    nominal = load_scenario("inspection", [*own, "safeguard.uncertain="], runs=3).law.modes
    assert {len(law.safeguard.offsets) for law in nominal.values()} == {10}
    assert scenario.region.inequality_names == ("edge_low", "edge_high", "too_near", "too_far")
    data = load_scenario("inspection", own, runs=20).run().dataset
    assert np.abs(data["state"].sel(state_name="psi").values[3:]).max() < 1.06


@pytest.mark.slow(
    "inspection-changes4-let the inputs track them",
    "inspection-changes5-observer: 'z' is not a state",
    "inspection-changes6-bandwidth is 0.0",
    "inspection-changes7-delay a whole multiple of sample_time",
)
@pytest.mark.parametrize(
    ("name", "changes", "complaint"),
    [
        (
            "inspection",
            ["safeguard.margins.edge_lo=0.1"],
            "safeguard.margins.edge_lo: unknown name",
        ),
        ("inspection", ["safeguard.margins.edge_low='2 m'"], "does not fit"),
        ("inspection", ["safeguard.gains=[1.0, -1.0]"], "safeguard: gains"),
        ("inspection", ["safeguard.constraints.heading='abs(chi) - 1'"], "unknown name 'chi'"),
        ("inspection", ["tracking="], "let the inputs track them"),
        ("inspection", ["observer.measured=['z']"], "observer: 'z' is not a state"),
        ("inspection", ["observer.bandwidth=0.0"], "bandwidth is 0.0"),
        ("inspection", ["run.delay=0.015"], "delay a whole multiple of sample_time"),
        ("inspection", ["system.promote=['u']"], "expected { state = [lowest, highest] }"),
        ("inspection", ["system.promote.w=[0, 1]"], "system.promote: unknown name"),
        ("inspection", ["compare.laws.x.without=3"], "compare.laws.x.without"),
    ],
)
def test_tables_of_the_safeguard_are_checked(name, changes, complaint):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(name, changes).run()
    assert complaint in str(caught.value)


@pytest.mark.parametrize("given", ["3", "[1]", "[1, 2, 3]", "{ a = 1 }", "[[1], 2]", "[true, 1]"])
@pytest.mark.parametrize(
    ("name", "key", "expected"),
    [
        ("ch7-discriminating", "grid.box.x", "two numbers [low, high]"),
        ("ch7-discriminating", "figures.plane", 'two names of states, such as ["x", "y"]'),
        ("inspection", "figures.plane", 'two names of states, such as ["x", "y"]'),
        ("inspection", "starts.box.x", "two numbers [low, high]"),
        ("inspection", "starts.every", "two numbers [low, high]"),
        ("inspection", "varied.draws.speed.range", "two numbers [low, high]"),
        ("inspection", "safeguard.gains", "two numbers [k1, k2]"),
        ("ch5-viable-goal-set", "redesign.layers.too_near", "two numbers [cmax, cmin]"),
        ("wheeled_camera", "system.inputs.v.bounds", "two numbers or expressions [low, high]"),
    ],
)
def test_what_is_no_array_of_two_is_told_which_two_it_should_be(name, key, expected, given):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(name, [f"{key}={given}"])
    said = str(caught.value)
    assert f"{key}: got " in said
    assert said.endswith(f"; expected {expected}")


def test_draw_is_told_which_two_it_should_be():
    for given in ("3", "[1]", "'fast'"):
        with pytest.raises(
            ScenarioError, match=r"varied.draws.speed: .* two numbers \[low, high\]"
        ):
            load_scenario("inspection", [f"varied.draws.speed={given}"])


def test_centre_of_what_is_drawn_is_told_which_two_it_should_be():
    change = "region.scene=[{ kind='circle', role='buoy', centre=3, radius=1 }]"
    with pytest.raises(ScenarioError, match=r"centre: got 3; expected two .* \[x, y\]"):
        load_scenario("wheeled_camera", [change])


@pytest.mark.heavy
@pytest.mark.parametrize(("name", "share"), [("pushed-cart", 0.70), ("seen-by-thrust", 0.61)])
def test_kernels_of_the_certificates_in_four_states_keep_what_they_promise(name, share):
    """Their grids go on to the greatest speeds, so that no start leaves them."""
    answer = load_scenario(name).run()
    assert not answer.value.report.ends_reached
    assert answer.promise.outcome == "confirmed from inside"
    assert all(t.off_grid == 0 for t in answer.promise.inside)
    assert answer.promise.kept_share == pytest.approx(share, abs=0.01)


@pytest.mark.heavy
def test_filter_keeps_the_kernel_of_camera_and_lasers_on_a_coarse_grid():
    """Legs ahead and back move the vehicle along the wall, and V has a ridge between them."""
    coarse = ["grid.nodes={R=38, beta=96, delta=31}", "march.horizon=20"]
    scenario = load_scenario("seen-with-lasers", coarse)
    answer = scenario.run()
    assert answer.promise.outcome == "confirmed"
    law = at_rest(scenario.system)
    tried = hf.check_promise(
        scenario.system, answer.value, scenario.region, law=law, runs=40, horizon=9,
        sample_time=0.02, rate=2.0,
    )  # fmt: skip
    assert tried.outcome == "confirmed"
    assert tried.tried_share == pytest.approx(1.0, abs=1e-9)


def test_overrides_are_texts_or_a_table():
    by_text = hf.load_scenario("ch2-unicycle", ["run.horizon=4", 'run.sample_time="20 ms"'])
    by_key = hf.load_scenario("ch2-unicycle", {"run.horizon": 4, "run.sample_time": "20 ms"})
    nested = hf.load_scenario("ch2-unicycle", {"run": {"horizon": 4, "sample_time": "20 ms"}})
    states = {"starts.states": [{"x": 1.0, "y": np.float32(0.5)}], "run.horizon": np.int64(2)}
    assert hf.load_scenario("ch2-unicycle", states).starts.states[0]["y"] == 0.5
    with pytest.raises(ScenarioError, match=r"overrides: run\.horizon is None; expected a number"):
        hf.load_scenario("ch2-unicycle", {"run.horizon": None})
    assert by_key.settings == by_text.settings == nested.settings
    assert by_key.settings["horizon"] == 4
    with pytest.raises(ScenarioError, match=r'expected a list, such as \["run.horizon=4"\]'):
        hf.load_scenario("ch2-unicycle", "run.horizon=4")
