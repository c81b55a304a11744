"""The monotone numerical Hamiltonian of a system: that of first order, for one-sided slopes.

With the mean p of the slopes at both sides of a node, and half their difference g,

    H_M(p, g) = opt_u opp_d  sum_i  f_i p_i + |f_i| g_i

over the corners of both sets: every pair of them has the differences on the side that it comes
from. It is H for g = 0, does not fall with a slope above nor rise with one below, and changes no
faster than the speeds with either, so that the Euler step with it is monotone (H. J. Kushner,
P. G. Dupuis, Numerical Methods for Stochastic Control Problems in Continuous Time, 1992).

A set without corners, or with too many, has its support function in H, and the largest speed that
it adds in the dissipation (Lax-Friedrichs), which is monotone, too, and smears a ridge more.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import greatest, least, magnitude
from holdfast.maths.games.hamiltonian import Game, Hamiltonian, game_of, of_all
from holdfast.maths.games.sampled_inputs import Point

MOST_PAIRS = 16
"""Most pairs of corners of both sets that are compared at a sampled point."""


def monotone_flux(h: Hamiltonian, gaps: Sequence[sp.Symbol]) -> sp.Expr:
    """H_M in terms of the costates of `h`, which stand for the mean slopes, and half gaps."""
    game = game_of(h)
    corners = _corners(game)

    def best(side: str, values: Sequence[sp.Expr]) -> sp.Expr:
        return of_all(greatest if side == "max" else least, values)

    def case(u: Point, d: Point) -> sp.Expr:
        drift, gains = game.at(u | d)
        still, wide, smooth = drift, [sp.S.Zero] * len(drift), sp.S.Zero
        p = sp.Matrix(h.costates)
        for player, gain, points in zip(game.players, gains, corners, strict=True):
            if points is not None or not player.members:
                continue
            centre, width, _, _ = player.reach(gain, p, sp.zeros(len(drift), 1))
            smooth += player.support(gain.T * p)[0] - (p.T * sp.Matrix(centre))[0]
            still = still + sp.Matrix(centre)
            wide = [a + b for a, b in zip(wide, width, strict=True)]
        moved = [
            [gain * sp.Matrix(c) for c in points] if points else [sp.zeros(len(drift), 1)]
            for gain, points in zip(gains, corners, strict=True)
        ]
        return smooth + best(
            h.sides[0],
            [best(h.sides[1], [carried(still + a + b, wide) for b in moved[1]]) for a in moved[0]],
        )

    def carried(rates: sp.Matrix, wide: Sequence[sp.Expr]) -> sp.Expr:
        return sp.Add(
            *(
                f * p + (magnitude(f) + w) * g
                for f, w, p, g in zip(rates, wide, h.costates, gaps, strict=True)
            )
        )

    answers = [best(h.sides[1], [case(u, d) for d in game.points[1]]) for u in game.points[0]]
    return best(h.sides[0], answers)


def _corners(game: Game) -> list[list[tuple[sp.Expr, ...]] | None]:
    """Of each player the corners that are compared; None for a support function."""
    found: list[list[tuple[sp.Expr, ...]] | None] = []
    for player in game.players:
        try:
            found.append(player.bounds.corners() if player.bounds and player.members else None)
        except DefinitionError:  # it has none
            found.append(None)
    counts = [len(c) if c else 1 for c in found]
    while counts[0] * counts[1] > MOST_PAIRS:
        k = 0 if counts[0] > counts[1] else 1
        found[k], counts[k] = None, 1
    return found
