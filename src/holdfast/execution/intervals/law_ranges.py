"""What a sampled law may do with states that are measured in a box, every rounding counted.

A safeguard's quadratic program over boxes, for every set of conditions that may be active:

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

A table of values at nodes is linear along every axis between two nodes, and so are its central
differences over one step; within one step of the end of a grid a difference is one-sided, and lies
between those at the two nodes around it. So over a box both lie between what they are at the nodes
around it. A place beyond the grid counts as the nearest place of it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp

from holdfast.execution.arithmetic.steps import Steps, Value, choose
from holdfast.execution.arrays import Array, Wholes
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.intervals.enclosure import (
    Enclosure,
    Interval,
    Row,
    chosen,
    constant,
    dot,
    every,
    hull,
    largest,
    number,
    pairs,
)
from holdfast.execution.intervals.tape import Tape
from holdfast.execution.intervals.tape import number as number_between
from holdfast.execution.leaf import compiled_leaves
from holdfast.execution.table_in_parts import in_memory
from holdfast.maths.definitions.law import LawCases, Option, Program
from holdfast.maths.definitions.quantity import TIME_IN_MODE
from holdfast.maths.expressions.traversal import symbols_of

MOST_SETS = 400
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
class Chosen:
    """Inputs that may be given, and whether these surely are."""

    may: Value
    sure: Value
    inputs: Row


def sets_of(rows: int, inputs: int, *, wanted: bool) -> list[tuple[int, ...]]:
    """The sets of conditions that may be active; of anything that is wanted only full ones."""
    sizes = range(inputs + 1) if wanted else (inputs,)
    return [s for k in sizes for s in itertools.combinations(range(rows), k)]


def choices(p: Values) -> Iterator[Chosen]:
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
        bounded = [~q.unknown for q in u]
        feasible.append(every(steps, [*bounded, *(o.high < 0.0 for o in others)]))
        if p.wanted is not None:
            may = [*(~(m.high < 0.0) for m in multipliers), *(~(o.low > 0.0) for o in others)]
            sure = [*(m.low > 0.0 for m in multipliers), *(o.high < 0.0 for o in others), *bounded]
            yield Chosen(every(steps, may), every(steps, sure), u)
    relaxed = every(steps, [~f for f in feasible])
    yield Chosen(relaxed, never, _pushed(p))


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
        solution = [dot(row, beyond, steps) * whole for row in _adjugate(matrix, steps)]
    else:
        assert v is not None
        over = size.inverse()
        solution = [
            v[i] - dot([row[k] for row in matrix], multipliers, steps) * over if rest else v[i]
            for k, i in enumerate(left)
        ]
    y |= dict(zip(left, solution, strict=True))
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
        return number_between(steps, Fraction(1))
    if len(m) == 1:
        return m[0][0]
    total = number_between(steps, Fraction(0))
    for k, entry in enumerate(m[0]):
        part = entry * _determinant([[*row[:k], *row[k + 1 :]] for row in m[1:]], steps)
        total = total + part if k % 2 == 0 else total - part
    return total


def _adjugate(m: list[Row], steps: Steps) -> list[Row]:
    n = len(m)

    def minor(i: int, j: int) -> Interval:
        rows = [[*row[:j], *row[j + 1 :]] for k, row in enumerate(m) if k != i]
        determinant = _determinant(rows, steps)
        return determinant if (i + j) % 2 == 0 else -determinant

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
    pushed = []
    for (low, high), q, s in zip(p.box, a, p.scales, strict=True):
        most = largest(*(abs(end * s.inverse()).high for end in (low, high)))
        reach = Interval(most, most) + number_between(steps, Fraction(1))
        little = (reach * number_between(steps, PULL) * norm).high
        down, up = q.low > little, -q.high > little
        pushed.append(chosen(down, low, chosen(up, high, hull(low, high))))
    return pushed


Ends = tuple[Array, Array]
MOST_STEPS = 64
"""Steps of the grid along an axis that a box may reach over; of a wider one nothing is known."""

FARTHEST = 1e9
"""Steps from the first node of a periodic axis; nothing is known beyond."""


class TableRanges:
    """A table of `interpolate.py`: its values, lowest nodes, steps, shape, and periodic axes.

    nodes: of the value, then of the slope along each axis, the ends at the nodes, both of the
    shape of the grid: they are apart by rounding.
    """

    def __init__(self, table: Any) -> None:
        values, low, steps, shape, periodic = table
        self.shape = tuple(int(n) for n in shape)
        self.values = np.asarray(in_memory(values), dtype=np.float64).reshape(self.shape)
        self.low, self.steps = np.asarray(low, float), np.asarray(steps, float)
        self.periodic = tuple(bool(p) for p in periodic)
        slopes = map(self._node_slopes, range(len(self.shape)))
        self.nodes: list[Ends] = [(self.values, self.values), *slopes]

    def over(self, low: Array, high: Array) -> tuple[Array, Array]:
        """The ends of the value and the slopes over boxes of places, shapes (boxes, 1 + axes)."""
        blocks = [self._block(axis, low[:, axis], high[:, axis]) for axis in range(low.shape[1])]
        shape = (len(low), len(self.nodes))
        least, most = np.full(shape, np.inf), np.full(shape, -np.inf)
        for offsets in itertools.product(*(range(int(n.max(initial=0)) + 1) for _, n in blocks)):
            there = np.ones(len(low), dtype=bool)
            for k, (_, more) in zip(offsets, blocks, strict=True):
                there &= k <= more
            some = np.flatnonzero(there)
            at = tuple(
                (first[some] + k) % n
                for k, (first, _), n in zip(offsets, blocks, self.shape, strict=True)
            )
            for k, (a, b) in enumerate(self.nodes):
                least[some, k] = np.minimum(least[some, k], a[at])
                most[some, k] = np.maximum(most[some, k], b[at])
        covered = ~np.isinf(least)
        return np.where(covered, least, np.nan), np.where(covered, most, np.nan)

    def _node_slopes(self, axis: int) -> Ends:
        """The differences at the nodes along an axis, one-sided at its ends."""
        v, h = np.moveaxis(self.values, axis, 0), self.steps[axis]
        around = [v[-1:], v, v[:1]] if self.periodic[axis] else [v[:1], v, v[-1:]]
        wide = np.concatenate(around)
        apart = np.full(len(v), 2.0)
        if not self.periodic[axis]:
            apart[[0, -1]] = 1.0
        slopes = (wide[2:] - wide[:-2]) / (apart * h).reshape(-1, *(1,) * (v.ndim - 1))
        room = 2.0**-50 * np.abs(slopes)  # three roundings
        ends = (np.nextafter(slopes + side * room, side * np.inf) for side in (-1, 1))
        low, high = (np.moveaxis(e, 0, axis) for e in ends)
        return low, high

    def _block(self, axis: int, low: Array, high: Array) -> tuple[Any, Any]:
        """The first node around boxes, and how many more there are; -1 where not known."""
        with np.errstate(invalid="ignore", over="ignore"):
            a, b = ((end - self.low[axis]) / self.steps[axis] for end in (low, high))
            room = 2.0**-50 * (np.abs(a) + np.abs(b) + np.abs(self.low[axis] / self.steps[axis]))
            a, b = np.floor(a - room), np.ceil(b + room)
        last = self.shape[axis] - 1
        if self.periodic[axis]:
            usable = (np.abs(a) < FARTHEST) & (b - a < MOST_STEPS)
        else:
            a, b = np.clip(a, 0, last), np.clip(b, 0, last)
            usable = b - a < MOST_STEPS  # false for what is not a number
        more = np.where(usable, b - a, -1.0)
        return np.where(usable, a, 0.0).astype(np.int64), more.astype(np.int64)


TOGETHER = 12
"""Options of one leaf: longer ones take longer than in proportion to compile."""


@dataclass(frozen=True)
class Given:
    """Inputs that may be given: of which box (row), between what, and the mode afterwards.

    low, high: shape (rows, inputs).
    """

    row: Wholes
    low: Array
    high: Array
    to: Wholes


@dataclass(frozen=True)
class _Group:
    """What is given by one leaf: the modes afterwards, and whether it leaves inputs free."""

    leaf: str
    to: tuple[int, ...]
    free: bool


class LawRanges:
    """The options of a law over boxes.

    free: symbol -> (least, greatest) of what the law may measure beside the states.
    """

    def __init__(
        self,
        law: LawCases,
        states: Sequence[Any],
        inputs: Sequence[Any],
        free: Mapping[Any, tuple[float, float]],
    ) -> None:
        self.law, self.modes, self.initial = law, len(law.modes), law.initial
        self._states, self._inputs, self._free = list(states), list(inputs), free
        self._table = self._places = None
        if law.lookup is not None:
            self._table = TableRanges(law.lookup.table)
            self._places = Enclosure(law.lookup.places, self._states)
        self._parts = [list(itertools.pairwise(edges)) for edges in law.parts]
        leaves: dict[str, Leaf] = {}
        self._groups: list[list[_Group]] = []
        for k, options in enumerate(law.options):
            self._groups.append([])
            for g, (free_inputs, some) in enumerate(self._grouped(options)):
                leaf, to = self._leaf(some)
                group = _Group(f"options{k}_{g}", to, free_inputs)
                leaves[group.leaf] = leaf
                self._groups[-1].append(group)
        self._leaves = compiled_leaves(leaves)

    def given(self, mode: int, low: Array, high: Array) -> Given:
        """What the law may give with states measured in boxes, in this mode before the sample. low,
        high: shape (boxes, measured states)."""
        chunks = list(self._every(mode, self._columns(low, high)))
        m = len(self._inputs)
        if not chunks:
            none = np.empty(0, dtype=np.int64)
            return Given(none, np.empty((0, m)), np.empty((0, m)), none)
        row, least, most, to = (np.concatenate(parts) for parts in zip(*chunks, strict=True))
        return Given(row, least, most, to)

    def _columns(self, low: Array, high: Array) -> Array:
        """The ends of the states and of what the table has, low and high in turn."""
        ends = [np.stack([low, high], axis=2).reshape(len(low), 2 * low.shape[1])]
        if self._table is not None and self._places is not None:
            a, b = self._table.over(*self._places.over(low, high))
            ends.append(np.stack([a, b], axis=2).reshape(len(low), 2 * a.shape[1]))
        return np.concatenate(ends, axis=1)

    def _every(self, mode: int, columns: Array) -> Iterator[tuple[Any, ...]]:
        left = np.arange(len(columns))  # boxes for which no option is sure yet
        for group in self._groups[mode]:
            decided, certain = (np.zeros(len(left), dtype=bool) for _ in range(2))
            for options in self._found(group, columns[left]):
                for to, (may, sure, least, most) in zip(group.to, options, strict=True):
                    row = np.flatnonzero((may > 0) & ~decided)
                    yield left[row], least[row], most[row], np.full(len(row), to)
                    certain |= sure > 0
                    if not group.free:  # all parts of a free input count
                        decided = certain.copy()
            left = left[~certain]

    def _found(self, group: _Group, columns: Array) -> Iterator[list[tuple[Array, ...]]]:
        """For each part of the inputs: may, sure, least and greatest inputs of each option."""
        m, count = len(self._inputs), len(group.to)
        for part in itertools.product(*self._parts) if group.free else [((0.0, 0.0),) * m]:
            inputs = np.tile(np.ravel(part), (len(columns), 1))
            rows = np.concatenate([columns, inputs], axis=1)
            wide = 2 + 2 * m
            numbers = self._leaves.values(group.leaf, len(rows), count * wide, rows)
            split = (numbers[:, k * wide : (k + 1) * wide] for k in range(count))
            yield [(o[:, 0], o[:, 1], o[:, 2 : 2 + m], o[:, 2 + m :]) for o in split]

    def _grouped(
        self, options: Sequence[Option | Program]
    ) -> list[tuple[bool, list[Option | Program]]]:
        """Options in order, as many together as leave no input free; others alone.

        A program of which anything may be wanted gives any input that meets its conditions, and
        what it gives where they are relaxed.
        """
        groups: list[tuple[bool, list[Option | Program]]] = []
        for option in options:
            several: list[Option | Program] = [option]
            if isinstance(option, Program) and option.wanted is None:
                met = (
                    sp.Add(*(n * u for n, u in zip(normal, self._inputs, strict=True))) - offset
                    for *normal, offset in option.rows
                )
                several = [Option((*option.when, *met), tuple(self._inputs), option.to), option]
            for one in several:
                free = not symbols_of(one.expressions).isdisjoint(self._inputs)
                alone = free or isinstance(one, Program)
                if alone or not groups or groups[-1][0] or len(groups[-1][1]) == TOGETHER:
                    groups.append((free, []))
                groups[-1][1].append(one)
                if isinstance(one, Program):
                    groups.append((False, []))
        return [(free, some) for free, some in groups if some]

    def _leaf(self, options: Sequence[Option | Program]) -> tuple[Leaf, tuple[int, ...]]:
        """Of each option whether it may be taken, whether it surely is where none before is, and
        the ends of its inputs; and the modes afterwards."""
        lookup = self.law.lookup.symbols if self.law.lookup is not None else ()
        symbols = [*self._states, *lookup, *self._inputs]
        steps = Steps(expanded=True)
        names = [f"q{i}" for i in range(2 * len(symbols))]
        ranges = {s.name: constant(steps, *ends) for s, ends in self._free.items()}
        ranges |= dict(zip((s.name for s in symbols), pairs(steps, names), strict=True))
        ranges[TIME_IN_MODE.name] = number(steps, math.nan)
        results, to = [], []
        for option in options:
            tape = Tape(option.expressions)
            row = tape.of(tape.values(steps, ranges))
            when, rest = row[: len(option.when)], row[len(option.when) :]
            may = every(steps, [~(c.low > 0.0) for c in when])
            # where a condition is 0 the next option may be taken as well
            sure = every(steps, [c.high < 0.0 for c in when])
            outcomes = [Chosen(may, sure, rest)]
            if isinstance(option, Program):
                outcomes = [Chosen(may & g.may, sure & g.sure, g.inputs)
                            for g in self._of_program(steps, option, rest, ranges)]  # fmt: skip
                outcomes.append(Chosen(~every(steps, []), sure, outcomes[-1].inputs))
            for g in outcomes:
                results += [choose(flag, 1.0, 0.0) for flag in (g.may, g.sure)]
                results += [*(e.low for e in g.inputs), *(e.high for e in g.inputs)]
                to.append(option.to)
        return Leaf(steps, {"q": names}, results), tuple(to)

    def _of_program(
        self, steps: Steps, p: Program, row: Row, ranges: Mapping[str, Interval]
    ) -> Iterator[Chosen]:
        """What a safeguard gives, limited as actuators limit it."""
        m, count = len(self._inputs), len(p.rows)
        wanted, row = (row[:m], row[m:]) if p.wanted is not None else (None, row)
        rows = [row[k * (m + 1) : (k + 1) * (m + 1)] for k in range(count)]
        scales, ends = row[count * (m + 1) :][:m], row[count * (m + 1) + m :]
        box = list(zip(ends[0::2], ends[1::2], strict=True)) if p.box is not None else None
        values = Values(
            steps, wanted, [r[:m] for r in rows], [r[m] for r in rows], p.hard, scales, box,
            _are_sides(p),
        )  # fmt: skip
        limits, inputs = Tape(p.limits), [s.name for s in self._inputs]
        infinite = constant(steps, -math.inf, math.inf)
        every_input = [constant(steps, e[0], e[-1]) for e in self.law.parts]
        for g in choices(values):
            u = [chosen(q.unknown, infinite, q) for q in g.inputs or every_input]
            at = {**ranges, **dict(zip(inputs, u, strict=True))}
            yield Chosen(g.may, g.sure, limits.of(limits.values(steps, at)))


def _are_sides(p: Program) -> bool:
    """Whether the conditions of a program that are not relaxed are the bounds of its inputs."""
    m, sides = len(p.scales), set[tuple[sp.Expr, ...]]()
    for i, (low, high) in enumerate(p.box or ()):
        for sign, end in ((1, high), (-1, low)):
            sides.add((*(sp.Integer(sign * (i == k)) for k in range(m)), sign * end))
    return bool(sides) and set(p.rows[: p.hard]) == sides and p.hard == 2 * m
