"""Nanoseconds for one evaluation of each law of a scenario's comparison, compiled.

    python benchmarks/viable_law.py [scenario]

Every law is evaluated at the same random states of the region, in every mode, in one thread; the
fastest of five passes counts. What is timed is all that a vehicle's computer would do at a control
sample: what guards and laws of all modes share, the velocities, the tracking law, the rows of the
quadratic program and its solution.
"""

import sys
import time
import tomllib

import numpy as np

from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.codegen.scalar_llvm import called
from holdfast.execution.leaf import BLOCK, columns
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from holdfast.execution.simulation.settings import RK4
from holdfast.scenario.files import read_text
from holdfast.studies.comparison import variant

COUNT = 200 * BLOCK


def kept(answers, m, count, hard):
    """The commands and slacks of a safeguard for these answers of its law, and the seconds."""
    rows = m + count * (m + 1)
    parts = (answers[:m], answers[rows:], answers[m:rows])
    wanted, scales, conditions = (np.ascontiguousarray(part.T) for part in parts)
    counts = (np.full(BLOCK, n) for n in (count, hard))
    room, whole = numbers_of_programs(m, count)
    given = np.empty((BLOCK, m + 1))
    arguments = (BLOCK, wanted, scales, conditions, conditions.shape[1], *counts, m, given)
    scratch = np.empty(room), np.empty(whole, dtype=np.int64)
    began = time.perf_counter()
    called("simulation/quadratic_program", "keep_many", *arguments, *scratch)
    return given, time.perf_counter() - began


def main() -> None:
    name = sys.argv[1] if len(sys.argv) > 1 else "ch5-rescue"
    print(f"{'law':<16}{'mode':<12}{'ns':>8}{'admissible':>12}")
    others = tomllib.loads(read_text(name)[1])["compare"]["laws"]
    for title in (name, *others):
        scenario = variant(name, title, runs=1)
        program = closed_loop_program(
            scenario.system,
            scenario.law,
            region=scenario.region,
            goal=None,
            disturbance={},
            stepper=RK4,
        )
        loop, m = ClosedLoop(program), len(program.inputs)
        width = len(program.states) + program.measured + len(program.remembered)
        states = np.zeros((COUNT, width))
        generator = np.random.default_rng(0)
        for i, state in enumerate(program.states):
            low, high = scenario.starts.box.get(state.name, (-0.1, 0.1))
            states[:, i] = generator.uniform(low, high, COUNT)
        shared, t = np.empty((COUNT, program.shared)), np.zeros((1, BLOCK))
        rows = np.hstack([states, shared])
        blocks = [columns(rows[k : k + BLOCK], BLOCK) for k in range(0, COUNT, BLOCK)]
        p = np.repeat(loop.parameter_array()[:, np.newaxis], BLOCK, axis=1)
        p = np.vstack([p, np.zeros((program.prepared, BLOCK))])
        if program.prepared:
            loop.leaves.call("prepared", t, t, t, p, p[-program.prepared :])
        for mode, word in enumerate(program.modes):
            count, hard = program.conditions_of_modes[mode]
            answers = np.empty((m + (count * (m + 1) + m if count else 0), BLOCK))
            best, relaxed = np.inf, 0
            for _ in range(5):
                seconds, relaxed = 0.0, 0
                for seen in blocks:
                    began = time.perf_counter()
                    if program.shared:
                        loop.leaves.call("shared", t, seen, t, p, seen[width:])
                    loop.leaves.call(f"law{mode}", t, seen, t, p, answers)
                    seconds += time.perf_counter() - began
                    if count:
                        given, own = kept(answers, m, count, hard)
                        seconds, relaxed = seconds + own, relaxed + (given[:, m] > 0.0).sum()
                best = min(best, seconds)
            share = 1 - relaxed / COUNT
            print(f"{title:<16}{word:<12}{1e9 * best / COUNT:>8.0f}{share:>12.3f}")


if __name__ == "__main__":
    main()
