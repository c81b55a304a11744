"""The state in which an input acts, from a measurement that is late and the inputs since sent.

A measurement that is D old was taken when the last k = ceil(D / T) inputs had not all acted. With
u_1 the last of them, held for T each, the state now is, without a disturbance,

    z = F(h_1, u_1) o ... o F(h_k, u_k) (q),   h_1 = ... = h_(k-1) = T,   h_k = D - (k - 1) T

where F(h, u) is the motion with u held for h (`held_motion.py`). Before the first sample no input
was sent: at sample j only j of them count. This is the Smith predictor in its form for states
(Z. Artstein, IEEE Trans. Automat. Control 27, 1982), with held inputs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import sympy as sp

from holdfast.maths.control.held_motion import held_flow
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.memory import Memory, joined
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.switching import Switching, as_switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import clip, least

SAMPLES = "samples_since_start"

MOST_SENT = 20
"""Inputs that are remembered, at most."""

MOST_OPERATIONS = 4000
"""Operations of a predicted state, at most."""


def sent(samples_ago: int, name: str) -> str:
    """What is remembered of an input that was sent so many samples ago."""
    return f"sent_{samples_ago}_{name}"


@dataclass(frozen=True)
class Prediction:
    """delay: in seconds. places: each state at the time at which the input acts, in terms of the
    measured states and the memory."""

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
    """
    count = math.ceil(delay / hold - 1e-9)
    if not 0 < count <= MOST_SENT:
        return None
    samples = Quantity(SAMPLES, "1", "samples since the first, as far as they count")
    past = [
        [Quantity(sent(k, q.name), q.unit, f"{q.name}, {k} samples ago") for q in system.inputs]
        for k in range(1, count + 1)
    ]
    places: dict[sp.Symbol, sp.Expr] = {q.symbol: q.symbol for q in system.states}
    for k in range(count, 0, -1):
        length = hold if k < count else delay - (count - 1) * hold
        held = sp.Float(length) * clip(samples.symbol - (k - 1), sp.S.Zero, sp.S.One)
        acting = dict(zip((q.symbol for q in system.inputs), past[k - 1], strict=True))
        there = {**places, **{u: q.symbol for u, q in acting.items()}}
        flow = held_flow(system, held).xreplace({d.symbol: sp.S.Zero for d in system.disturbances})
        places = {q.symbol: e.xreplace(there) for q, e in zip(system.states, flow, strict=True)}
        if sum(int(sp.count_ops(e)) for e in places.values()) > MOST_OPERATIONS:
            return None
    following = {samples.name: least(samples.symbol + 1, sp.Integer(count))}
    for k, row in enumerate(past):
        before = system.inputs if k == 0 else past[k - 1]
        following |= {q.name: b.symbol for q, b in zip(row, before, strict=True)}
    quantities = (samples, *(q for row in past for q in row))
    initial = dict.fromkeys((q.name for q in quantities), sp.S.Zero)
    return Prediction(delay, places, Memory(quantities, initial, following, (), system.inputs))
