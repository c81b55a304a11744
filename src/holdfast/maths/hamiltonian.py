"""The Hamiltonian of a system: the best input against the worst disturbance, in closed form.

    H(t, q, p) = opt_u  opp_d  p . f(t, q, u, d),   opt, opp each a maximum or a minimum

For rates that are affine in u and d the two separate, H = p . f0 + s_u(G'p) + s_d(D'p), where s
is the support function of the set: sum of |.| for a box, the Euclidean norm for a ball, that of
M' G'p for the image under M. Nothing here is specific to a system (thesis (7.3), (7.6), (7.7)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.bounds import Ball, Bounds, Box, LinearImage, Product
from holdfast.maths.functions import magnitude, select, sgn
from holdfast.maths.quantity import Quantity, frozen
from holdfast.maths.system import System


@dataclass(frozen=True)
class Hamiltonian:
    """H and what follows from it, as expressions of t, the states, `costates` and parameters.

    costates: p_i, one for each state. inputs, disturbances: the optimal ones. speeds: bounds of
    |dH/dp_i| for every p, the dissipation of a local Lax-Friedrichs scheme. tight_speeds: the same
    for p_i within `spreads` (half-widths) of `costates`, of the local-local scheme.
    """

    system: System
    costates: tuple[sp.Symbol, ...]
    spreads: tuple[sp.Symbol, ...]
    value: sp.Expr
    inputs: Mapping[str, sp.Expr]
    disturbances: Mapping[str, sp.Expr]
    speeds: tuple[sp.Expr, ...]
    tight_speeds: tuple[sp.Expr, ...]


def hamiltonian(system: System, *, inputs: str = "max", disturbances: str = "min") -> Hamiltonian:
    """The Hamiltonian of `system` within its bounds; each player a "max" or a "min".

    Raises `DefinitionError` for an input or a disturbance that is unbounded, and for rates that
    are not affine in them, or that multiply one by the other: those have no closed form here.
    """
    for what, side in (("inputs", inputs), ("disturbances", disturbances)):
        if side not in ("max", "min"):
            raise DefinitionError(f"{what}={side!r}", expected='"max" or "min"')
    rates = sp.Matrix(list(system.rates.values()))
    n = len(system.states)
    p = sp.Matrix(sp.symbols(f"_p0:{n}", real=True))
    spread = sp.Matrix(sp.symbols(f"_dp0:{n}", real=True))
    players = (
        _Player(system, "input", system.inputs, system.input_bounds, inputs),
        _Player(
            system, "disturbance", system.disturbances, system.disturbance_bounds, disturbances
        ),
    )
    nothing = {q.symbol: 0 for q in (*system.inputs, *system.disturbances)}
    drift = rates.xreplace(nothing)
    value = (p.T * drift)[0]
    speeds, tight = list(drift), list(drift)
    widths = [sp.S.Zero] * n
    tight_widths = [sp.S.Zero] * n
    chosen = []
    for player in players:
        gain = player.gain(rates)
        support, best = player.support(gain.T * p)
        value += support
        chosen.append(best)
        centre, width, near, narrow = player.reach(gain, p, spread)
        for i in range(n):
            speeds[i] += centre[i]
            widths[i] += width[i]
            tight[i] += near[i]
            tight_widths[i] += narrow[i]
    return Hamiltonian(
        system,
        tuple(p),
        tuple(spread),
        value,
        frozen(chosen[0]),
        frozen(chosen[1]),
        tuple(magnitude(a) + w for a, w in zip(speeds, widths, strict=True)),
        tuple(magnitude(a) + w for a, w in zip(tight, tight_widths, strict=True)),
    )


@dataclass(frozen=True)
class _Player:
    """One side: its quantities, the set they live in, whether it takes the most or the least."""

    system: System
    what: str
    members: tuple[Quantity, ...]
    bounds: Bounds | None
    side: str

    @property
    def sign(self) -> int:
        return 1 if self.side == "max" else -1

    def gain(self, rates: sp.Matrix) -> sp.Matrix:
        """d f / d u, refused where it depends on an input or a disturbance."""
        owner = f"system '{self.system.name}'"
        symbols = [q.symbol for q in self.members]
        if not symbols:
            return sp.zeros(len(rates), 0)
        if self.bounds is None:
            raise DefinitionError(
                f"{owner} has no bounds for its {self.what}s",
                remedy=f"give {self.what} bounds: a kernel depends on what the {self.what}s can do",
            )
        gain = rates.jacobian(symbols)
        moving = {q.symbol for q in (*self.system.inputs, *self.system.disturbances)}
        for name, row in zip(self.system.state_names, gain.tolist(), strict=True):
            for symbol, entry in zip(symbols, row, strict=True):
                if found := entry.free_symbols & moving:
                    raise DefinitionError(
                        f"the rate of '{name}' is not affine in '{symbol}': its derivative by it "
                        f"depends on '{min(map(str, found))}'",
                        expected="rates affine in every input and disturbance, for a closed form",
                    )
        if any(e.is_infinite for e in _ends(self.bounds)):
            raise DefinitionError(f"a {self.what} of {owner} is unbounded")
        return gain

    def support(self, weights: sp.Matrix) -> tuple[sp.Expr, dict[str, sp.Expr]]:
        """opt over the set of weights . u, and where it is attained."""
        if not self.members:
            return sp.S.Zero, {}
        value, best = _support(self.bounds, list(weights), self.sign)
        return value, dict(zip((q.name for q in self.members), best, strict=True))

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
