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

A set-membership observer has guaranteed intervals of a disturbance, and a safety filter for them.

Measured y with |error| <= n, other states s, a disturbance d within known bounds, constant, and
f_y = g(y, s) + C d, where each d_i moves one measured state alone, C_i its constant coefficient.
The other states follow their own model, which d does not enter, corrected by measured states
that d does not move (e = y - yh, bandwidth w; the injections of `observe`),

    sh' = f_s(y, sh, u) + w^2 c_s^T e / |c_s0|^2,   sh(0) = 0,   |s - sh| <= b

with the stated bound b of each state, so that what the model does not explain of a measured state
since t = 0 is the disturbance:

    y(t) - y(0) - int g(y, sh) dt  =  C d t  +- E(t)
    E(t) = 2 n + int (|dg/dy| n + |dg/ds| b) dt

    d in  [low, high]  <-  [low, high]  n  [(y - y(0) - int g - E) / C t, (... + E) / C t]

Each sample intersects the interval with what it had: it never grows, and begins with the known
bounds. Where nothing is left the bounds or the model were wrong, or the disturbance has changed:
then it begins anew. The integrals are of second order in the sample time (midpoint rule); their
error, that of the stated bounds, and slow drifts belong into n and b. This is interval set-
membership estimation (L. Jaulin et al., Applied Interval Analysis, 2001) for what enters linearly.

Where d may change, at most by rho in a second, what is unexplained is its mean over a window that
began at t - T, and the end of the window is at most rho T / 2 from the mean. A set that was true
grows by rho with time, and is intersected with

    d(t) in  (y(t) - y(t - T) - int g +- E) / C T  +-  rho T / 2

A window ends at T = sqrt(4 n / (|C| rho)), where 2 n / (|C| T) + rho T / 2 is least, and the next
one begins: the half width of the set is then at most 2 sqrt(n rho / |C|) and what the model leaves
open, in the next window at most 1.42 times the first part. rho is that of what the vehicle feels:
|dd/dt| + |dd/dx| times its speed over ground, where d is a field. The model's states s are
velocities through the water, whose rates must not depend on how the water accelerates.

A condition of a safety filter  normal . u <= offset(q, d)  then counts the worst of the whole set,

    offset - sum_i |d offset/d z_i| h_i - 1/2 sum_ij |d2 offset/d z_i d z_j| h_i h_j,   z = (s, d)

with half widths h: the support function of the box, and the most that a quadratic rest can add.

The memory of it, from sample to sample, are the intervals and the integrals.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated

import sympy as sp

