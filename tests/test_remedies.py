"""What a first hour gets wrong: every refusal names the place, and its remedy is right."""

import copy
import pickle
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.safety.promise import Layer, Promise, Trials
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.errors import HoldfastError
from tests.command_line import holdfast

X, U = sp.Symbol("x"), sp.Symbol("u")  # as a user of SymPy writes them
STATES, INPUTS = (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),)

MOWER = """
[scenario]
title = "Mower"
kind = "viability-kernel"
[system]
name = "mower"
states = { x = { unit = "m" }, y = { unit = "m" }, th = { unit = "rad", angle = true } }
inputs = { v = { unit = "m/s", bounds = [0, 1] }, w = { unit = "rad/s", bounds = [-1, 1] } }
rates = { x = "v*cos(th)", y = "v*sin(th)", th = "w" }
[region]
constraints = { lawn = { expression = "abs(y) - 3", unit = "m" } }
[grid]
nodes = 11
box = { x = [-4, 4], y = [-4, 4], th = ["-180 deg", "180 deg"] }
[march]
horizon = 1
"""

FILES = {
    # what is changed in the file: what is said
    ("abs(y) - 3", "abs(y) <= 3"): "region.constraints.lawn.expression: a condition where a value is "
        "wanted in 'abs(y) <= 3'; for an inequality write what is at most 0 where it holds, "
        "'abs(y) - 3', for a choice 'a if condition else b'",
    ("abs(y) - 3", "3 > abs(y) + 1"): "'abs(y) + 1 - 3'",
    ("abs(y) - 3", "not abs(y) <= 3"): "write 'a if condition else b'",
    ("v*cos(th)", "v*cosine(th)"): "'cosine' is not allowed in 'v*cosine(th)'; did you mean 'cos'?",
    ("v*sin(th)", "v*sine(th)"): "did you mean 'sin'?",
    ("v*sin(th)", "v*sin(theta)"): "unknown name 'theta'",
    ("[0, 1]", "[1, 0]"): "system.inputs.v.bounds: box has the empty interval [1, 0]",
    ("[-1, 1]", "[1, -1]"): "system.inputs.w.bounds: box has the empty interval [1, -1]",
    ("[0, 1]", "[0]"): "system.inputs.v.bounds",
    ('th = ["-180 deg", "180 deg"]', 'psi = ["-180 deg", "180 deg"]'): "grid.box.psi: unknown name; allowed: th, x, y",
    (', th = ["-180 deg", "180 deg"]', ""): "the grid has no interval for 'th'",
    ('th = "w"', 'phi = "w"'): "'phi'",
    ('"viability-kernel"', '"viabilty-kernel"'): "did you mean 'viability-kernel'?",
    ("horizon = 1", "horizont = 1"): "did you mean 'horizon'?",
    ("horizon = 1", 'horizon = "1 m"'): "'m' does not fit",
    ("nodes = 11", "nodes = 1"): "nodes along 'x': 1; expected a whole number of at least 2",
    ("nodes = 11", 'nodes = "eleven"'): "grid.nodes",
    ('unit = "m/s"', 'unit = "knotz"'): "'knotz'",
    ("[grid]", "[gird]"): "did you mean 'grid'?",
    ('title = "Mower"', "title = Mower"): "not a TOML file",
    ("v*cos(th)", "v*cos(v)"): "the rate of 'x' of system 'mower': the term 'cos(v)', whose 'v' is in "
        "m/s; expected an angle in rad or a number without a unit; correct it, or multiply it by a "
        "parameter in s/m; where units do not count say why: empirical = ",
    ("v*cos(th)", "v*cos(th) + w"): "'v*cos(th) + w' adds 'w' in rad/s and 'v*cos(th)' in m/s; expected one",
    ("[0, 1]", '["0 m/s^2", "1 m/s^2"]'): "system.inputs.v.bounds: the unit 'm/s^2' does not fit; expected 'm/s'",
    ("[0, 1]", '[0, "1 knotz"]'): "system.inputs.v.bounds: '1 knotz' is not an expression",
    ("abs(y) - 3", "y**2"): "region: inequality 'lawn' of region 'region': 'y**2' is in m^2; expected m",
    ('name = "mower"', 'name = "mower"\nempirical = true'): "system.empirical: got True; expected the "
        'reason as text, such as empirical = "drag fitted to a tank test"',
    ("[-1, 1]", '["60 deg/s", "-60 deg/s"]'): "system.inputs.w.bounds: box has the empty interval [1.047",
    ("[-1, 1]", '["61 deg/s", "-61 deg/s"]'): ', written as ["61 deg/s", "-61 deg/s"]',
    ('["-180 deg", "180 deg"]', '["180 deg", "-180 deg"]'): "grid: the interval of 'th' is [3.14159, "
        '-3.14159], written as box.th = ["180 deg", "-180 deg"]; expected low < high',
    ("horizon = 1", 'horizon = "-2 min"'): 'march: the horizon [s] is -120.0, written as horizon = "-2 min"',
    ('unit = "rad/s"', 'unit = "deg/s"'): "'w' is in deg/s; expected 1/s",
}  # fmt: skip


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mower.toml").write_text(MOWER)
    return tmp_path


