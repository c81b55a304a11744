"""Laws as C99: warnings are errors, the numbers are those of the compiled closed loop."""

import ctypes
import re

import numpy as np
import pytest
from click.testing import CliRunner

import holdfast as hf
from holdfast.commands.export_c import command
from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.codegen import c_source
from holdfast.execution.codegen.c_source import export_c
from holdfast.execution.codegen.c_timing import time_law, timed_rows
from tests.c_code import built, needs_gcc, pointer

pytestmark = needs_gcc

OBSERVED = ["observer={measured = ['x', 'y', 'psi'], bandwidth = 5.0}"]


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("ch2-integrator", []),
        ("ch5-viable-goal-set", []),
        ("ch3-unknown-current", []),
        ("ch5-nominal", OBSERVED),  # what it remembers is its estimate
        ("ch4-trailer", ["system.hitch_1=0.2"]),  # its coordinates have a quadrature
        ("inspection", []),  # what it asks for is changed by a program
    ],
)
def test_supervisor_in_c_goes_through_the_same_modes(name, more, tmp_path):
    """Every sample of recorded runs, one after the other: mode and actuators as recorded."""
    sample_time = hf.load_scenario(name).settings["sample_time"]
    changes = [f"run.record_every={sample_time}", "run.horizon=20", *more]
    same_as_recorded(hf.load_scenario(name, changes, runs=8), tmp_path)


def same_as_recorded(scenario, folder):
    data = scenario.run().dataset
    c = built(folder, export_c(scenario.system, scenario.kept().law, "law_"), "law_")
    inputs, sample_time = len(scenario.system.inputs), scenario.settings["sample_time"]
    acts = (
        data["actuator"]
        if "actuator" in data and data.sizes.get("actuator_name")
        else data["input"]
    )
    command, actuators = np.zeros(inputs), np.zeros(acts.shape[2])
    parameters = ctypes.c_double.in_dll(c, "law__parameters")
    for run in range(data.sizes["run"]):
        state = (ctypes.c_double * 128)()
        c.law__start(ctypes.byref(state))
        for k, t in enumerate(data["time"].values):
            seen = np.ascontiguousarray(data["state"].values[run, k])
            mode = c.law__step(
                ctypes.byref(state), ctypes.c_double(t), ctypes.c_double(sample_time),
                pointer(seen), ctypes.byref(parameters), pointer(command), pointer(actuators),
            )  # fmt: skip
            assert mode == data["mode"].values[run, k]
            assert actuators == pytest.approx(acts.values[run, k], rel=1e-9, abs=1e-9)
    return data


FERRY = """
[scenario]
title = "a ferry"

[system]
states = {{ y = {{ unit = "m" }}, psi = {{ unit = "rad", angle = true }} }}
inputs = {{ w = {{ unit = "rad/s", bounds = [-0.5, 0.5] }} }}
disturbances = {{ drift = {{ unit = "m/s", bounds = [-0.1, 0.1] }} }}
rates = {{ y = "sin(psi) + drift", psi = "w" }}

[region]
constraints = {{ bank = {{ expression = "abs(y) - 4", unit = "m" }} }}
{more}
"""
KERNEL = """
[grid]
nodes = 41
box = { y = [-5, 5], psi = ["-180 deg", "180 deg"] }
ends = { psi = "periodic" }

[march]
horizon = 20
forever = true
"""
KEPT = """
[law]
outputs = { w = "0.3*sin(0.2*t)" }

[safety]
kernel = "kernel.toml"

[starts]
random = 8
box = { y = [-2, 2], psi = [-0.5, 0.5] }

[run]
horizon = 20
sample_time = 0.05
record_every = 0.05
"""


def test_law_that_is_kept_in_a_kernel_is_exported_with_it(tmp_path):
    kind = 'a ferry"\nkind = "discriminating-kernel"'
    (tmp_path / "kernel.toml").write_text(FERRY.format(more=KERNEL).replace('a ferry"', kind))
    (tmp_path / "safe.toml").write_text(FERRY.format(more=KEPT))
    scenario = hf.load_scenario(str(tmp_path / "safe.toml"))
    data = same_as_recorded(scenario, tmp_path)
    alone = data["input"] - 0.3 * np.sin(0.2 * data["time"])
    assert abs(alone).max() > 0.1  # the kernel has changed it


