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
from holdfast.execution.intervals.enclosure import Enclosure, IntervalLowering
from holdfast.execution.intervals.interval import Interval
from holdfast.execution.intervals.rows import constant, every, number, pairs
from holdfast.execution.intervals.table_ranges import TableRanges
from holdfast.execution.leaf import compiled_leaves
from holdfast.maths.definitions.law_cases import LawCases, Option
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
    """Options of one leaf: the modes afterwards, and whether they leave inputs free."""

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
        self._where = dict(law.where)
        leaves: dict[str, Leaf] = {}
        self._groups: list[list[_Group]] = []
        for k, options in enumerate(law.options):
            self._groups.append([])
            for g, (free_inputs, some) in enumerate(self._grouped(options)):
                group = _Group(f"options{k}_{g}", tuple(o.to for o in some), free_inputs)
                leaves[group.leaf] = self._leaf(some)
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

    def _grouped(self, options: Sequence[Option]) -> list[tuple[bool, list[Option]]]:
        """Options in order, as many together as leave no input free; others alone."""
        found: list[tuple[bool, list[Option]]] = []
        for option in options:
            used = symbols_of([*option.when, *option.inputs])
            free = not used.isdisjoint(self._inputs)
            if free or not found or found[-1][0] or len(found[-1][1]) == TOGETHER:
                found.append((free, []))
            found[-1][1].append(option)
        return found

    def _leaf(self, options: Sequence[Option]) -> Leaf:
        """Of each option whether it may be taken, whether it surely is where none before is, and
        the ends of its inputs."""
        lookup = self.law.lookup.symbols if self.law.lookup is not None else ()
        symbols = [*self._states, *lookup, *self._inputs]
        steps = Steps(expanded=True)
        names = [f"q{i}" for i in range(2 * len(symbols))]
        known: dict[Any, Any] = {s: constant(steps, *ends) for s, ends in self._free.items()}
        known |= dict(zip(symbols, pairs(steps, names), strict=True))
        known[TIME_IN_MODE] = number(steps, math.nan)
        lowering = IntervalLowering(steps, known)

        def value(e: sp.Expr) -> Interval:
            for symbol in symbols_of([e]) & self._where.keys():
                if symbol not in lowering.known:
                    lowering.known[symbol] = value(self._where[symbol])
            found: Any = lowering.value(sp.sympify(e))
            return found

        results = []
        for option in options:
            conditions = [value(c) for c in option.when]
            may = every(steps, [~(c.low > 0.0) for c in conditions])
            # where a condition is 0 the next option may be taken as well
            sure = every(steps, [c.high < 0.0 for c in conditions])
            given = [value(e) for e in option.inputs]
            results += [choose(flag, 1.0, 0.0) for flag in (may, sure)]
            results += [*(e.low for e in given), *(e.high for e in given)]
        return Leaf(steps, {"q": names}, results)
