"""The Hamiltonian of a system: the best input against the worst disturbance.

    H(t, q, p) = opt_u  opp_d  p . f(t, q, u, d),   opt, opp each a maximum or a minimum

For rates that are affine in u and d the two separate, H = p . f0 + s_u(G'p) + s_d(D'p), where s
is the support function of the set: sum of |.| for a box, the Euclidean norm for a ball, that of
M' G'p for the image under M. What has no closed form is sampled (`sampled.py`). Nothing here is
specific to a system (thesis (7.3), (7.6), (7.7)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.bounds import Ball, Bounds, Box, LinearImage, Product, section
from holdfast.maths.functions import greatest, least, magnitude, select, sgn
from holdfast.maths.quantity import Quantity, frozen
from holdfast.maths.sampled import (
    Point,
    check_count,
    dependences,
    in_the_way,
    points_of,
    without_closed_form,
)
from holdfast.maths.system import System


@dataclass(frozen=True)
class Hamiltonian:
    """H and what follows from it, as expressions of t, the states, `costates` and parameters.

    costates: p_i, one for each state. inputs, disturbances: the optimal ones. speeds: bounds of
    |dH/dp_i| for every p, the dissipation of a local Lax-Friedrichs scheme. tight_speeds: the same
    for p_i within `spreads` (half-widths) of `costates`, of the local-local scheme. samples: along
    every coordinate of what is sampled, 0 for a closed form. separable: whether no rate mixes
    inputs with disturbances, so that it does not matter who chooses first (the condition of
    R. Isaacs); where it is False, the disturbance answers the input.
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


