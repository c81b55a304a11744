"""The answers of laws of certificates: of their machine code, and of their C."""

import ctypes

import numpy as np

from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.simulation.control_sample import ControlSamples
from holdfast.execution.simulation.settings import RK4
from tests.c_code import pointer


def answers(system, law, certificate, count):
    """The compiled law of many vehicles at a sample: inputs, and whether it knows the cells."""
    program = closed_loop_program(system, law, region=None, goal=None, disturbance={}, stepper=RK4)
    samples = ControlSamples(program, certificate.hold, count)

    def answer(states):
        found = samples.answers(0.0, states)
        return found[:, samples.rows.command], np.isnan(found[:, samples.rows.outside])

    return answer


MANY = """
void many(int count, const double *seen, double *commands, int *outside) {
    law_state s;
    double actuators[ACTUATORS];
    law_start(&s);
    for (int k = 0; k < count; k++) {
        law_step(&s, 0.0, 0.1, seen + k * LAW_SEEN, law_parameters, commands + k * INPUTS,
                 actuators);
        outside[k] = s.outside;
    }
}
"""


def in_c(c, states, inputs):
    """Commands at states, and whether each is outside."""
    commands = np.empty((len(states), inputs))
    outside = np.empty(len(states), dtype=np.int32)
    c.many(
        len(states), pointer(states), pointer(commands),
        outside.ctypes.data_as(ctypes.POINTER(ctypes.c_int)),
    )  # fmt: skip
    return commands, outside
