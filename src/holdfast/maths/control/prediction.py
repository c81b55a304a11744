"""The state in which an input acts, from a measurement that is late and the inputs since sent.

A measurement that is D old was taken when the last k = ceil(D / T) inputs had not all acted. With
u_1 the last of them, held for T each, the state now is, without a disturbance,

    z = F(h_1, u_1) o ... o F(h_k, u_k) (q),   h_1 = ... = h_(k-1) = T,   h_k = D - (k - 1) T

where F(h, u) is the motion with u held for h. Before the first sample no input
was sent: the spans h are remembered with the inputs, and are 0 of those that are not there. This is
the Smith predictor in its form for states (Z. Artstein, IEEE Trans. Automat. Control 27, 1982),
with held inputs.

It is a polynomial in the inputs. With rates f(q, u, d) and a hold T it is, by Taylor's
theorem,

    q + T f + T^2/2 (df/dq) f + T^3/6 (d/dq ((df/dq) f)) f + ...

cut off after a power of T. f is affine in u and d, so that the part of T^2 is quadratic in them;
what is of a higher degree, or a product of an input and a disturbance, is left out. How much that
is, whoever uses it measures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.switching import Memory, Switching, as_switching, joined
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import least

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


MOST_SENT = 20
"""Inputs that are remembered, at most."""

MOST_OPERATIONS = 4000
"""Operations of a predicted state, at most."""


def span(samples_ago: int) -> str:
    """The time for which an input counts that was sent so many samples ago."""
    return f"span_{samples_ago}"


def sent(samples_ago: int, name: str) -> str:
    """What is remembered of an input that was sent so many samples ago."""
    return f"sent_{samples_ago}_{name}"


@dataclass(frozen=True)
class Prediction:
    """delay: in seconds. places: each state at the time at which the input acts, in terms of the
    measured states and the memory, whose quantities are the spans and then the inputs, each from
    the last one to the first."""

    delay: float
    places: Mapping[sp.Symbol, sp.Expr]
    memory: Memory

    def remembered(self, law: Law | Switching) -> Switching:
        """A law that reads the memory, with it."""
        modes = as_switching(law)
        return replace(modes, memory=joined(modes.memory, self.memory))


def prediction(system: System, hold: float, delay: float) -> Prediction | None:
    """The prediction over a delay [s] of inputs that are held for `hold` [s].

    None where more than `MOST_SENT` inputs are on their way, or the expressions are too long.
    `DefinitionError` where the system has a name of what is remembered.
    """
    count = math.ceil(delay / hold - 1e-9)
    if not 0 < count <= MOST_SENT:
        return None
    oldest = delay - (count - 1) * hold
    spans = [Quantity(span(k), "s", f"for which input {k} counts") for k in range(1, count + 1)]
    past = [
        [Quantity(sent(k, q.name), q.unit, f"{q.name}, {k} samples ago") for q in system.inputs]
        for k in range(1, count + 1)
    ]
    flow = _short(system)
    places: dict[sp.Symbol, sp.Expr] = {q.symbol: q.symbol for q in system.states}
    for length, row in zip(reversed(spans), reversed(past), strict=True):
        acting = {u.symbol: q.symbol for u, q in zip(system.inputs, row, strict=True)}
        there = {**places, **acting, HELD: length.symbol}
        places = {q.symbol: e.xreplace(there) for q, e in zip(system.states, flow, strict=True)}
        if sum(int(sp.count_ops(e)) for e in places.values()) > MOST_OPERATIONS:
            return None
    following: dict[str, sp.Expr] = {}
    for k in range(count):
        ahead = sp.Float(hold) if k == 0 else spans[k - 1].symbol
        following[spans[k].name] = ahead if k < count - 1 else least(ahead, sp.Float(oldest))
        before: Sequence[Quantity] = system.inputs if k == 0 else past[k - 1]
        following |= {q.name: b.symbol for q, b in zip(past[k], before, strict=True)}
    quantities = (*spans, *(q for row in past for q in row))
    named = {q.name for q in (*system.states, *system.parameters, *system.disturbances)}
    for name in sorted(named & {q.name for q in quantities}):
        raise DefinitionError(
            f"system '{system.name}' has a '{name}', as has what a filter remembers of its inputs",
            remedy="give it another name, or leave out the delay",
        )
    initial = dict.fromkeys((q.name for q in quantities), sp.S.Zero)
    return Prediction(delay, places, Memory(quantities, initial, following, (), system.inputs))


HELD = sp.Symbol("_held", real=True)


def _short(system: System) -> list[sp.Expr]:
    """The motion without a disturbance for `HELD`, in which each state stands as rarely as it can:
    what is put in its place is as long as the steps before it."""
    states = [q.symbol for q in system.states]
    calm = {d.symbol: sp.S.Zero for d in system.disturbances}
    return [
        min(e, sp.collect(sp.expand(e), states), key=lambda f: sum(f.count(s) for s in states))
        for e in held_flow(system, HELD).xreplace(calm)
    ]


def check_not_predicted(law: Switching, what: str) -> None:
    """Refuse a law that predicts the state, which something else would have to know."""
    names = {q.name for q in law.memory.quantities} if law.memory else set()
    if span(1) in names:
        raise DefinitionError(
            f"{what} of a law that predicts the state over a delay",
            expected="a law whose margin allows for the delay",
            remedy="take hf.SafetyFilter(..., states=..., delay=...)",
        )