@checked
def hamiltonian(
    system: System, *, inputs: str = "max", disturbances: str = "min", samples: int | None = None
) -> Hamiltonian:
    """The Hamiltonian of `system` within its bounds; each player a "max" or a "min".

    samples: what has no closed form is replaced by so many points along every coordinate of its
    set (`maths/sampled.py`), the rest keeps its closed form; by default `system.samples`.

    Raises `DefinitionError` for an input or a disturbance that is unbounded; without samples, for
    rates that are not affine in them, or that multiply one by another; and for samples where there
    is a closed form, or that are more points than `sampled.MOST`.
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
            "input and disturbance: there is a closed form",
            remedy="leave out samples",
        )
    players, points = [], []
    for what, members, bounds, side in (
        ("input", system.inputs, system.input_bounds, inputs),
        ("disturbance", system.disturbances, system.disturbance_bounds, disturbances),
    ):
        closed = tuple(q for q in members if q.symbol not in which)
        rest = section(bounds, [q in closed for q in members])
        players.append(_Player(system, what, closed, rest, side, frozenset(which)))
        symbols = [q.symbol for q in members]
        points.append(points_of(bounds, symbols, which, system.samples))
    check_count(*(len(every) for every in points))
    rates = sp.Matrix(list(system.rates.values()))
    gains = [player.gain(rates) for player in players]
    still = rates.xreplace({q.symbol: sp.S.Zero for one in players for q in one.members})

    def case(u: Point, d: Point) -> _Case:
        at = u | d
        drift = still.xreplace(at)
        now = [gain.xreplace(at) for gain in gains]
        sets = zip(players, now, strict=True)
        return _case(list(sets), drift, p, spread, at)

    answers = [_best([case(u, d) for d in points[1]], players[1].sign) for u in points[0]]
    found = _best(answers, players[0].sign)
    return Hamiltonian(
        system,
        tuple(p),
        tuple(spread),
        found.value,
        frozen({q.name: found.chosen[q.symbol] for q in system.inputs}),
        frozen({q.name: found.chosen[q.symbol] for q in system.disturbances}),
        found.speeds,
        found.tight_speeds,
        system.samples if which else 0,
        not any(
            found & {d.symbol for d in system.disturbances}
            for q in system.inputs
            for found in dependences(system, q.symbol)
        ),
    )


@dataclass(frozen=True)
class _Case:
    """H for some points of what is sampled, who chooses what, and the speeds."""

    value: sp.Expr
    chosen: Mapping[sp.Symbol, sp.Expr]
    speeds: tuple[sp.Expr, ...]
    tight_speeds: tuple[sp.Expr, ...]


def _case(
    sets: Sequence[tuple[_Player, sp.Matrix]],
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
        tuple(magnitude(a) + w for a, w in zip(speeds, widths, strict=True)),
        tuple(magnitude(a) + w for a, w in zip(tight, tight_widths, strict=True)),
    )


def _best(cases: Sequence[_Case], sign: int) -> _Case:
    """The case of the most (the least) value, by halves, so that expressions stay shallow."""
    if len(cases) == 1:
        return cases[0]
    one, other = (_best(half, sign) for half in (cases[::2], cases[1::2]))
    lead = sign * (one.value - other.value)
    pick = greatest if sign > 0 else least
    return _Case(
        pick(one.value, other.value),
        {s: select(lead, e, other.chosen[s]) for s, e in one.chosen.items()},
        tuple(greatest(a, b) for a, b in zip(one.speeds, other.speeds, strict=True)),
        tuple(greatest(a, b) for a, b in zip(one.tight_speeds, other.tight_speeds, strict=True)),
    )


def _check_bounded(
    system: System, what: str, members: Sequence[Quantity], bounds: Bounds | None
) -> None:
    owner = f"system '{system.name}'"
    if members and bounds is None:
        raise DefinitionError(
            f"{owner} has no bounds for its {what}s",
            remedy=f"give {what} bounds: a kernel depends on what the {what}s can do",
        )
    if bounds is not None and any(e.is_infinite for e in _ends(bounds)):
        raise DefinitionError(
            f"{'an' if what == 'input' else 'a'} {what} of {owner} is unbounded",
            expected="finite bounds",
            remedy=f"say what the {what} can be at most",
        )


@dataclass(frozen=True)
class _Player:
    """One side: its quantities that have a closed form, the set they live in, whether it takes the
    most or the least, and what is sampled of either side."""

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
            for name, found in zip(self.system.state_names, ways, strict=True):
                if found:
                    raise DefinitionError(
                        f"the rate of '{name}' is not affine in '{symbol}': its derivative by it "
                        f"depends on '{min(map(str, found))}'",
                        expected="rates affine in every input and disturbance, for a closed form",
                        remedy="or take points of their sets in place of it, for example samples=9",
                    )
        return rates.jacobian(symbols) if symbols else sp.zeros(len(rates), 0)

    def support(self, weights: sp.Matrix) -> tuple[sp.Expr, dict[sp.Symbol, sp.Expr]]:
        """opt over the set of weights . u, and where it is attained."""
        if not self.members:
            return sp.S.Zero, {}
        value, best = _support(self.bounds, list(weights), self.sign)
        return value, dict(zip((q.symbol for q in self.members), best, strict=True))

    def reach(self, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix) -> tuple[list[sp.Expr], ...]:
        """What it adds to each rate: centre and half-width, for any p, and for those near."""
        if self.bounds is None:
            return ([sp.S.Zero] * gain.rows,) * 4
        return _reach(self.bounds, gain, p, spread, self.sign)


def _ends(bounds: Bounds) -> tuple[sp.Expr, ...]:
    """What is infinite where the set is not bounded."""
    if isinstance(bounds, Product):
        return tuple(e for part in bounds.parts for e in _ends(part))
    of = bounds.of if isinstance(bounds, LinearImage) else bounds
    if isinstance(of, Ball):
        return (of.radius,)
    assert isinstance(of, Box)
    return (*of.lower, *of.upper)


def _reach(
    bounds: Bounds, gain: sp.Matrix, p: sp.Matrix, spread: sp.Matrix, sign: int
) -> tuple[list[sp.Expr], ...]:
    n = gain.rows
    if isinstance(bounds, Product):
        columns = [gain.col(j) for j in range(gain.cols)]
        found = [
            _reach(part, sp.Matrix.hstack(*mine), p, spread, sign)
            for part, mine in bounds.split(columns)
        ]
        return tuple([sum(e) for e in zip(*same, strict=True)] for same in zip(*found, strict=True))
    if isinstance(bounds, LinearImage):
        return _reach(bounds.of, gain * bounds.matrix, p, spread, sign)
    if isinstance(bounds, Ball):
        width = [bounds.radius * sp.sqrt(sum(e**2 for e in gain.row(i))) for i in range(n)]
        still = [sp.S.Zero] * n
        return still, width, still, width
    assert isinstance(bounds, Box)
    low, high = bounds.lower, bounds.upper
    middle = sp.Matrix([(a + b) / 2 for a, b in zip(low, high, strict=True)])
    half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
    sizes = gain.applyfunc(magnitude)
    weights, ranges = gain.T * p, sizes.T * spread
    # where no p within the spread changes the sign of a weight, that input does not switch
    fixed = [
        select(magnitude(w) - r, sp.S.One, sp.S.Zero) for w, r in zip(weights, ranges, strict=True)
    ]
    held = sp.Matrix([sign * h * f * sgn(w) for h, f, w in zip(half, fixed, weights, strict=True)])
    loose = sp.Matrix([h * (1 - f) for h, f in zip(half, fixed, strict=True)])
    centre = gain * middle
    return (
        list(centre),
        list(sizes * sp.Matrix(half)),
        list(centre + gain * held),
        list(sizes * loose),
    )


def _support(
    bounds: Bounds | None, weights: Sequence[sp.Expr], sign: int
) -> tuple[sp.Expr, list[sp.Expr]]:
    if isinstance(bounds, Product):
        found = [_support(part, mine, sign) for part, mine in bounds.split(list(weights))]
        return sum((v for v, _ in found), start=sp.S.Zero), [e for _, best in found for e in best]
    if isinstance(bounds, LinearImage):
        value, best = _support(bounds.of, list(bounds.matrix.T * sp.Matrix(weights)), sign)
        return value, list(bounds.produce(best))
    if isinstance(bounds, Ball):
        size = sp.sqrt(sum((w**2 for w in weights), start=sp.S.Zero))
        return sign * bounds.radius * size, [
            sign * bounds.radius * w / (size + sp.Float(1e-300)) for w in weights
        ]
    assert isinstance(bounds, Box)
    pairs = list(zip(bounds.lower, bounds.upper, strict=True))
    middle, half = [(a + b) / 2 for a, b in pairs], [(b - a) / 2 for a, b in pairs]
    terms = [m * w + sign * h * magnitude(w) for m, h, w in zip(middle, half, weights, strict=True)]
    best = [m + sign * h * sgn(w) for m, h, w in zip(middle, half, weights, strict=True)]
    return sum(terms, start=sp.S.Zero), best
