"""How large a disturbance a kernel stands: exact limits, beginnings from other kernels, refusals."""

import json
import math
import re

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.reachability.solve import Answer, Tried, search
from holdfast.errors import ScenarioError, SimulationError
from holdfast.presentation.studies.margin import margin_text
from tests.command_line import called
from tests.scenario_files import LINE

CART = """
[scenario]
title = "A cart that brakes before two walls"
kind = "discriminating-kernel"

[system]
states = { x = { unit = "m" }, v = { unit = "m/s" } }
inputs = { u = { unit = "m/s^2", bounds = [-1, 1] } }
disturbances = { d = { unit = "m/s^2", bounds = ["-push", "push"] } }
parameters = { push = { value = 0.6, unit = "m/s^2" } }
rates = { x = "v", v = "u + d" }

[region]
constraints = { left = { expression = "-1 - x", unit = "m" }, right = { expression = "x - 1", unit = "m" } }

[grid]
nodes = 41
box = { x = [-1.3, 1.3], v = [-1.8, 1.8] }
ends = { v = "extrapolated" }

[march]
horizon = 30
forever = true
"""
PUSH = "system.parameters.push.value"


@pytest.fixture
def cart(tmp_path):
    path = tmp_path / "cart.toml"
    path.write_text(CART)
    return str(path)


@pytest.fixture
def line(tmp_path):
    path = tmp_path / "line.toml"
    path.write_text(LINE)
    return str(path)


FOR_4_S = ["march.forever=false", "march.horizon=4"]


@pytest.mark.few("2.0")
@pytest.mark.parametrize("horizon", [1.5, 2.0])
def test_cart_is_pushed_from_the_middle_to_a_wall_by_what_its_brakes_have_not(cart, horizon):
    """A kernel is left for T seconds if and only if (D - 1) T^2 / 2 < 1, D the largest push."""
    settings = [f"march.horizon={horizon}", "march.forever=false", "grid.nodes=61"]
    found = hf.disturbance_margin(cart, PUSH, overrides=settings)
    assert found.answered
    assert found.monotone
    assert found.high - found.low <= found.tolerance == pytest.approx(0.012)
    assert found.low == pytest.approx(1 + 2 / horizon**2, abs=0.05)
    assert (found.name, found.unit) == ("push", "m/s^2")
    assert not any(t.warm for t in found.trials), "a kernel for a horizon"


def test_unstable_line_is_held_for_ever_by_an_input_stronger_than_the_push(line):
    """|x| <= 0.6 - D, to a cell, as long as there is one."""
    found = hf.disturbance_margin(line, PUSH)
    assert found.forever
    held = [t for t in found.trials if t.answer is Answer.HELD]
    assert all(t.converged for t in held)
    for t in held:
        assert 2.4 * t.fraction / 2 == pytest.approx(0.6 - t.value, abs=0.03)
    assert found.answered
    assert found.low == pytest.approx(0.575, abs=0.002)
    assert found.high <= found.low + found.tolerance


def test_state_of_the_unstable_line_is_kept_for_ever_up_to_a_known_push(line):
    found = hf.disturbance_margin(line, PUSH, keep=[{"x": 0.3}])
    assert found.answered
    assert found.low == pytest.approx(0.3, abs=0.03)


@pytest.mark.few("1.0")
@pytest.mark.parametrize("speed", [0.6, 1.0])
def test_cart_with_a_speed_stops_in_time_up_to_a_known_push(cart, speed):
    """From the middle: v^2 / 2 <= 1 - D."""
    found = hf.disturbance_margin(
        cart, PUSH, keep=[{"v": speed}], tolerance=0.005, overrides=FOR_4_S
    )
    assert found.answered
    assert found.low == pytest.approx(1 - speed**2 / 2, abs=0.04)
    lost = [t for t in found.trials if t.answer is Answer.LOST]
    assert all(np.isnan(t.fraction) for t in lost)
    assert min(t.reached for t in lost) < 3, "it ends as soon as the state is lost"


