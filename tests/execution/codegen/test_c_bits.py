"""Exported laws have every bit of the simulated ones: commands, actuators, slack, modes, memory."""

import ctypes
import tomllib
from importlib.resources import files

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.execution.codegen.c_source import export_c
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import RK4
from holdfast.maths.formations.walls import sight_distance, wall_distance
from tests.c_code import built, needs_gcc, pointer
from tests.carts import BOX, WALLS, cart, swinging
from tests.execution.compiled_law import commands

pytestmark = needs_gcc

HARNESS = """
void laws(int count, const double *rows, int mode, const double *p, double *out) {
    for (int i = 0; i < count; i++) {
        const double *seen = rows + (long)i * (LAW__SEEN + LAW__KEPT + 2);
        const double *kept = seen + LAW__SEEN, t = kept[LAW__KEPT], in_mode = kept[LAW__KEPT + 1];
        double *to = out + (long)i * (INPUTS + ACTUATORS + 2);
        to[INPUTS + ACTUATORS] = law__hf_law(t, 0.02, seen, kept, mode, p, to);
        law__hf_limit(to, p, to + INPUTS);
        to[INPUTS + ACTUATORS + 1] = law__hf_next_mode(t, seen, kept, mode, in_mode, p);
    }
}
"""
MEMORY = """
void memories(int count, const double *rows, const double *asked, const double *p, double *out) {
    for (int i = 0; i < count; i++) {
        const double *seen = rows + (long)i * (LAW__SEEN + LAW__KEPT + 2);
        const double *kept = seen + LAW__SEEN;
        double *to = out + (long)i * LAW__KEPT;
        for (int k = 0; k < LAW__KEPT; k++) to[k] = kept[k];
        law__hf_remember(kept[LAW__KEPT], 0.0, seen, asked + (long)i * ACTUATORS, p, to);
    }
}
"""


def kept_off_walls():
    robot = hf.systems.unicycle()
    x, y = (hf.symbol(n) for n in ("x", "y"))
    ends = [sp.Float(v) for v in (-1.5, -1.0, 1.5, -1.0, 1.0, -1.0, 1.0, 1.5)]
    clear = hf.Inequality("clear", sp.Float(0.3) - wall_distance((x, y), ends), "m")
    line = sight_distance((x, y), (sp.Float(0.2), sp.Float(0.1)), ends)
    sight = hf.Inequality("sight", sp.Float(0.1) - line, "m")
    room = hf.Region("room", robot.states[:2], (clear, sight))
    return robot, hf.safeguard(robot, hf.laws.steer_unicycle(robot), room)


def kernel(**options):
    system = cart()
    return hf.discriminating_kernel(system, WALLS, hf.grid(system, BOX, 41), horizon=3, **options)


def kept_in_kernel():
    return cart(), hf.safety_law(cart(), kernel(precision="float32"), swinging())


def kept_at_rest():
    """One sample ahead, by a table in single precision."""
    system, grid = cart(), hf.grid(cart(), BOX, 41)
    value = hf.discriminating_kernel(system, WALLS, grid, horizon=40, precision="float32")
    law = hf.safety_law(system, value, swinging())
    assert law.safeguard.foresight is not None
    assert law.lookup.table[0].dtype == "float32"
    return system, law


def optimal():
    return cart(), hf.safety_law(cart(), kernel())


def at_the_time_left():
    times = np.linspace(0.0, 1.0, 11)
    system = cart(push=1.4)  # nothing is kept for ever
    found = hf.discriminating_kernel(
        system, WALLS, hf.grid(system, BOX, 41), horizon=1.0, times=times
    )
    return system, hf.safety_law(system, found, swinging(), margin=0.01)


