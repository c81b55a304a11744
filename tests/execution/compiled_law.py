"""The commands of a compiled law at many states, as the closed loop computes them."""

import numpy as np

from holdfast.execution.compile import compile_functions, compile_interpolation

SWEEP = """
@compiled
def sweep(answers, m, count, hard, out):
    rows = count * (m + 1)
    for i in range(len(answers)):
        given = keep_within(
            answers[i, :m], answers[i, m + rows :], answers[i, m : m + rows], hard
        )
        for j in range(m + 1):
            out[i, j] = given[j]
"""


def looked_up(table, places):
    """The value and its slopes at the nearest place of the grid."""
    values, low, steps, shape, periodic = table
    high = low + steps * (shape - 1)
    at = np.where(periodic, places, np.clip(places, low, high))
    found = np.empty((len(places), len(low) + 1))
    module, slopes = compile_interpolation(), np.empty((len(places), len(low)))
    first = np.empty(len(places))
    module.interpolate_many(values, at, low, steps, shape, periodic, first)
    module.slopes_many(values, at, low, steps, shape, periodic, slopes)
    found[:, 0], found[:, 1:] = first, slopes
    return found


def commands(loop, times, seen, mode):
    """(command, slack), a row for each state, and the actuators for it."""
    program, p, count = loop.program, loop.parameter_array(), len(seen)
    t, none, m = times[:, np.newaxis], np.zeros(1), len(loop.program.inputs)
    look = none
    if program.places:
        places = loop.leaves.values("places", count, program.places, t, seen, none, p)
        look = looked_up(program.table, places)
    conditions, hard = program.conditions_of_modes[mode]
    width = m + (conditions * (m + 1) + m if conditions else 0)
    answers = loop.leaves.values(f"law{mode}", count, width, t, seen, look, p)
    found = np.zeros((count, m + 1))
    if conditions:
        compile_functions(SWEEP).sweep(answers, m, conditions, hard, found)
    else:
        found[:, :m] = answers
    limited = program.limited
    acts = loop.leaves.values("actuate", count, 2 * limited + m, t, found[:, :m], p, p)
    return found, acts[:, limited : 2 * limited]
