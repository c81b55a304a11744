"""What a sampled law may do with states that are measured in a box, every rounding counted."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.execution.arithmetic.steps import Steps, choose
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.intervals import active_sets
from holdfast.execution.intervals.active_sets import Given as Chosen
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.execution.intervals.interval import Interval, chosen
from holdfast.execution.intervals.rows import Row, constant, every, number, pairs
from holdfast.execution.intervals.table_ranges import TableRanges
from holdfast.execution.intervals.tape import Tape
from holdfast.execution.leaf import compiled_leaves
from holdfast.maths.definitions.law_cases import LawCases, Option, Program
from holdfast.maths.definitions.quantity import TIME_IN_MODE
from holdfast.maths.expressions.traversal import symbols_of

TOGETHER = 12
"""Options of one leaf: longer ones take longer than in proportion to compile."""


@dataclass(frozen=True)
class Given:
    """Inputs that may be given: of which box (row), between what, and the mode afterwards.

    low, high: shape (rows, inputs).
    """

    row: npt.NDArray[np.int64]
    low: Array
    high: Array
    to: npt.NDArray[np.int64]


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
        """What the law may give with states measured in boxes, in this mode before the sample."""
        found = list(self._every(mode, self._columns(low, high)))
        m = len(self._inputs)
        if not found:
            none = np.empty(0, dtype=np.int64)
            return Given(none, np.empty((0, m)), np.empty((0, m)), none)
        row, least, most, to = (np.concatenate(parts) for parts in zip(*found, strict=True))
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
            for found in self._found(group, columns[left]):
                for to, (may, sure, least, most) in zip(group.to, found, strict=True):
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
            given = np.tile(np.ravel(part), (len(columns), 1))
            rows = np.concatenate([columns, given], axis=1)
            wide = 2 + 2 * m
            found = self._leaves.values(group.leaf, len(rows), count * wide, rows)
            split = (found[:, k * wide : (k + 1) * wide] for k in range(count))
            yield [(o[:, 0], o[:, 1], o[:, 2 : 2 + m], o[:, 2 + m :]) for o in split]

    def _grouped(
        self, options: Sequence[Option | Program]
    ) -> list[tuple[bool, list[Option | Program]]]:
        """Options in order, as many together as leave no input free; others alone.

        A program of which anything may be wanted gives any input that meets its conditions, and
        what it gives where they are relaxed.
        """
        found: list[tuple[bool, list[Option | Program]]] = []
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
                if alone or not found or found[-1][0] or len(found[-1][1]) == TOGETHER:
                    found.append((free, []))
                found[-1][1].append(one)
                if isinstance(one, Program):
                    found.append((False, []))
        return [(free, some) for free, some in found if some]

    def _leaf(self, options: Sequence[Option | Program]) -> tuple[Leaf, tuple[int, ...]]:
        """Of each option whether it may be taken, whether it surely is where none before is, and
        the ends of its inputs; and the modes afterwards."""
        lookup = self.law.lookup.symbols if self.law.lookup is not None else ()
        symbols = [*self._states, *lookup, *self._inputs]
        steps = Steps(expanded=True)
        names = [f"q{i}" for i in range(2 * len(symbols))]
        known = {s.name: constant(steps, *ends) for s, ends in self._free.items()}
        known |= dict(zip((s.name for s in symbols), pairs(steps, names), strict=True))
        known[TIME_IN_MODE.name] = number(steps, math.nan)
        results, to = [], []
        for option in options:
            tape = Tape(option.expressions)
            row = tape.of(tape.values(steps, known))
            when, rest = row[: len(option.when)], row[len(option.when) :]
            may = every(steps, [~(c.low > 0.0) for c in when])
            # where a condition is 0 the next option may be taken as well
            sure = every(steps, [c.high < 0.0 for c in when])
            given = [Chosen(may, sure, rest)]
            if isinstance(option, Program):
                given = [Chosen(may & g.may, sure & g.sure, g.inputs)
                         for g in self._of_program(steps, option, rest, known)]  # fmt: skip
                given.append(Chosen(~every(steps, []), sure, given[-1].inputs))
            for g in given:
                results += [choose(flag, 1.0, 0.0) for flag in (g.may, g.sure)]
                results += [*(e.low for e in g.inputs), *(e.high for e in g.inputs)]
                to.append(option.to)
        return Leaf(steps, {"q": names}, results), tuple(to)

    def _of_program(
        self, steps: Steps, p: Program, row: Row, known: Mapping[str, Interval]
    ) -> Iterator[Chosen]:
        """What a safeguard gives, limited as actuators limit it."""
        m, count = len(self._inputs), len(p.rows)
        wanted, row = (row[:m], row[m:]) if p.wanted is not None else (None, row)
        rows = [row[k * (m + 1) : (k + 1) * (m + 1)] for k in range(count)]
        scales, ends = row[count * (m + 1) :][:m], row[count * (m + 1) + m :]
        box = list(zip(ends[0::2], ends[1::2], strict=True)) if p.box is not None else None
        values = active_sets.Values(
            steps, wanted, [r[:m] for r in rows], [r[m] for r in rows], p.hard, scales, box,
            _are_sides(p),
        )  # fmt: skip
        limits, inputs = Tape(p.limits), [s.name for s in self._inputs]
        infinite = constant(steps, -math.inf, math.inf)
        every_input = [constant(steps, e[0], e[-1]) for e in self.law.parts]
        for g in active_sets.choices(values):
            u = [chosen(q.unknown, infinite, q) for q in g.inputs or every_input]
            at = {**known, **dict(zip(inputs, u, strict=True))}
            yield Chosen(g.may, g.sure, limits.of(limits.values(steps, at)))


def _are_sides(p: Program) -> bool:
    """Whether the conditions of a program that are not relaxed are the bounds of its inputs."""
    m, sides = len(p.scales), set[tuple[sp.Expr, ...]]()
    for i, (low, high) in enumerate(p.box or ()):
        for sign, end in ((1, high), (-1, low)):
            sides.add((*(sp.Integer(sign * (i == k)) for k in range(m)), sign * end))
    return bool(sides) and set(p.rows[: p.hard]) == sides and p.hard == 2 * m