@pytest.mark.heavy
def test_states_of_a_region_can_be_asked_for(cart):
    x, v = hf.symbol("x"), hf.symbol("v")
    slow = hf.Region(
        "slow", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        (hf.Inequality("c", (x / 0.2) ** 2 + (v / 0.6) ** 2 - 1, "1"),),
    )  # fmt: skip
    found = hf.disturbance_margin(cart, PUSH, keep=[slow], overrides=FOR_4_S)
    alone = hf.disturbance_margin(cart, PUSH, keep=[{"v": 0.5}], overrides=FOR_4_S)
    assert 0.5 < found.low <= alone.high


@pytest.mark.heavy
def test_trials_begun_from_the_kernel_of_a_smaller_bound_are_the_same_in_fewer_steps(line):
    warm, cold = (
        hf.disturbance_margin(line, PUSH, overrides=["march.scheme=upwind"], warm_start=w)
        for w in (True, False)
    )
    assert warm.low == cold.low
    pairs = [(a, b) for a in warm.trials for b in cold.trials if a.value == b.value and a.warm]
    held = [(a, b) for a, b in pairs if b.answer is Answer.HELD]
    assert len(held) >= 3
    for a, b in held:
        assert a.answer is b.answer
        assert a.fraction == pytest.approx(b.fraction, abs=0.25 * 2 / 100)  # a quarter of a cell
    assert sum(a.steps for a, _ in held) < 0.6 * sum(b.steps for _, b in held)
    for a, b in pairs:
        assert a.answer is b.answer or b.answer is Answer.UNDECIDED


def test_scheme_that_may_rest_above_the_kernel_begins_with_the_region(cart):
    """weno5, the default: begun from another kernel it came to rest at a larger one than this."""
    found = hf.disturbance_margin(cart, PUSH, tolerance=0.2)
    assert not any(t.warm for t in found.trials)


def unstable(most, nodes=41):
    x, y, u, d, e = (hf.symbol(n) for n in ("x", "y", "u", "d", "e"))
    plane = hf.System(
        "plane", (hf.Quantity("x"), hf.Quantity("y")), (hf.Quantity("u"),),
        {"x": 0.8 * x + u + d, "y": -y + 0.5 * x + e},
        disturbances=(hf.Quantity("d"), hf.Quantity("e")),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Ball(most, 2),
    )  # fmt: skip
    square = hf.Region(
        "square", plane.states, (hf.Inequality("x", x**2 - 1), hf.Inequality("y", y**2 - 1)),
    )  # fmt: skip
    return plane, square, hf.grid(plane, {"x": (-1.2, 1.2), "y": (-1.2, 1.2)}, nodes)


def test_kernel_begun_from_that_of_a_smaller_bound_is_that_begun_from_the_region():
    options = {"scheme": "upwind", "band": 0.2}
    before = hf.discriminating_kernel(*unstable(0.05), 300.0, **options)
    cold = hf.discriminating_kernel(*unstable(0.1), 300.0, **options)
    warm = hf.discriminating_kernel(*unstable(0.1), 300.0, **options, begin=before)
    assert cold.dataset.attrs["converged"] == warm.dataset.attrs["converged"] == 1
    assert 0 < cold.volume() < before.volume()
    assert warm.dataset.attrs["steps"] <= cold.dataset.attrs["steps"]
    assert np.array_equal(warm.values() > 0, cold.values() > 0)


def test_value_to_begin_with_has_to_be_one_of_the_same_question():
    plane, square, grid = unstable(0.2)
    upwind = {"scheme": "upwind", "band": 0.2}
    done = hf.discriminating_kernel(*unstable(0.1), 100.0, **upwind)
    short = hf.discriminating_kernel(*unstable(0.1), 0.5, **upwind)
    coarse = unstable(0.2, 51)[2]
    for begin, over, options, complaint in (
        (short, grid, {}, "has converged = False; expected True"),
        (done, coarse, {}, "is on another grid"),
        (done, grid, {"scheme": "weno5"}, "cannot begin with another value: its steps"),
        (done, grid, {"dissipation": "local"}, "its steps are not monotone"),
        (done, grid, {"times": [1.0, 2.0]}, "begin or until with times"),
        (done, grid, {"estimate_error": True}, "begin or until with estimate_error"),
    ):
        with pytest.raises(SimulationError, match=complaint):
            hf.discriminating_kernel(plane, square, over, 5.0, begin=begin, **{**upwind, **options})
    with pytest.raises(SimulationError, match="has kind = discriminating-kernel"):
        hf.invariance_kernel(plane, square, grid, 5.0, begin=done, **upwind)
    with pytest.raises(SimulationError, match="cannot begin with another value"):
        hf.backward_reachable_tube(plane, square, grid, 5.0, begin=done)


