"""The Hamiltonian of a system: the best input against the worst disturbance.

    H(t, q, p) = opt_u  opp_d  p . f(t, q, u, d),   opt, opp each a maximum or a minimum

For rates that are affine in u and d the two separate, H = p . f0 + s_u(G'p) + s_d(D'p), where s
is the support function of the set: sum of |.| for a box, the Euclidean norm for a ball, that of
M' G'p for the image under M. Nothing here is specific to a system (thesis (7.3), (7.6), (7.7)).

Inputs without a closed form are sampled:

    H = opt_i opp_j  p . f(t, q, u_i, d_j)   over the points u_i, d_j of the sets

opt comes first: the disturbance answers the input. With max_i min_j that is the lower value,
max min <= min max, which is guaranteed even against a disturbance that knows the input.

A problem may be invariant under a reflection; half the grid then suffices:

    H(t, S q, S p) = H(t, q, p),   { c_j(S q) } = { c_j(q) },   S = diag(+-1)

Then V(S q) = V(q). The inputs need no reflection: H is already optimal over them.

The monotone numerical Hamiltonian is that of first order, for one-sided slopes. With the mean p
of the slopes at both sides of a node, and half their difference g,

    H_M(p, g) = opt_u opp_d  sum_i  f_i p_i + |f_i| g_i

over the corners of both sets and points between them, since at a summit the best input is none of
the corners: every pair of them has the differences on the side that it comes from. It is H for
g = 0, does not fall with a slope above nor rise with one below, and changes no faster than the
speeds with either, so that the Euler step with it is monotone (H. J. Kushner, P. G. Dupuis,
Numerical Methods for Stochastic Control Problems in Continuous Time, 1992).

Axes on which no input or disturbance acts jointly are a sum of such terms, each over the corners
of what acts on it. What moves the state within an ellipsoid with half-axes r_i, as a current of any
direction does, has a term of its own,

    +- |(r_i max(|p_i| +- g_i, 0))_i|,   + if it maximises, - if it minimises

(S. Osher, J. A. Sethian, J. Comput. Phys. 79, 1988). Another set without corners, or one with too
many, has its support function in H, and the largest speed that it adds in the dissipation
(Lax-Friedrichs), which is monotone, too, and smears a ridge more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, check_name
from holdfast.maths.definitions.bounds import Bounds, section
from holdfast.maths.definitions.quantity import Quantity, frozen
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.sets.base import WITHIN
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, least, magnitude, select, sgn, wrap

MOST = 400
"""Most pairs of an input point and a disturbance point; every node evaluates all of them."""

Point = dict[sp.Symbol, sp.Expr]


def dependences(system: System, symbol: sp.Symbol) -> list[set[sp.Symbol]]:
    """The symbols in the derivative of every rate by `symbol`: none for a constant gain.

    A rate that jumps in `symbol`, and so has no derivative there, depends on it.
    """
    by_rate = []
    for rate in system.rates.values():
        jumps = any(e.has(symbol) for e in rate.atoms(sgn, wrap, select, sp.Piecewise))
        by_rate.append(rate.diff(symbol).free_symbols | ({symbol} if jumps else set()))
    return by_rate


def in_the_way(system: System, symbol: sp.Symbol, sampled: set[sp.Symbol]) -> list[set[sp.Symbol]]:
    """For every rate, the inputs and disturbances for which `symbol` has no closed form.

    A disturbance has one at every sampled input. An input is chosen first, without
    knowing the disturbance.
    """
    inputs = {q.symbol for q in system.inputs}
    disturbances = {q.symbol for q in system.disturbances}
    unknown = (inputs | disturbances) - sampled
    if symbol in inputs:
        unknown |= disturbances
    return [used & unknown for used in dependences(system, symbol)]


def without_closed_form(system: System) -> set[sp.Symbol]:
    """The inputs and disturbances to sample so that all others have a closed form.

    Members of a ball or an image go together. First those in which a rate is not affine; then the
    inputs that mix with disturbances; then those that mix among the inputs, or the disturbances.
    """
    groups = [
        group
        for bounds, members in (
            (system.input_bounds, system.inputs),
            (system.disturbance_bounds, system.disturbances),
        )
        for group in _groups(bounds, [q.symbol for q in members])
    ]
    disturbances = {q.symbol for q in system.disturbances}
    sampled: set[sp.Symbol] = set()
    for among in ("itself", "the disturbances", "all"):
        for group in groups:
            blocking = set().union(*(e for s in group for e in in_the_way(system, s, sampled)))
            if among == "itself":
                blocking &= set(group)
            elif among == "the disturbances":
                blocking &= disturbances
            if blocking:
                sampled |= set(group)
    return sampled


def points_of(bounds: Bounds | None, members: Sequence[sp.Symbol], which: set[sp.Symbol],
              samples: int) -> list[Point]:  # fmt: skip
    """The points of the members in `which`; one point without coordinates if it is empty."""
    part = section(bounds, [m in which for m in members])
    if part is None:
        return [{}]
    names = [m for m in members if m in which]
    return [dict(zip(names, point, strict=True)) for point in part.points(samples)]


def check_count(inputs: int, disturbances: int) -> None:
    if inputs * disturbances > MOST:
        raise DefinitionError(
            f"{inputs} points of the inputs times {disturbances} points of the disturbances "
            f"make {inputs * disturbances} pairs",
            expected=f"at most {MOST}",
            remedy="take fewer samples",
        )


def _groups(bounds: Bounds | None, members: Sequence[sp.Symbol]) -> list[Sequence[sp.Symbol]]:
    """The members of a set that can be chosen independently."""
    return [members] if bounds is None else bounds.groups(members)


@dataclass(frozen=True)
class Hamiltonian:
    """H and its derived quantities, as expressions of t, the states, `costates` and parameters.

    costates: p_i, one for each state. inputs, disturbances: the optimal ones. speeds: bounds of
    |dH/dp_i| for every p, the dissipation of a local Lax-Friedrichs scheme. tight_speeds: the same
    for p_i within `spreads` (half-widths) of `costates`, of the local-local scheme. samples: along
    every sampled coordinate, 0 for a closed form. separable: whether no rate mixes
    inputs with disturbances, so that it does not matter who chooses first (the condition of
    R. Isaacs); where it is False, the disturbance answers the input. sides: "max" or "min", of the
    inputs and of the disturbances.
    """

    system: System
    costates: tuple[sp.Symbol, ...]
    spreads: tuple[sp.Symbol, ...]
    value: sp.Expr
    inputs: Mapping[str, sp.Expr]
    disturbances: Mapping[str, sp.Expr]
    speeds: tuple[sp.Expr, ...]
    tight_speeds: tuple[sp.Expr, ...]
    samples: int = 0
    separable: bool = True
    sides: tuple[str, str] = ("max", "min")

    def __hash__(self) -> int:
        return hash((self.costates, self.value, self.speeds, self.tight_speeds, self.sides))


@checked
def hamiltonian(
    system: System, *, inputs: str = "max", disturbances: str = "min", samples: int | None = None
) -> Hamiltonian:
    """The Hamiltonian of `system` within its bounds.

    inputs, disturbances: what each player does, "max" or "min".

    samples: the points per coordinate that replace the set of an input without a closed form;
    the others keep their closed form. By default `system.samples`.

    Raises `DefinitionError` for an input or a disturbance that is unbounded; without samples, for
    rates that are not affine in them, or that multiply one by another; and for samples where a
    closed form exists, or more points than `MOST`.

    >>> hf.hamiltonian(gusty, inputs="max", disturbances="min").value
    _p0*v + 0.8*magnitude(_p1)
    """
    for what, side in (("inputs", inputs), ("disturbances", disturbances)):
        if side not in ("max", "min"):
            raise DefinitionError(f"{what}={side!r}", expected='"max" or "min"')
    if samples is not None:
        system = replace(system, samples=samples)
    n = len(system.states)
    p = sp.Matrix(sp.symbols(f"_p0:{n}", real=True))
    spread = sp.Matrix(sp.symbols(f"_dp0:{n}", real=True))
    for what, members, bounds in (
        ("input", system.inputs, system.input_bounds),
        ("disturbance", system.disturbances, system.disturbance_bounds),
    ):
        _check_bounded(system, what, members, bounds)
    which = without_closed_form(system) if system.samples else set()
    if samples and not which:
        raise DefinitionError(
            f"samples: {samples}, but the rates of system '{system.name}' are affine in every "
            "input and disturbance: a closed form exists",
            remedy="leave out samples",
        )
    game = _game_with(system, inputs, disturbances, which)
    players, points = game.players, game.points

    def case(u: Point, d: Point) -> _Case:
        drift, gains = game.at(u | d)
        return _case(list(zip(players, gains, strict=True)), drift, p, spread, u | d)

    answers = [_best([case(u, d) for d in points[1]], players[1].sign, spread) for u in points[0]]
    answer = _best(answers, players[0].sign, spread)
    return Hamiltonian(
        system,
        tuple(p),
        tuple(spread),
        answer.value,
        frozen({q.name: answer.chosen[q.symbol] for q in system.inputs}),
        frozen({q.name: answer.chosen[q.symbol] for q in system.disturbances}),
        answer.speeds,
        answer.tight_speeds,
        system.samples if which else 0,
        not any(
            answer & {d.symbol for d in system.disturbances}
            for q in system.inputs
            for answer in dependences(system, q.symbol)
        ),
        (inputs, disturbances),
    )


@dataclass(frozen=True)
class Game:
    """The players, the sampled points of each, and the rates: without the closed forms, and how
    they change with these."""

    players: list[Player]
    points: list[list[Point]]
    still: sp.Matrix
    gains: list[sp.Matrix]

    def at(self, point: Point) -> tuple[sp.Matrix, list[sp.Matrix]]:
        """The rates without the closed forms, and the gains of these, at a sampled point."""
        return self.still.xreplace(point), [gain.xreplace(point) for gain in self.gains]


def game_of(h: Hamiltonian) -> Game:
    """The game that a Hamiltonian is the value of."""
    return _game_with(h.system, *h.sides, without_closed_form(h.system) if h.samples else set())


def _game_with(system: System, inputs: str, disturbances: str, which: set[sp.Symbol]) -> Game:
    """which: the inputs and disturbances that are sampled."""
    players, points = [], []
    for what, members, bounds, side in (
        ("input", system.inputs, system.input_bounds, inputs),
        ("disturbance", system.disturbances, system.disturbance_bounds, disturbances),
    ):
        closed = tuple(q for q in members if q.symbol not in which)
        rest = section(bounds, [q in closed for q in members])
        players.append(Player(system, what, closed, rest, side, frozenset(which)))
        symbols = [q.symbol for q in members]
        points.append(points_of(bounds, symbols, which, system.samples))
    check_count(*(len(every) for every in points))
    rates = sp.Matrix(list(system.rates.values()))
    still = rates.xreplace({q.symbol: sp.S.Zero for one in players for q in one.members})
    return Game(players, points, still, [player.gain(rates) for player in players])


@dataclass(frozen=True)
class _Case:
    """H at some sample points, and the choices of both players.

    low, high: bounds of dH/dp_i for every p. tight_speeds: of |dH/dp_i| for p within the spread.
    """

    value: sp.Expr
    chosen: Mapping[sp.Symbol, sp.Expr]
    low: tuple[sp.Expr, ...]
    high: tuple[sp.Expr, ...]
    speeds: tuple[sp.Expr, ...]
    tight_speeds: tuple[sp.Expr, ...]


def _case(
    sets: Sequence[tuple[Player, sp.Matrix]],
    drift: sp.Matrix,
    p: sp.Matrix,
    spread: sp.Matrix,
    at: Point,
) -> _Case:
    """The closed form of H = p . drift + s_u(G'p) + s_d(D'p)."""
    n = len(drift)
    value, chosen = (p.T * drift)[0], dict(at)
    speeds, tight = list(drift), list(drift)
    widths = [sp.S.Zero] * n
    tight_widths = [sp.S.Zero] * n
    for player, gain in sets:
        support, best = player.support(gain.T * p)
        value += support
        chosen |= best
        centre, width, near, narrow = player.reach(gain, p, spread)
        for i in range(n):
            speeds[i] += centre[i]
            widths[i] += width[i]
            tight[i] += near[i]
            tight_widths[i] += narrow[i]
    return _Case(
        value,
        chosen,
        tuple(a - w for a, w in zip(speeds, widths, strict=True)),
        tuple(a + w for a, w in zip(speeds, widths, strict=True)),
        tuple(magnitude(a) + w for a, w in zip(speeds, widths, strict=True)),
        tuple(magnitude(a) + w for a, w in zip(tight, tight_widths, strict=True)),
    )


def _best(cases: Sequence[_Case], sign: int, spread: sp.Matrix) -> _Case:
    """The case of the largest (smallest) value.

    Within the spread dp the lead of the best case b over case k changes by at most

        S_k = sum_i |dH_b/dp_i - dH_k/dp_i| dp_i

    A case that is further behind is the best for none of those p, and its speeds do not count.
    """
    if len(cases) == 1:
        return cases[0]
    axes = range(len(spread))
    first = _first(cases, sign)
    tight: list[list[sp.Expr]] = [[] for _ in axes]
    for case in cases:
        swing = sum(
            greatest(magnitude(case.high[i] - first.low[i]), magnitude(first.high[i] - case.low[i]))
            * spread[i]
            for i in axes
        )
        room = WITHIN * swing - sign * (first.value - case.value)  # < 0: nowhere best
        for i in axes:
            tight[i].append(select(room, case.tight_speeds[i], sp.S.Zero))
    return _Case(
        first.value,
        first.chosen,
        tuple(of_all(least, [c.low[i] for c in cases]) for i in axes),
        tuple(of_all(greatest, [c.high[i] for c in cases]) for i in axes),
        tuple(of_all(greatest, [c.speeds[i] for c in cases]) for i in axes),
        tuple(of_all(greatest, row) for row in tight),
    )


def _first(cases: Sequence[_Case], sign: int) -> _Case:
    """The case of the largest (smallest) value at p itself, by bisection of the list."""
    if len(cases) == 1:
        return cases[0]
    one, other = (_first(half, sign) for half in (cases[::2], cases[1::2]))
    lead = sign * (one.value - other.value)

    def pick(these: Sequence[sp.Expr], those: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
        return tuple(select(lead, a, b) for a, b in zip(these, those, strict=True))

    return replace(
        one,
        value=(greatest if sign > 0 else least)(one.value, other.value),
        chosen={s: select(lead, e, other.chosen[s]) for s, e in one.chosen.items()},
        low=pick(one.low, other.low),
        high=pick(one.high, other.high),
    )


def of_all(pick: Callable[..., sp.Expr], values: Sequence[sp.Expr]) -> sp.Expr:
    """The least or the greatest, by bisection of the list, so that expressions stay shallow."""
    if len(values) == 1:
        return values[0]
    return pick(of_all(pick, values[::2]), of_all(pick, values[1::2]))


def _check_bounded(
    system: System, what: str, members: Sequence[Quantity], bounds: Bounds | None
) -> None:
    owner = f"system '{system.name}'"
    if members and bounds is None:
        raise DefinitionError(
            f"{owner} has no bounds for its {what}s",
            remedy=f"give {what} bounds: a kernel depends on what the {what}s can do",
        )
    if bounds is not None and any(e.is_infinite for e in bounds.ends()):
        raise DefinitionError(
            f"{'an' if what == 'input' else 'a'} {what} of {owner} is unbounded",
            expected="finite bounds",
            remedy=f"give the largest {what}",
        )


@dataclass(frozen=True)
class Player:
    """One player: its quantities with a closed form, their set, whether it maximises or minimises,
    and the sampled quantities of both players."""

    system: System
    what: str
    members: tuple[Quantity, ...]
    bounds: Bounds | None
    side: str
    sampled: frozenset[sp.Symbol]

    @property
    def sign(self) -> int:
        return 1 if self.side == "max" else -1

    def gain(self, rates: sp.Matrix) -> sp.Matrix:
        """d f / d u, refused where it depends on an input or a disturbance that is not sampled."""
        symbols = [q.symbol for q in self.members]
        for symbol in symbols:
            ways = in_the_way(self.system, symbol, set(self.sampled))
            for name, blocking in zip(self.system.state_names, ways, strict=True):
                if blocking:
                    raise DefinitionError(
                        f"the rate of '{name}' is not affine in '{symbol}': its derivative by it "
                        f"depends on '{min(map(str, blocking))}'",
                        expected="rates affine in every input and disturbance, for a closed form",
                        remedy="or take points of their sets in place of it, for example samples=9 "
                        "(of a kernel; for a filter take another input, such as the tangent of a "
                        "steering angle, or its rate, by hf.dynamic_extension)",
                    )
        return rates.jacobian(symbols) if symbols else sp.zeros(len(rates), 0)

    def support(self, weights: sp.Matrix) -> tuple[sp.Expr, dict[sp.Symbol, sp.Expr]]:
        """opt over the set of weights . u, and the point that attains it."""
        if self.bounds is None or not self.members:
            return sp.S.Zero, {}
        value, best = self.bounds.support(list(weights), self.sign)
        return value, dict(zip((q.symbol for q in self.members), best, strict=True))

    def reach(self, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix) -> tuple[list[sp.Expr], ...]:
        """Its contribution to each rate: centre and half-width, for any p and within the spread."""
        if self.bounds is None:
            return ([sp.S.Zero] * gain.rows,) * 4
        return self.bounds.reach(gain, p, spread, self.sign)


def check_symmetry(h: Hamiltonian, regions: Sequence[Region], signs: Mapping[str, int]) -> None:
    """Refuse a reflection (state -> -1, or 1) whose invariance cannot be shown.

    Raises `DefinitionError` that names the rate, the inequality or the players that change.
    """
    system = h.system
    if h.samples:
        raise DefinitionError(
            f"a symmetry of system '{system.name}' with {h.samples} samples cannot be shown",
            remedy="leave out the symmetry",
        )
    for name, sign in signs.items():
        check_name(
            name, system.state_names, DefinitionError, f"symmetry of '{name}', which is not a state"
        )
        if isinstance(sign, bool) or sign not in (-1, 1):
            raise DefinitionError(f"symmetry of '{name}' is {sign!r}", expected="-1 or 1")
    if -1 not in signs.values():
        raise DefinitionError("the symmetry reflects no state", expected="-1 for one at least")
    of = [signs.get(n, 1) for n in system.state_names]
    states = {q.symbol: s * q.symbol for q, s in zip(system.states, of, strict=True)}
    costates = {p: s * p for p, s in zip(h.costates, of, strict=True)}
    still = {q.symbol: sp.S.Zero for q in (*system.inputs, *system.disturbances)}
    drift = [r.xreplace(still) for r in system.rates.values()]
    for name, sign, rate in zip(system.state_names, of, drift, strict=True):
        if not _same(rate.xreplace(states), sign * rate):
            raise _broken(f"the rate of '{name}'")
    steered = h.value - sum((p * f for p, f in zip(h.costates, drift, strict=True)), sp.S.Zero)
    if not _same(steered.xreplace(states | costates), steered):
        raise _broken("the effect of inputs and disturbances")
    for region in regions:
        every = [c.expression for c in region.inequalities]
        for c in region.inequalities:
            if not _same(c.expression.xreplace(states), *every):
                raise _broken(f"inequality '{c.name}' of region '{region.name}'")


def _broken(what: str) -> DefinitionError:
    return DefinitionError(
        f"{what} is not the same after the reflection, or it cannot be shown",
        remedy="reflect the states that belong together, or leave the symmetry out",
    )


def _same(one: sp.Expr, *others: sp.Expr) -> bool:
    """Whether it equals one of the others."""
    gaps = [sp.expand(sp.expand(one) - sp.expand(other)) for other in others]
    return any(gap == 0 for gap in gaps) or any(sp.simplify(gap) == 0 for gap in gaps)


MOST_PAIRS = 16
"""Most pairs of points of both sets that are compared at a sampled point, on axes that go
together."""

BETWEEN = 3
"""Points along every coordinate of a set, where these are not too many; else its corners."""

MOST_POINTS = 36
"""The same where points stand for a set without corners."""

Corners = list[tuple[sp.Expr, ...]]
Rates = list[sp.Matrix]


def monotone_flux(
    h: Hamiltonian, gaps: Sequence[sp.Symbol], *, over_points: bool = True
) -> sp.Expr:
    """H_M in terms of the costates of `h`, which stand for the mean slopes, and half gaps.

    over_points: whether a player without corners also has what points of its set get. At some of
    these the rates vanish where it cancels the drift, so that a ridge there does not wear. A march
    without another beside it leaves them out: where V jumps they make a set two cells too large.
    """
    game = game_of(h)
    blocks = list(_blocks(game))

    def case(u: Point, d: Point) -> sp.Expr:
        drift, gains = game.at(u | d)
        return sp.Add(*(block.flux(h, gaps, drift, gains, over_points) for block in blocks))

    picks = [greatest if side == "max" else least for side in h.sides]
    answers = [of_all(picks[1], [case(u, d) for d in game.points[1]]) for u in game.points[0]]
    return of_all(picks[0], answers)


def is_sharp(h: Hamiltonian) -> bool:
    """Whether H_M, without points, smears a value no more than the speeds between the slopes at a
    node ask for.

    The rate wears ridges where inputs without corners move several axes, and where disturbances
    without corners do that are no ellipsoid along them.
    """
    game = game_of(h)
    return not any(len(b.axes) > 1 and b.is_worn(game.gains) for b in _blocks(game))


@dataclass(frozen=True)
class _Block:
    """Axes, and of each player the members that act on them and on no others.

    columns: their places among all members. corners: those that are compared; None for a support
    function.
    """

    axes: tuple[int, ...]
    players: tuple[Player, ...]
    columns: tuple[tuple[int, ...], ...]
    corners: tuple[Corners | None, ...]

    def flux(
        self,
        h: Hamiltonian,
        gaps: Sequence[sp.Symbol],
        drift: sp.Matrix,
        gains: Sequence[sp.Matrix],
        over_points: bool,
    ) -> sp.Expr:
        """Its terms of H_M, from the rates without players and how these change them."""
        axes, count = list(self.axes), len(self.axes)
        p = sp.Matrix([h.costates[i] for i in axes])
        g = [gaps[i] for i in axes]
        drift_alone, smooth = drift.extract(axes, [0]), sp.S.Zero
        still, wide = drift_alone, [sp.S.Zero] * count
        by_players = []
        for k, player in enumerate(self.players):
            gain, corners = self._gain(k, gains), self.corners[k]
            if corners is not None or not player.members:
                by_players.append(self._moved(k, gains, corners or []))
                continue
            half_axes = player.bounds.half_axes(gain) if player.bounds else None
            if half_axes is not None:
                smooth += player.sign * _length(
                    r * greatest(magnitude(slope) + player.sign * gap, sp.S.Zero)
                    for r, slope, gap in zip(half_axes, p, g, strict=True)
                )
            else:
                centre, width, _, _ = player.reach(gain, p, sp.zeros(count, 1))
                smooth += player.support(gain.T * p)[0] - (p.T * sp.Matrix(centre))[0]
                still = still + sp.Matrix(centre)
                wide = [a + b for a, b in zip(wide, width, strict=True)]
            by_players.append([sp.zeros(count, 1)])
        picks = [greatest if side == "max" else least for side in h.sides]

        def change(rates: sp.Matrix, wide: Sequence[sp.Expr]) -> sp.Expr:
            terms = zip(rates, wide, p, g, strict=True)
            return sp.Add(*(f * slope + (magnitude(f) + w) * gap for f, w, slope, gap in terms))

        def best(rates: Sequence[Rates], still: sp.Matrix, wide: Sequence[sp.Expr]) -> sp.Expr:
            answers = [[change(still + a + b, wide) for b in rates[1]] for a in rates[0]]
            return of_all(picks[0], [of_all(picks[1], row) for row in answers])

        flux = smooth + best(by_players, still, wide)
        if over_points and (at_points := self.rates_at_points(gains)) is not None:
            k, rates = at_points
            flux = picks[k](flux, best(rates, drift_alone, [sp.S.Zero] * count))
        return flux

    def rates_at_points(self, gains: Sequence[sp.Matrix]) -> tuple[int, list[Rates]] | None:
        """The place of a player without corners, and the rates of both at points of its set and at
        the corners of the other's: of inputs, and of disturbances alone.

        Points of a set get no more than the set, so that the better of both is H for g = 0. Inputs
        at corners alone would wear a ridge, so that disturbances have no points beside them.
        """
        rounded = self._without_corners()
        together = all(player.members for player in self.players)
        if not rounded or (together and rounded != [0]):
            return None
        k = rounded[0]
        chosen: list[Corners] = [[], []]
        chosen[k] = self._bounds(k).points(BETWEEN)
        if together:
            chosen[1] = self._bounds(1).corners()
        if len(chosen[k]) * max(len(chosen[1 - k]), 1) > MOST_POINTS:
            return None
        return k, [self._moved(j, gains, c) for j, c in enumerate(chosen)]

    def is_worn(self, gains: Sequence[sp.Matrix]) -> bool:
        """Whether the dissipation of a set without corners is larger than it needs to be: inputs
        cancel drift and disturbances, which then have dissipations of their own."""
        return any(
            k == 0
            or not self.players[0].members
            or self._bounds(k).half_axes(self._gain(k, gains)) is None
            for k in self._without_corners()
        )

    def _without_corners(self) -> list[int]:
        return [k for k, q in enumerate(self.players) if q.members and self.corners[k] is None]

    def _bounds(self, k: int) -> Bounds:
        bounds = self.players[k].bounds
        assert bounds is not None  # of a player that has members
        return bounds

    def _moved(self, k: int, gains: Sequence[sp.Matrix], points: Corners) -> Rates:
        """What a player does to the rates at points of its set; nothing if there are none."""
        gain = self._gain(k, gains)
        return [gain * sp.Matrix(c) for c in points] or [sp.zeros(len(self.axes), 1)]

    def _gain(self, k: int, gains: Sequence[sp.Matrix]) -> sp.Matrix:
        return gains[k].extract(list(self.axes), list(self.columns[k]))


def _length(components: Iterable[sp.Expr]) -> sp.Expr:
    return sp.sqrt(sp.Add(*(e**2 for e in components)))


def _blocks(game: Game) -> Iterator[_Block]:
    """The axes in as many blocks as there are that no free group of members acts on jointly."""
    block_of = list(range(len(game.still)))
    groups: list[list[Sequence[int]]] = []
    for player, gain in zip(game.players, game.gains, strict=True):
        places = range(len(player.members))
        free = player.bounds.groups(places) if player.bounds and player.members else []
        groups.append(free)
        for group in groups[-1]:
            joint = {b for i, b in enumerate(block_of) if any(gain[i, j] != 0 for j in group)}
            block_of = [min(joint) if b in joint else b for b in block_of]
    for block in sorted(set(block_of)):
        axes = tuple(i for i, b in enumerate(block_of) if b == block)
        players, columns = [], []
        for player, gain, free in zip(game.players, game.gains, groups, strict=True):
            acts = [g for g in free if any(gain[i, j] != 0 for i in axes for j in g)]
            mine = [j for group in acts for j in group]
            acting = [j in mine for j in range(len(player.members))]
            members = tuple(q for q, k in zip(player.members, acting, strict=True) if k)
            columns.append(tuple(j for j, k in enumerate(acting) if k))
            players.append(replace(player, members=members, bounds=section(player.bounds, acting)))
        yield _Block(axes, tuple(players), tuple(columns), _corners(players))


def _corners(players: Sequence[Player]) -> tuple[Corners | None, ...]:
    """Of each player the points that are compared, its corners among them; or None."""
    corners: list[Corners | None] = []
    for player in players:
        try:
            corners.append(player.bounds.corners() if player.bounds and player.members else None)
        except DefinitionError:  # it has none
            corners.append(None)
    more = [
        player.bounds.points(BETWEEN) if some and player.bounds else some
        for player, some in zip(players, corners, strict=True)
    ]
    for points in (more, corners):
        counts = [len(p) if p else 1 for p in points]
        if counts[0] * counts[1] <= MOST_PAIRS:
            return tuple(points)
    while counts[0] * counts[1] > MOST_PAIRS:
        k = 0 if counts[0] > counts[1] else 1
        corners[k], counts[k] = None, 1
    return tuple(corners)
