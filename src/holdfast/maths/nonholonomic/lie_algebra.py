"""Test of nonholonomy: growth of the Lie algebra of the allowed motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import sympy as sp

from holdfast.maths.expressions.random_points import Bounded, Sampler, rank
from holdfast.maths.expressions.trigonometry import plain
from holdfast.maths.nonholonomic.structure import Structure


@dataclass(frozen=True)
class Growth:
    """The dimension of span{g_i, [g_i, g_j], ...} by the order of the brackets.

    vector: the dimensions at a generic point, order by order, until they no longer grow.
    origin: the dimension found at the origin, at least. brackets: (name, field) of the new
    directions.
    integrable: how many of the constraints can be integrated (0: completely nonholonomic).
    integrable_rows: the numbers, from 1, of rows that are integrable each on its own.
    """

    vector: tuple[int, ...]
    origin: int
    brackets: tuple[tuple[str, sp.ImmutableMatrix], ...]
    integrable: int
    integrable_rows: tuple[int, ...]


def bracket(f: sp.Matrix, g: sp.Matrix, symbols: Sequence[sp.Symbol]) -> sp.Matrix:
    """The Lie bracket [f, g] = (dg/dq) f - (df/dq) g."""
    g, f = sp.Matrix(g), sp.Matrix(f)
    return g.jacobian(symbols) * f - f.jacobian(symbols) * g


def growth(found: Structure) -> Growth:
    """The growth of the Lie algebra of the motions that A q' = 0 allows (Frobenius, Chow).

    The distribution ker A is involutive, hence A integrable, exactly when the first brackets
    add nothing; kappa - integrable constraints are nonholonomic.
    """
    symbols, sampler = found.symbols, found.sampler()
    n = len(symbols)
    names = [f"g_{name}" for name in found.direction_names]
    kept = [(name, sp.Matrix(g)) for name, g in zip(names, found.directions, strict=True)]
    entries = [e for _, g in kept for e in g]
    place = sampler.generic_point(symbols, entries, "the motion that the constraint allows")
    generic, origin = _Span(sampler, place), _Span(sampler, sampler.origin(symbols))
    for _, g in kept:
        generic.take(g)
        origin.take(g)
    vector, new, brackets = [generic.rank], kept, []
    for order in range(2, n + _FURTHER + 1):
        fresh, shown = [], []
        for (left, f), (right, g) in _pairs(kept, new, first=order == 2)[:_MOST]:
            made = bracket(f, g, symbols).applyfunc(plain)
            if any(e != 0 for e in made):
                named = (f"[{left}, {right}]", made)
                fresh.append(named)
                grows = generic.take(made)
                if origin.take(made) or grows:
                    shown.append(named)
                if generic.rank == origin.rank == n:
                    break
        brackets += shown
        if generic.rank > vector[-1]:
            vector.append(generic.rank)
        elif origin.rank == generic.rank or not fresh:
            break
        if generic.rank == n:
            if origin.rank == n:
                break
            new = fresh
        else:
            new = [named for named in fresh if named in shown] or fresh
    return Growth(
        vector=tuple(vector),
        origin=origin.rank,
        brackets=tuple((name, sp.ImmutableMatrix(g)) for name, g in brackets),
        integrable=n - generic.rank,
        integrable_rows=tuple(
            i + 1 for i in range(found.matrix.rows) if _row_integrable(found, i, sampler)
        ),
    )


def derived_flag(found: Structure) -> tuple[int, ...]:
    """The dimensions at a generic point of E_0 = span{g_i}, E_(k+1) = E_k + [E_k, E_k].

    Until they no longer grow. Brackets of all fields count, those of `growth` with a g_i alone: a
    system with two inputs and without drift is flat, and has chained coordinates, exactly where
    they are 2, 3, 4, ..., n (P. Martin, P. Rouchon, Feedback linearization and driftless systems,
    Mathematics of Control, Signals, and Systems 7, 1994).
    """
    symbols, sampler = found.symbols, found.sampler()
    kept = [sp.Matrix(g) for g in found.directions]
    entries = [e for g in kept for e in g]
    place = sampler.generic_point(symbols, entries, "the motion that the constraint allows")
    span = _Span(sampler, place)
    kept = [g for g in kept if span.take(g)]
    dimensions, known = [span.rank], 0
    while span.rank < len(symbols):
        fresh = []
        for i, f in enumerate(kept):
            for g in kept[max(known, i + 1) :]:
                made = bracket(f, g, symbols).applyfunc(plain)
                if span.take(made):
                    fresh.append(made)
        if not fresh:
            break
        known, kept = len(kept), kept + fresh
        dimensions.append(span.rank)
    return tuple(dimensions)


_FURTHER = 1
"""Bracket orders beyond n that are tried for the dimension at the origin."""

_MOST = 60
"""Brackets of one order."""


class _Span:
    """The span of vector fields at one point."""

    def __init__(self, sampler: Sampler, at: dict[sp.Symbol, sp.Expr]) -> None:
        self.sampler, self.at, self.rank = sampler, at, 0
        self.rows: list[list[Bounded]] = []

    def take(self, vector: sp.Matrix) -> bool:
        """Whether the vector is a new direction; then it is kept."""
        row = self.sampler.row(vector, self.at)
        if row is None:
            return False
        grown = rank([*self.rows, row])
        if grown == self.rank:
            return False
        self.rows.append(row)
        self.rank = grown
        return True


Named = tuple[str, sp.Matrix]


def _pairs(kept: list[Named], new: list[Named], *, first: bool) -> list[tuple[Named, Named]]:
    if first:
        return list(combinations(kept, 2))
    return [(g, h) for g in kept for h in new]


def _row_integrable(found: Structure, number: int, sampler: Sampler) -> bool:
    """Frobenius for one row a: a ^ da = 0."""
    a, q = found.matrix.row(number), found.symbols
    return all(
        sampler.vanishes(
            a[i] * (a[k].diff(q[j]) - a[j].diff(q[k]))
            + a[j] * (a[i].diff(q[k]) - a[k].diff(q[i]))
            + a[k] * (a[j].diff(q[i]) - a[i].diff(q[j]))
        )
        for i, j, k in combinations(range(len(q)), 3)
    )
