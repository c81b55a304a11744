"""Which inequalities can be kept apart: those whose factors share no input.

M. Chen, S. Herbert, M. Vashishtha, S. Bansal, C. Tomlin, "Decomposition of reachable sets and tubes
for a class of nonlinear systems", IEEE TAC 63(11), 2018: of self-contained subsystems without
common controls the set that avoids a union of targets, kept in an intersection, is the
intersection of theirs.

A factor is the smallest part of a system that some inequalities depend on: states are dropped, or
relative. It is z = C q, whose rates are functions of z. N = ker C holds the directions along which
the inequalities, and then the rates of z, do not change:

    N_0 = { n : dc/dq n = 0 for all q },   N_{i+1} = { n in N_i : df/dq n in N_i for all q }

The limit is the largest such space of constant directions (the unobservable subspace of the
inequalities; R. Hermann, A. J. Krener, IEEE TAC 22(5), 1977). It holds the states on which nothing
depends, and translations: of two vehicles whose distance matters, both positions together.

A region may be a union of intersections, by inequalities that are the least of several expressions:

    min(a, b) <= 0   where   a <= 0 or b <= 0
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.maths.definitions.bounds import Bounds, Box, product, section
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.region import Inequality
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, least
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
    vectors = sp.Matrix(equations).nullspace()
    return [list((sp.Matrix([v.T]) * sp.Matrix(within)).row(0)) for v in vectors]


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


MOST = 16
"""More alternatives than these are not taken apart."""


def alternatives(inequalities: Sequence[Inequality]) -> list[tuple[Inequality, ...]]:
    """Lists of inequalities of which one holds altogether, exactly where all the given ones do."""
    rows = [_rows(c.expression) for c in inequalities]
    if math.prod(map(len, rows)) > MOST:
        return [tuple(inequalities)]
    cases = []
    for chosen in itertools.product(*rows):
        parts = []
        for c, both in zip(inequalities, chosen, strict=True):
            for k, e in enumerate(both):
                name = c.name if len(both) == 1 else f"{c.name}_{k + 1}"
                parts.append(replace(c, name=name, expression=e))
        cases.append(tuple(parts))
    return cases


def _rows(e: sp.Expr) -> list[tuple[sp.Expr, ...]]:
    """Of e <= 0: the alternatives, each a list of expressions that are all to be <= 0."""
    if isinstance(e, (least, sp.Min)):
        return [row for a in e.args for row in _rows(a)]
    if isinstance(e, (greatest, sp.Max)):
        every = itertools.product(*(_rows(a) for a in e.args))
        return [tuple(itertools.chain(*one)) for one in every]
    return [(e,)]


Interval = tuple[float, float]


@dataclass(frozen=True)
class Group:
    """Inequalities that are kept together: their factor, and the states that disturb it.

    cut: of those states that the factor uses, the intervals.
    """

    factor: Factor
    cut: Mapping[str, Interval]


@dataclass(frozen=True)
class Grouping:
    """The groups, and sentences that say why inequalities stay together."""

    groups: tuple[Group, ...]
    reasons: tuple[str, ...]


def with_cut(system: System, cut: Mapping[str, Interval]) -> System:
    """The system in which these states are disturbances within their intervals."""
    if not cut:
        return system
    by_name = {q.name: q for q in system.states}
    box = Box(tuple(a for a, _ in cut.values()), tuple(b for _, b in cut.values()))
    felt = product(box, system.disturbance_bounds) if system.disturbances else box
    return replace(
        system,
        states=tuple(q for q in system.states if q.name not in cut),
        rates={n: r for n, r in system.rates.items() if n not in cut},
        disturbances=(*(by_name[n] for n in cut), *system.disturbances),
        disturbance_bounds=felt,
        pfaffian=(),
        measurements=(),
        flat_output=None,
    )


def grouped(
    system: System,
    inequalities: Sequence[Inequality],
    *,
    cut: Mapping[str, Interval],
    chosen: Sequence[str],
    together: Sequence[str] = (),
    relative: bool = True,
) -> Grouping:
    """The finest groups of inequalities whose factors share none of the `chosen` quantities.

    chosen: what somebody chooses who wants the inequalities to hold. together: inequalities that
    are to stay together whatever they use. relative: as for `factor`. Inequalities that no
    state enters stay with the first.
    """
    reasons: list[str] = []
    sets: list[list[Inequality]] = [[c for c in inequalities if c.name in together]]
    sets += [[c] for c in inequalities if c.name not in together]
    groups: list[tuple[list[Inequality], Group]] = []
    still: list[Inequality] = []
    for members in (s for s in sets if s):
        group = _group(system, members, cut, relative)
        if group is None:
            still += members
            continue
        while group is not None:
            held = _held(group, chosen)
            other = next((k for k, (_, g) in enumerate(groups) if held & _held(g, chosen)), None)
            if other is None:
                break
            others, g = groups.pop(other)
            reasons += _shared(g, group, sorted(held & _held(g, chosen)))
            members = [*others, *members]
            group = _group(system, members, cut, relative)
        if group is not None:
            groups.append((members, group))
    if still and groups:
        members, _ = groups[0]
        again = _group(system, [*members, *still], cut, relative)
        assert again is not None
        groups[0] = ([*members, *still], again)
    groups = _absorbed(system, groups, cut, relative)
    return Grouping(tuple(g for _, g in groups), tuple(dict.fromkeys(reasons)))


def _absorbed(
    system: System,
    groups: list[tuple[list[Inequality], Group]],
    cut: Mapping[str, Interval],
    relative: bool,
) -> list[tuple[list[Inequality], Group]]:
    """The groups, those with no state of their own put together with another that has them all."""
    left = sorted(groups, key=lambda pair: -len(pair[1].factor.coordinates))
    remaining: list[tuple[list[Inequality], Group]] = []
    for members, group in left:
        mine = dict(group.factor.coordinates)
        for k, (others, g) in enumerate(remaining):
            if mine.items() <= dict(g.factor.coordinates).items() and mine.keys().isdisjoint(g.cut):
                again = _group(system, [*others, *members], cut, relative)
                assert again is not None
                if again.factor.coordinates == g.factor.coordinates and again.cut == g.cut:
                    remaining[k] = ([*others, *members], again)
                    break
        else:
            remaining.append((members, group))
    order = {c.name: k for k, (m, _) in enumerate(groups) for c in m}
    return sorted(remaining, key=lambda pair: min(order[c.name] for c in pair[0]))


def _group(
    system: System, members: Sequence[Inequality], cut: Mapping[str, Interval], relative: bool
) -> Group | None:
    read = set().union(*(c.expression.free_symbols for c in members))
    names = {q.name: q.symbol for q in system.states}
    mine = {n: i for n, i in cut.items() if names[n] not in read}
    projection = factor(with_cut(system, mine), members, relative=relative)
    if projection is None:
        return None
    used = {n: i for n, i in mine.items() if n in projection.system.disturbance_names}
    return Group(projection, used)


def _held(group: Group, chosen: Sequence[str]) -> set[str]:
    """The names of the chosen quantities that the factor uses."""
    system = group.factor.system
    every: list[tuple[Quantity, ...]] = players(system.input_bounds, system.inputs, system)
    every += players(system.disturbance_bounds, system.disturbances, system)
    return {q.name for g in every for q in g if q.name in chosen and q.name not in group.cut}


def _shared(one: Group, other: Group, shared: Sequence[str]) -> list[str]:
    """Why two factors become one; nothing where one of them has the states of the other."""
    first, second = (dict(g.factor.coordinates) for g in (one, other))
    if first.items() <= second.items() or second.items() <= first.items():
        return []
    sides = (", ".join(side) for side in (first, second))
    return [
        f"({next(sides)}) and ({next(sides)}) are one part: both need {', '.join(shared)}, of "
        "which one choice has to do for both; the intersection of their separate sets would only "
        "contain the set"
    ]
