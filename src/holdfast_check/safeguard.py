"""What a quadratic program gives over a box: every set of its conditions that may be active.

    minimise  sum_i ((u_i - w_i) / s_i)^2   subject to   n_j . u <= b_j

With y = u / s, v = w / s, a_j = s n_j and the rows A of a set S, at most as many as inputs,
y_S = v - A' (A A')^-1 (A v - b) is the minimiser where its multipliers (A A')^-1 (A v - b) are not
negative and the other conditions hold. A condition on one input alone decides it. Where every y_S
violates a condition those beyond `hard` are relaxed: one of them beside the bounds of all inputs
pushes each input to a bound where its part of the normal is not small.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb, fmpq

from holdfast_check.intervals import (
    ZERO,
    Interval,
    Row,
    add,
    dot,
    hull,
    inverse,
    mul,
    neg,
    point,
    power,
    root,
    size,
    sub,
)  # fmt: skip

PULL = fmpq(1, 10**6)

Given = tuple[bool, bool, Row]
"""Whether inputs may be given, whether they surely are, and these."""


@dataclass
class Values:
    """The numbers of a program over a box.

    wanted: None where it may be anything. zero: which parts of each normal are the number 0. box:
    the bounds of the inputs, if they are such.
    """

    wanted: Row | None
    normals: list[Row]
    zero: list[list[bool]]
    offsets: Row
    hard: int
    scales: Row
    box: list[tuple[Interval, Interval]] | None


def choices(p: Values) -> Iterator[Given]:
    """What each set gives, and at last what is given where conditions are relaxed."""
    m, feasible = len(p.scales), False
    for k in range(m + 1) if p.wanted is not None else (m,):
        for rows in itertools.combinations(range(len(p.offsets)), k):
            solved = _solved(p, rows)
            if solved is None:
                continue
            u = [mul(s, q) for s, q in zip(p.scales, solved[0], strict=True)]
            others = [
                sub(dot(p.normals[j], u), b) for j, b in enumerate(p.offsets) if j not in rows
            ]
            met = all(q[0] <= q[1] for q in u) and all(o[1] < 0 for o in others)
            feasible |= met
            if p.wanted is not None:
                may = not any(m[1] < 0 for m in solved[1]) and not any(o[0] > 0 for o in others)
                yield may, met and all(m[0] > 0 for m in solved[1]), u
    yield not feasible, False, _pushed(p)


def _solved(p: Values, rows: Sequence[int]) -> tuple[Row, Row] | None:
    """y where these conditions are active, and their multipliers times a size; None of sets that
    depend on each other."""
    inputs = range(len(p.scales))
    a: dict[int, list[Any]] = {
        j: [None if p.zero[j][i] else mul(p.normals[j][i], p.scales[i]) for i in inputs]
        for j in rows
    }
    v = None
    if p.wanted is not None:
        v = [mul(w, inverse(s)) for w, s in zip(p.wanted, p.scales, strict=True)]
    y: dict[int, Interval] = {}
    deciding: dict[int, int] = {}
    for j in rows:
        some = [i for i in inputs if a[j][i] is not None]
        if not some or (len(some) == 1 and some[0] in y):
            return None
        if len(some) == 1:
            y[some[0]], deciding[some[0]] = mul(p.offsets[j], inverse(a[j][some[0]])), j
    left = [i for i in inputs if i not in y]
    rest = [j for j in rows if j not in deciding.values()]
    if len(rest) > len(left):
        return None
    matrix = [[a[j][i] for i in left] for j in rest]
    beyond = [sub(p.offsets[j], dot([a[j][i] for i in y], list(y.values()))) for j in rest]
    gram = [[_square(r) if r is q else dot(r, q) for q in matrix] for r in matrix]
    whole, multipliers = _determinant(gram), list[Interval]()
    if v is not None:
        free = [v[i] for i in left]
        slack = [sub(dot(row, free), b) for row, b in zip(matrix, beyond, strict=True)]
        multipliers = [dot(row, slack) for row in _adjugate(gram)]
    if len(rest) == len(left):
        over = inverse(_determinant(matrix))
        solved = [mul(dot(row, beyond), over) for row in _adjugate(matrix)]
    elif v is not None:
        over, columns = inverse(whole), ([row[k] for row in matrix] for k in range(len(left)))
        solved = [
            sub(v[i], mul(dot(column, multipliers), over)) if rest else v[i]
            for i, column in zip(left, columns, strict=True)
        ]
    else:
        return None
    y |= dict(zip(left, solved, strict=True))
    if v is not None:
        for i, j in deciding.items():
            pulled = dot([a[k][i] for k in rest], multipliers[: len(rest)])
            multipliers.append(mul(sub(mul(sub(v[i], y[i]), whole), pulled), a[j][i]))
    return [y[i] for i in inputs], multipliers


def _square(row: Sequence[Interval | None]) -> Interval:
    parts = [power(q, 2) for q in row if q is not None]
    total = point(0)
    for part in parts:
        total = add(total, part)
    return total


def _determinant(m: Sequence[Sequence[Interval | None]]) -> Interval:
    """By its first row; of no row it is 1."""
    if not m:
        return point(1)
    total = point(0)
    for k, entry in enumerate(m[0]):
        if entry is not None:
            part = mul(entry, _determinant([[*row[:k], *row[k + 1 :]] for row in m[1:]]))
            total = add(total, part) if k % 2 == 0 else sub(total, part)
    return total


def _adjugate(m: Sequence[Sequence[Interval | None]]) -> list[Row]:
    n = range(len(m))

    def minor(i: int, j: int) -> Interval:
        det = _determinant([[*row[:j], *row[j + 1 :]] for k, row in enumerate(m) if k != i])
        return det if (i + j) % 2 == 0 else neg(det)

    return [[minor(j, i) for j in n] for i in n]


def _pushed(p: Values) -> Row:
    """The inputs where conditions are relaxed; none of inputs without bounds of their own."""
    if p.box is None:
        return []
    whole = [hull(*ends) for ends in p.box]
    sides = _are_sides(p)
    if len(p.offsets) != p.hard + 1 or not sides:
        return whole
    a = [mul(n, s) for n, s in zip(p.normals[p.hard], p.scales, strict=True)]
    norm, inputs = root(_square(a)), []
    for (low, high), q, s in zip(p.box, a, p.scales, strict=True):
        most = max(size(mul(end, inverse(s)))[1] for end in (low, high))
        little = mul(mul(add(point(most), point(1)), point(arb(PULL))), norm)[1]
        inputs.append(low if q[0] > little else high if -q[1] > little else hull(low, high))
    return inputs


def _are_sides(p: Values) -> bool:
    """Whether the conditions that are hard are the two bounds of each input, and no others."""
    sides = set()
    for normal, zero, offset in zip(p.normals[: p.hard], p.zero, p.offsets, strict=False):
        some = [i for i, z in enumerate(zero) if not z]
        if len(some) != 1 or not normal[some[0]][0] == normal[some[0]][1] != ZERO:
            return False
        (i,) = some
        value, bounds = mul(offset, inverse(normal[i])), (p.box or [])[i]
        side = 1 if normal[i][0] > 0 else 0
        if not all(e == f for e, f in zip(value, bounds[side], strict=True)):
            return False
        sides.add((i, side))
    return len(sides) == p.hard == 2 * len(p.scales)
