"""The memory of a set-membership observer: intervals of a disturbance, from sample to sample.

See `set_observer.py` for the equations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.control.observer import along
from holdfast.maths.definitions.memory import Memory
from holdfast.maths.definitions.quantity import SAMPLE_TIME, Parameter, Quantity, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, least, magnitude, select, wrap

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
    kept: list[Quantity] = []
    initial: dict[str, sp.Expr] = {}
    following: dict[str, sp.Expr] = {}

    def remember(name: str, unit: str, what: str, first: sp.Expr, then: sp.Expr) -> None:
        kept.append(Quantity(name, unit, what))
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
        own = window[d.name]
        time = greatest(own, SAMPLE_TIME)  # at t = 0 nothing is learnt: see below
        at, by = left / (coefficient * time), symbol(f"{d.name}_doubt")
        by = by / (magnitude(coefficient) * time)
        if d.name in rate:  # from the mean of the window to its end
            by += HALF * rate[d.name] * time
        learnt = own - HALF * SAMPLE_TIME
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
        unmoved, of, own = symbol(f"{d.name}_unmoved"), symbol(f"{d.name}_doubt"), window[d.name]
        low, high = unless_empty(low, first_low), unless_empty(high, first_high)
        if d.name in rate:
            ends = own - sp.sqrt(4 * n / (magnitude(coefficient) * rate[d.name]))
            unmoved, of, own = (
                select(ends, first, then)
                for first, then in ((y.symbol, unmoved), (2 * n, of), (sp.S.Zero, own))
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
                sp.S.Zero, unless_empty(own, sp.S.Zero) + SAMPLE_TIME,
            )  # fmt: skip
    remember(
        ELAPSED, "s", "time for which the set has been learnt",
        sp.S.Zero, unless_empty(elapsed, sp.S.Zero) + SAMPLE_TIME,
    )  # fmt: skip
    return Memory(
        quantities=tuple(kept),
        initial=initial,
        following=following,
        reads=tuple(seen),
        inputs=system.inputs,
        parameters=(*system.parameters, *numbers),
    )


def _intervals(system: System) -> dict[str, tuple[sp.Expr, sp.Expr]]:
    """The least and the largest value of each disturbance within its bounds."""
    count = len(system.disturbances)
    found = {}
    for i, d in enumerate(system.disturbances):
        unit = [sp.S.One if k == i else sp.S.Zero for k in range(count)]
        if system.disturbance_bounds is None:
            raise DefinitionError(f"disturbance '{d.name}' has no bounds to begin with")
        ends = [system.disturbance_bounds.support(unit, sign)[0] for sign in (-1, 1)]
        if any(e.has(sp.oo, -sp.oo, sp.nan) for e in ends):
            raise DefinitionError(f"disturbance '{d.name}' has no finite bounds to begin with")
        found[d.name] = ends[0], ends[1]
    return found
