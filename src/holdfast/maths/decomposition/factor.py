"""The smallest factor of a system that some inequalities depend on: states dropped, or relative.

A factor is z = C q whose rates are functions of z. N = ker C holds the directions along which the
inequalities, and then the rates of z, do not change:

    N_0 = { n : dc/dq n = 0 for all q },   N_{i+1} = { n in N_i : df/dq n in N_i for all q }

The limit is the largest such space of constant directions (the unobservable subspace of the
inequalities; R. Hermann, A. J. Krener, IEEE TAC 22(5), 1977). It holds the states on which nothing
depends, and translations: of two vehicles whose distance matters, both positions together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.maths.definitions.bounds import Bounds, section
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.region import Inequality
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.random_points import Sampler
from holdfast.maths.expressions.traversal import derivatives

_ALONG = sp.Symbol("_along", real=True)

Directions = list[list[sp.Rational]]


@dataclass(frozen=True)
class Factor:
    """A factor z = C q of a system, and the inequalities as functions of z.

    coordinates: name of z -> its expression in the states of the whole system, which is linear.
    """

    system: System
    inequalities: tuple[Inequality, ...]
    coordinates: Mapping[str, sp.Expr]


def factor(
    system: System, inequalities: Sequence[Inequality], *, relative: bool = True
) -> Factor | None:
    """The smallest linear factor whose states decide the inequalities; None if none matters.

    relative: whether differences of states are looked for, or only states that do not matter.
    """
    symbols = [q.symbol for q in system.states]
    rates = list(system.rates.values())
    about = [c.expression for c in inequalities]
    lost = _unobservable(rates, about, symbols) if relative else []
    if not relative or not _same_along(lost, rates, about, symbols):
        lost = _unread(rates, about, symbols)
    if len(lost) == len(symbols):
        return None
    pivots = [next(i for i, e in enumerate(row) if e != 0) for row in lost]
    there = {symbols[p]: sp.S.Zero for p in pivots}
    states, coordinates, moved = [], {}, {}
    for i, q in enumerate(system.states):
        if i in pivots:
            continue
        against = [(row[i], p) for row, p in zip(lost, pivots, strict=True) if row[i] != 0]
        seen = _relative(q, system.states, against) if against else q
        states.append(seen)
        coordinates[seen.name] = sp.Add(q.symbol, *(-k * symbols[p] for k, p in against))
        rate = sp.Add(rates[i], *(-k * rates[p] for k, p in against))
        moved[seen.name] = sp.expand(rate.xreplace(there)) if against else rate.xreplace(there)
        there[q.symbol] = seen.symbol
    moved = {n: r.xreplace(there) for n, r in moved.items()}
    return Factor(
        _with_players(replace(
            system,
            name=system.name if not lost else f"{system.name}, {', '.join(moved)}",
            states=tuple(states),
            rates=moved,
            pfaffian=(),
            measurements=(),
            flat_output=None,
        )) if lost else _with_players(system),
        tuple(replace(c, expression=c.expression.xreplace(there)) for c in inequalities),
        coordinates,
    )  # fmt: skip


def _relative(
    q: Quantity, states: Sequence[Quantity], against: Sequence[tuple[sp.Expr, int]]
) -> Quantity:
    """`x2_less_x1` of x2 - x1: an angle where turns of the others are turns of it."""
    words = {1: "less", -1: "plus"}
    name = q.name + "".join(f"_{words.get(k, 'against')}_{states[p].name}" for k, p in against)
    return replace(q, name=name, angle=q.angle and all(k.is_integer for k, _ in against))


def _unobservable(
    rates: Sequence[sp.Expr], about: Sequence[sp.Expr], symbols: Sequence[sp.Symbol]
) -> Directions:
    """A basis of N, in reduced row echelon form."""
    slopes = [derivatives(f, symbols) for f in rates]
    rows = [[derivatives(c, symbols)[s] for s in symbols] for c in about]
    basis = _reduced(_constant_null_space(rows, sp.eye(len(symbols)).tolist()))
    while basis:
        seen = _complement(basis, len(symbols))
        rows = [
            [sp.Add(*(k * slope[s] for k, slope in zip(row, slopes, strict=True) if k != 0))
             for s in symbols]
            for row in seen
        ]  # fmt: skip
        smaller = _reduced(_constant_null_space(rows, basis))
        if len(smaller) == len(basis):
            break
        basis = smaller
    return basis


def _constant_null_space(rows: Sequence[Sequence[sp.Expr]], within: Directions) -> Directions:
    """The combinations of some directions along which every row vanishes identically.

    The terms of an expanded row that differ in more than a number count as independent. Where they
    are not, a direction is missed, and none is wrong.
    """
    if not within or _full_rank(rows):
        return []
    equations: list[list[sp.Expr]] = []
    for row in rows:
        terms: dict[sp.Expr, list[sp.Expr]] = {}
        for k, way in enumerate(within):
            along = sp.expand(sp.Add(*(c * e for c, e in zip(way, row, strict=True) if c != 0)))
            for term in sp.Add.make_args(along):
                number, rest = term.as_coeff_Mul()
                terms.setdefault(rest, [sp.S.Zero] * len(within))[k] += sp.nsimplify(number)
        equations += terms.values()
    if not equations:
        return within
    found = sp.Matrix(equations).nullspace()
    return [list((sp.Matrix([v.T]) * sp.Matrix(within)).row(0)) for v in found]


def _full_rank(rows: Sequence[Sequence[sp.Expr]]) -> bool:
    """Whether no direction at all makes every row vanish, as seen at one random point."""
    if not rows or len(rows) < len(rows[0]):
        return False
    every = [e for row in rows for e in row]
    sampler = Sampler({}, every)
    free = set().union(*(e.free_symbols for e in every))
    return sampler.rank(rows, sampler.point(free)) == len(rows[0])


def _reduced(basis: Directions) -> Directions:
    if not basis:
        return []
    echelon, pivots = sp.Matrix(basis).rref()
    return [list(echelon.row(i)) for i in range(len(pivots))]


def _complement(basis: Directions, count: int) -> Directions:
    """Rows C with ker C spanned by a basis in reduced row echelon form."""
    pivots = [next(i for i, e in enumerate(row) if e != 0) for row in basis]
    rows = []
    for i in range(count):
        if i not in pivots:
            row = [sp.Integer(i == k) for k in range(count)]
            for way, p in zip(basis, pivots, strict=True):
                row[p] = -way[i]
            rows.append(row)
    return rows


def _same_along(
    lost: Directions,
    rates: Sequence[sp.Expr],
    about: Sequence[sp.Expr],
    symbols: Sequence[sp.Symbol],
) -> bool:
    """Whether what is read does not change along the directions: put in, not differentiated.

    A derivative does not see the jumps of a function, such as that of `select`.
    """
    seen = _complement(lost, len(symbols))
    rows = [sp.Add(*(k * f for k, f in zip(row, rates, strict=True) if k != 0)) for row in seen]
    for way in lost:
        moved = {s: s + k * _ALONG for s, k in zip(symbols, way, strict=True) if k != 0}
        for e in (*about, *rows):
            if e.free_symbols & set(moved) and sp.expand(e.xreplace(moved)).has(_ALONG):
                return False
    return True


def _unread(
    rates: Sequence[sp.Expr], about: Sequence[sp.Expr], symbols: Sequence[sp.Symbol]
) -> Directions:
    """The states on which nothing depends that matters, as directions."""
    matters: set[sp.Symbol] = set().union(*(c.free_symbols for c in about)) & set(symbols)
    while True:
        more = [r.free_symbols for s, r in zip(symbols, rates, strict=True) if s in matters]
        wider = matters | (set().union(*more) & set(symbols))
        if wider == matters:
            break
        matters = wider
    return [
        [sp.Integer(i == k) for k in range(len(symbols))]
        for i, s in enumerate(symbols)
        if s not in matters
    ]


def players(
    bounds: Bounds | None, members: Sequence[Quantity], system: System
) -> list[tuple[Quantity, ...]]:
    """The groups of inputs, or of disturbances, that the rates use; a group is bounded together."""
    used = set().union(*(r.free_symbols for r in system.rates.values()))
    groups = [members] if bounds is None and members else []
    if bounds is not None and members:
        groups = [tuple(group) for group in bounds.groups(tuple(members))]
    return [tuple(g) for g in groups if any(q.symbol in used for q in g)]


def _with_players(system: System) -> System:
    """The system without the groups of inputs and of disturbances that no rate uses."""
    inputs = [q for g in players(system.input_bounds, system.inputs, system) for q in g]
    felt = [q for g in players(system.disturbance_bounds, system.disturbances, system) for q in g]
    return replace(
        system,
        inputs=tuple(inputs),
        disturbances=tuple(felt),
        input_bounds=section(system.input_bounds, [q in inputs for q in system.inputs]),
        disturbance_bounds=section(
            system.disturbance_bounds, [q in felt for q in system.disturbances]
        ),
        pfaffian=(),
        measurements=(),
        flat_output=None,
    )
