"""A stage of a step at a node, for every target, and its leaf: a run of nodes to their new values.

    slopes   mean = half (below + above),  gap = half (above - below)
    step     new = base + weight ((value - base) + dt rate), the rate limited to one sign,
             and new within the bounds

Of a scheme that has one slope of every interval the slopes are differences of the nodes on either
side; others have computed them before. What lies between the two is the rate.

A scheme of higher order may balance a ridge against its dissipation, and stand still where the
equation does not. So it is filtered: with r the rate of the scheme, r_M that of the monotone step
from the plain differences (`maths/games/hamiltonian.py`), s a bound of |r - r_M|, and b how far
the slopes are from the mean of the plain differences and from one another,

    rate = r_M + w (r - r_M),   w = 1 to s + k b = e,  2 - (s + k b) / e to 2 e,  0 beyond

Where the value is smooth s is of the order of a cell, b of its square, and both are less than the
leeway e, so that the rate is that of the scheme. At a kink within a cell b is a part of s, however
weak the kink: there a scheme of high order takes the slope of either side as far as the kink, and
stands still where neither side falls. k is 0 where no other march is beside this one.

A step differs from a monotone one by no more than e dt, and e tends to 0 with the cells, whatever
the value, so that the values converge to the viscosity solution (G. Barles, P. E. Souganidis,
Asymptotic Anal. 4, 1991; B. D. Froese, A. M. Oberman, SIAM J. Numer. Anal. 51, 2013;
O. Bokanowski, M. Falcone, S. Sahu, SIAM J. Sci. Comput. 38, 2016, where w depends on |r - r_M|
itself, which is small where a ridge is balanced). Limits and bounds keep the order of two values,
and a Runge-Kutta step is a convex combination of such stages, so that it holds for a whole step.

Every part of the rate is computed as far out as possible. Level k of a loop nest is inside the loop
over axis k, and -1 is before all loops; every part of an expression moves to the outermost one:

| leaf | argument w | results |
|---|---|---|
| along | the nodes of the last axis | what depends on the last axis alone |
| rows | of each row the other axes | what depends on outer axes; what depends on the row's |
| rate | along, the row's, mean slopes, half gaps | dW/dtau before it is limited, ... |

Their argument u are numbers that are the same at all nodes: of the first two the time, the
parameters and the largest speed along each axis; of the last what the rows have of outer axes.
The rate is not called but is a part of the leaf of a stage, in which nothing between slopes, rate
and step is stored. The others of its results are for a filtered scheme: the rate of a monotone step
from the plain differences, and the largest speeds at the node. The steps of slopes and of the new
value may be fused (`Steps`), those of the rate may not: where the slope on one side is
zero, two equal products are subtracted, and the sign of their difference decides which input is
optimal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import sympy as sp

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose, only_where
from holdfast.execution.codegen.llvm_text import Leaf, Places, lanes_of
from holdfast.execution.codegen.lowering import is_algebraic, lowered
from holdfast.execution.level_set.stencils import PITCH
from holdfast.maths.definitions.quantity import TIME, Parameter
from holdfast.maths.games.hamiltonian import Hamiltonian, is_sharp, monotone_flux

BEFORE = -1


@dataclass
class Schedule:
    """Statements by level for loops over `axes`; `moving` symbols differ at every node."""

    axes: Sequence[sp.Symbol]
    moving: frozenset[sp.Symbol] = frozenset()
    levels: dict[int, list[tuple[sp.Symbol, sp.Expr]]] = field(default_factory=dict)
    tables: list[tuple[sp.Symbol, sp.Expr]] = field(default_factory=list)
    _level_of: dict[sp.Symbol, frozenset[int]] = field(default_factory=dict)
    _known: dict[sp.Expr, sp.Symbol] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.node = len(self.axes)  # the level of node-dependent parts
        for i, axis in enumerate(self.axes):
            self._level_of[axis] = frozenset({i})
        for s in self.moving:
            self._level_of[s] = frozenset({self.node})

    def add(self, results: Sequence[sp.Expr]) -> list[sp.Expr]:
        """Schedule the parts of these expressions; returns the expressions left at a node."""
        shared, reduced = sp.cse(
            list(results), symbols=sp.numbered_symbols("c_", real=True), order="none"
        )
        for s, e in shared:
            self._define(s, e)
        return [self._part(e) for e in reduced]

    def _where(self, e: sp.Expr) -> frozenset[int]:
        levels = (self._level_of.get(s, frozenset()) for s in e.free_symbols)
        return frozenset().union(*levels)

    def _level(self, where: frozenset[int]) -> int:
        """The level at which a part with these dependences is computed; the table counts as one."""
        if not where:
            return BEFORE
        last = self.node - 1
        return max(where) if max(where) < last or where == {last} else self.node

    def _define(self, s: sp.Symbol, e: sp.Expr) -> None:
        where = self._where(e)
        level = self._level(where)
        inside = self._rewritten(e, where)
        if level == self.node - 1:
            self.tables.append((s, inside))
        else:
            self.levels.setdefault(level, []).append((s, inside))
        self._level_of[s] = where

    def _part(self, e: sp.Expr) -> sp.Expr:
        """The form of e at a node: a symbol, if it belongs further out."""
        where = self._where(e)
        if self._level(where) == self.node:
            return self._rewritten(e, where)
        return self._symbol(e)

    def _symbol(self, e: sp.Expr) -> sp.Expr:
        if e.is_Atom or (e.is_Mul and len(e.args) == 2 and e.args[0] == -1 and e.args[1].is_Atom):
            return e
        if e not in self._known:
            s = sp.Symbol(f"h_{len(self._known)}", real=True)
            self._known[e] = s
            self._define(s, e)
        return self._known[e]

    def _rewritten(self, e: sp.Expr, where: frozenset[int]) -> sp.Expr:
        """e with every part that belongs further out than e replaced by its symbol."""
        level = self._level(where)
        if e.is_Atom:
            return e
        if e.is_Add or e.is_Mul:
            groups: dict[int, list[sp.Expr]] = {}
            for a in e.args:
                groups.setdefault(self._level(self._where(a)), []).append(a)
            at_level = [self._rewritten(a, self._where(a)) for a in groups.pop(level, [])]
            outer: list[sp.Expr] = []
            for k in sorted(groups):
                both = e.func(*outer, *groups[k])
                if self._level(self._where(both)) == level:  # an axis and the table
                    outer.append(self._symbol(e.func(*groups[k])))
                else:
                    outer = [self._symbol(both)]
            return e.func(*outer, *at_level)
        arguments = []
        for a in e.args:
            inside = self._where(a)
            lower = self._level(inside) < level and not a.is_Atom
            arguments.append(self._symbol(a) if lower else self._rewritten(a, inside))
        return e.func(*arguments)


DISSIPATIONS = ("global", "local", "local-local")

Statements = Sequence[tuple[sp.Symbol, sp.Expr]]


class RateLeaves(NamedTuple):
    """The leaves, and how many values they have: along the last axis, of a row, of outer axes."""

    leaves: dict[str, Leaf]
    rate: Leaf
    along: int
    of_row: int
    outer: int


def rate_leaves(
    hamiltonian: Hamiltonian,
    parameters: Sequence[Parameter],
    *,
    dissipation: str,
    filtered: bool,
    one_slope: bool = False,
    precision: str = "float64",
) -> RateLeaves:
    """The leaves of the Lax-Friedrichs scheme with this Hamiltonian.

    filtered: whether the rate of a monotone step and the speeds are wanted, too. one_slope: whether
    the slopes are plain differences. "local-local" uses that rate then, where it is sharp: the
    speeds of all slopes between those at a node wear a ridge on every grid, if a player acts on
    several axes.
    """
    n = len(hamiltonian.costates)
    gaps = [sp.Symbol(f"_g{i}", real=True) for i in range(n)]  # no user name begins so
    largest = [sp.Symbol(f"_a{i}", real=True) for i in range(n)]
    if dissipation == "global":
        speeds: Sequence[sp.Expr] = largest
    else:
        speeds = hamiltonian.speeds if dissipation == "local" else hamiltonian.tight_speeds
    total = hamiltonian.value + sum(
        (a * g for a, g in zip(speeds, gaps, strict=True)), start=sp.S.Zero
    )
    width = {s: sp.Abs(g) for s, g in zip(hamiltonian.spreads, gaps, strict=True)}
    scheme_rate = total.xreplace(width)
    if one_slope and dissipation == "local-local" and is_sharp(hamiltonian):
        scheme_rate = monotone_flux(hamiltonian, gaps, over_points=False)
    totals = [scheme_rate]
    if filtered:
        totals += [monotone_flux(hamiltonian, gaps), *hamiltonian.speeds]
    slopes = [*hamiltonian.costates, *gaps]
    axes = [q.symbol for q in hamiltonian.system.states]
    plan = Schedule(axes, frozenset(slopes))
    results = plan.add(totals)
    at_node = plan.levels.get(n, [])
    outside = [x for level in range(BEFORE, n - 1) for x in plan.levels.get(level, [])]
    asked = set().union(*(e.free_symbols for e in [*(e for _, e in at_node), *results]))
    asked -= {s for s, _ in at_node} | set(slopes)
    order = sorted(asked, key=str)
    tables = {axes[-1], *(s for s, _ in plan.tables)}
    row = {s for s, _ in plan.levels.get(n - 2, [])} | {axes[n - 2]} if n > 1 else set()
    along = [s for s in order if s in tables]
    of_row = [s for s in order if s in row]
    outer = [s for s in order if s not in tables | row]
    same = [TIME, *(q.symbol for q in parameters), *largest]
    before = plan.levels.get(BEFORE, [])
    algebraic = is_algebraic([*results, *(e for _, e in at_node)])
    leaves = {
        "along": _leaf(axes[-1:], same, [*before, *plan.tables], along),
        "rows": _leaf(axes[:-1], same, outside, [*outer, *of_row]),
    }
    of_node = _leaf(
        [*along, *of_row, *slopes], outer, at_node, results,
        single=precision == "float32", algebraic=algebraic,
    )  # fmt: skip
    return RateLeaves(leaves, of_node, len(along), len(of_row), len(outer))


def _leaf(
    rows: Sequence[sp.Symbol],
    same: Sequence[sp.Symbol],
    statements: Statements,
    results: Sequence[sp.Expr],
    *,
    single: bool = False,
    algebraic: bool = False,
) -> Leaf:
    """The leaf of statements that follow one another; w are the rows, u what is the same."""
    steps = Steps(expanded=True)
    names = {"w": [f"w{i}" for i in range(len(rows))], "u": [f"u{i}" for i in range(len(same))]}
    by_symbol: dict[sp.Symbol, Value] = {}
    for name, symbol in [*zip(names["w"], rows, strict=True), *zip(names["u"], same, strict=True)]:
        by_symbol[symbol] = steps.input(name)
    for symbol, expression in statements:
        (by_symbol[symbol],) = lowered(steps, [expression], by_symbol)
    outputs = lowered(steps, results, by_symbol)
    return Leaf(steps, names, outputs, frozenset({"u"}), single=single, algebraic=algebraic)


NUMBERS = ("dt", "weight", "floor", "ceiling", "nearest", "leeway", "share", "bent")
"""The first of its numbers, the last three for a filter; `OF_AXES` of every axis follow."""

OF_AXES = ("half", "step", "low", "high", "lowest_low", "lowest_high")
"""Numbers of each axis: half the inverse of its step, its step, and of what a set is kept within
(`stencils.py`) how much it falls from node to node beyond both ends, and down to what."""


def names_of_numbers(axes: int) -> list[str]:
    """The numbers of a stage, in their order."""
    return [*NUMBERS, *(f"{x}{i}" for x in OF_AXES for i in range(axes))]


INFINITE = 1e300

MOST_STEEP = 4.0
"""How many times larger the leeway may be where the value is steeper than the start value."""


PLACES = (
    "value", "base", "before", "lower", "upper", "out", "rest", "changed", "odd", "moves", "along",
    "of_row", "outer", "numbers",
)  # fmt: skip
"""The addresses that a stage asks for, in the order of `sweep.py`. Two slopes for each axis follow,
and of a filtered scheme two plain differences for each."""

Sides = Sequence[tuple[Value, Value]]
"""Of each axis the slopes below and above a node, in cells."""


@dataclass(frozen=True)
class Stage:
    """one_slope: whether an interval has one slope. filtered: whether the rate is held close to
    that of a monotone step. limits: the lowest and the highest rate. side: of zero, for which it is
    measured how fast the set moves. from_start: the values are those that the step begins with and
    that its result is compared with. lower, upper: whether there are such bounds at nodes."""

    rates: RateLeaves
    axes: int
    one_slope: bool
    filtered: bool
    limits: tuple[float, float]
    side: float
    from_start: bool
    lower: bool
    upper: bool

    @property
    def lanes(self) -> int:
        """Nodes that are computed at a time."""
        return lanes_of(self.rates.rate)

    def leaves(self) -> dict[str, Leaf]:
        """`stage`, and `measured`, which also finds the largest move."""
        results = self.results()
        return {"stage": self._leaf(results[:3]), "measured": self._leaf(results)}

    def _leaf(self, results: Sequence[Value]) -> Leaf:
        rates, sides = self.rates, [f"{x}{i}" for i in range(self.axes) for x in ("below", "above")]
        if self.filtered:
            sides += [f"plain_{x}" for x in sides]
        nodes = ("value", "base", "before", "lower", "upper")
        of_node = rates.rate.arguments["w"]
        rows = {
            **{name: [name] for name in (*nodes, *sides)},
            "along": of_node[: rates.along],
            "of_row": of_node[rates.along : rates.along + rates.of_row],
            "outer": rates.rate.arguments["u"],
            "numbers": names_of_numbers(self.axes),
        }
        into = ("out", "changed", "odd", "moves")[: len(results)]
        places = Places((*PLACES, *sides), PITCH, into, largest="moves", rest="rest")
        return Leaf(
            results[0].steps, rows, results, frozenset({"outer", "numbers"}),
            single=rates.rate.single, algebraic=rates.rate.algebraic, places=places,
        )  # fmt: skip

    def results(self) -> list[Value]:
        """The new value, whether it differs, whether it is not finite, and how far it has moved.

        Inputs: those of `_leaf`. Of a scheme that has one slope of every interval, those at the
        sides of a node are the values there.
        """
        steps = Steps(expanded=True, fused=True)
        sides = self._sides(steps, "")
        slopes = sides
        if self.one_slope:
            here = steps.input("value")
            slopes = [(here - below, above - here) for below, above in sides]
        means, gaps = self._slopes(steps, slopes)
        (rate,) = self._rates(steps, means, gaps, 0, 1)
        if self.filtered:
            speeds = self._rates(steps, means, gaps, 2, 2 + self.axes)
            rate = self._held_close(steps, rate, slopes, speeds)
        return self._step(steps, rate, means, gaps)

    def _sides(self, steps: Steps, kind: str) -> Sides:
        return [
            (steps.input(f"{kind}below{i}"), steps.input(f"{kind}above{i}"))
            for i in range(self.axes)
        ]

    def _slopes(self, steps: Steps, sides: Sides) -> tuple[list[Value], list[Value]]:
        """The means, and the gaps."""
        halves = [steps.input(f"half{i}") for i in range(self.axes)]
        means = [half * (below + above) for half, (below, above) in zip(halves, sides, strict=True)]
        gaps = [half * (above - below) for half, (below, above) in zip(halves, sides, strict=True)]
        return means, gaps

    def _rates(
        self, steps: Steps, means: Sequence[Value], gaps: Sequence[Value], first: int, last: int
    ) -> list[Value]:
        """Some results of the leaf of the rate."""
        rate, begin = self.rates.rate, self.rates.along + self.rates.of_row
        slopes = dict(zip(rate.arguments["w"][begin:], [*means, *gaps], strict=True))
        return steps.repeat(rate.results[first:last], slopes)

    def _held_close(
        self, steps: Steps, rate: Value, sides: Sides, speeds: Sequence[Value]
    ) -> Value:
        """The rate within the leeway of the monotone one, which is computed where a node needs it:
        where s + k b is more than the leeway e, with s a bound of |r - r_M| whatever the
        Hamiltonian.

        No speed exceeds c_i, so that with slopes p and plain differences q on both sides of a node

            |r - r_M| <= s = sum_i c_i (max(|p_i- - q_i-|, |p_i+ - q_i+|) + |q_i+ - q_i-| / 2)
                         b = sum_i c_i (|p_i- + p_i+ - q_i- - q_i+| + |p_i+ - p_i-|) / 2
            e = a R,  or  a sum_i c_i min(|q_i-|, |q_i+|)  where that is more, at most 4 a R

        with the share a and the largest rate R of the start value. Among the numbers are leeway,
        which is a R, share, and bent, which is k.
        """
        plain, bent = self._sides(steps, "plain_"), steps.input("bent")
        most, steep = steps.constant(0.0, FLOAT), steps.constant(0.0, FLOAT)
        for i, ((below, above), (lower, upper)) in enumerate(zip(sides, plain, strict=True)):
            pace = 2.0 * (steps.input(f"half{i}") * speeds[i])
            differ = _at_least(abs(below - lower), abs(above - upper))
            bend = abs(below + above - lower - upper) + abs(above - below)
            most = most + pace * (differ + 0.5 * abs(upper - lower) + 0.5 * (bent * bend))
            steep = steep + pace * _at_most(abs(lower), abs(upper))
        leeway = steps.input("leeway")
        allowed = _at_least(steep * steps.input("share"), leeway)
        allowed = _at_most(allowed, MOST_STEEP * leeway)
        far = most > allowed
        (monotone,) = self._rates(steps, *self._slopes(steps, plain), 1, 2)
        left = _at_least((2.0 * allowed - most) / allowed, steps.constant(0.0, FLOAT))
        return only_where(far, choose(far, monotone + left * (rate - monotone), rate), rate)

    def _step(
        self, steps: Steps, rate: Value, means: Sequence[Value], gaps: Sequence[Value]
    ) -> list[Value]:
        value, dt, weight = (steps.input(x) for x in ("value", "dt", "weight"))
        base, was = (value if self.from_start else steps.input(name) for name in ("base", "before"))
        lowest, highest = self.limits
        r = rate if highest == math.inf else _at_most(rate, steps.constant(highest, FLOAT))
        r = r if lowest == -math.inf else _at_least(r, steps.constant(lowest, FLOAT))
        new = base + weight * ((value - base) + dt * r)
        for name, bound, there in (
            ("lower", _at_least, self.lower),
            ("upper", _at_most, self.upper),
        ):
            if there:
                new = bound(new, steps.input(name))
        new = _at_most(_at_least(new, steps.input("floor")), steps.input("ceiling"))
        move = self._move(steps, new, was, means, gaps)
        return [new, new.differs(was), ~(abs(new) < INFINITE), move]

    def _move(
        self, steps: Steps, new: Value, was: Value, means: Sequence[Value], gaps: Sequence[Value]
    ) -> Value:
        """By how much of a cell the value of a node on that side of zero has moved.

        Or by how much of its distance from zero, if that is more. A cell is how much the value
        changes from a node to the next, on its flatter side, the largest along the axes: of the
        slopes mean - gap and mean + gap on either side the smaller is ||mean| - |gap||.
        """
        cell = steps.constant(0.0, FLOAT)
        for i, (mean, gap) in enumerate(zip(means, gaps, strict=True)):
            change = steps.input(f"step{i}") * abs(abs(mean) - abs(gap))
            cell = choose(change > cell, change, cell)
        w = self.side * was
        near = choose(w > cell, w, cell)
        nearest = steps.input("nearest")
        near = choose(near > nearest, near, nearest)
        return choose(w > 0.0, abs(new - was) / near, 0.0)


def _at_most(value: Value, bound: Value) -> Value:
    """NaN passes, so that it is seen."""
    return choose(value > bound, bound, value)


def _at_least(value: Value, bound: Value) -> Value:
    return choose(value < bound, bound, value)
