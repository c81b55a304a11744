"""The value of the sampled game on a grid: inputs are held from sample to sample.

    W(q) = min(V(q), max over held u of min over d of W(q after the sample))

W is the function between the nodes that `interpolate.py` gives; V is where it begins. After a
sample the state is, with the numbers of a node,

    base_i + sum_j (gain_ij + sum_(k >= j) curve_ijk u_k) u_j + move_ri   for the disturbance r

These are scalar functions (`codegen/scalar_reader.py`). All arrays have one dimension; m is the
number of inputs:

    values, flags, chosen           (nodes,)         the last axis is the fastest
    q, low, steps, shape            (axes,)          in the units of the axes
    ends, reach                     (axes,)
    u                               (m,)
    motion                          (wide,)          base, gains, curves and moves of a node
    motions                         (count * wide,)  one node after the other
    points                          (inputs * m,)    one input after the other
    out                             (axes,)
    room                            (6 * axes,)      three places of `others`, base, and a place
    whole                           (4 * axes + 1,)  nodes below and above, turns; then a count
"""

from __future__ import annotations

import math

from holdfast.execution.arrays import Floats, Wholes
from holdfast.execution.interpolate import between_nodes

STILL = 1e-9  # the weight of the other nodes below which a state has not moved


def numbers_of_motion(axes: int, inputs: int, moves: int, curved: int) -> int:
    """The numbers of a node: base, gains, curves and moves."""
    pairs = inputs * (inputs + 1) // 2
    return axes * (1 + inputs + curved * pairs + moves)


def held_place(motion: Floats, u: Floats, axes: int, m: int, curved: int, out: Floats) -> None:
    """Fill `out` with the state after a sample, without the move of a disturbance."""
    curve = axes * (1 + m)
    for i in range(axes):
        out[i] = motion[i]
        for j in range(m):
            out[i] += motion[axes + i * m + j] * u[j]
    if curved != 0:
        for i in range(axes):
            for j in range(m):
                for k in range(j, m):
                    out[i] += motion[curve] * u[j] * u[k]
                    curve += 1


def others(
    values: Floats, q: Floats, node: int, low: Floats, steps: Floats, shape: Wholes, ends: Wholes,
    axes: int, lost: float, room: Floats, whole: Wholes,
) -> float:  # fmt: skip
    """The mean of the nodes around q but `node`, by their weights; its own value if q is there.

    W at q is at least that of the node where this mean is. ends: 0 where beyond the grid all is
    `lost`, 1 where the axis is periodic, 2 where the state stays at the end.
    """
    near, far = whole, whole[axes:]
    turns = whole[2 * axes :]
    at_end = room[2 * axes :]
    for i in range(axes):
        turns[i] = 1 if ends[i] == 1 else 0
        at_end[i] = q[i]
        if ends[i] == 2:
            at_end[i] = min(max(q[i], low[i]), low[i] + steps[i] * (shape[i] - 1))
    if not between_nodes(at_end, low, steps, shape, turns, axes, room, whole):
        return lost
    total, rest = 0.0, 0.0
    for corner in range(1 << axes):
        at, weight = 0, 1.0
        for i in range(axes):
            if (corner >> i) & 1:
                at = at * shape[i] + far[i]
                weight *= room[i]
            else:
                at = at * shape[i] + near[i]
                weight *= 1.0 - room[i]
        if at != node and weight != 0.0:
            total += weight * values[at]
            rest += weight
    if node >= 0 and rest < STILL:
        return values[node]
    return total / rest


def worst_after(
    values: Floats, motion: Floats, u: Floats, node: int, least: float, low: Floats, steps: Floats,
    shape: Wholes, ends: Wholes, axes: int, m: int, moves: int, curved: int, lost: float,
    room: Floats, whole: Wholes,
) -> float:  # fmt: skip
    """The least of `others` over the disturbances; where it is below `least`, one below it."""
    base, place = room[4 * axes :], room[5 * axes :]
    held_place(motion, u, axes, m, curved, base)
    move = motion[axes * (1 + m + curved * (m * (m + 1) // 2)) :]
    found = math.inf
    for r in range(moves):
        for i in range(axes):
            place[i] = base[i] + move[r * axes + i]
        found = min(
            found, others(values, place, node, low, steps, shape, ends, axes, lost, room, whole)
        )
        if found < least:
            return found
    return found


def touch(
    flags: Wholes, node: int, shape: Wholes, ends: Wholes, reach: Wholes, axes: int, whole: Wholes
) -> None:
    """Set the flags of the nodes around one, so many along each axis, which may lead to it."""
    at, step = whole, whole[axes:]
    rest, total = node, 1
    for i in range(axes):
        k = axes - 1 - i
        at[k] = rest % shape[k]
        rest = rest // shape[k]
        step[k] = -reach[k]
        total = total * (2 * reach[k] + 1)
    for _ in range(total):
        place, inside = 0, True
        for i in range(axes):
            k = at[i] + step[i]
            if ends[i] == 1:
                if k < 0:
                    k += shape[i]
                if k >= shape[i]:
                    k -= shape[i]
            inside = inside and 0 <= k < shape[i]
            place = place * shape[i] + k
        if inside:
            flags[place] = 1
        moving = True
        for i in range(axes):
            k = axes - 1 - i
            if moving:
                step[k] += 1
                moving = step[k] > reach[k]
                if moving:
                    step[k] = -reach[k]


def sweep_game(
    values: Floats, flags: Wholes, chosen: Wholes, motions: Floats, first: int, count: int,
    back: int, points: Floats, inputs: int, wide: int, low: Floats, steps: Floats, shape: Wholes,
    ends: Wholes, reach: Wholes, axes: int, m: int, moves: int, curved: int, lost: float,
    little: float, room: Floats, whole: Wholes,
) -> int:  # fmt: skip
    """Lower the values of `count` nodes from `first` on, in turn or back; how many fell.

    flags: the nodes to look at; those that fall by more than `little` set the flags around them.
    chosen: the input of each node that was best last. Nodes at `lost` stay there. whole[4 axes]:
    the inputs that were tried at nodes are added to it.
    """
    fallen, tried = 0, 0
    for step in range(count):
        j = step
        if back != 0:
            j = count - 1 - step
        node = first + j
        if flags[node] == 0:
            continue
        flags[node] = 0
        value = values[node]
        if value <= lost:
            continue
        motion = motions[j * wide :]
        best = worst_after(
            values, motion, points[chosen[node] * m :], node, -math.inf, low, steps, shape, ends,
            axes, m, moves, curved, lost, room, whole,
        )  # fmt: skip
        tried += 1
        if best >= value:
            continue
        for k in range(inputs):
            if k == chosen[node]:
                continue
            found = worst_after(
                values, motion, points[k * m :], node, best, low, steps, shape, ends, axes, m,
                moves, curved, lost, room, whole,
            )  # fmt: skip
            tried += 1
            if found > best:
                best = found
                chosen[node] = k
                if best >= value:
                    break
        if best < value:
            best = max(best, lost)
            values[node] = best
            if value - best > little:
                fallen += 1
                touch(flags, node, shape, ends, reach, axes, whole)
    whole[4 * axes] += tried
    return fallen