def said(*words, status):
    """What the command writes, to its output or as an error."""
    ended = holdfast(*map(str, words), cwd=Path.cwd())
    assert ended.returncode == status, (ended.stdout, ended.stderr)
    assert "Traceback" not in ended.stderr
    return ended.stdout or ended.stderr


@pytest.mark.parametrize("change", FILES)
def test_what_is_wrong_in_a_file_is_said_with_its_place_and_a_remedy(here, change):
    assert change[0] in MOWER
    Path("mower.toml").write_text(MOWER.replace(*change, 1))
    output = said("run", "mower.toml", status=2)
    assert FILES[change] in output
    assert output.startswith("holdfast: mower.toml: ")
    assert len(output.splitlines()) == 1


def line(**more):
    return hf.System("line", STATES, INPUTS, {"x": U}, **more)


def car(**rates):
    """A car whose steering angle is an input; rates: other ones than those of the rear axle."""
    states = (*STATES, hf.Quantity("y", "m"), hf.Quantity("th", "rad", angle=True))
    rear = {"x": "2.0*cos(th)", "y": "2.0*sin(th)", "th": "tan(delta)"}
    inputs, bounds = (hf.Quantity("delta", "rad"),), hf.Box((-0.5,), (0.5,))
    return hf.System(
        "car", states, inputs, rear | rates, input_bounds=bounds, empirical="per metre"
    )


def within(system, expression, more=()):
    limits = (hf.Inequality("edge", expression), *more)
    return hf.Region("road", system.states, limits, empirical="no unit")


STILL = hf.System("still", STATES, (), {"x": -1.0 * X})
WALL = hf.Region("wall", STATES, (hf.Inequality("right", X - 1, "m"),))


def still_set():
    grid = hf.grid(STILL, {"x": (-2, 2)}, 21, {"x": "extrapolated"})
    return hf.viability_kernel(STILL, WALL, grid, 1.0)


