"""The monotone numerical Hamiltonian of a system: that of first order, for one-sided slopes.

With the mean p of the slopes at both sides of a node, and half their difference g,

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

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import Bounds, section
from holdfast.maths.expressions.functions import greatest, least, magnitude
from holdfast.maths.games.hamiltonian import Game, Hamiltonian, Player, Point, game_of, of_all

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
            mine = [j for group in free for j in group if _acts(gain, group, axes)]
            kept = [j in mine for j in range(len(player.members))]
            members = tuple(q for q, k in zip(player.members, kept, strict=True) if k)
            columns.append(tuple(j for j, k in enumerate(kept) if k))
            players.append(replace(player, members=members, bounds=section(player.bounds, kept)))
        yield _Block(axes, tuple(players), tuple(columns), _corners(players))


def _acts(gain: sp.Matrix, group: Sequence[int], axes: Sequence[int]) -> bool:
    return any(gain[i, j] != 0 for i in axes for j in group)


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
