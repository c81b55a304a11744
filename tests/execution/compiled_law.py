"""The commands of a compiled law at many states, as the closed loop computes them."""

import numpy as np

from holdfast.execution.look_up import slopes_at, values_at
from tests.execution.simulation.random_programs import solved


def looked_up(table, places):
    """The value and its slopes at the nearest place of the grid."""
    values, low, steps, shape, periodic = table
    high = low + steps * (shape - 1)
    at = np.where(periodic, places, np.clip(places, low, high))
    return np.column_stack([f(values, at, table[1:]) for f in (values_at, slopes_at)])


def commands(loop, times, seen, mode):
    """(command, slack), a row for each state, and the actuators for it."""
    program, p, count = loop.program, loop.parameter_array(), len(seen)
    t, none, m = times[:, np.newaxis], np.zeros(1), len(loop.program.inputs)
    look = none
    if program.places:
        places = loop.values("places", count, program.places, t, seen, none, p)
        look = looked_up(program.table, places)
    conditions, hard = program.conditions_of_modes[mode]
    width = m + (conditions * (m + 1) + m if conditions else 0)
    answers = loop.values(f"law{mode}", count, width, t, seen, look, p)
    found = np.zeros((count, m + 1))
    if conditions:
        rows = m + conditions * (m + 1)
        parts = (answers[:, :m], answers[:, rows:], answers[:, m:rows])
        counts = (np.full(count, n) for n in (conditions, hard))
        found = solved(*map(np.ascontiguousarray, parts), *counts)
    else:
        found[:, :m] = answers
    limited = program.limited
    acts = loop.values("actuate", count, 2 * limited + m, t, found[:, :m], p, p)
    return found, acts[:, limited : 2 * limited]
