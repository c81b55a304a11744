"""State and disturbance observer (output feedback) for a law that measures some states only.

Measured y, other states s, disturbances d; with e = y - yh (angles wrapped) and bandwidth w,

    yh' = f_y(y, sh, dh, u) + 2 w e
    sh' = f_s(y, sh, dh, u) + w^2 c_s^T e / |c_s0|^2        c_s = d f_y / d s
    dh' =                     w^2 c_d^T e / |c_d0|^2        c_d = d f_y / d d

one Euler step each control sample; c_s0 is c_s with states, inputs and disturbances 0, so that the
bandwidth is one of any unit (where c_s0 is 0 the unit counts, and the division is left out). The
injections are those of the passive observers of marine craft (T. I. Fossen, J. P. Strand,
Automatica 35, 1999), derived for any system: where the c are constant, the estimation error's
energy |y - yh|^2 w^2 + |c_s0|^2 |s - sh|^2 + |c_d0|^2 |d - dh|^2 falls except for the effect of
f_s. Without noise and with the right model a constant disturbance is found; dh is kept within its
known bounds. w times the sample time has to be below 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.control.prediction import check_not_predicted
from holdfast.maths.definitions.law import Law, Safeguard
from holdfast.maths.definitions.quantity import (
    SAMPLE_TIME,
    TIME,
    Parameter,
    Quantity,
    symbol,
)
from holdfast.maths.definitions.switching import Memory, Switching, Transition, as_switching, joined
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, wrap

TINY = sp.Float(1e-300)
"""Where a parameter makes a slope 0, its correction is 0."""


@checked
def observe(
    system: System,
    law: Law | Switching,
    *,
    measured: Sequence[str] | None = None,
    bandwidth: float = 2.0,
) -> Switching:
    """`law` with measurements of the `measured` states only; estimates replace all else it reads.

    measured: names of states, by default all of them: then only the disturbances are estimated.
    bandwidth: w in 1/s, above 0. The estimate of a state s is the remembered quantity s_hat; the
    unmeasured states and the disturbances start at 0.

    Raises `DefinitionError` for unknown names, a law that already has a memory, a time-varying
    system, or a quantity that the law reads and that moves none of the measured states.
    """
    names = tuple(system.state_names if measured is None else measured)
    for name in names:
        if name not in system.state_names:
            raise DefinitionError(
                f"'{name}' is not a state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    if isinstance(bandwidth, bool) or not 0 < bandwidth < math.inf:
        raise DefinitionError(f"the observer's bandwidth is {bandwidth!r}", expected="above 0")
    switching = as_switching(law)
    if switching.memory is not None and switching.memory.reads:
        raise DefinitionError(f"law '{law.name}' already has a memory of what it measures")
    if any(rate.has(TIME) for rate in system.rates.values()):
        raise DefinitionError(f"the rates of system '{system.name}' depend on time")
    seen = [q for q in system.states if q.name in names]
    hidden = [q for q in system.states if q.name not in names]
    unknown = [*hidden, *system.disturbances]
    felt = [y for y in seen if system.rates[y.name].free_symbols & {q.symbol for q in unknown}]
    slopes = {q.name: [system.rates[y.name].diff(q.symbol) for y in felt] for q in unknown}
    for q in unknown:
        if q in switching.reads and not any(slopes[q.name]):
            raise DefinitionError(
                f"'{q.name}' moves none of the measured states directly, so it is not estimated",
                expected="measured states whose rates contain it",
            )
    kept = [Quantity(f"{q.name}_hat", q.unit, f"estimate of {q.name}") for q in (*felt, *unknown)]
    hat = {q.symbol: symbol(f"{q.name}_hat") for q in (*felt, *unknown)}
    guess = {q.symbol: hat[q.symbol] for q in unknown}
    w = symbol("observer_bandwidth")
    errors = [y.symbol - hat[y.symbol] for y in felt]
    errors = [wrap(e) if y.angle else e for e, y in zip(errors, felt, strict=True)]
    following = {}
    moving = {q.symbol for q in (*system.states, *system.inputs, *system.disturbances)}
    for q in (*felt, *unknown):
        rate = system.rates.get(q.name, sp.S.Zero)
        inject = (
            2 * w * errors[felt.index(q)]
            if q in felt
            else w**2 * along(slopes[q.name], errors, moving)
        )
        change = rate.xreplace(guess) + inject.xreplace(guess)
        following[f"{q.name}_hat"] = hat[q.symbol] + SAMPLE_TIME * change
    if system.disturbance_bounds is not None:
        d_names = [f"{n}_hat" for n in system.disturbance_names]
        within = system.disturbance_bounds.saturate([following[n] for n in d_names])
        following |= dict(zip(d_names, within, strict=True))
    memory = Memory(
        quantities=tuple(kept),
        initial={
            k.name: q.symbol if q in felt else sp.S.Zero
            for k, q in zip(kept, (*felt, *unknown), strict=True)
        },
        following=following,
        reads=tuple(seen),
        inputs=system.inputs,
        parameters=(
            *system.parameters,
            Parameter(
                "observer_bandwidth", "1/s", "of the observer", value=float(bandwidth), above=0
            ),
        ),
    )
    estimated = tuple(kept[len(felt) :])

    return told_by(switching, guess, estimated, memory)


def told_by(
    switching: Switching,
    guess: Mapping[sp.Symbol, sp.Expr],
    estimated: Sequence[Quantity],
    memory: Memory,
    guarded: Callable[[Safeguard], Safeguard] = lambda guard: guard,
    parameters: tuple[Parameter, ...] = (),
) -> Switching:
    """The law with estimates in place of what it does not measure.

    guess: expressions of the estimated quantities of `memory`, by what they replace. guarded,
    parameters: what a safeguard becomes before it is told the estimates, and its new parameters.
    """

    check_not_predicted(switching, "an observer")

    def told(mode: Law) -> Law:
        reads = [q for q in mode.reads if q.symbol not in guess]
        guard = mode.safeguard
        return replace(
            mode,
            reads=(*reads, *estimated),
            outputs={n: e.xreplace(guess) for n, e in mode.outputs.items()},
            signals={n: e.xreplace(guess) for n, e in mode.signals.items()},
            parameters=(*mode.parameters, *parameters) if guard else mode.parameters,
            believed={},
            safeguard=guarded(guard).subs(guess) if guard else None,
            lookup=mode.lookup.subs(guess) if mode.lookup else None,
        )

    return replace(
        switching,
        name=f"{switching.name}, observed",
        modes={name: told(mode) for name, mode in switching.modes.items()},
        transitions=tuple(
            Transition(t.source, t.target, t.when.xreplace(guess)) for t in switching.transitions
        ),
        signals={n: e.xreplace(guess) for n, e in switching.signals.items()},
        memory=joined(switching.memory, memory),
    )


def along(slopes: list[sp.Expr], errors: list[sp.Expr], moving: set[sp.Symbol]) -> sp.Expr:
    """c^T e / |c_0|^2, where c_0 is c at zero; c^T e where that vanishes or does not exist."""
    error = sp.Add(*(c * e for c, e in zip(slopes, errors, strict=True)))
    still = dict.fromkeys(moving, sp.S.Zero)
    size = sp.Add(*(c.xreplace(still) ** 2 for c in slopes))
    if size == 0 or size.has(sp.nan, sp.zoo, sp.oo):
        return error
    return error / greatest(size, TINY)