CALLS = {
    "a filter of a steering angle": (
        lambda: hf.SafetyFilter(car(), within(car(), "th - 1")),
        "command the rate of 'delta' instead: hf.dynamic_extension(system, ('delta',)), with the "
        "bounds hf.input_limits(system, ('delta',)) in the region",
    ),
    "a filter of a steering angle that acts late": (
        lambda: hf.SafetyFilter(car(), within(car(), "y - 3")),
        "take another input than 'delta', such as the tangent of a steering angle, or keep a kernel",
    ),
    "a grid in degrees": (
        lambda: hf.grid(car(), {"x": (-1, 1), "y": (-1, 1), "th": ("200 deg", "10 deg")}, 9),
        "the interval of 'th' is [200 deg, 10 deg]",
    ),
    "input_bounds=hf.Box((1,), (0,))": (
        lambda: line(input_bounds=hf.Box((1,), (0,))), "empty interval [1, 0]",
    ),
    "the second side of a box": (
        lambda: hf.Box((-1, 0), (1, -2)), "empty interval [0, -2] at place 1 of 0 to 1",
    ),
    "a relation as an inequality": (
        lambda: hf.Inequality("wall", X <= 3, "m"),
        "is the relation x <= 3; expected an expression that is at most 0 where it holds; write x - 3",
    ),
    "an equation": (lambda: hf.Inequality("wall", sp.Eq(X, 3)), "is the relation Eq(x, 3)"),
    "two relations": (
        lambda: hf.Inequality("wall", sp.And(X < 1, X > -1)), "write an inequality for each part",
    ),
    "a law of a system that has no inputs": (
        lambda: hf.check_promise(STILL, still_set(), WALL, law=hf.Law("home", STATES, {"u": -1.5 * X})),
        "system 'still' has no inputs; expected no law",
    ),
    "the other relation": (lambda: hf.Inequality("wall", X > 1, "m"), "write 1 - x"),
    "a relation in a text": (
        lambda: hf.Inequality("wall", "abs(x) <= 3", "m"), "'abs(x) - 3'",
    ),
    "a bound that is no expression": (lambda: hf.Box(("-a",), ("a +",)), "'a +' is not an"),
    "an end of a grid in another unit": (
        lambda: hf.grid(line(), {"x": ("-3 kg", 3)}, 9), 'such as "1 m"',
    ),
    "a rate of a name that nobody declared": (
        lambda: hf.System("line", STATES, INPUTS, {"x": "u + w"}), "undeclared name 'w'",
    ),
    "a rate that is no expression": (
        lambda: hf.System("line", STATES, INPUTS, {"x": "u +"}), "'u +' is not an expression",
    ),
    "a rate that calls a program": (
        lambda: hf.System("line", STATES, INPUTS, {"x": "__import__('os').getcwd()"}),
        "a call of anything but a function name is not allowed",
    ),
    "an unknown scenario": (lambda: hf.load_scenario("inspektion"), "did you mean 'inspection'?"),
    "an unknown vehicle": (lambda: hf.load_vehicle("bluerov"), "bluerov2"),
    "a start of another state": (
        lambda: hf.simulate(line(), hf.Law("home", STATES, {"u": -1.5 * X}), starts=[{"y": 1}], horizon=1),
        "'y'",
    ),
    "a start of another length": (
        lambda: hf.simulate(line(), hf.Law("home", STATES, {"u": -1.5 * X}), starts=[[1, 2]], horizon=1),
        "expected (runs, 1) for the states x",
    ),
    "a horizon below 0": (
        lambda: hf.simulate(line(), hf.Law("home", STATES, {"u": -1.5 * X}), starts=[[1]], horizon=-1),
        "horizon",
    ),
    "a law without its output": (
        lambda: hf.simulate(line(), hf.Law("home", STATES, {"v": -1.5 * X}), starts=[[1]], horizon=1),
        "law 'home' gives v; expected the inputs of system 'line': u",
    ),
    "a scheme that is misspelt": (
        lambda: hf.viability_kernel(
            line(input_bounds=hf.Box((-1,), (1,))),
            hf.Region("r", STATES, (hf.Inequality("c", X, "m"),)),
            hf.grid(line(), {"x": (-1, 1)}, 11), 1.0, scheme="weno"),
        "weno5",
    ),
}  # fmt: skip


@pytest.mark.parametrize("call", CALLS)
def test_what_is_wrong_in_a_call_is_said(call):
    wrong, message = CALLS[call]
    with pytest.raises(HoldfastError, match=re.escape(message)):
        wrong()


