"""Where a vehicle is near obstacles: pairs of discs that touch as the bodies do, scalar functions.

The closed loop, exported laws and Python run the same text (`codegen/scalar_reader.py`). A body is
convex: the points within a radius of a polygon of k corners in the order of its outline, a disc for
k = 1 and a capsule for k = 2. The hull of a vehicle has several such parts, in the axes of the
vehicle. Two convex bodies that are apart are nearest at a corner of one of them, so that they are
apart as long as each corner of each is outside the other. A corner and what it is nearest to make a
pair of discs: two corners are discs of their own radii, and a side is a disc with the radius
`FLAT`, which touches it from behind. All arrays have one dimension; lengths are in m:

    hull       (numbers,)           a part after the other: k, its radius, x and y of its corners
    records    (size,)              a body after the other: k, its radius, its velocity (2), how
                                    fast that may change, its share, the age of these numbers, the
                                    error of the velocity, then its corners
    pose       (3 * stride + 1,)    x and y of the vehicle, cosine and sine of its heading, each
                                    `stride` behind the one before
    pairs      (most * PAIR,)       here, lever (2), centre (2), reach, velocity (2), change,
                                    unsure, share: for `maths/control/moving_obstacles.py`
    near       (2 * most,)          of each pair the gap, and the number of the obstacle
    points     (2 * k,)             x and y of the corners of one body
    row        (PAIR,)              one of the pairs
    record     (RECORD + 2 * k,)    one of the records
    touch      (6,)                 of a point and a body: the nearest point, the normal there from
                                    the body to the point, the distance, negative inside, and
                                    whether a side is nearest
"""

from __future__ import annotations

import math

from holdfast.execution.arrays import Floats

PAIR = 11
RECORD = 8
PART = 2
"""The numbers of a pair, and of an obstacle and a part of the hull before their corners."""

FLAT = 1e6
"""The radius of a disc that stands for a side [m]: over 1 m it departs from the side by half a
micrometre."""

FAR = 1e9
"""Where nothing is [m]."""


def nearest_on(points: Floats, k: int, x: float, y: float, touch: Floats) -> None:
    """Fill `touch` for a point and a convex polygon of k corners."""
    best, inside = math.inf, k > 2
    depth = -math.inf
    area = 0.0
    for i in range(k):
        j = i + 1 if i + 1 < k else 0
        area += points[2 * i] * points[2 * j + 1] - points[2 * j] * points[2 * i + 1]
    turn = 1.0 if area >= 0.0 else -1.0
    for i in range(k if k > 1 else 1):
        j = i + 1 if i + 1 < k else 0
        ax, ay = points[2 * i], points[2 * i + 1]
        dx, dy = points[2 * j] - ax, points[2 * j + 1] - ay
        size = dx * dx + dy * dy
        s = 0.0
        if size > 0.0:
            s = ((x - ax) * dx + (y - ay) * dy) / size
        flat = 0.0 < s < 1.0
        s = min(max(s, 0.0), 1.0)
        qx, qy = ax + s * dx, ay + s * dy
        away = math.sqrt((x - qx) * (x - qx) + (y - qy) * (y - qy))
        nx, ny, side = 1.0, 0.0, 0.0
        if size > 0.0:
            length = math.sqrt(size)
            nx, ny = turn * dy / length, -turn * dx / length
            side = (x - ax) * nx + (y - ay) * ny
        if side > 0.0 or k < 3:
            inside = False
        if away < best:
            best = away
            touch[0], touch[1], touch[4] = qx, qy, away
            touch[5] = 1.0 if flat else 0.0
            if away > 0.0:
                touch[2], touch[3] = (x - qx) / away, (y - qy) / away
            else:
                touch[2], touch[3] = nx, ny
        if inside and side > depth:
            depth = side
    if not inside:
        return
    for i in range(k):  # inside: out through the nearest side
        j = i + 1 if i + 1 < k else 0
        ax, ay = points[2 * i], points[2 * i + 1]
        dx, dy = points[2 * j] - ax, points[2 * j + 1] - ay
        length = math.sqrt(dx * dx + dy * dy)
        if not length > 0.0:
            continue
        nx, ny = turn * dy / length, -turn * dx / length
        side = (x - ax) * nx + (y - ay) * ny
        if side >= depth:
            touch[0], touch[1] = x - side * nx, y - side * ny
            touch[2], touch[3], touch[4], touch[5] = nx, ny, side, 1.0
            return


