"""The state in which an input acts, from a measurement that is late and the inputs since sent.

A measurement that is D old was taken when the last k = ceil(D / T) inputs had not all acted. With
u_1 the last of them, held for T each, the state now is, without a disturbance,

    z = F(h_1, u_1) o ... o F(h_k, u_k) (q),   h_1 = ... = h_(k-1) = T,   h_k = D - (k - 1) T

where F(h, u) is the motion with u held for h (`held_motion.py`). Before the first sample no input
was sent: the spans h are remembered with the inputs, and are 0 of those that are not there. This is
the Smith predictor in its form for states (Z. Artstein, IEEE Trans. Automat. Control 27, 1982),
with held inputs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.control.held_motion import held_flow
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.memory import Memory, joined
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.switching import Switching, as_switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import least

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