MADE = {
    "walls": kept_off_walls,
    "kernel": kept_in_kernel,
    "kernel at rest": kept_at_rest,
    "optimal": optimal,
    "time left": at_the_time_left,
}
OBSERVED = "observer={measured = ['x', 'y', 'psi'], bandwidth = 5.0}"
OBSERVED_SET = (
    "observer={measured=['x','y','psi'],bandwidth=40,error_bounds="
    "{x='1 mm',y='1 mm',psi='1 mrad',u=0.005,v=0.005,r=0.1}}"
)
FOLLOWED_SET = OBSERVED_SET[:-1] + ",rate_bounds={Vx=0.03,Vy=0.02}}"
SOME = ["ch3-unknown-current", "ch5-viable-goal-set", "observed", *MADE]
SCENARIOS = sorted(
    path.name.removesuffix(".toml")
    for path in files("holdfast.scenarios").iterdir()
    if path.name.endswith(".toml")
    and {"law", "formation"} & set(said := tomllib.loads(path.read_text("utf-8")))
    and "obstacles" not in said
)
"""Those of closed loops whose laws are handed nothing (`test_moving_obstacles`); the laws of kernels are those of `MADE`."""


def made(name):
    if name in MADE:
        return MADE[name]()
    if name == "observed":
        scenario = hf.load_scenario("inspection", [OBSERVED])
    elif name in ("observed set", "followed set"):
        chosen = OBSERVED_SET if name == "observed set" else FOLLOWED_SET
        scenario = hf.load_scenario("inspection-current", [chosen])
    else:
        scenario = hf.load_scenario(name)
    return scenario.system, scenario.law


def same_bits(name, folder, states):
    """Compare both at so many states, shared among the modes; returns how many were compared."""
    system, law = made(name)
    program = closed_loop_program(system, law, region=None, goal=None, disturbance={}, stepper=RK4)
    remembered, acts = len(program.remembered), len(program.actuators or system.inputs)
    c = built(
        folder, export_c(system, law, "law_"), "law_", HARNESS + (MEMORY if remembered else "")
    )
    text = (folder / "law_.c").read_text()
    used = int(text.split("#define LAW__PARAMETERS ")[1].split()[0])
    parameters = (ctypes.c_double * used).in_dll(c, "law__parameters")
    n, m = len(program.states) + program.measured, len(program.inputs)
    loop, count = ClosedLoop(program), states // len(program.modes)
    kept = max(remembered, 1)
    rows = np.random.default_rng(5).uniform(-2.0, 2.0, (count, n + kept + 2))
    rows[:, -2:] = np.abs(rows[:, -2:])  # times
    seen, p = np.ascontiguousarray(rows[:, : n + remembered]), loop.parameter_array()
    for mode in range(len(program.modes)):
        expected = np.zeros((count, m + acts + 2))
        given, actuators = commands(loop, rows[:, -2], seen, mode)
        expected[:, :m], expected[:, m : m + acts] = given[:, :m], actuators
        expected[:, -2], expected[:, -1] = given[:, m], mode
        targets, t = program.targets[mode], rows[:, -2:-1]
        if targets:
            name = f"guards{mode}"
            levels = loop.values(name, count, len(targets), t, seen, rows[:, -1:], p)
            for place, target in reversed(list(enumerate(targets))):
                expected[levels[:, place] >= 0, -1] = target
        out = np.zeros_like(expected)
        c.laws(count, pointer(rows), mode, parameters, pointer(out))
        assert np.isfinite(expected[:, : m + acts]).mean() > 0.9
        assert np.array_equal(out, expected, equal_nan=True)
        assert np.array_equal(np.signbit(out), np.signbit(expected))
    if remembered:
        asked = np.random.default_rng(6).uniform(-1.0, 1.0, (count, acts))
        after = loop.values("remember", count, remembered, t, seen, asked, p)
        out = np.zeros((count, kept))
        c.memories(count, pointer(rows), pointer(asked), parameters, pointer(out))
        assert np.array_equal(out, after, equal_nan=True)
    return count * len(program.modes)


@pytest.mark.few("ch3-unknown-current")
@pytest.mark.parametrize("name", SOME)
def test_exported_law_has_every_bit_of_the_simulated_law(name, tmp_path):
    assert same_bits(name, tmp_path, 50_000) > 49_000


@pytest.mark.heavy
@pytest.mark.parametrize("name", [*SCENARIOS, "observed", "observed set", "followed set", *MADE])
def test_every_law_has_every_bit_at_a_million_states(name, tmp_path):
    assert same_bits(name, tmp_path, 1_000_000) > 999_000