from holdfast.arguments import OfStates, UnitsOf, checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.control.prediction import check_not_predicted
from holdfast.maths.control.safety_filter import over_time
from holdfast.maths.definitions.law import Foresight, Law, Safeguard
from holdfast.maths.definitions.quantity import (
    SAMPLE_TIME,
    TIME,
    Parameter,
    Quantity,
    symbol,
)
from holdfast.maths.definitions.switching import Memory, Switching, Transition, as_switching, joined
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, least, magnitude, select, wrap
from holdfast.maths.expressions.traversal import exchanged

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

    >>> seen = hf.observe(gusty, brake, measured=["x"], bandwidth=5.0)
    >>> hf.simulate(gusty, seen, starts=starts, horizon=8.0, disturbance={"d": 0.1})
    <Result of 2 runs: 2 stayed>
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
    remembered = [
        Quantity(f"{q.name}_hat", q.unit, f"estimate of {q.name}") for q in (*felt, *unknown)
    ]
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
        quantities=tuple(remembered),
        initial={
            k.name: q.symbol if q in felt else sp.S.Zero
            for k, q in zip(remembered, (*felt, *unknown), strict=True)
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
    estimated = tuple(remembered[len(felt) :])

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

    def observed(mode: Law) -> Law:
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
        modes={name: observed(mode) for name, mode in switching.modes.items()},
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


ELAPSED = "learning_time"
ERROR, RATE = "error_", "rate_"
HALF = sp.Rational(1, 2)


def found_from(
    system: System, d: Quantity, seen: Sequence[Quantity], hidden: Sequence[Quantity]
) -> tuple[Quantity, sp.Expr]:
    """The measured state that the disturbance moves, and its coefficient."""
    moved = [q for q in system.states if system.rates[q.name].has(d.symbol)]
    constant = {p.symbol for p in system.parameters}
    others = {q.symbol for q in system.disturbances} - {d.symbol}
    if len(moved) == 1 and moved[0] in seen:
        rate = system.rates[moved[0].name]
        coefficient = rate.diff(d.symbol)
        if coefficient.free_symbols <= constant and not rate.free_symbols & others:
            return moved[0], coefficient
    odd = [q.name for q in moved if q in hidden]
    raise DefinitionError(
        f"'{d.name}' " + (f"moves '{odd[0]}', which is not measured" if odd else
        "does not enter the rate of one measured state alone, with a constant coefficient"),
        expected="a disturbance such as a current in the coordinates of a measured position",
    )  # fmt: skip


def set_memory(
    system: System,
    seen: Sequence[Quantity],
    hidden: Sequence[Quantity],
    felt: Mapping[str, tuple[Quantity, sp.Expr]],
    numbers: Sequence[Parameter],
) -> Memory:
    """The model's values, the unexplained, its doubt and the intervals, from sample to sample.

    numbers: error_NAME of states, rate_NAME of disturbances, and the observer's bandwidth.
    """
    hat = {q.symbol: symbol(f"{q.name}_hat") for q in hidden}
    still = {d.symbol: sp.S.Zero for d in system.disturbances}
    g = {q.name: system.rates[q.name].xreplace(still).xreplace(hat) for q in system.states}
    now = {**{q.symbol: q.symbol for q in seen}, **hat}
    w = symbol("observer_bandwidth")
    half = {
        now[q.symbol]: now[q.symbol] + HALF * SAMPLE_TIME * g[q.name] for q in system.states
    }  # the midpoint of the sample
    middle = {n: e.xreplace(half) for n, e in g.items()}
    remembered: list[Quantity] = []
    initial: dict[str, sp.Expr] = {}
    following: dict[str, sp.Expr] = {}

    def remember(name: str, unit: str, what: str, first: sp.Expr, then: sp.Expr) -> None:
        remembered.append(Quantity(name, unit, what))
        initial[name], following[name] = first, then

    moving = {q.symbol for q in (*system.states, *system.inputs, *system.disturbances)}
    clean = [
        q
        for q in seen
        if system.rates[q.name].free_symbols & set(hat)
        and not system.rates[q.name].free_symbols & set(still)
    ]
    off = [q.symbol - symbol(f"{q.name}_hat") for q in clean]
    off = [wrap(e) if q.angle else e for e, q in zip(off, clean, strict=True)]
    for q, e in zip(clean, off, strict=True):
        value = symbol(f"{q.name}_hat") + SAMPLE_TIME * (middle[q.name] + 2 * w * e)
        remember(f"{q.name}_hat", q.unit, f"estimate of {q.name}", q.symbol, value)
    for q in hidden:
        slopes = [system.rates[y.name].diff(q.symbol) for y in clean]
        correction = w**2 * along(slopes, off, moving).xreplace(hat) if any(slopes) else sp.S.Zero
        value = hat[q.symbol] + SAMPLE_TIME * (middle[q.name] + correction)
        remember(f"{q.name}_hat", q.unit, f"estimate of {q.name}", sp.S.Zero, value)
    bounds = _intervals(system)
    error, rate = (
        {q.name.removeprefix(kind): q.symbol for q in numbers if q.name.startswith(kind)}
        for kind in (ERROR, RATE)
    )
    elapsed = symbol(ELAPSED)
    window = {
        d.name: symbol(f"{d.name}_window") if d.name in rate else elapsed
        for d in system.disturbances
    }
    anew: list[sp.Expr] = []
    within: dict[str, tuple[sp.Expr, sp.Expr]] = {}
    for d in system.disturbances:
        y, coefficient = felt[d.name]
        left = y.symbol - symbol(f"{d.name}_unmoved")
        left = wrap(left) if y.angle else left
        span = window[d.name]
        time = greatest(span, SAMPLE_TIME)  # at t = 0 nothing is learnt: see below
        at, by = left / (coefficient * time), symbol(f"{d.name}_doubt")
        by = by / (magnitude(coefficient) * time)
        if d.name in rate:  # from the mean of the window to its end
            by += HALF * rate[d.name] * time
        learnt = span - HALF * SAMPLE_TIME
        low, high = symbol(f"{d.name}_low"), symbol(f"{d.name}_high")
        least_d = select(learnt, greatest(low, at - by), low)
        most_d = select(learnt, least(high, at + by), high)
        within[d.name] = least_d, most_d
        anew.append(least_d - most_d)
    empty = anew[0]
    for more in anew[1:]:
        empty = greatest(empty, more)
    empty -= sp.Float(1e-12)  # above 0 where a set is empty

    def unless_empty(value: sp.Expr, first: sp.Expr) -> sp.Expr:
        return select(empty, first, value)

    for d in system.disturbances:
        y, coefficient = felt[d.name]
        n = error[y.name]
        doubt = sp.Add(
            *(
                magnitude(g[y.name].diff(now[q.symbol])) * error[q.name]
                for q in system.states
                if q.name in error
            )
        )
        step = SAMPLE_TIME * middle[y.name]
        low, high = within[d.name]
        first_low, first_high = bounds[d.name]
        unmoved, of, span = symbol(f"{d.name}_unmoved"), symbol(f"{d.name}_doubt"), window[d.name]
        low, high = unless_empty(low, first_low), unless_empty(high, first_high)
        if d.name in rate:
            ends = span - sp.sqrt(4 * n / (magnitude(coefficient) * rate[d.name]))
            unmoved, of, span = (
                select(ends, first, then)
                for first, then in ((y.symbol, unmoved), (2 * n, of), (sp.S.Zero, span))
            )
            wider = SAMPLE_TIME * rate[d.name]
            low, high = greatest(first_low, low - wider), least(first_high, high + wider)
        remember(
            f"{d.name}_unmoved", y.unit, f"{y.name} had there been no {d.name}",
            y.symbol, unless_empty(unmoved, y.symbol) + step,
        )  # fmt: skip
        remember(
            f"{d.name}_doubt", y.unit, f"largest error of {y.name} less that",
            2 * n, unless_empty(of, 2 * n) + SAMPLE_TIME * doubt,
        )  # fmt: skip
        remember(f"{d.name}_low", d.unit, f"least possible {d.name}", first_low, low)
        remember(f"{d.name}_high", d.unit, f"largest possible {d.name}", first_high, high)
        if d.name in rate:
            remember(
                f"{d.name}_window", "s", f"time since which {d.name} is found from {y.name}",
                sp.S.Zero, unless_empty(span, sp.S.Zero) + SAMPLE_TIME,
            )  # fmt: skip
    remember(
        ELAPSED, "s", "time for which the set has been learnt",
        sp.S.Zero, unless_empty(elapsed, sp.S.Zero) + SAMPLE_TIME,
    )  # fmt: skip
    return Memory(
        quantities=tuple(remembered),
        initial=initial,
        following=following,
        reads=tuple(seen),
        inputs=system.inputs,
        parameters=(*system.parameters, *numbers),
    )


def _intervals(system: System) -> dict[str, tuple[sp.Expr, sp.Expr]]:
    """The least and the largest value of each disturbance within its bounds."""
    count = len(system.disturbances)
    intervals = {}
    for i, d in enumerate(system.disturbances):
        unit = [sp.S.One if k == i else sp.S.Zero for k in range(count)]
        if system.disturbance_bounds is None:
            raise DefinitionError(f"disturbance '{d.name}' has no bounds to begin with")
        ends = [system.disturbance_bounds.support(unit, sign)[0] for sign in (-1, 1)]
        if any(e.has(sp.oo, -sp.oo, sp.nan) for e in ends):
            raise DefinitionError(f"disturbance '{d.name}' has no finite bounds to begin with")
        intervals[d.name] = ends[0], ends[1]
    return intervals


MOST_UNSURE = 4
"""States within whose widths a look ahead counts every corner."""


@checked
def observe_set(
    system: System,
    law: Law | Switching,
    *,
    measured: Sequence[str] | None = None,
    bandwidth: float = 2.0,
    error_bounds: OfStates,
    rate_bounds: Annotated[Mapping[str, float], UnitsOf("rates")] | None = None,
) -> Switching:
    """`law` with a guaranteed set of the disturbance, which its safety filter counts as a whole.

    The law itself gets the middle of the set, and the model's values of the states that are not
    measured. measured: names of states, by default all. bandwidth: w in 1/s, above 0. error_bounds:
    state -> the largest error of its measurement, or of the model's value of a state that is not
    measured, in its unit; 0 where left out, but above 0 where a disturbance is found from the
    state. rate_bounds: disturbance -> the most by which what the vehicle feels of it changes in a
    second, in its unit per second: with time, and with the place times the speed over ground. One
    that is left out, or 0, is constant.

    The set is as true as these bounds and the model. Memory: NAME_hat of other states, NAME_low and
    NAME_high of every disturbance, and what they are found from.

    Raises `DefinitionError` for unknown names and invalid bounds, a law with a memory of what it
    measures, a time-varying system, a disturbance without finite bounds or that does not enter
    one measured state's rate alone with a constant coefficient, one that moves an unmeasured
    state, and a condition whose normal depends on what is not measured.

    >>> boat = hf.systems.drifting_unicycle()
    >>> ahead = hf.Law("ahead", boat.states, {"v": 0.2, "r": 0})
    >>> seen = {"measured": ["x", "y", "psi"], "bandwidth": 2.0}
    >>> errors = {"x": 0.01, "y": 0.01, "psi": 0.01}
    >>> law = hf.observe_set(boat, ahead, **seen, error_bounds=errors)
    >>> [q.name for q in law.memory.quantities][:4]
    ['Vx_unmoved', 'Vx_doubt', 'Vx_low', 'Vx_high']
    """
    names = tuple(system.state_names if measured is None else measured)
    for name in (*names, *error_bounds):
        if name not in system.state_names:
            raise DefinitionError(
                f"'{name}' is not a state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    rates = dict(rate_bounds or {})
    for name, value in rates.items():
        if name not in system.disturbance_names:
            raise DefinitionError(
                f"rate bound of '{name}', which is not a disturbance of system '{system.name}'",
                remedy=suggestion(name, system.disturbance_names),
            )
        if isinstance(value, bool) or not 0 <= value < math.inf:
            raise DefinitionError(f"rate bound of '{name}' is {value!r}", expected="0 or more")
    for name, value in error_bounds.items():
        if isinstance(value, bool) or not 0 <= value < math.inf:
            raise DefinitionError(f"error bound of '{name}' is {value!r}", expected="0 or more")
    if isinstance(bandwidth, bool) or not 0 < bandwidth < math.inf:
        raise DefinitionError(f"the observer's bandwidth is {bandwidth!r}", expected="above 0")
    switching = as_switching(law)
    if switching.memory is not None and switching.memory.reads:
        raise DefinitionError(f"law '{law.name}' already has a memory of what it measures")
    if any(rate.has(TIME) for rate in system.rates.values()):
        raise DefinitionError(f"the rates of system '{system.name}' depend on time")
    if not system.disturbances:
        raise DefinitionError(f"system '{system.name}' has no disturbance to be found")
    seen = [q for q in system.states if q.name in names]
    hidden = [q for q in system.states if q.name not in names]
    felt = {d.name: found_from(system, d, seen, hidden) for d in system.disturbances}
    for name, (y, _) in felt.items():
        if not error_bounds.get(y.name, 0.0) > 0:
            raise DefinitionError(
                f"'{name}' is found from '{y.name}', whose error bound is 0",
                expected=f"error_bounds: {y.name} above 0; it also covers the sample time",
            )
    parameters = (
        *(
            Parameter(f"{ERROR}{q.name}", q.unit, f"largest error of {q.name}", value=float(b))
            for q in system.states
            if (b := error_bounds.get(q.name, 0.0)) > 0
        ),
        *(
            Parameter(
                f"{RATE}{d.name}",
                over_time(d.unit, 1),
                f"largest rate of {d.name}",
                value=float(b),
            )
            for d in system.disturbances
            if (b := rates.get(d.name, 0.0)) > 0
        ),
        Parameter("observer_bandwidth", "1/s", "of the observer", value=float(bandwidth), above=0),
    )
    memory = set_memory(system, seen, hidden, felt, parameters)
    guess = {q.symbol: symbol(f"{q.name}_hat") for q in hidden}
    width: dict[sp.Symbol, sp.Expr] = {
        q.symbol: symbol(f"{ERROR}{q.name}") for q in hidden if error_bounds.get(q.name, 0.0) > 0
    }
    for d in system.disturbances:
        low, high = symbol(f"{d.name}_low"), symbol(f"{d.name}_high")
        guess[d.symbol], width[d.symbol] = (low + high) / 2, (high - low) / 2
    remembered = {q.symbol: q for q in memory.quantities}
    told_of = [
        remembered[s] for s in remembered if any(s in e.free_symbols for e in guess.values())
    ]

    for mode in switching.modes.values():
        table, guard = mode.lookup, mode.safeguard
        blind = guard is not None and guard.foresight is None
        if table and blind and any(p.has(q.symbol) for p in table.places for q in hidden):
            raise DefinitionError(
                "a kernel's filter that goes by the slope of the value counts no error of "
                f"'{hidden[0].name}', which is not measured",
                remedy="measure it, or let the filter look a sample ahead",
            )
    return told_by(
        switching, guess, told_of, memory, lambda guard: worst_of(guard, width), parameters
    )


def worst_of(guard: Safeguard, width: Mapping[sp.Symbol, sp.Expr]) -> Safeguard:
    """The conditions for the worst of all values within `width` of each symbol.

    Raises `DefinitionError` for a normal that depends on one of them.
    """
    ahead = guard.foresight
    if any(n.free_symbols & set(width) for column in guard.normals.values() for n in column):
        raise DefinitionError(
            "the effect of the inputs on a condition depends on what is not measured",
            remedy="measure the states that it depends on",
        )

    return replace(
        guard,
        offsets=tuple(o - _change(o, width) for o in guard.offsets),
        foresight=ahead and _worst_ahead(ahead, len(guard.normals), width),
    )


def _worst_ahead(ahead: Foresight, inputs: int, width: Mapping[sp.Symbol, sp.Expr]) -> Foresight:
    """The same of a look ahead: where a sample leads from every corner of the widths, too."""
    n = ahead.axes(inputs)
    base, moves = ahead.motion[:n], ahead.motion[len(ahead.motion) - n * ahead.moves :]
    unsure = [s for s in width if any(e.has(s) for e in base)]
    if len(unsure) > MOST_UNSURE:
        raise DefinitionError(
            f"a kernel's filter with {len(unsure)} states that are not measured",
            expected=f"at most {MOST_UNSURE}",
        )
    slopes = sp.Matrix(base).jacobian(unsure) if unsure else sp.zeros(n, 0)
    aside = [
        slopes * sp.Matrix([sign * width[s] for sign, s in zip(signs, unsure, strict=True)])
        for signs in itertools.product((1, -1), repeat=len(unsure))
    ]
    wider = [
        moves[n * r + i] + (e[i] if unsure else 0)
        for r in range(ahead.moves)
        for e in aside
        for i in range(n)
    ]
    return replace(
        ahead,
        motion=(*ahead.motion[: len(ahead.motion) - n * ahead.moves], *wider),
        moves=ahead.moves * len(aside),
    )


def _change(e: sp.Expr, width: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    """The most by which an expression changes within the widths, of the second order.

    The larger of two changes by no more than the one of them that changes most.
    """
    kinks = {k: sp.Dummy(real=True) for k in e.atoms(greatest) if k.free_symbols & set(width)}
    (smooth,) = exchanged([e], kinks)
    beside = {
        d: greatest(*(_change(a, width) for a in k.args)) for k, d in kinks.items() if smooth.has(d)
    }
    widths = {**width, **beside}
    unsure = [s for s in widths if smooth.has(s)]
    slopes = {s: smooth.diff(s) for s in unsure}
    margin = sp.Add(*(magnitude(slopes[s]) * widths[s] for s in unsure))
    for a, b in itertools.product(unsure, repeat=2):
        bend = slopes[a].diff(b)
        if bend != 0:
            margin += HALF * magnitude(bend) * widths[a] * widths[b]
    return margin.xreplace({d: k for k, d in kinks.items()})
