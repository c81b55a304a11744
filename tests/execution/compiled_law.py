"""The commands of a compiled law at many states, as the closed loop computes them."""

import numpy as np

from holdfast.execution.codegen.scalar_llvm import called
from holdfast.execution.foreseen import CUTS, numbers_of_search
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from holdfast.execution.table_in_parts import slopes_at, values_at
from tests.execution.simulation.random_programs import solved


def looked_up(table, places, found):
    """The value at the nearest place of the grid, and its slopes where more is found."""
    values, low, steps, shape, periodic = table
    high = low + steps * (shape - 1)
    at = np.where(periodic, places, np.clip(places, low, high))
    looks = (values_at, slopes_at) if found > 1 else (values_at,)
    return np.column_stack([f(values, at, table[1:]) for f in looks])


def foreseen(program, mode, answers):
    """(command, slack) of a safeguard that looks ahead, a row for each answer of the law."""
    values, low, steps, shape, periodic = program.table
    (most, hard), ends = program.conditions_of_modes[mode], program.levels_of_modes[mode]
    points, moves, curved, motion, first = program.foresight_of_modes[mode]
    m, axes, n = len(program.inputs), len(shape), len(answers)
    room = np.empty(numbers_of_search(axes, m, most, moves))
    own, counts = numbers_of_programs(m, most + CUTS * moves)
    grid = low, steps, *(np.ascontiguousarray(a, dtype=np.int64) for a in (shape, periodic))
    rest = room, np.zeros(3 * axes, np.int64), np.empty(own + m), np.zeros(counts, np.int64)
    found, result = np.zeros((n, m + 1)), np.empty(m + 1)
    for k, row in enumerate(answers):
        scales = m + most * (m + 1)
        more = scales + m
        level, floor, beyond = row[more : more + 3]
        found[k, m] = called(
            "foreseen", "keep_foreseen", values, row[:m].copy(), row[scales:].copy(),
            row[m:].copy(), row[more + 3 :].copy(), row[more + 3 + motion :].copy(), m, most, hard,
            np.array(ends), len(ends), first, points, level, floor, beyond, *grid, axes, moves,
            curved, result, *rest,
        )  # fmt: skip
        found[k, :m] = result[:m]
    return found


def commands(loop, times, seen, mode):
    """(command, slack), a row for each state, and the actuators for it."""
    program, p, count = loop.program, loop.parameter_array(), len(seen)
    t, none, m = times[:, np.newaxis], np.zeros(1), len(loop.program.inputs)
    look = none
    if program.places:
        places = loop.values("places", count, program.places, t, seen, none, p)
        look = looked_up(program.table, places, program.found)
    conditions, hard = program.conditions_of_modes[mode]
    width = program.rows_of(f"law{mode}")
    answers = loop.values(f"law{mode}", count, width, t, seen, look, p)
    found = np.zeros((count, m + 1))
    if program.foresight_of_modes[mode]:
        found = foreseen(program, mode, answers)
    elif conditions:
        rows = m + conditions * (m + 1)
        parts = (answers[:, :m], answers[:, rows:], answers[:, m:rows])
        counts = (np.full(count, n) for n in (conditions, hard))
        found = solved(*map(np.ascontiguousarray, parts), *counts)
    else:
        found[:, :m] = answers
    limited = program.limited
    acts = loop.values("actuate", count, 2 * limited + m, t, found[:, :m], p, p)
    return found, acts[:, limited : 2 * limited]