def test_names_are_enough():
    """Plain symbols of SymPy, and texts, stand for the states and inputs of their names."""
    declared = hf.System("line", STATES, INPUTS, {"x": hf.symbol("u") * sp.cos(2 * hf.symbol("x"))})
    assert hf.System("line", STATES, INPUTS, {"x": U * sp.cos(2 * X)}) == declared
    assert hf.System("line", STATES, INPUTS, {"x": "u*cos(2*x)"}) == declared
    assert (
        hf.System("line", STATES, INPUTS, {"x": sp.Symbol("u", positive=True) * sp.cos(2 * X)})
        == declared
    )
    law = hf.Law("home", STATES, {"u": -1.5 * X})
    assert (
        law
        == hf.Law("home", STATES, {"u": "-1.5*x"})
        == hf.Law("home", STATES, {"u": -1.5 * hf.symbol("x")})
    )
    assert hf.Inequality("wall", X - 3).expression == hf.symbol("x") - 3
    assert hf.System("line", STATES, INPUTS, {"x": "u + pi"}).rates["x"] == hf.symbol("u") + sp.pi


def test_a_file_is_found_by_its_name_without_its_ending(here):
    assert "Mower" in holdfast("run", "mower", "--no-figures", "--out", "out", cwd=here).stdout
    assert tomllib.loads(said("show", "mower", status=0))["system"]["name"] == "mower"
    assert "did you mean 'mower'?" in said("run", "mowr", status=2)
    assert said("run", "mover", status=2).startswith("holdfast: unknown scenario 'mover'; ")


@pytest.mark.parametrize("name", ["x" * 300, "a/b", "\x01"])
def test_a_name_that_is_none_of_a_file_is_refused(here, name):
    assert "holdfast: " in said("run", name, status=2)
    assert "holdfast: " in said("show", name, status=2)


def test_a_margin_without_a_disturbance_says_so(here):
    output = said("margin", "mower.toml", status=2)
    assert "system 'mower' has no current, and no other disturbance" in output
    assert "name the key of the number to vary with --of" in output


def test_a_vehicle_of_ones_own_is_shown(here):
    shipped = Path(hf.__file__).parent / "vehicles" / "bluerov2.toml"
    shutil.copy(shipped, "mine.toml")
    assert said("show", "mine.toml", status=0).startswith("vehicle mine.toml: BlueROV2")


SYSTEM = MOWER[: MOWER.index("[region]")].replace('kind = "viability-kernel"\n', "").replace(
    "rates = {", "parameters = { slip = { value = 0.8 } }\nrates = {"
).replace('"v*cos(th)"', '"slip*v*cos(th)"').replace('"v*sin(th)"', '"slip*v*sin(th)"')  # fmt: skip


def test_a_system_without_a_law_is_identified_and_explained(here):
    Path("own.toml").write_text(SYSTEM)
    t = np.arange(0, 20, 0.05)
    v, w = 0.5 + 0.3 * np.sin(t), 0.4 * np.cos(0.7 * t)
    turned = np.concatenate([[0], np.cumsum(0.05 * w)[:-1]])
    x, y = (np.concatenate([[0], np.cumsum(0.05 * 0.9 * v * f(turned))[:-1]])
            for f in (np.cos, np.sin))  # fmt: skip
    table = np.column_stack([t, x, y, turned, v, w])
    np.savetxt("log.csv", table, delimiter=",", header="t,x,y,th,v,w", comments="")
    output = said("identify", "log.csv", "--system", "own.toml", "--no-figures", status=0)
    assert "slip" in output
    numbers = tomllib.loads(Path("runs/log/identified.toml").read_text())
    assert numbers["system"]["parameters"]["slip"]["value"] == pytest.approx(0.9, abs=0.01)
    assert "Is it nonholonomic" in said("explain", "own.toml", status=0)
    assert "--runs" in said("identify", "log.csv", "--system", "own.toml", "--runs", 3, status=2)


def test_a_folder_that_was_deleted_is_one_line(here):
    script = "mkdir gone && cd gone && rmdir ../gone && exec {} -m holdfast run ch2-unicycle"
    ended = subprocess.run(
        ["sh", "-c", script.format(sys.executable)], capture_output=True, text=True
    )
    assert ended.returncode == 2
    assert ended.stderr == "holdfast: the current folder was deleted; change to another\n"


SWEEP = ("sweep", "ch2-unicycle", "--over", "law.k=1:2:500", "--workers", "1", "--runs", "200")


