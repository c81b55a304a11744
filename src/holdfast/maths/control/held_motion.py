"""The state after inputs were held for a time, as a polynomial in the inputs.

With rates f(q, u, d) and a hold T it is, by Taylor's theorem,

    q + T f + T^2/2 (df/dq) f + T^3/6 (d/dq ((df/dq) f)) f + ...

cut off after a power of T. f is affine in u and d, so that the part of T^2 is quadratic in them;
what is of a higher degree, or a product of an input and a disturbance, is left out. How much that
is, whoever uses it measures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.maths.definitions.system import System

SHORT = 40
"""Operations of all rates up to which the part of T^3 is taken."""


@dataclass(frozen=True)
class HeldMotion:
    """base_i + sum_j (gain_ij + sum_(k >= j) curve_ijk u_k) u_j + move_ri, for state i.

    expressions: these numbers in turn, those of a state after those of another. moves: how many
    disturbances there are; curved: whether there are curves.
    """

    expressions: tuple[sp.Expr, ...]
    moves: int
    curved: bool


def held_flow(system: System, hold: sp.Expr) -> sp.Matrix:
    """The state after `hold`, in terms of the state, the inputs and the disturbances."""
    q = sp.Matrix([s.symbol for s in system.states])
    rates = sp.Matrix(list(system.rates.values()))
    after, part = q + hold * rates, rates
    short = sum(int(sp.count_ops(r)) for r in rates) <= SHORT
    for power in range(2, 4 if short else 3):
        part = part.jacobian(q) * rates
        after += hold**power / sp.factorial(power) * part
    return after


def held_motion(
    system: System,
    hold: sp.Expr,
    disturbances: Sequence[Sequence[sp.Expr]],
    errors: Sequence[Sequence[sp.Expr]] = ((),),
    delay: float = 0.0,
) -> HeldMotion:
    """The motion of a system in which inputs and each of the disturbances are held for `hold`.

    errors: by how much the inputs that act differ from those that are held, with each disturbance.
    delay [s]: the motion of what is predicted so far ahead: what a disturbance has moved is carried
    on through it, sample by sample, for every corner of the inputs on which that depends.
    """
    u = [s.symbol for s in system.inputs]
    d = [s.symbol for s in system.disturbances]
    after = held_flow(system, hold)
    still = dict.fromkeys([*u, *d], sp.S.Zero)
    undisturbed = after.xreplace(dict.fromkeys(d, sp.S.Zero))
    base = after.xreplace(still)
    gains = undisturbed.jacobian(u).xreplace(still)
    curves = [
        [
            (e.diff(a).diff(b) / (2 if a == b else 1)).xreplace(still)
            for j, a in enumerate(u)
            for b in u[j:]
        ]
        for e in undisturbed
    ]
    curved = any(e != 0 for row in curves for e in row)
    drifting = after.xreplace(dict.fromkeys(u, sp.S.Zero))
    moves = [
        onward
        * (
            drifting.xreplace(dict(zip(d, p, strict=True)))
            - base
            + (gains * sp.Matrix(list(e)) if e else sp.zeros(len(base), 1))
        )
        for onward in _onward(system, float(hold), delay if d or any(errors) else 0.0)
        for p in disturbances
        for e in errors
    ]
    return HeldMotion(
        (
            *base,
            *gains,
            *((e for row in curves for e in row) if curved else ()),
            *(e for move in moves for e in move),
        ),
        len(moves),
        curved,
    )


def _onward(system: System, hold: float, delay: float) -> list[sp.Matrix]:
    """What becomes of a small difference of the state in a delay: the slopes of the motion."""
    q = sp.Matrix([s.symbol for s in system.states])
    u = [s.symbol for s in system.inputs]
    calm = dict.fromkeys([d.symbol for d in system.disturbances], sp.S.Zero)
    count = max(math.ceil(delay / hold - 1e-9), 0)
    if not count:
        return [sp.eye(len(q))]
    pieces = [
        held_flow(system, sp.Float(length)).xreplace(calm).jacobian(q)
        for length in (delay - (count - 1) * hold, hold)
    ]
    corners: Sequence[Sequence[sp.Expr]] = [(sp.S.Zero,) * len(u)]
    if system.input_bounds is not None and any(p.free_symbols & set(u) for p in pieces):
        corners = list(system.input_bounds.points(2))
    slopes = []
    for corner in corners:
        oldest, whole = (p.xreplace(dict(zip(u, corner, strict=True))) for p in pieces)
        slopes.append(whole ** (count - 1) * oldest)
    return slopes