def put(
    pairs: Floats, near: Floats, most: int, count: int, gap: float, number: int, ahead: float,
    left: float, x: float, y: float, reach: float,
) -> int:  # fmt: skip
    """Store a pair, in the place of the one with the largest gap where all places are taken.

    Returns the place; -1 where it is farther than all others.
    """
    place = count
    if count >= most:
        place = 0
        for i in range(most):
            if near[2 * i] > near[2 * place]:
                place = i
        if gap >= near[2 * place]:
            return -1
    near[2 * place], near[2 * place + 1] = gap, number
    row = pairs[place * PAIR :]
    row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, ahead, left, x, y, reach
    return place


def fill_motion(row: Floats, record: Floats, first: bool) -> None:
    """The velocity of an obstacle, how it may change, and the share, in the row of a pair."""
    row[6], row[7], row[8] = record[2], record[3], record[4]
    row[9], row[10] = record[7] + record[4] * record[6], record[5]
    if first and record[5] < 1.0:
        row[6], row[7], row[8], row[9] = 0.0, 0.0, 0.0, 0.0


def find_pairs(
    hull: Floats, parts: int, pose: Floats, stride: int, records: Floats, size: int, most: int,
    clearance: float, first: bool, pairs: Floats, near: Floats, touch: Floats,
) -> int:  # fmt: skip
    """Fill `pairs` with the nearest pairs of the hull and the bodies; how many there were.

    size: how many numbers there are in `records`.
    clearance [m] is kept between them. first: whether the conditions bound a first derivative; an
    obstacle that answers for a share of it then answers for its own velocity. Returns -1 - k where
    a number of the body k is not finite or cannot be (a share of 0, a negative radius), or it has
    no corners; nothing of `pairs` counts then.
    """
    x, y, cos, sin = pose[0], pose[stride], pose[2 * stride], pose[3 * stride]
    for i in range(most):
        row = pairs[i * PAIR :]
        for c in range(PAIR):
            row[c] = 0.0
        row[3], row[4], row[10] = x + FAR, y, 1.0
        near[2 * i], near[2 * i + 1] = math.inf, -1.0
    total, at, number = 0, 0, -1
    while at < size:
        number += 1
        record = records[at:]
        corners = record[RECORD:]
        if not 1.0 <= record[0] <= 1e6:
            return -1 - number
        k = int(record[0])
        if at + RECORD + 2 * k > size:
            return -1 - number
        for c in range(RECORD + 2 * k):
            if not math.isfinite(record[c]):
                return -1 - number
        if record[1] < 0.0 or record[4] < 0.0 or record[6] < 0.0 or record[7] < 0.0:
            return -1 - number
        if not 0.0 < record[5] <= 1.0:  # a share of 0 would leave it out
            return -1 - number
        at += RECORD + 2 * k
        vx, vy, change, age = record[2], record[3], record[4], record[6]
        grown = record[1] + (record[7] + change * age / 2.0) * age
        part = hull
        for _p in range(parts):
            sides, radius, of_hull = int(part[0]), part[1], part[PART:]
            reach = radius + grown + clearance
            for i in range(sides):
                ahead, left = of_hull[2 * i], of_hull[2 * i + 1]
                px, py = x + ahead * cos - left * sin, y + ahead * sin + left * cos
                nearest_on(corners, k, px - vx * age, py - vy * age, touch)
                bx, by, apart = touch[0], touch[1], reach
                if touch[5] != 0.0:
                    bx, by, apart = bx - FLAT * touch[2], by - FLAT * touch[3], reach + FLAT
                place = put(
                    pairs, near, most, total, touch[4] - reach, number, ahead, left,
                    bx + vx * age, by + vy * age, apart,
                )  # fmt: skip
                total += 1
                if place >= 0:
                    fill_motion(pairs[place * PAIR :], record, first)
            if sides > 1:
                for i in range(k):
                    bx, by = corners[2 * i] + vx * age, corners[2 * i + 1] + vy * age
                    dx, dy = bx - x, by - y
                    nearest_on(of_hull, sides, dx * cos + dy * sin, dy * cos - dx * sin, touch)
                    if touch[5] == 0.0:
                        continue  # two corners are a pair already
                    ahead, left = touch[0] - FLAT * touch[2], touch[1] - FLAT * touch[3]
                    place = put(
                        pairs, near, most, total, touch[4] - reach, number, ahead, left, bx, by,
                        reach + FLAT,
                    )  # fmt: skip
                    total += 1
                    if place >= 0:
                        fill_motion(pairs[place * PAIR :], record, first)
            part = part[PART + 2 * sides :]
    return total
