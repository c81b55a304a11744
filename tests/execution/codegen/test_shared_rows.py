"""Rows that several leaves share have every bit of what each leaf would compute for itself."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.leaf import compiled_leaves
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import RK4


def inspection():
    scene = hf.load_scenario("inspection")
    return closed_loop_program(
        scene.system, scene.law, region=scene.region, goal=scene.goal, disturbance={}, stepper=RK4
    )


@pytest.mark.heavy
def test_leaves_with_shared_rows_give_the_bits_of_leaves_without():
    program = inspection()
    assert program.shared > 0
    assert program.prepared > 0
    loop, rng = ClosedLoop(program), np.random.default_rng(2)
    p = loop.parameter_array(sample_time=0.02)
    t, q, x = (rng.uniform(-1.0, 1.0, (40, n)) for n in (1, len(program.states), 2))
    names = [n for n in program.leaves if n.startswith(("law", "guards", "rates", "goal"))]
    alone = compiled_leaves({n: replace(program.leaves[n], read={}) for n in names})
    for name in names:
        width = program.rows_of(name)
        expected = alone.values(name, len(q), width, t, q, x, p)
        assert np.array_equal(loop.values(name, len(q), width, t, q, x, p), expected)


def test_only_values_that_two_users_need_and_that_are_work_have_rows():
    program = inspection()
    steps = program.leaves["law0"].steps

    def needed(name, read):
        leaf = program.leaves[name]
        return set(steps.needed([v.number for v in leaf.results], leaf.read if read else ()))

    for value in program.leaves["shared"].results:
        modes = {n[-1] for n in program.leaves if n[:-1] in ("law", "guards") and
                 value.number in needed(n, read=False)}  # fmt: skip
        assert modes == {"0", "1"}
    for value in program.leaves["prepared"].results:
        inputs = (steps.list[k] for k in steps.needed([value.number]))
        assert {s.given[0] for s in inputs if s.operation == "input"} == {"p"}
    whole, left = (len(needed("guards1", read)) for read in (False, True))
    assert left < whole / 5
