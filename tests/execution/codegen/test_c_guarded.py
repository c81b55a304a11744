"""Laws that solve a program at every sample, or look up a kernel, as C99."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.execution.codegen.c_printer import scalars_c
from holdfast.execution.codegen.scalar_reader import scalars
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from tests.c_code import built, needs_gcc, pointer
from tests.carts import BOX, WALLS, cart
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


@pytest.mark.few("1")
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


def kernel(**options):
    system = cart()
    return hf.discriminating_kernel(system, WALLS, hf.grid(system, BOX, 41), horizon=3, **options)


ONE_STEP = """
int outside(const double *seen) {
    law_state s;
    double command[LAW_INPUTS], actuators[LAW_ACTUATORS];
    law_start(&s);
    law_step(&s, 0.0, 0.02, seen, law_parameters, command, actuators);
    return s.outside;
}
"""


@pytest.mark.heavy
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