@pytest.mark.heavy
def test_the_command_writes_a_large_table_into_a_file(tmp_path, monkeypatch):
    assert c_source.MOST_AS_TEXT == 65_536
    kind = 'a ferry"\nkind = "discriminating-kernel"'
    (tmp_path / "kernel.toml").write_text(FERRY.format(more=KERNEL).replace('a ferry"', kind))
    (tmp_path / "safe.toml").write_text(FERRY.format(more=KEPT))
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke
    done = run(command, ["safe.toml", "--out", "law.c", "--no-timing"], catch_exceptions=False)
    assert "table:" not in done.output
    assert not (tmp_path / "law.bin").exists()
    monkeypatch.setattr(c_source, "MOST_AS_TEXT", 41 * 41 - 1)
    done = run(command, ["safe.toml", "--out", "law.c"], catch_exceptions=False)
    assert "law.bin (1,681 numbers" in done.output
    assert "ns per call" in done.output
    assert "safe_load" in (tmp_path / "law.h").read_text()
    assert (tmp_path / "law.bin").stat().st_size == 128 + 8 * 1681


@pytest.mark.few("-law_")
@pytest.mark.parametrize(
    ("name", "called"), [("3d", "law_3d"), ("my-boat.2", "my_boat_2"), ("bât", "b_t"), ("", "law_")]
)
def test_any_name_is_one_in_c(name, called, tmp_path):
    robot = hf.systems.unicycle()
    c = built(tmp_path, export_c(robot, hf.laws.steer_unicycle(robot), name), called)
    assert getattr(c, f"{called}_start")


def test_numbers_and_names_of_any_kind_make_c(tmp_path):
    """A number of NumPy; units and modes that would end a comment, or be letters in older C."""
    k = hf.Parameter("k", "m*/s ??/", "half ???/ of /* it", value=np.linspace(0.1, 1, 3)[1])
    x = hf.Quantity("x", "m")
    law = hf.Law("steer", (x,), {"u": -hf.symbol("k") * x.symbol}, (k,), empirical="odd units")
    u = hf.Quantity("u", "m/s")
    system = hf.System(name="s", states=(x,), inputs=(u,), rates={"x": u.symbol})
    both = hf.Switching("both\n*/ int", {"a*/b": law, "??/": law}, empirical="odd units")
    c = built(tmp_path, export_c(system, both, "law_"), "law_")
    assert ctypes.c_double.in_dll(c, "law__parameters").value == 0.55


@pytest.mark.few("ch4-unicycle")
@pytest.mark.parametrize("name", ["ch4-unicycle", "ch6-chain", "inspection"])
def test_no_function_is_in_the_file_that_is_not_called(name):
    """Of which some compilers warn."""
    scenario = hf.load_scenario(name)
    text = export_c(scenario.system, scenario.law, name)
    defined = re.findall(r"^static .*?(\w+)\(", text, re.MULTILINE)
    assert defined
    for function in defined:
        assert len(re.findall(rf"\b{function}\(", text)) > 1, function


def test_law_is_timed_along_every_run_from_its_start_to_where_its_numbers_end(tmp_path):
    times, states = np.array([0.0, 0.5]), np.arange(12.0).reshape(3, 2, 2)
    states[1, 1] = np.nan
    rows = [[1, 0, 0, 1], [0, 0.5, 2, 3], [1, 0, 4, 5], [1, 0, 8, 9], [0, 0.5, 10, 11]]
    assert timed_rows(times, states).tolist() == rows
    robot = hf.systems.unicycle()
    text = export_c(robot, hf.laws.steer_unicycle(robot), "MY_UPPER_NAME")
    found = time_law(text, "MY_UPPER_NAME", times, np.ones((3, 2, 3)), 0.02)
    assert 0 < found.nanoseconds < 1e5
    with pytest.raises(SimulationError, match="all states of its runs are NaN"):
        time_law(text, "MY_UPPER_NAME", times, np.full((3, 2, 3), np.nan), 0.02)


def test_what_has_no_c_is_refused():
    scenario = hf.load_scenario("ch5-viable-goal-set")
    other = hf.systems.unicycle()
    with pytest.raises(DefinitionError, match="expected the inputs"):
        export_c(
            other,
            scenario.law.modes[scenario.law.initial].__class__(
                "x", other.states, {"a": hf.symbol("x")}
            ),
        )
