"""Nonholonomy, and a search for chained coordinates: z1 and zn are states, the others derivatives.

Whether a system is nonholonomic the growth of the Lie algebra of the allowed motions says.

    z_(j-1) = L_g1 z_j / L_g1 z1,   j = n ... 3,   while L_g2 z_j = 0;   L_g2 z1 = 0

with g1, g2 a basis of the motions. Then z1' = v1, z2' = v2, zj' = z(j-1) v1 for the inputs
v1 = L_g1 z1 u1 and v2 = L_g1 z2 u1 + L_g2 z2 u2, and the exact linear closed loop of
`chained_feedback.py` applies. Only states are tried as ends: combinations of states, and
coordinates that solve partial differential equations, are not, unless the system declares them
(`FlatOutput`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import mpmath
import sympy as sp

from holdfast.maths.definitions.system import Antiderivative, FlatOutput
from holdfast.maths.expressions.random_points import Bounded, Sampler, rank, value_at
from holdfast.maths.nonholonomic.structure import Structure


def plain(expression: sp.Expr) -> sp.Expr:
    """Light simplification in bounded time: sin / cos to tan, tan^2 + 1 to 1 / cos^2."""
    swaps: dict[sp.Expr, sp.Expr] = {}
    for a in {f.args[0] for f in expression.atoms(sp.tan)}:
        swaps |= {sp.tan(a) ** 2 + 1: sp.cos(a) ** -2, -(sp.tan(a) ** 2) - 1: -(sp.cos(a) ** -2)}
    return sp.powsimp(expression.xreplace(swaps).replace(sp.Mul, _tangents))


def _tangents(*factors: sp.Expr) -> sp.Expr:
    product = sp.Mul(*factors)
    powers = product.as_powers_dict()
    for base in [b for b in powers if isinstance(b, sp.sin)]:
        inner, up = base.args[0], powers[base]
        down = sp.sympify(powers.get(sp.cos(inner), 0))
        if up == 1 and down.is_number and down < 0:
            product = product / sp.sin(inner) * sp.cos(inner) * sp.tan(inner)
    return product


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


def growth(constraint: Structure) -> Growth:
    """The growth of the Lie algebra of the motions that A q' = 0 allows (Frobenius, Chow).

    The distribution ker A is involutive, hence A integrable, exactly when the first brackets
    add nothing; kappa - integrable constraints are nonholonomic.
    """
    symbols, sampler = constraint.symbols, constraint.sampler()
    n = len(symbols)
    names = [f"g_{name}" for name in constraint.direction_names]
    generators = [
        (name, sp.Matrix(g)) for name, g in zip(names, constraint.directions, strict=True)
    ]
    entries = [e for _, g in generators for e in g]
    place = sampler.generic_point(symbols, entries, "the motion that the constraint allows")
    generic, origin = _Span(sampler, place), _Span(sampler, sampler.origin(symbols))
    for _, g in generators:
        generic.take(g)
        origin.take(g)
    vector, new, brackets = [generic.rank], generators, []
    for order in range(2, n + _FURTHER + 1):
        fresh, shown = [], []
        for (left, f), (right, g) in _pairs(generators, new, first=order == 2)[:_MOST]:
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
            i + 1 for i in range(constraint.matrix.rows) if _row_integrable(constraint, i, sampler)
        ),
    )


def derived_flag(constraint: Structure) -> tuple[int, ...]:
    """The dimensions at a generic point of E_0 = span{g_i}, E_(k+1) = E_k + [E_k, E_k].

    Until they no longer grow. Brackets of all fields count, those of `growth` with a g_i alone: a
    system with two inputs and without drift is flat, and has chained coordinates, exactly where
    they are 2, 3, 4, ..., n (P. Martin, P. Rouchon, Feedback linearization and driftless systems,
    Mathematics of Control, Signals, and Systems 7, 1994).
    """
    symbols, sampler = constraint.symbols, constraint.sampler()
    basis = [sp.Matrix(g) for g in constraint.directions]
    entries = [e for g in basis for e in g]
    place = sampler.generic_point(symbols, entries, "the motion that the constraint allows")
    span = _Span(sampler, place)
    basis = [g for g in basis if span.take(g)]
    dimensions, done = [span.rank], 0
    while span.rank < len(symbols):
        fresh = []
        for i, f in enumerate(basis):
            for g in basis[max(done, i + 1) :]:
                made = bracket(f, g, symbols).applyfunc(plain)
                if span.take(made):
                    fresh.append(made)
        if not fresh:
            break
        done, basis = len(basis), basis + fresh
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


def _pairs(generators: list[Named], new: list[Named], *, first: bool) -> list[tuple[Named, Named]]:
    if first:
        return list(combinations(generators, 2))
    return [(g, h) for g in generators for h in new]


def _row_integrable(constraint: Structure, number: int, sampler: Sampler) -> bool:
    """Frobenius for one row a: a ^ da = 0."""
    a, q = constraint.matrix.row(number), constraint.symbols
    return all(
        sampler.vanishes(
            a[i] * (a[k].diff(q[j]) - a[j].diff(q[k]))
            + a[j] * (a[i].diff(q[k]) - a[k].diff(q[i]))
            + a[k] * (a[j].diff(q[i]) - a[i].diff(q[j]))
        )
        for i, j, k in combinations(range(len(q)), 3)
    )


_LARGEST = 20_000
"""Most operations in one expression; a pair of coordinates beyond it is abandoned."""


@dataclass(frozen=True)
class ChainedForm:
    """Chained coordinates z(q) and the transformation of their inputs to the system's.

    coordinates: (z1, ..., zn). coefficients: each input u_i = a v1 + b v2 as (a, b).
    divisors: expressions that must not vanish. positive: expressions that must stay positive. The
    law is local to the states where both hold. antiderivatives: quantities that the expressions
    name; `written_out` has their values in their place.
    """

    coordinates: tuple[sp.Expr, ...]
    coefficients: tuple[tuple[sp.Expr, sp.Expr], ...]
    divisors: tuple[sp.Expr, ...]
    positive: tuple[sp.Expr, ...]
    antiderivatives: tuple[Antiderivative, ...] = ()

    def written_out(self) -> ChainedForm:
        """The form as a function of states and parameters alone."""
        values = {a.symbol: a.value for a in self.antiderivatives}
        return ChainedForm(
            tuple(z.xreplace(values) for z in self.coordinates),
            tuple((a.xreplace(values), b.xreplace(values)) for a, b in self.coefficients),
            tuple(e.xreplace(values) for e in self.divisors),
            tuple(e.xreplace(values) for e in self.positive),
        )


@dataclass(frozen=True)
class Search:
    """The outcome: a chained form, or the reason for its absence; and the number of pairs tried."""

    found: ChainedForm | None
    reason: str
    tried: int
    pairs: int
    seconds: float


def find_chained_form(
    constraint: Structure,
    *,
    limit: float = 60.0,
    progress: Callable[[float], None] | None = None,
) -> Search:
    """The chain of the declared flat output, or of the first pair (z1, zn) of states that has one.

    For at most `limit` seconds.
    """
    began = time.monotonic()

    def ended(form: ChainedForm | None, reason: str, tried: int, pairs: int) -> Search:
        return Search(form, reason, tried, pairs, time.monotonic() - began)

    n = len(constraint.coordinates)
    if not constraint.catastatic or any(f != 0 for f in constraint.drift):
        return ended(None, "a chained form has no drift, this system has", 0, 0)
    if not constraint.kinematic or len(constraint.directions) != 2:
        count = len(constraint.inputs) or "other"
        return ended(None, f"a chained form has two inputs, this system {count}", 0, 0)
    if constraint.flat_output is not None:
        result = _chain_of(constraint, constraint.flat_output, began + limit)
        if isinstance(result, ChainedForm):
            return ended(result, "", 0, 0)
        return ended(None, f"the declared flat output begins no chain: {result}", 0, 0)
    states = constraint.coordinates
    pairs = [(a, b) for a in states for b in states if a != b]
    refusals: dict[str, list[str]] = {}
    for number, (first, last) in enumerate(pairs):
        if time.monotonic() - began > limit:
            return ended(
                None,
                f"stopped after {limit:g} s with {number} of {len(pairs)} pairs tried",
                number,
                len(pairs),
            )
        if progress is not None:
            progress(number / len(pairs))
        result = _chain_of(constraint, FlatOutput(first.symbol, (last.symbol,)), began + limit)
        if isinstance(result, ChainedForm):
            return ended(result, "", number + 1, len(pairs))
        refusals.setdefault(result, []).append(f"({first.name}, {last.name})")
    flag = derived_flag(constraint)
    if flag != tuple(range(2, n + 1)):
        return ended(
            None,
            f"its derived flag has the dimensions {flag}, and a system of {n} states with two "
            f"inputs has a flat output, and so chained coordinates, only with "
            f"{tuple(range(2, n + 1))}",
            len(pairs),
            len(pairs),
        )
    reasons = "; ".join(f"{r}: {', '.join(p)}" for r, p in refusals.items())
    return ended(
        None,
        f"no pair of states begins and ends a chain ({reasons}); combinations of states, and "
        "coordinates that solve partial differential equations, are not tried",
        len(pairs),
        len(pairs),
    )


def _chain_of(constraint: Structure, flat: FlatOutput, deadline: float) -> ChainedForm | str:
    sampler, n = constraint.sampler(), len(constraint.coordinates)
    # an antiderivative is one more coordinate here, which any constant may be added to
    integrals = flat.antiderivatives
    q = [*constraint.symbols, *(a.symbol for a in integrals)]
    origin = sampler.origin(q)

    def lifted(direction: sp.ImmutableMatrix) -> sp.Matrix:
        rows = [a.slope * _along(direction, a.upper, constraint.symbols) for a in integrals]
        return sp.Matrix([*direction, *rows])

    (ga, gb) = map(lifted, constraint.directions)
    one, zero = sp.S.One, sp.S.Zero
    first = flat.first
    ahead_a, ahead_b = (_along(g, first, q) for g in (ga, gb))
    if ahead_b == 0:
        g1, g2, mix = ga, gb, ((one, zero), (zero, one))
    elif ahead_a == 0:
        g1, g2, mix = gb, ga, ((zero, one), (one, zero))
    else:
        g1, g2 = ga, (ahead_a * gb - ahead_b * ga).applyfunc(plain)
        mix = ((one, zero), (-ahead_b, ahead_a))

    def along(g: sp.Matrix, z: sp.Expr) -> sp.Expr:
        return _along(g, z, q)

    speed = plain(along(g1, first))
    if not sampler.nonzero(speed, origin):
        return "the first does not move at the origin"
    chain = list(flat.last)
    if any(sampler.nonzero(z, origin) for z in (first, *chain)):
        return "a coordinate is not zero at the origin"
    for before, z in pairwise(chain):
        if not (sampler.vanishes(along(g2, z)) and sampler.vanishes(along(g1, z) - before * speed)):
            return "a coordinate is not what differentiation of the next one gives"
    while True:
        across = along(g2, chain[0])
        if len(chain) == n - 1:
            break
        if not sampler.vanishes(across):
            return "a coordinate of the chain is moved by the second input too early"
        z = plain(along(g1, chain[0]) / speed)
        if time.monotonic() > deadline:
            return "out of time"
        if sp.count_ops(z) > _LARGEST:
            return "an expression of the chain grows too large"
        if not mpmath.isfinite(value_at(z, origin)) or sampler.nonzero(z, origin):
            return "a coordinate of the chain is not zero at the origin"
        chain.insert(0, z)
    across = plain(across)
    if not sampler.nonzero(across, origin):
        return "the second input does not move the chain at the origin"
    z = (first, *chain)
    if not _regular(z, flat, constraint.symbols, sampler):
        return "the coordinates are dependent at the origin"
    ahead = along(g1, z[1])
    # u on (g1, g2): u1 = v1 / speed, u2 = (v2 - ahead u1) / across
    first_input = (one / speed, zero)
    second = (-ahead / (speed * across), one / across)
    coefficients = tuple(
        (
            mix[0][k] * first_input[0] + mix[1][k] * second[0],
            mix[0][k] * first_input[1] + mix[1][k] * second[1],
        )
        for k in (0, 1)
    )
    shown = (*z, *(e for pair in coefficients for e in pair), speed, across)
    divisors, positive = _domain(shown, set(q))
    return ChainedForm(z, coefficients, divisors, positive, integrals)


def _along(g: sp.Matrix, z: sp.Expr, q: list[sp.Symbol]) -> sp.Expr:
    return sp.Add(*(z.diff(s) * e for s, e in zip(q, g, strict=True)))


def _regular(
    z: tuple[sp.Expr, ...], flat: FlatOutput, q: list[sp.Symbol], sampler: Sampler
) -> bool:
    integrals = flat.antiderivatives
    origin = sampler.origin([*q, *(a.symbol for a in integrals)])
    slopes = [
        [
            sp.Add(e.diff(s), *(e.diff(a.symbol) * a.slope * a.upper.diff(s) for a in integrals))
            for s in q
        ]
        for e in z
    ]
    return sampler.rank(slopes, origin) == len(q)


def _domain(
    expressions: tuple[sp.Expr, ...], states: set[sp.Symbol]
) -> tuple[tuple[sp.Expr, ...], tuple[sp.Expr, ...]]:
    """Divisors that must not vanish and terms that must be positive for regular expressions."""
    nonzero: set[sp.Expr] = set()
    positive: set[sp.Expr] = set()
    for e in expressions:
        for tangent in e.atoms(sp.tan):
            nonzero.add(sp.cos(tangent.args[0]))
        for power in e.atoms(sp.Pow):
            if not power.exp.is_Integer:
                positive.add(power.base)
            elif power.exp < 0:
                nonzero |= {f.as_base_exp()[0] for f in sp.Mul.make_args(power.base)}
        for function in e.atoms(sp.log):
            positive.add(function.args[0])
    ordered = (sorted(terms, key=sp.default_sort_key) for terms in (nonzero, positive))
    divisors, bases = (tuple(e for e in terms if e.free_symbols & states) for terms in ordered)
    return divisors, bases