@pytest.mark.heavy
def test_current_of_any_direction_that_a_coarse_kernel_of_the_camera_stands_for_3_s():
    found = hf.disturbance_margin("ch7-any-current", overrides=["grid.nodes=31"])
    assert found.answered
    assert found.low == pytest.approx(0.284, abs=0.003)


@pytest.mark.heavy
def test_horizon_that_is_too_short_leaves_the_limit_open_and_says_so(cart):
    found = hf.disturbance_margin(cart, PUSH, overrides=["march.horizon=6"])
    assert found.undecided
    assert not found.answered
    assert all(found.low < v < found.high for v in found.undecided)
    assert found.low < 1.0 < found.high
    assert found.summary()["undecided"] == list(found.undecided)


def test_kernel_for_a_horizon_is_never_begun_from_another(cart):
    found = hf.disturbance_margin(cart, PUSH, overrides=["march.forever=false", "march.horizon=2"])
    assert found.answered
    assert found.low > 1.0, "2 s can be stood against more"
    assert not any(t.warm for t in found.trials)


def tried(value, held):
    answer = Answer.HELD if held else Answer.LOST
    return Tried(value, answer, 0.0, 0.1, True, False, 1, 1.0, 0.0)


def test_limit_that_is_none_is_found_out():
    """Held up to 0.3 and again between 0.6 and 0.8: not monotone."""
    trials = search(
        lambda v, *_: tried(v, v <= 0.3 or 0.6 < v < 0.8), 0.0, 1.0, 0.01,
        monotone=False, end=1.0,
    )  # fmt: skip
    found = margin(trials)
    assert found.low <= 0.3 < found.high <= found.low + 0.01
    assert found.answered
    assert found.holds_again
    assert all(0.6 < v < 0.8 for v in found.holds_again)


def margin(trials):
    return hf.Margin("t", "s", "k", "k", "1", False, 1.0, False, 0.01, False, trials)


def test_interval_grows_while_everything_holds():
    trials = search(lambda v, *_: tried(v, v < 5.5), 0.0, 1.0, 0.1, monotone=True, end=math.inf)
    assert margin(trials).low == pytest.approx(5.5, abs=0.1)
    trials = search(lambda v, *_: tried(v, v < 5.5), 0.0, 1.0, 0.1, monotone=True, end=1.0)
    assert margin(trials).high is None
    assert not margin(trials).answered


@pytest.mark.slow(
    "ch7-any-current-options6-between 0.3 and 0.1; expected LOW < HIGH",
    "ch7-any-current-options12-the tolerance is 0; expected above 0",
    "ch7-any-current-options13-give the interval",
    "ch7-any-current-options16---keep: unknown state 'z'",
    "ch7-any-current-options17-is not in region 'camera_and_lasers'",
    "ch7-any-current-options18-the unit 's' does not fit",
)
@pytest.mark.parametrize(
    ("name", "options", "complaint"),
    [
        ("inspection", {}, "'inspection' does not compute a kernel"),
        ("ch7-capture-basin", {}, "'ch7-capture-basin' does not compute a kernel"),
        ("ch7-any-current", {"of": "system.curent_limit"}, "did you mean 'current.speed'|did you"),
        ("ch7-any-current", {"of": "system.name"}, "system.name: 'marine_vehicle' is not a number"),
        ("ch7-any-current", {"of": "march.forever", "overrides": ["march.forever=true"]}, "True is not a number"),
        ("ch7-any-current", {"of": "grid.box"}, "is not a number"),
        ("ch7-any-current", {"between": (0.3, 0.1)}, "between 0.3 and 0.1; expected LOW < HIGH"),
        ("ch7-any-current", {"of": "promise.runs", "between": (1, 12)}, "promise.runs: no kernel depends on it"),
        ("ch7-any-current", {"overrides": ["promise.runs=5"]}, "promise.runs=5: no kernel depends on it"),
        ("ch7-any-current", {"overrides": ["law.outputs.u=0.2"]}, "law.outputs.u=0.2: no kernel depends on it"),
        ("ch7-hold-goal", {"of": "system.thrust_limit"}, "nothing depends on 'thrust_limit'"),
        ("ch7-hold-goal", {"overrides": ["system.thrust_limit=1"]}, "nothing depends on 'thrust_limit'"),
        ("ch7-any-current", {"tolerance": 0.0}, "the tolerance is 0; expected above 0"),
        ("ch7-any-current", {"overrides": ["system.current_limit=0"]}, "give the interval"),
        ("ch7-discriminating", {"overrides": ["disturbance.Vy=0"]}, "is zero and has no direction"),
        ("ch7-any-current", {"overrides": ["march.estimate_error=true"]}, "remove it with --set"),
        ("ch7-any-current", {"keep": [{"z": 1}]}, "--keep: unknown state 'z'"),
        ("ch7-any-current", {"keep": [{"x": 0.1}]}, "is not in region 'camera_and_lasers'"),
        ("ch7-any-current", {"keep": [{"x": "1 s"}]}, "the unit 's' does not fit"),
    ],
)  # fmt: skip
def test_what_cannot_be_searched_is_refused_with_the_reason(name, options, complaint):
    with pytest.raises(ScenarioError, match=complaint):
        hf.disturbance_margin(name, **options)


