"""Nanoseconds for one evaluation of each law of a scenario's comparison, compiled.

    python benchmarks/viable_law.py [scenario]

Every law is evaluated at the same random states of the region, in every mode, in one thread; the
fastest of five passes counts. What is timed is all that a vehicle's computer would do at a control
sample: the velocities, the tracking law, the rows of the quadratic program and its solution.
"""

import sys
import time
import tomllib

import numpy as np
from numba import njit

from holdfast.execution.codegen.closed_loop_source import closed_loop_program
from holdfast.execution.compile import compile_closed_loop
from holdfast.execution.simulation.steppers import RK4
from holdfast.maths.definitions.switching import as_switching
from holdfast.scenario.files import read_text
from holdfast.studies.comparison.compare import variant

COUNT = 200_000


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
        law = compile_closed_loop(program.source).law
        law_of = as_switching(scenario.law)
        memory = law_of.memory
        read = {q.name for q in (*law_of.reads, *(memory.reads if memory else ()))}
        told = sum(d.name in read for d in program.disturbances) or 1  # else one zero
        width = len(program.states) + told + (len(memory.quantities) if memory else 0)
        states = np.zeros((COUNT, width))
        generator = np.random.default_rng(0)
        for i, state in enumerate(program.states):
            low, high = scenario.starts.box.get(state.name, (-0.1, 0.1))
            states[:, i] = generator.uniform(low, high, COUNT)
        p = np.array([*(q.value for q in program.parameters), 0.0])
        table = np.zeros(1)
        passes = timed(law, width)
        for mode, word in enumerate(program.modes):
            best, relaxed = np.inf, 0
            for _ in range(5):
                began = time.perf_counter()
                _, relaxed = passes(states, mode, p, table)
                best = min(best, time.perf_counter() - began)
            share = 1 - relaxed / COUNT
            print(f"{title:<16}{word:<12}{1e9 * best / COUNT:>8.0f}{share:>12.3f}")


def timed(law, width):
    entries = ", ".join(f"q[i, {j}]" for j in range(width))
    scope = {"njit": njit, "law": law}
    exec(  # a tuple of fixed length has to be written out
        "@njit\ndef passes(q, mode, p, table):\n"
        "    total, relaxed = 0.0, 0\n"
        "    for i in range(q.shape[0]):\n"
        f"        u = law(0.0, ({entries},), mode, p, table)\n"
        "        total += u[0]\n"
        "        relaxed += u[2] > 0.0\n"
        "    return total, relaxed\n",
        scope,
    )
    return scope["passes"]


if __name__ == "__main__":
    main()