@pytest.mark.heavy
def test_an_interrupted_sweep_says_what_is_kept_and_how_to_go_on(here):
    command = [sys.executable, "-m", "holdfast", *SWEEP]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    finished = here / "runs" / "ch2-unicycle"
    while not any(p.stat().st_size > 20_000 for p in finished.glob("*.db")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.rstrip().endswith(
        "holdfast: interrupted; the cells that are finished are kept in runs/ch2-unicycle, and the "
        "same command goes on from there"
    )


TURNING = """
[scenario]
title = "Turns"
kind = "closed-loop"
[system]
states = { th = { unit = "rad", angle = true } }
inputs = { w = { unit = "rad/s", bounds = ["-90 deg/s", "90 deg/s"] } }
rates = { th = "w" }
[law]
outputs = { w = "-0.5*th" }
[starts]
states = [{ th = 0 }]
[run]
horizon = 1
"""


@pytest.mark.parametrize(
    ("written", "key", "turns"),
    [
        ("states = [{ th = 90 }]", "starts.states.0.th: 'th' without a unit is read as 90 rad", "14.3"),
        ('states = [{ th = "90" }]', "starts.states.0.th", "14.3"),
        ("random = 2\nbox = { th = [-180, 170] }", "starts.box.th", "-28.6"),
        ("random = 2\nevery = [0, 7]", "starts.every", "1.11"),
        ('states = [{ th = "900 deg" }, { th = 6.2832 }]', "", ""),
        ('random = 2\nbox = { th = ["-720 deg", 3.2] }', "", ""),
    ],
)  # fmt: skip
def test_an_angle_without_a_unit_that_is_more_than_a_turn_is_read_with_a_warning(
    here, recwarn, written, key, turns
):
    Path("turns.toml").write_text(TURNING.replace("states = [{ th = 0 }]", written, 1))
    scenario = hf.load_scenario("turns.toml")
    assert float(scenario.system.input_bounds.upper[0]) == pytest.approx(np.pi / 2)
    messages = [str(w.message) for w in recwarn if w.category is hf.AngleWarning]
    assert len(messages) == bool(key)
    if key:
        assert key in messages[0]
        assert f"(= {turns} turns); if it is in degrees, write" in messages[0]


def test_a_start_in_degrees_is_told_in_python_too():
    th = (hf.Quantity("th", "rad", angle=True),)
    turning = hf.System("turning", th, (hf.Quantity("w", "rad/s"),), {"th": "w"})
    law = hf.Law("back", th, {"w": "-0.5*th"})
    for starts in ([[0.1], [90.0]], hf.Starts([{"th": 90.0}])):
        with pytest.warns(hf.AngleWarning, match=r"write math.radians\(90\)"):
            hf.simulate(turning, law, starts=starts, horizon=0.1)


def test_the_remedy_for_a_steering_angle_is_right():
    """Its rate is commanded, and its bounds stand in the region."""
    faster = hf.dynamic_extension(car(), ("delta",), hf.Box((-1,), (1,)))
    limits = hf.input_limits(car(), ("delta",)).inequalities
    guard = hf.SafetyFilter(faster, within(faster, "th - 1", limits))
    assert guard.step([0, 0, 0.5, 0.0], [0.5]).input[0] <= 0.5


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("systems.bicycle", "holdfast.systems has no 'bicycle'; bicycle model: hf.systems.car"),
        ("systems.tractor_trailor", "did you mean 'tractor_trailer'?"),
        ("laws.steer_unicicle", "did you mean 'steer_unicycle'?"),
        ("regions.camera_veiw", "did you mean 'camera_view'?"),
        ("fields.zzz", "allowed: charge_pair, dipolar"),
        ("viabilty_kernel", "holdfast has no 'viabilty_kernel'; did you mean 'viability_kernel'?"),
        ("BRT", "holdfast has no 'BRT'; backward reachable tube"),
        ("zzz", "holdfast has no 'zzz'; dir(holdfast) lists all names"),
    ],
)
def test_a_name_that_a_module_does_not_have_is_answered(name, said):
    module, _, last = name.rpartition(".")
    with pytest.raises(AttributeError, match=re.escape(said)):
        getattr(getattr(hf, module) if module else hf, last)


