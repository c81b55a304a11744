"""Is a constraint nonholonomic at all: growth of the Lie algebra of the allowed motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import sympy as sp

from holdfast.maths.numbers import Sampler, rank, value_at
from holdfast.maths.pfaffian import Structure
from holdfast.maths.trigonometry import plain


@dataclass(frozen=True)
class Growth:
    """How the dimension of span{g_i, [g_i, g_j], ...} grows with the order of the brackets.

    vector: the dimensions at a generic point, order by order, until they no longer grow.
    origin: the dimension reached at the origin. brackets: (name, field) of the new directions.
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
    points = [sampler.point(symbols), dict.fromkeys(symbols, sp.S.Zero) | sampler.fixed]
    names = [f"g_{n}" for n in found.direction_names]
    kept = [(n, sp.Matrix(g)) for n, g in zip(names, found.directions, strict=True)]
    values: list[list[list[float]]] = [[], []]
    for _, g in kept:
        for store, at in zip(values, points, strict=True):
            store.append([value_at(e, at) for e in g])
    ranks = [rank(store) for store in values]
    vector, new, brackets = [ranks[0]], kept, []
    for _ in range(n):
        fresh = []
        for (left, f), (right, g) in _pairs(kept, new, first=len(vector) == 1):
            found_bracket = bracket(f, g, symbols).applyfunc(plain)
            numbers = [[value_at(e, at) for e in found_bracket] for at in points]
            grown = [rank([*store, row]) for store, row in zip(values, numbers, strict=True)]
            if grown == ranks:
                continue
            ranks = grown
            for store, row in zip(values, numbers, strict=True):
                store.append(row)
            fresh.append((f"[{left}, {right}]", found_bracket))
        if not fresh:
            break
        vector.append(ranks[0])
        brackets += fresh
        new = fresh
        if ranks[0] == n and ranks[1] == n:
            break
    return Growth(
        vector=tuple(vector),
        origin=ranks[1],
        brackets=tuple((name, sp.ImmutableMatrix(g)) for name, g in brackets),
        integrable=n - ranks[0],
        integrable_rows=tuple(
            i + 1 for i in range(found.matrix.rows) if _row_integrable(found, i, sampler)
        ),
    )


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
