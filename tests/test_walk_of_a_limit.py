"""The walk of `thrust_limit` that docs/architecture.md tells: from a file to the figure, built once."""

import ctypes
import tomllib
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.maths.definitions.system import System
from tests.c_code import built, needs_gcc, pointer

LIMIT = 2.0  # N
PUSH = f"""
[scenario]
title = "full ahead"
[system]
name = "marine_vehicle"
thrust_limit = "{LIMIT:g} N"
[law]
outputs = {{ tau_u = 100, tau_r = 0 }}
[region]
constraints = {{ far = {{ expression = "x - 100", unit = "m" }} }}
[starts]
states = [{{ x = 0 }}]
[run]
horizon = 60
"""
OVERRIDE = [f"system.thrust_limit={LIMIT}"]


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    file = tmp_path_factory.mktemp("walk") / "push.toml"
    file.write_text(PUSH)
    return hf.load_scenario(str(file))


@pytest.fixture(scope="module")
def result(scenario):
    return scenario.run()


def test_value_of_the_file_is_one_parameter_that_expressions_name(scenario):
    parameters = {p.name: p.value for p in scenario.system.parameters}
    assert parameters["thrust_limit"] == LIMIT
    assert hf.symbol("thrust_limit") in scenario.system.input_bounds.free_symbols


def test_thrusters_of_the_closed_loop_stop_at_it(result):
    assert np.abs(result.dataset["actuator"].values).max() == LIMIT
    assert (result.dataset["actuator_high"].values == LIMIT).all()


def test_hamiltonian_of_the_whole_vehicle_has_it():
    """max over u of p . f at rest, for a costate along the surge: 2 F / m11."""
    system = hf.load_scenario("ch7-six-states", OVERRIDE).system
    h = hf.hamiltonian(system)
    values = {p.symbol: p.value for p in system.parameters} | {q.symbol: 0 for q in system.states}
    values |= {s: float(n == "u") for n, s in zip(system.state_names, h.costates, strict=True)}
    known = {p.name: p.value for p in system.parameters}
    expected = 2 * LIMIT / (known["mass"] - known["Xudot"])
    assert float(h.value.xreplace(values).evalf()) == pytest.approx(expected)


def test_reduced_kernel_has_the_speed_at_which_the_closed_loop_comes_to_rest(result):
    bounds = hf.load_scenario("ch7-discriminating", OVERRIDE).system.input_bounds
    reached = float(result.dataset["state"].sel(state_name="u").values[0, -1])
    assert float(bounds.upper[0]) == pytest.approx(reached, rel=1e-6)


STEP = """
void once(double *command, double *actuators) {
    push_state s;
    double seen[6] = {0};
    push_start(&s);
    push_step(&s, 0.0, 0.02, seen, push_parameters, command, actuators);
}
"""


@needs_gcc
def test_c_limits_the_actuators_to_it(scenario, tmp_path):
    c = built(tmp_path, hf.export_c(scenario.system, scenario.law, "push"), "push", STEP)
    command, actuators = np.zeros(2), np.zeros(2)
    c.once(pointer(command), pointer(actuators))
    assert command.tolist() == [100.0, 0.0]
    assert actuators.tolist() == [LIMIT, LIMIT]
    values = (ctypes.c_double * len(scenario.system.parameters)).in_dll(c, "push_parameters")
    assert LIMIT in list(values)


def test_figure_draws_it(result):
    figure = hf.histories_figure(result)
    lines = {
        (round(float(line.get_ydata()[0]), 12), line.get_label())
        for axis in figure.axes
        for line in axis.get_lines()
        if "limit" in line.get_label()
    }
    assert {level for level, _ in lines} == {-LIMIT, LIMIT}
    assert any(f"limit ±{LIMIT:g}" in label for _, label in lines)


def test_each_value_is_built_once(tmp_path, monkeypatch):
    """One file is parsed once, and one system is built."""
    seen = {"system": 0, "file": 0}
    build, parse = System.__post_init__, tomllib.loads

    def counted(self):
        seen["system"] += 1
        build(self)

    def read(text):
        seen["file"] += "mass =" in text
        return parse(text)

    monkeypatch.setattr(System, "__post_init__", counted)
    monkeypatch.setattr(tomllib, "loads", read)
    (tmp_path / "push.toml").write_text(PUSH)
    hf.load_scenario(str(tmp_path / "push.toml"))
    assert seen == {"system": 1, "file": 1}


def test_page_tells_the_walk_by_names_that_exist():
    root = Path(__file__).parent.parent
    page = (root / "docs" / "architecture.md").read_text("utf-8")
    walk = page[page.index("## The walk of a number") :]
    steps = [line for line in walk.splitlines() if line.startswith("- `")]
    assert len(steps) == 8
    for step in steps:
        (path, name) = step.split("`")[1:4:2]
        assert name.rpartition(".")[2] in (root / "src" / "holdfast" / path).read_text("utf-8")
