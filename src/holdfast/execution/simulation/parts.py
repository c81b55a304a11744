"""Parts of the simulation loop that go from lane to lane: scalar functions.

The loop calls them with its arrays s and w, and the place in s of their entries, which `blocks.py`
fills. Of a block of `width` runs every quantity of w is a row of that many numbers:

    w    (rows * width,)    numbers of the lanes, then rooms that all lanes share
    s    (entries,)         places in w and sizes; those of a call begin at k
"""

from __future__ import annotations

import math

from holdfast.execution.arrays import Floats, Table, Wholes
from holdfast.execution.foreseen import keep_foreseen, numbers_of_search
from holdfast.execution.interpolate import beyond_grid, look_up
from holdfast.execution.look_in_cells import look_in_cells
from holdfast.execution.simulation.built_loop import AHEAD, LANES_OF_BLOCK
from holdfast.execution.simulation.quadratic_program import keep_in_order, overrules
from holdfast.execution.simulation.settings import Outcome


def table_at(address: int) -> Table:
    """The array at an address: a part of the compiler, not of Python, shape (numbers,)."""
    raise NotImplementedError


def keep_lanes(s: Wholes, w: Floats, k: int) -> None:
    """The program of a safeguard for the lanes that need it: from the answer of the law and its
    conditions to the command, the slack, and whether the law was overruled."""
    width = s[LANES_OF_BLOCK]
    m, most, hard, answer, command = s[k], s[k + 1], s[k + 2], s[k + 3], s[k + 4]
    rows = most * (m + 1)
    point, counts = w[s[k + 8] :], s[s[k + 9] :]
    levels, ends = s[k + 10], s[k + 11 :]
    ahead = s[k + AHEAD :]
    inputs, moves, motion, first, grid = ahead[0], ahead[1], ahead[3], ahead[4], ahead[5]
    numbers = m + rows + m
    if inputs > 0:
        numbers += 3 + motion + inputs * m
    given = point[numbers:]
    room = given[m + 1 :]
    for lane in range(width):
        if w[s[k + 7] + lane] == 0.0:
            continue
        for i in range(numbers):
            point[i] = w[answer + i * width + lane]
        conditions, scales = point[m:], point[m + rows :]
        if inputs > 0:
            axes, more = s[grid + 3], scales[m:]
            low, shape = w[s[grid + 11] :], s[grid + 16 :]
            search_room, search_whole = numbers_of_search(axes, m, most, moves), 3 * axes
            slack = keep_foreseen(
                table_at(s[grid]), point, scales, conditions, more[3:], more[3 + motion :], m, most,
                hard, ends, levels, first, inputs, more[0], more[1], more[2], low, low[axes:],
                shape, shape[axes:], axes, moves, ahead[2], given, room, counts,
                room[search_room:], counts[search_whole:],
            )  # fmt: skip
            for i in range(m):
                w[command + i * width + lane] = given[i]
            w[s[k + 5] + lane] = slack
            w[s[k + 6] + lane] = given[m]
            continue
        slack = keep_in_order(
            point, scales, conditions, m, most, hard, ends, levels, given, room, counts
        )  # fmt: skip
        for i in range(m):
            w[command + i * width + lane] = given[i]
        w[s[k + 5] + lane] = slack
        overruled = overrules(point, given, slack, conditions, m, most, hard)
        w[s[k + 6] + lane] = 1.0 if overruled else 0.0


def look_up_lanes(s: Wholes, w: Floats, k: int) -> None:
    """The value of the law's table and its slopes at a place of each lane.

    When the entry `noted` is set, also the first time outside of the table.
    """
    values, width = table_at(s[k]), s[LANES_OF_BLOCK]
    first, noted, axes = s[k + 1], s[k + 2], s[k + 3]
    look_at, look, alive, now, off = s[k + 4], s[k + 5], s[k + 6], s[k + 7], s[k + 8]
    outcome, ended = s[k + 9], s[k + 10]
    whole, shape, periodic = s[s[k + 12] :], s[k + 16 :], s[k + 16 + axes :]
    low, steps = w[s[k + 11] :], w[s[k + 11] + axes :]
    point, found = steps[axes:], steps[2 * axes :]
    count = s[k + 15]
    rest = found[count:]
    for lane in range(width):
        if w[alive + lane] == 0.0:
            continue
        for i in range(axes):
            point[i] = w[look_at + i * width + lane]
        look_up(values, point, low, steps, shape, periodic, axes, count - 1, found, rest, whole)
        for i in range(count):
            w[look + i * width + lane] = found[i]
        if not noted or not math.isnan(w[off + lane]):
            continue
        if beyond_grid(point, low, steps, shape, periodic, axes, first):
            w[off + lane] = w[now + lane]
            if w[outcome + lane] == Outcome.STAYED:
                w[outcome + lane] = Outcome.OFF_GRID
                w[ended + lane] = w[now + lane]


def look_in_cells_lanes(s: Wholes, w: Floats, k: int) -> None:
    """What the law's table says of the cell of each lane.

    When the entry `noted` is set, also the first time in no cell that is known.
    """
    entries, width = table_at(s[k]), s[LANES_OF_BLOCK]
    noted, axes = s[k + 2], s[k + 3]
    look_at, look, alive, now, off = s[k + 4], s[k + 5], s[k + 6], s[k + 7], s[k + 8]
    outcome, ended = s[k + 9], s[k + 10]
    whole, shape, periodic = s[s[k + 12] :], s[k + 16 :], s[k + 16 + axes :]
    numbers, rows, count = w[s[k + 13] :], s[k + 14], s[k + 15]
    point = w[s[k + 11] + 2 * axes :]
    found = point[axes:]
    for lane in range(width):
        if w[alive + lane] == 0.0:
            continue
        for i in range(axes):
            point[i] = w[look_at + i * width + lane]
        known = look_in_cells(
            entries, point, numbers, shape, periodic, axes, rows, count, found, whole
        )  # fmt: skip
        for i in range(count):
            w[look + i * width + lane] = found[i]
        if not known and noted != 0 and math.isnan(w[off + lane]):
            w[off + lane] = w[now + lane]
            if w[outcome + lane] == Outcome.STAYED:
                w[outcome + lane] = Outcome.OFF_GRID
                w[ended + lane] = w[now + lane]