def test_a_word_that_is_misspelt_is_answered_by_the_list(here):
    assert "did you mean 'bicycle'?" in said("list", "bycicle", status=2)


class Wrong:
    """Controllers that define a system in wrong units at every sample."""

    most = 10

    def begin(self, runs):
        pass

    def command(self, t, states, alive=None):
        hf.System("line", STATES, (hf.Quantity("u", "m"),), {"x": "u"})
        return states

    def end(self):
        pass


@pytest.mark.parametrize(
    "handed",
    [
        {"command": Wrong().command},
        {"command": partial(Wrong().command)},
        {"command": Wrong()},
        {"command": lambda t, states: -states, "progress": lambda done: Wrong().command(0, None)},
    ],
)
def test_what_a_function_of_the_users_defines_is_checked_for_units(handed):
    system = line()
    with pytest.raises(HoldfastError, match="'u' is in m; expected m/s"):
        hf.simulate(system, hf.commanded(system), starts=[[1.0]], horizon=0.1, **handed)


def test_a_table_of_a_scenario_cannot_be_changed():
    scenario = hf.load_scenario("ch2-unicycle", runs=1)
    for change in (
        lambda: scenario.settings.update(horizon=1.0),
        lambda: scenario.settings["noise_uniform"].update(x=1.0),
    ):
        with pytest.raises(TypeError, match="cannot be changed"):
            change()
    for other in (copy.deepcopy(scenario), pickle.loads(pickle.dumps(scenario))):
        assert other == scenario
        assert hash(other) == hash(scenario)
    assert scenario.with_settings(horizon=1.0) != scenario


def test_modes_in_another_order_have_other_numbers():
    """And so are another switching."""
    go, stop = hf.Law("go", STATES, {"u": -1.0}), hf.Law("stop", STATES, {"u": 0})
    made = [
        hf.Switching("s", modes, (hf.Transition("go", "stop", -X),), "go")
        for modes in ({"go": go, "stop": stop}, {"stop": stop, "go": go}, {"go": go, "stop": stop})
    ]
    assert made[0] != made[1]
    assert made[0] == made[2] == pickle.loads(pickle.dumps(made[2]))
    first = [hf.simulate(line(), s, starts=[[1.0]], horizon=0.1) for s in made[:2]]
    assert [int(r.dataset.mode.values.ravel()[0]) for r in first] == [0, 1]


def trials(kept, off=0):
    return Trials("no disturbance", Rate(kept, 10), off, 0.0, 0)


def promise_of(inside, *layers):
    return Promise("law", None, "m", 1.0, 0.02, (inside,), None, layers=layers)


def test_a_promise_prints_what_was_tried_and_what_came_of_it():
    promise = promise_of(trials(10), Layer("within a cell of the edge", "the edge", 0.2, trials(8)))
    text = repr(promise)
    assert text.startswith("Promise over 1 s, by 'law': confirmed from inside\n")
    assert "\n  within a cell of the edge: 8 of 10 kept\n" in text
    assert promise.conclusion in " ".join(text.split())
    assert len(text.splitlines()) <= 10
    assert "8 of 10 kept" in promise._repr_html_()


@pytest.mark.parametrize("layer", [False, True])
def test_a_start_that_leaves_the_grid_refutes_nothing(layer):
    """What becomes of it beyond the grid is not known: it may have got away."""

    def tried(part):
        within = Layer("at least a cell inside", "a cell", 0.2, part, 0.5, 0.1)
        return promise_of(trials(10), within) if layer else promise_of(part)

    unknown, lost = tried(trials(8, off=2)), tried(trials(8, off=1))
    assert unknown.outcome == "not confirmed"
    assert "2 of 10 starts" in unknown.conclusion
    assert "widen the grid" in unknown.conclusion
    assert not unknown.held
    assert lost.outcome == "fell short"
    assert "the promise falls short" in lost.conclusion
