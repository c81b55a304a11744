"""Laws that solve a program at every sample, or look up a kernel, as C99."""

import ctypes

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.execution.codegen.c_source import export_c
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.codegen.scalar_c import scalars_c
from holdfast.execution.codegen.scalar_functions import scalars
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from holdfast.execution.simulation.steppers import RK4
from holdfast.maths.definitions.switching import as_switching
from holdfast.maths.formations.walls import sight_distance, wall_distance
from tests.c_code import built, needs_gcc, pointer
from tests.carts import BOX, WALLS, cart, swinging
from tests.execution.compiled_law import commands
from tests.execution.simulation.random_programs import (
    FAMILIES,
    MOST_ROWS,
    answers,
    packed,
    programs,
)

pytestmark = needs_gcc

PROGRAMS = """
#include <math.h>
#include <stddef.h>
{text}
void solved(int count, const double *wanted, const double *scales, const double *rows,
            const long *counts, const long *hard, double *out) {{
    double room[{room}];
    long own[{whole}];
    hf_keep_many(count, wanted, scales, rows, {most} * {wide}, counts, hard, {m}, out, room, own);
}}
"""


@pytest.mark.parametrize("m", [1, 2, 3, 4])
def test_programs_in_c_have_the_very_answers_of_the_closed_loop(m, tmp_path):
    source = scalars_c(scalars("simulation/quadratic_program"), ["keep_many"])
    room, whole = numbers_of_programs(m, MOST_ROWS)
    text = PROGRAMS.format(m=m, wide=m + 1, most=MOST_ROWS, text=source, room=room, whole=whole)
    c = built(tmp_path, text, f"programs{m}")
    for family in FAMILIES:
        for badly_scaled in (False, True):
            given = programs(family, m, badly_scaled, 1500)
            expected = answers(given)
            arrays = [np.ascontiguousarray(a) for a in packed(given).values()]
            out = np.zeros_like(expected)
            c.solved(len(given), *(pointer(a) for a in arrays), pointer(out))
            assert np.array_equal(out, expected, equal_nan=True), (family.__name__, badly_scaled)


LAWS = """
void laws(int count, const double *rows, int width, int mode, const double *p, double *out) {
    for (int i = 0; i < count; i++) {
        const double *row = rows + i * width;
        double *to = out + i * (INPUTS + ACTUATORS + 1), kept[1] = {0.0};
        to[INPUTS + ACTUATORS] = law__hf_law(row[width - 1], row, kept, mode, p, to);
        law__hf_limit(to, p, to + INPUTS);
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


def scenario(name, *changes):
    loaded = hf.load_scenario(name, list(changes))
    return loaded.system, loaded.law


def kernel(**options):
    system = cart()
    return hf.discriminating_kernel(system, WALLS, hf.grid(system, BOX, 41), horizon=3, **options)


def kept_in_kernel():
    return cart(), hf.safety_law(cart(), kernel(precision="float32"), swinging())


def optimal():
    return cart(), hf.safety_law(cart(), kernel())


def at_the_time_left():
    times = np.linspace(0.0, 1.0, 11)
    system = cart(push=1.4)  # nothing is kept for ever
    found = hf.discriminating_kernel(
        system, WALLS, hf.grid(system, BOX, 41), horizon=1.0, times=times
    )
    return system, hf.safety_law(system, found, swinging(), margin=0.01)


CASES = {
    "inspection": lambda: scenario("inspection"),
    "rescue": lambda: scenario("ch5-rescue"),
    "walls": kept_off_walls,
    "kernel": kept_in_kernel,
    "optimal": optimal,
    "time left": at_the_time_left,
}


@pytest.mark.parametrize("name", CASES)
def test_exported_law_has_every_bit_of_the_law_at_a_hundred_thousand_states(name, tmp_path):
    system, law = CASES[name]()
    c = built(tmp_path, export_c(system, law, "law_"), "law_", LAWS)
    program = closed_loop_program(system, law, region=None, goal=None, disturbance={}, stepper=RK4)
    n, m = len(system.states), len(system.inputs)
    loop, switching = ClosedLoop(program), as_switching(law)
    count = 100_000 // len(switching.modes)
    rows = np.random.default_rng(5).uniform(-2.0, 2.0, (count, n + 1))
    text = (tmp_path / "law_.c").read_text()
    used = int(text.split("#define LAW__PARAMETERS ")[1].split()[0])
    parameters = (ctypes.c_double * used).in_dll(c, "law__parameters")
    for mode in range(len(switching.modes)):
        expected = np.zeros((count, m + len(program.actuators or system.inputs) + 1))
        given, acts = commands(loop, rows[:, n], rows[:, :n], mode)
        expected[:, :m], expected[:, m:-1], expected[:, -1] = given[:, :m], acts, given[:, m]
        out = np.zeros_like(expected)
        c.laws(count, pointer(rows), n + 1, mode, parameters, pointer(out))
        assert np.isfinite(expected).all()
        assert (expected[:, -1] >= 0).all()
        assert np.array_equal(out, expected)


ONE_STEP = """
int outside(const double *seen) {
    law_state s;
    double command[LAW_INPUTS], actuators[LAW_ACTUATORS];
    law_start(&s);
    law_step(&s, 0.0, 0.02, seen, law_parameters, command, actuators);
    return s.outside;
}
"""


def test_law_of_a_kernel_in_c_says_that_it_was_asked_outside_its_grid(tmp_path):
    system, value = cart(), kernel()
    text = hf.export_c(system, hf.safety_law(system, value), "law")
    assert "law_state.outside: 1 if" in hf.export_c_header(
        system, hf.safety_law(system, value), "law"
    )
    c = built(tmp_path, text + ONE_STEP, "outside")
    low, high = zip(*BOX.values(), strict=True)
    wide = np.random.default_rng(1).uniform(np.array(low) - 1, np.array(high) + 1, (500, 2))
    corners = [(low[0], high[1]), (high[0], low[1])]
    states = np.concatenate([wide, corners])
    seen = np.zeros((len(states), 8))
    seen[:, :2] = states
    found = np.array([c.outside(pointer(row)) for row in seen], dtype=bool)
    assert np.array_equal(found, np.isnan(value.at(states)))
    assert found[:500].any()
    assert not found[:500].all()
    for odd in ((np.nan, 0.0), (0.0, np.inf)):
        seen[0, :2] = odd
        assert c.outside(pointer(seen[0])) == 1
