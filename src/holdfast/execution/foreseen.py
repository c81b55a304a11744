"""The input nearest to a wanted one after which the value of the sampled game is high enough.

    minimise  sum_i ((u_i - wanted_i) / scale_i)^2
    subject to  min over the moves r of W(place(u) + move_r) >= level,  normals u <= offsets

W is a table (`interpolate.py`), place(u) the state after a sample (`sampled_game.held_place`). The
condition has corners where W has ridges, and only what has been looked up counts: the wanted
input, then the answers of quadratic programs with the slopes of W where the last one leads
(cutting planes), then given points of the bounds and what lies between them and the wanted input.
These are scalar functions (`codegen/scalar_reader.py`): the closed loop, exported laws and
Python run the same text. All arrays have one dimension; m is the number of inputs:

    values                                 (nodes,)            of W, the last axis is the fastest
    q, low, steps, shape, periodic, slope  (axes,)             in the units of the axes
    wanted, scales, u, result              (m,)                result: (m + 1,) of `keep_foreseen`
    constraints                            (most * (m + 1),)   of each the normal, then the offset
    points                                 (inputs * m,)       one input after the other
    motion                                 (numbers_of_motion,) base, gains, curves and moves
    motions, levels                        (number * wide,)    levels: (number,)
    out                                    (number * (m + 1),) of each the input and the shortfall
    ends                                   (levels,)           where each level of conditions ends
    room                                   (numbers_of_search,)
    rows                                   (rows * (m + 1),)   as constraints, with those of moves
    whole                                  (2 * axes,)         the nodes below, and those above
    own, counts                            (numbers of `keep_within`,)

With a plane for each move and cut, a program has most + CUTS * moves rows of m + 1 numbers.
"""

from __future__ import annotations

import math

from holdfast.execution.arrays import Floats, Table, Wholes
from holdfast.execution.sampled_game import held_place
from holdfast.execution.simulation.quadratic_program import keep_in_order, keep_within, overrules

CUTS = 3  # quadratic programs, of which each adds a plane for every move that lacks something
HALVINGS = 5  # of the way from an input that is admissible to the wanted one
ROUNDS = 4  # of the search around the best point
BETTER = 1e-9  # of the size of the values, by which a better input is better
SURE = 1e-9  # of that size, by which a plane is taken too narrow
ROUNDING = 1e-9  # of the terms of a half-space, beyond which a point is outside
SIDES = 0.5  # how far around the best point the search begins, in half widths


def numbers_of_look(axes: int, moves: int) -> int:
    """The numbers of `room` that `least_after` needs; of `whole` it needs 2 * axes."""
    return 4 * axes + 2 * (1 << axes) + moves


def value_there(
    values: Table, q: Floats, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes,
    axes: int, beyond: float, slope: Floats, sloped: bool, room: Floats, whole: Wholes,
) -> float:  # fmt: skip
    """W at q, and its slope in the cell of q; beyond the grid less than 0, by `beyond` a cell.

    The values at the corners of the cell are halved axis by axis: the last two, then the others.
    """
    near, far, corners = whole, whole[axes:], room[axes:]
    count, out = 1, 0.0
    for i in range(axes):
        x = (q[i] - low[i]) / steps[i]
        if not math.isfinite(x):
            return -math.inf
        top = shape[i] - 1
        if periodic[i] != 0:
            if not 0.0 <= x < shape[i]:
                x -= shape[i] * math.floor(x / shape[i])
        else:
            if x < 0.0:
                out -= x
                x = 0.0
            elif x > top:
                out += x - top
                x = float(top)
            top -= 1
        k = min(max(int(x), 0), top)
        near[i] = k
        far[i] = k + 1
        if k + 1 == shape[i]:
            far[i] = 0
        room[i] = x - k
    last, other, other_near, other_far, across, lines = axes - 1, axes - 2, 0, 0, 0.0, 1
    if axes > 1:
        other_near, other_far, across = near[other], far[other], room[other]
        lines = shape[other]
    corners[0] = 0.0  # the places of the corners along the axes before these two
    for i in range(axes - 2):
        for c in range(count - 1, -1, -1):
            first = corners[c] * shape[i]
            corners[2 * c] = first + near[i]
            corners[2 * c + 1] = first + far[i]
        count *= 2
    tilts = corners[1 << axes :]  # of axis i from 1 << i on
    for c in range(count):
        plane = int(corners[c]) * lines
        line = (plane + other_near) * shape[last]
        next_line = (plane + other_far) * shape[last]
        at, beside = float(values[line + near[last]]), float(values[next_line + near[last]])
        tilt = float(values[line + far[last]]) - at
        tilt_beside = float(values[next_line + far[last]]) - beside
        at += room[last] * tilt
        beside += room[last] * tilt_beside
        corners[c] = at + across * (beside - at)
        if sloped:
            tilts[(1 << last) + c] = tilt + across * (tilt_beside - tilt)
            if axes > 1:
                tilts[(1 << other) + c] = beside - at
    for k in range(axes - 2):
        i = axes - 3 - k
        count = count // 2
        between = room[i]
        if sloped:
            for j in range(i + 1, axes):
                along = tilts[1 << j :]
                for c in range(count):
                    along[c] = along[2 * c] + between * (along[2 * c + 1] - along[2 * c])
            for c in range(count):
                tilts[(1 << i) + c] = corners[2 * c + 1] - corners[2 * c]
        for c in range(count):
            corners[c] = corners[2 * c] + between * (corners[2 * c + 1] - corners[2 * c])
    if sloped:
        for i in range(axes):
            slope[i] = tilts[1 << i] / steps[i]
    if out > 1e-6:
        return min(corners[0], 0.0) - out * beyond
    return corners[0]