@pytest.mark.heavy
def test_command_writes_the_trials_and_the_figure(tmp_path):
    answer = called(
        "margin", "ch7-any-current", "--set", "grid.nodes=21", "--tolerance", "0.02",
        "--keep", "x=-0.8,psi=0", cwd=tmp_path,
    )  # fmt: skip
    assert answer.returncode == 0, answer.stderr
    folder = tmp_path / "runs" / "ch7-any-current"
    assert sorted(p.name for p in folder.iterdir()) == ["margin.json", "margin.png", "margin.svg"]
    said = json.loads((folder / "margin.json").read_text())
    assert said["answered"]
    assert 0.1 < said["low"] < said["high"] <= said["low"] + 0.02
    assert re.search(r"the limit +between 0\.\d+ and 0\.\d+ m/s", answer.stdout)
    assert f"--set system.current_limit={said['low']!r}" in answer.stdout
    assert not answer.stderr


def test_command_exits_1_where_no_limit_is_found(tmp_path, cart):
    arguments = ("margin", cart, "--of", PUSH, "--no-figures", "--out", str(tmp_path / "out"))
    answer = called(*arguments, "--between", "1.5", "2")
    assert answer.returncode == 1
    assert "none found: 1.5 m/s^2 is empty already" in answer.stdout
    assert "look elsewhere with --between" in answer.stderr
    answer = called(*arguments, "--keep", "x")
    assert answer.returncode == 2
    assert "expected a state, such as x=-0.8" in answer.stderr


@pytest.mark.heavy
def test_search_for_a_given_current_ends_at_the_bounds_of_the_system():
    few = ["grid.nodes=11", "march.horizon=0.1"]
    found = hf.disturbance_margin("ch7-discriminating", overrides=few)
    assert found.low == max(t.value for t in found.trials) == 0.5
    assert found.high is None
    assert "nothing is lost up to 0.5 m/s, the largest value within the bounds" in margin_text(
        found
    )
    few.append("system.current_limit=2")
    found = hf.disturbance_margin("ch7-discriminating", overrides=few)
    assert max(t.value for t in found.trials) > 1.0


@pytest.mark.heavy
def test_search_over_the_horizon_is_not_held_by_the_samples_of_the_promise():
    found = hf.disturbance_margin(
        "ch7-any-current", "march.horizon", between=(1.0, 1.755), tolerance=0.2,
        overrides=["grid.nodes=11"],
    )  # fmt: skip
    assert any(t.value % 0.02 > 1e-3 for t in found.trials)


def test_speed_of_a_given_current_keeps_its_direction():
    found = hf.disturbance_margin(
        "ch7-discriminating", between=(0.0, 0.4), tolerance=0.39,
        overrides=["grid.nodes=11", "march.horizon=0.2", "disturbance.Vx=0.3", "disturbance.Vy=-0.4"],
    )  # fmt: skip
    assert not found.monotone
    assert found.settings[-2:] == ("disturbance.Vx=0.24", "disturbance.Vy=-0.32000000000000006")
