"""A safeguard's quadratic program over boxes, for every set of conditions that may be active.

    minimise  sum_i ((u_i - w_i) / s_i)^2   subject to   n_j . u <= b_j

With y = u / s, v = w / s and a_j = s n_j: where there is a minimiser, it is

    y_S = v - A' (A A')^-1 (A v - b),   (A A')^-1 (A v - b) >= 0,   a_j . y_S <= b_j for j not in S

for a set S of conditions whose normals A are independent (Karush, Kuhn, Tucker; at most as many as
there are inputs). A condition on one input alone decides that input, and the others are found
without it. Multiplied by det(A A') >= 0, the second is without a division. The program has no
admissible input only where each y_S violates a condition outside S.

Then conditions are relaxed by the least slack. If it is one condition a . y <= b, and the others
are bounds of each input, this is

    minimise  |y - v|^2 + (s + P)^2   subject to   a . y - b <= |a| s,    P = 1e6 max(1, |v_i|)

with s > 0 everywhere, so that y_i is at its lower bound where a_i > |a| max |y_i - v_i| / P, at the
upper one where a_i is below the opposite of this, and may be any between. Of several conditions
nothing is said but that the inputs are within their bounds.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

from holdfast.execution.arithmetic.steps import Steps, Value
from holdfast.execution.intervals.interval import Interval, chosen, hull, largest
from holdfast.execution.intervals.rows import Row, dot, every
from holdfast.execution.intervals.tape import number

MOST = 400
"""Sets of conditions."""

PULL = Fraction(1, 10**6)
"""Of the slack that is wanted in the simulated program, one part of it over what inputs are."""


@dataclass(frozen=True)
class Values:
    """The numbers of a program over a box.

    wanted: None where these may be anything. sides: whether the conditions that are not relaxed
    are the bounds of the inputs, both of each.
    """

    steps: Steps
    wanted: Row | None
    normals: list[Row]
    offsets: Row
    hard: int
    scales: Row
    box: list[tuple[Interval, Interval]] | None
    sides: bool


@dataclass(frozen=True)
class Given:
    """Inputs that may be given, and whether these surely are."""

    may: Value
    sure: Value
    inputs: Row


def sets_of(rows: int, inputs: int, *, wanted: bool) -> list[tuple[int, ...]]:
    """The sets of conditions that may be active; of anything that is wanted only full ones."""
    sizes = range(inputs + 1) if wanted else (inputs,)
    return [s for k in sizes for s in itertools.combinations(range(rows), k)]


def choices(p: Values) -> Iterator[Given]:
    """What each set gives, and at last what is given where conditions are relaxed.

    Of anything that is wanted there is the last alone. Its inputs are those of the box, or None.
    """
    steps = p.steps
    never = ~every(steps, [])
    feasible = [never]
    for chosen_rows in sets_of(len(p.offsets), len(p.scales), wanted=p.wanted is not None):
        solved = _solved(p, chosen_rows)
        if solved is None:
            continue
        y, multipliers = solved
        u = [s * q for s, q in zip(p.scales, y, strict=True)]
        others = [
            dot(normal, u, steps) - offset
            for j, (normal, offset) in enumerate(zip(p.normals, p.offsets, strict=True))
            if j not in chosen_rows
        ]
        known = [~q.unknown for q in u]
        feasible.append(every(steps, [*known, *(o.high < 0.0 for o in others)]))
        if p.wanted is not None:
            may = [*(~(m.high < 0.0) for m in multipliers), *(~(o.low > 0.0) for o in others)]
            sure = [*(m.low > 0.0 for m in multipliers), *(o.high < 0.0 for o in others), *known]
            yield Given(every(steps, may), every(steps, sure), u)
    relaxed = every(steps, [~f for f in feasible])
    yield Given(relaxed, never, _pushed(p))


def _solved(p: Values, rows: Sequence[int]) -> tuple[Row, Row] | None:
    """y where these conditions are active, and their multipliers times a size; None of sets that
    depend on each other."""
    steps, inputs = p.steps, range(len(p.scales))
    a = {j: [n * s for n, s in zip(p.normals[j], p.scales, strict=True)] for j in rows}
    v = None
    if p.wanted is not None:
        v = [w * s.inverse() for w, s in zip(p.wanted, p.scales, strict=True)]
    y: dict[int, Interval] = {}
    deciding: dict[int, int] = {}
    for j in rows:
        some = [i for i in inputs if a[j][i].number != 0]
        if not some or (len(some) == 1 and some[0] in y):
            return None
        if len(some) == 1:
            (i,) = some
            y[i], deciding[i] = p.offsets[j] * a[j][i].inverse(), j
    left = [i for i in inputs if i not in y]
    rest = [j for j in rows if j not in deciding.values()]
    if len(rest) > len(left):
        return None
    matrix = [[a[j][i] for i in left] for j in rest]
    beyond = [p.offsets[j] - dot([a[j][i] for i in y], list(y.values()), steps) for j in rest]
    gram = [[_dot(r, q, steps, same=r is q) for q in matrix] for r in matrix]
    size, slack = _determinant(gram, steps), list[Interval]()
    if v is not None:
        slack = [
            dot(row, [v[i] for i in left], steps) - b for row, b in zip(matrix, beyond, strict=True)
        ]
    multipliers = [dot(row, slack, steps) for row in _adjugate(gram, steps)] if slack else []
    if len(rest) == len(left):
        whole = _determinant(matrix, steps).inverse()
        found = [dot(row, beyond, steps) * whole for row in _adjugate(matrix, steps)]
    else:
        assert v is not None
        over = size.inverse()
        found = [
            v[i] - dot([row[k] for row in matrix], multipliers, steps) * over if rest else v[i]
            for k, i in enumerate(left)
        ]
    y |= dict(zip(left, found, strict=True))
    if v is not None:
        for i, j in deciding.items():
            pulled = dot([a[k][i] for k in rest], multipliers[: len(rest)], steps)
            off = (v[i] - y[i]) * size - pulled
            multipliers.append(off * a[j][i])
    return [y[i] for i in inputs], multipliers


def _dot(p: Row, q: Row, steps: Steps, *, same: bool) -> Interval:
    """A product of rows, which is a sum of squares of one with itself alone."""
    return dot(p, p if same else [e.copy() if e.number is None else e for e in q], steps)


def _determinant(m: list[Row], steps: Steps) -> Interval:
    """By its first row; of no row it is 1."""
    if not m:
        return number(steps, Fraction(1))
    if len(m) == 1:
        return m[0][0]
    total = number(steps, Fraction(0))
    for k, entry in enumerate(m[0]):
        part = entry * _determinant([[*row[:k], *row[k + 1 :]] for row in m[1:]], steps)
        total = total + part if k % 2 == 0 else total - part
    return total


def _adjugate(m: list[Row], steps: Steps) -> list[Row]:
    n = len(m)

    def minor(i: int, j: int) -> Interval:
        rows = [[*row[:j], *row[j + 1 :]] for k, row in enumerate(m) if k != i]
        found = _determinant(rows, steps)
        return found if (i + j) % 2 == 0 else -found

    return [[minor(j, i) for j in range(n)] for i in range(n)]


def _pushed(p: Values) -> Row:
    """Where the one condition that is relaxed pushes inputs: to a bound, or anywhere within."""
    if p.box is None:
        return []
    steps = p.steps
    whole = [hull(low, high) for low, high in p.box]
    if len(p.offsets) != p.hard + 1 or not p.sides:
        return whole
    a = [n * s for n, s in zip(p.normals[p.hard], p.scales, strict=True)]
    norm = _dot(a, a, steps, same=True).root()
    found = []
    for (low, high), q, s in zip(p.box, a, p.scales, strict=True):
        most = largest(*(abs(end * s.inverse()).high for end in (low, high)))
        reach = Interval(most, most) + number(steps, Fraction(1))
        little = (reach * number(steps, PULL) * norm).high
        down, up = q.low > little, -q.high > little
        found.append(chosen(down, low, chosen(up, high, hull(low, high))))
    return found