def numbers_of_search(axes: int, m: int, most: int, moves: int) -> int:
    """The numbers of `room` that `search` needs, without its program; of `whole` it needs
    2 * axes."""
    return numbers_of_look(axes, moves) + (most + CUTS * moves) * (m + 1) + 5 * m


def least_after(
    values: Table, motion: Floats, u: Floats, enough: float, low: Floats, steps: Floats,
    shape: Wholes, periodic: Wholes, axes: int, m: int, moves: int, curved: int, beyond: float,
    room: Floats, whole: Wholes,
) -> float:  # fmt: skip
    """The least W after a sample with an input; what is below `enough` need not be the least.

    The heights of the moves, those that were not looked up -inf, and the place without a move are
    left to `add_planes` at the beginning of `room`.
    """
    heights, base = room, room[moves:]
    place, slope = base[axes:], base[2 * axes :]
    rest = base[3 * axes :]
    held_place(motion, u, axes, m, curved, base)
    move = motion[axes * (1 + m + curved * (m * (m + 1) // 2)) :]
    found = math.inf
    for r in range(moves):
        heights[r] = -math.inf
        if found >= enough:
            for i in range(axes):
                place[i] = base[i] + move[r * axes + i]
            heights[r] = value_there(
                values, place, low, steps, shape, periodic, axes, beyond, slope, False, rest, whole
            )
            if not heights[r] >= found:
                found = heights[r]
    return found


def add_planes(
    values: Table, motion: Floats, u: Floats, level: float, low: Floats, steps: Floats,
    shape: Wholes, periodic: Wholes, axes: int, m: int, moves: int, curved: int, beyond: float,
    rows: Floats, count: int, room: Floats, whole: Wholes,
) -> int:  # fmt: skip
    """Append a half-space of the inputs for each move after which W is below the level; how many
    rows there are then. `least_after` was called with the same input last.

    slope . (gain + curve) (v - u) >= level - W(u).
    """
    heights, base = room, room[moves:]
    place, slope = base[axes:], base[2 * axes :]
    rest = base[3 * axes :]
    move = motion[axes * (1 + m + curved * (m * (m + 1) // 2)) :]
    for r in range(moves):
        if heights[r] >= level:
            continue
        for i in range(axes):
            place[i] = base[i] + move[r * axes + i]
        value = value_there(
            values, place, low, steps, shape, periodic, axes, beyond, slope, True, rest, whole
        )
        if value >= level:
            continue
        row = rows[count * (m + 1) :]
        for j in range(m):
            row[j] = 0.0
        curve, size = axes * (1 + m), 0.0
        for i in range(axes):
            for j in range(m):
                row[j] -= slope[i] * motion[axes + i * m + j]
            if curved != 0:
                for j in range(m):
                    for k in range(j, m):
                        row[j] -= slope[i] * motion[curve] * u[k]
                        row[k] -= slope[i] * motion[curve] * u[j]
                        curve += 1
        offset = value - level - SURE * beyond
        for j in range(m):
            offset += row[j] * u[j]
            size += abs(row[j])
        if size > 0.0 and math.isfinite(offset) and math.isfinite(size):
            row[m] = offset
            count += 1
    return count


def within(u: Floats, constraints: Floats, m: int, most: int) -> bool:
    """Whether an input is in all half-spaces, or on their planes but for rounding."""
    for j in range(most):
        row = constraints[j * (m + 1) :]
        above = -row[m]
        size = abs(row[m])
        for k in range(m):
            above += row[k] * u[k]
            size += abs(row[k] * u[k])
        if not above <= ROUNDING * size:
            return False
    return True


def search(
    values: Table, wanted: Floats, scales: Floats, constraints: Floats, motion: Floats,
    points: Floats, m: int, most: int, inputs: int, level: float, floor: float, beyond: float,
    low: Floats, steps: Floats, shape: Wholes, periodic: Wholes, axes: int, moves: int,
    curved: int, result: Floats, room: Floats, whole: Wholes, own: Floats, counts: Wholes,
) -> float:  # fmt: skip
    """The admissible input nearest to `wanted` after which W is at least `level`; the shortfall.

    constraints: half-spaces with a common point. points: some inputs. Where none is found that
    reaches the level, it is the best that was found; the shortfall is what it lacks of `floor`, 0
    if it lacks nothing. NaN gives NaN. room, whole: see `numbers_of_search`; own, counts: of
    `keep_within` with `most` constraints and `CUTS` for each move.
    """
    rows = room[numbers_of_look(axes, moves) :]
    best = rows[(most + CUTS * moves) * (m + 1) :]
    tried = best[m:]
    held = tried[m:]
    way = held[m:]
    slack = keep_within(wanted, scales, constraints, m, most, most, held, own, counts)
    if not slack < math.inf or not math.isfinite(level):
        for i in range(m):
            result[i] = math.nan
        return math.nan
    for i in range(m):
        result[i] = held[i]
        best[i] = held[i]
    reached = least_after(
        values, motion, held, -math.inf, low, steps, shape, periodic, axes, m, moves, curved,
        beyond, room, whole,
    )  # fmt: skip
    if reached >= level:
        return 0.0
    for i in range(most * (m + 1)):
        rows[i] = constraints[i]
    count = most
    for i in range(m):
        tried[i] = held[i]
    for _ in range(CUTS):
        before = count
        count = add_planes(
            values, motion, tried, level, low, steps, shape, periodic, axes, m, moves, curved,
            beyond, rows, count, room, whole,
        )  # fmt: skip
        if count == before:
            break
        slack = keep_within(wanted, scales, rows, m, count, most, way, own, counts)
        if slack < math.inf:  # rounding may leave it beyond its bounds
            rest = keep_within(way, scales, constraints, m, most, most, tried, own, counts)
            slack = max(slack, rest)
        if not slack < math.inf:
            break
        value = least_after(
            values, motion, tried, min(level, reached), low, steps, shape, periodic, axes, m, moves,
            curved, beyond, room, whole,
        )  # fmt: skip
        if value > reached + BETTER * beyond:
            reached = value
            for i in range(m):
                best[i] = tried[i]
        if value >= level:
            for i in range(m):
                result[i] = tried[i]
            return 0.0
        if slack > 0.0:
            break
    nearest = math.inf
    for k in range(inputs):
        point = points[k * m :]
        if not within(point, constraints, m, most):
            continue
        value = least_after(
            values, motion, point, min(level, reached), low, steps, shape, periodic, axes, m, moves,
            curved, beyond, room, whole,
        )  # fmt: skip
        far = 0.0
        for i in range(m):
            step = (point[i] - wanted[i]) / scales[i]
            far += step * step
        if value >= level and far < nearest:
            nearest = far
            reached = value
            for i in range(m):
                best[i] = point[i]
        elif nearest == math.inf and value > reached + BETTER * beyond:
            reached = value
            for i in range(m):
                best[i] = point[i]
    if reached < level:
        for i in range(m):
            way[i] = SIDES * scales[i]
        for _ in range(ROUNDS):
            for i in range(m):
                for side in range(2):
                    for j in range(m):
                        tried[j] = best[j]
                    tried[i] = best[i] + way[i]
                    if side == 1:
                        tried[i] = best[i] - way[i]
                    if not within(tried, constraints, m, most):
                        continue
                    value = least_after(
                        values, motion, tried, reached, low, steps, shape, periodic, axes, m, moves,
                        curved, beyond, room, whole,
                    )  # fmt: skip
                    if value > reached + BETTER * beyond:
                        reached = value
                        for j in range(m):
                            best[j] = tried[j]
            for i in range(m):
                way[i] *= 0.5
    if reached >= floor:
        enough = min(level, reached)
        inner, outer = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (inner + outer)
            for i in range(m):
                tried[i] = best[i] + middle * (held[i] - best[i])
            value = least_after(
                values, motion, tried, enough, low, steps, shape, periodic, axes, m, moves, curved,
                beyond, room, whole,
            )  # fmt: skip
            if value >= enough:
                inner = middle
            else:
                outer = middle
        for i in range(m):
            result[i] = best[i] + inner * (held[i] - best[i])
        return 0.0
    for i in range(m):
        result[i] = best[i]
    return floor - reached


def keep_foreseen(
    values: Table, wanted: Floats, scales: Floats, constraints: Floats, motion: Floats,
    points: Floats, m: int, most: int, hard: int, ends: Wholes, levels: int, first: int,
    inputs: int, level: float, floor: float, beyond: float, low: Floats, steps: Floats,
    shape: Wholes, periodic: Wholes, axes: int, moves: int, curved: int, result: Floats,
    room: Floats, whole: Wholes, own: Floats, counts: Wholes,
) -> float:  # fmt: skip
    """The input nearest to `wanted` in the half-spaces, after which W is high enough; the slack.

    The half-spaces after the first `hard` give way to each other as in `keep_in_order`; where
    `first` is set they all give way to W, by as little as the input can, else W to them. result:
    the input, and 1 where a condition changed it, not the bounds alone. own: `m` numbers more than
    of `search`.
    """
    slack = keep_in_order(
        wanted, scales, constraints, m, most, hard, ends, levels, result, own, counts
    )
    if not slack < math.inf or not math.isfinite(level):
        for i in range(m):
            result[i] = math.nan
        result[m] = 1.0
        return math.nan
    if slack > 0.0 and levels < 2:
        for j in range(hard, most):
            constraints[j * (m + 1) + m] += slack * (1.0 + ROUNDING)
    result[m] = 0.0
    if overrules(wanted, result, slack, constraints, m, most, hard):
        result[m] = 1.0
    held, enough = own, floor
    if first != 0 and most > hard:
        enough = level
    for i in range(m):
        held[i] = result[i]
    lacking = search(
        values, wanted, scales, constraints, motion, points, m, most, inputs, level, enough, beyond,
        low, steps, shape, periodic, axes, moves, curved, result, room, whole, own[m:], counts,
    )  # fmt: skip
    if lacking > 0.0 and first != 0 and most > hard:
        lacking = search(
            values, held, scales, constraints, motion, points, m, hard, inputs, level, floor,
            beyond, low, steps, shape, periodic, axes, moves, curved, result, room, whole, own[m:],
            counts,
        )  # fmt: skip
    if lacking > 0.0:
        result[m] = 1.0
    for i in range(m):
        if result[i] != held[i]:
            result[m] = 1.0
    return max(slack, lacking)


def search_many(
    number: int, values: Table, wanted: Floats, scales: Floats, constraints: Floats,
    motions: Floats, wide: int, points: Floats, m: int, most: int, inputs: int, levels: Floats,
    beyond: float, low: Floats, steps: Floats, shape: Wholes, periodic: Wholes, axes: int,
    moves: int, curved: int, out: Floats, room: Floats, whole: Wholes, own: Floats,
    counts: Wholes,
) -> None:  # fmt: skip
    """`search` at many states: each has its wanted input, its motion and its level."""
    for k in range(number):
        result = out[k * (m + 1) :]
        result[m] = search(
            values, wanted[k * m :], scales, constraints, motions[k * wide :], points, m, most,
            inputs, levels[k], levels[k], beyond, low, steps, shape, periodic, axes, moves, curved,
            result, room, whole, own, counts,
        )  # fmt: skip
