"""Intervals that states never leave: why a state may be another part's bounded disturbance.

Rates and inequalities are made affine in some symbols, with a bound of what that leaves out:

    e(z, a, w) = e(z, m, w) + sum_k g_k(z) (a_k - m_k) + rest,   |rest| <= bound

for all z in a box, w in theirs and |a_k - m_k| <= A_k. Where de/da is continuous the bound is

    1/2 sum_kl A_k A_l sup |d^2 e/da_k da_l| + sum_k A_k sup |de/da_k(z, m, w) - g_k(z)|

and where it is not, such as of |a|, all of the change counts as rest: sum_k A_k sup |de/da_k|. The
suprema are those of interval arithmetic over the boxes, with every rounding counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import sympy as sp

from holdfast.analysis.decomposition.decomposition import Part, shown
from holdfast.errors import SimulationError, check_name
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.definitions.region import Inequality
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import angle, length, magnitude, select, sgn, wrap
from holdfast.maths.expressions.random_points import Sampler
from holdfast.maths.expressions.traversal import derivatives, parts
from holdfast.maths.games.hamiltonian import dependences

Interval = tuple[float, float]

UNFOLLOWED = (
    select, sgn, wrap, angle, length, sp.sign, sp.floor, sp.ceiling, sp.Piecewise, sp.Heaviside,
    sp.atan2,
)  # fmt: skip
"""Functions that jump, or whose derivative is guarded: it does not bound what they change by."""


@dataclass(frozen=True)
class Affine:
    """still: e at the middle of the swung symbols; gains: one for each; rest: the bound."""

    still: sp.Expr
    gains: tuple[sp.Expr, ...]
    rest: float


@dataclass
class _Row:
    still: sp.Expr
    gains: list[sp.Expr]
    bounds: list[tuple[float, sp.Expr]] = field(default_factory=list)


def affine_in(
    rows: Mapping[str, sp.Expr],
    swung: Mapping[sp.Symbol, Interval],
    free: Mapping[sp.Symbol, Interval],
    box: Mapping[sp.Symbol, Interval],
) -> dict[str, Affine]:
    """The rows, affine in the `swung` symbols.

    free: symbols that stay as they are and do not enter the gains, with their intervals; box: the
    others. Raises `SimulationError` for a function of a swung symbol that jumps or whose
    derivative is guarded, and where no bound is found.
    """
    middle = {s: sp.Float((a + b) / 2) for s, (a, b) in swung.items()}
    half = {s: (b - a) / 2 for s, (a, b) in swung.items()}
    made = {n: _row(n, e, middle, half, dict.fromkeys(free, sp.S.Zero)) for n, e in rows.items()}
    asked = [e for row in made.values() for _, e in row.bounds]
    sizes = iter(_largest(asked, {**box, **free, **swung}))
    affine = {}
    for n, row in made.items():
        rest = math.fsum(weight * next(sizes) for weight, _ in row.bounds)
        if not math.isfinite(rest):
            raise SimulationError(
                f"nothing bounds what '{n}' changes by with {', '.join(map(str, swung))}",
                expected="rates that are finite over the box",
                remedy="take a smaller box",
            )
        affine[n] = Affine(row.still, tuple(row.gains), rest * (1 + 1e-12))
    return affine


def _row(
    name: str,
    e: sp.Expr,
    middle: Mapping[sp.Symbol, sp.Expr],
    half: Mapping[sp.Symbol, float],
    still: Mapping[sp.Symbol, sp.Expr],
) -> _Row:
    row = _Row(sp.S.Zero, [sp.S.Zero] * len(half))
    held: list[sp.Expr] = []
    curved: list[list[sp.Expr]] = [[] for _ in half]
    for term in sp.Add.make_args(e):
        held.append(term.xreplace(middle))
        if not term.free_symbols & set(half):
            continue
        _check_jumps(name, term, half)
        slopes = list(derivatives(term, half).values())
        if all(_continuous(s) for s in slopes):
            for k, s in enumerate(slopes):
                curved[k].append(s)
        else:
            row.bounds += [(a, s) for a, s in zip(half.values(), slopes, strict=True)]
    row.still = sp.Add(*held)
    for k, (a, terms) in enumerate(zip(half.values(), curved, strict=True)):
        slope = sp.Add(*terms)
        here = slope.xreplace(middle)
        row.gains[k] = here.xreplace(still)
        if (moved := here - row.gains[k]) != 0:
            row.bounds.append((a, moved))
        second = derivatives(slope, half)
        row.bounds += [(a * b / 2, second[s]) for s, b in half.items() if second[s] != 0]
    return row


def _check_jumps(name: str, e: sp.Expr, swung: Mapping[sp.Symbol, float]) -> None:
    for part in parts([e]):
        if isinstance(part, UNFOLLOWED) and part.free_symbols & set(swung):
            raise SimulationError(
                f"the derivative of {part} in '{name}' does not bound what it changes by",
                expected="rates and inequalities without jumps, angles and lengths of what is "
                "predicted",
            )


def _continuous(slope: sp.Expr) -> bool:
    """Whether an expression with signs is continuous: their factors vanish where they change."""
    if any(isinstance(p, (select, sp.Piecewise)) for p in parts([slope])):
        return False
    for jump in [p for p in parts([slope]) if isinstance(p, (sgn, sp.sign))]:
        sign = sp.Dummy(real=True)
        factor = sp.diff(slope.xreplace({jump: sign}), sign)
        if not _vanishes_with(factor, jump.args[0]):
            return False
    return True


def _vanishes_with(factor: sp.Expr, inner: sp.Expr) -> bool:
    """Whether an expression is 0 wherever another, which is affine in some symbol, is."""
    for s in sorted(inner.free_symbols, key=str):
        slope = sp.diff(inner, s)
        if slope.is_number and slope != 0:
            root = factor.xreplace({s: s - inner / slope})
            return Sampler({}, [root]).vanishes(root)
    return False


def _largest(expressions: Sequence[sp.Expr], box: Mapping[sp.Symbol, Interval]) -> list[float]:
    """The largest magnitudes over a box; infinite where nothing is known."""
    if not expressions:
        return []
    low, high = enclosed(expressions, box)
    return [float(v) for v in np.nan_to_num(np.maximum(np.abs(low), np.abs(high)), nan=np.inf)]


def enclosed(
    expressions: Sequence[sp.Expr], box: Mapping[sp.Symbol, Interval]
) -> tuple[np.ndarray, np.ndarray]:
    """The ends of the expressions over one box; NaN where nothing is known. Both have the shape
    (expressions,)."""
    ends = np.array(list(box.values()), dtype=np.float64).reshape(len(box), 2)
    low, high = Enclosure(list(expressions), list(box)).over(ends[None, :, 0], ends[None, :, 1])
    return low[0], high[0]


BEYOND = 1e-3
"""Share of an interval beyond its ends in which a rate has to be Lipschitz."""

ROUNDING = 1e-12
"""Share of the range of a rate that counts as rounding, at an end that a state rests at."""


@dataclass(frozen=True)
class Guarantee:
    """An interval of a state, and the sentence that says why the state stays in it.

    kept: by a constraint, which another part keeps; else whatever the inputs do.
    """

    interval: Interval
    reason: str
    kept: bool


def guarantees(
    system: System,
    asked: Mapping[str, Interval | None],
    inequalities: Sequence[Inequality],
    *,
    always: bool,
) -> dict[str, Guarantee]:
    """For every state asked for, the interval that it stays in; None asks for the one that it has.

    always: whether the inequalities are kept all the time. An interval is guaranteed by one of
    these, or because the rate at either end does not lead out, whatever the inputs and the
    disturbances do and wherever the others are in their intervals (M. Nagumo, 1942).

    Raises `SimulationError` for an interval without a guarantee.
    """
    names = system.state_names
    for name in asked:
        check_name(
            name, names, SimulationError, f"'{name}' is not a state of system '{system.name}'"
        )
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    limits = {n: _limits(system, n, inequalities, numbers) for n in names} if always else {}
    intervals = {n: i for n, i in limits.items() if i is not None}
    proved: dict[str, Guarantee] = {}
    waiting = dict(asked)
    while waiting:
        done = {}
        for name, wanted in waiting.items():
            guarantee = _guarantee(system, name, wanted, intervals, numbers, limits.get(name))
            if guarantee is not None:
                done[name] = guarantee
        if not done:
            raise _without(system, next(iter(waiting.items())))
        proved |= done
        intervals |= {n: g.interval for n, g in done.items()}
        waiting = {n: i for n, i in waiting.items() if n not in done}
    return {n: proved[n] for n in asked}


def check_tried(part: Part) -> None:
    """Refuse rates that are not affine in a state that is cut off.

    A march finds the worst value of a disturbance in closed form where the rates are affine in it;
    points of its interval, which it takes elsewhere (`samples`), are not all that the state may be.
    """
    for q in part.system.disturbances:
        curved = any(q.symbol in used for used in dependences(part.system, q.symbol))
        if q.name in part.cut and curved:
            raise SimulationError(
                f"cut: the rates of ({', '.join(part.system.state_names)}) are not affine in "
                f"'{q.name}'",
                expected="rates that are affine in the states that are cut off",
                remedy=f"leave '{q.name}' in the part",
            )


def _guarantee(
    system: System,
    name: str,
    wanted: Interval | None,
    intervals: Mapping[str, Interval],
    numbers: Mapping[sp.Symbol, sp.Expr],
    limit: Interval | None,
) -> Guarantee | None:
    unit = _unit(system, name)
    if limit is not None and (wanted is None or _within(limit, wanted)):
        return Guarantee(
            limit, f"'{name}' stays within {shown(limit, unit)}, which the region asks for", True
        )
    interval = wanted or _rests_within(system, name, intervals, numbers)
    if interval is None or not _invariant(system, name, interval, intervals, numbers):
        return None
    return Guarantee(
        interval,
        f"'{name}' stays within {shown(interval, unit)} whatever the inputs do: at neither end "
        "does its rate lead out",
        False,
    )


def _without(system: System, asked: tuple[str, Interval | None]) -> SimulationError:
    name, wanted = asked
    rate = system.rates[name]
    if wanted is None:
        return SimulationError(
            f"no interval is known that '{name}' stays in",
            expected="a constraint on it alone, or a rate that leads back from an interval",
            remedy=f'give an interval: {{"{name}": (low, high)}}',
        )
    return SimulationError(
        f"'{name}' is not seen to stay within {shown(wanted, _unit(system, name))}: its rate is "
        f"{sp.sstr(rate)[:120]}",
        expected="an interval that its rate does not lead out of, with the others in theirs",
        remedy="widen it, name the other states of the rate too, or constrain it in the region",
    )


def _box(
    system: System, intervals: Mapping[str, Interval], numbers: Mapping[sp.Symbol, sp.Expr]
) -> dict[sp.Symbol, Interval]:
    """The intervals of everything that a rate may depend on; infinite where none is known."""
    box = {q.symbol: intervals.get(q.name, (-math.inf, math.inf)) for q in system.states}
    for members, bounds in (
        (system.inputs, system.input_bounds),
        (system.disturbances, system.disturbance_bounds),
    ):
        ranges = bounds.at(numbers).ranges() if bounds is not None else []
        for q, (low, high) in zip(members, ranges, strict=False):
            box[q.symbol] = (float(low), float(high))
    return box


def _over(rate: sp.Expr, box: Mapping[sp.Symbol, Interval]) -> Interval | None:
    """The interval of a rate; None where nothing is known."""
    mine = {s: box[s] for s in sorted(rate.free_symbols, key=str) if s in box}
    if rate.has(TIME) or rate.free_symbols - set(mine):
        return None
    if any(math.isinf(e) for i in mine.values() for e in i):
        return None
    if not mine:
        return float(rate), float(rate)
    low, high = enclosed([rate], mine)
    return None if np.isnan(low[0]) or np.isnan(high[0]) else (float(low[0]), float(high[0]))


def _invariant(
    system: System,
    name: str,
    interval: Interval,
    intervals: Mapping[str, Interval],
    numbers: Mapping[sp.Symbol, sp.Expr],
) -> bool:
    symbol = next(q.symbol for q in system.states if q.name == name)
    box = _box(system, intervals, numbers)
    rate = system.rates[name].xreplace(dict(numbers))
    whole = _over(rate, {**box, symbol: interval})
    if whole is None or not interval[0] < interval[1]:
        return False
    slack = ROUNDING * (whole[1] - whole[0])
    low, high = (_over(rate, {**box, symbol: (e, e)}) for e in interval)
    if low is None or high is None or low[0] < -slack or high[1] > slack:
        return False
    return _lipschitz(rate, symbol, interval, box)


def _lipschitz(
    rate: sp.Expr, symbol: sp.Symbol, interval: Interval, box: Mapping[sp.Symbol, Interval]
) -> bool:
    """Whether the rate is Lipschitz in the state just beyond both ends, as the theorem needs.

    w' = 2 sqrt(w) rests at 0 and leaves it all the same.
    """
    if any(isinstance(p, UNFOLLOWED) and symbol in p.free_symbols for p in parts([rate])):
        return False
    slope = derivatives(rate, [symbol])[symbol]
    (low, high), width = interval, BEYOND * (interval[1] - interval[0])
    slopes = [_over(slope, {**box, symbol: i}) for i in ((low - width, low), (high, high + width))]
    return all(i is not None and math.isfinite(i[0]) and math.isfinite(i[1]) for i in slopes)


def _rests_within(
    system: System,
    name: str,
    intervals: Mapping[str, Interval],
    numbers: Mapping[sp.Symbol, sp.Expr],
) -> Interval | None:
    """The interval of b / a where the rate is b - a s, with a number a above 0."""
    symbol = next(q.symbol for q in system.states if q.name == name)
    rate = sp.expand(system.rates[name].xreplace(dict(numbers)))
    slope = sp.diff(rate, symbol)
    if not rate.is_polynomial(symbol) or not slope.is_number or not slope < 0:
        return None
    rest = _over(sp.expand((rate - slope * symbol) / -slope), _box(system, intervals, numbers))
    return rest if rest is not None and rest[0] < rest[1] else None


def _limits(
    system: System,
    name: str,
    inequalities: Sequence[Inequality],
    numbers: Mapping[sp.Symbol, sp.Expr],
) -> Interval | None:
    """The interval that inequalities on this state alone ask for."""
    symbol = next(q.symbol for q in system.states if q.name == name)
    low, high = -math.inf, math.inf
    for c in inequalities:
        e = c.expression.xreplace(dict(numbers))
        if e.free_symbols != {symbol}:
            continue
        for row in _without_magnitude(e):
            row = sp.expand(row)
            slope = sp.diff(row, symbol)
            if not row.is_polynomial(symbol) or not slope.is_number or slope == 0:
                continue
            end = float(-row.xreplace({symbol: sp.S.Zero}) / slope)
            low, high = (low, min(high, end)) if slope > 0 else (max(low, end), high)
    return (low, high) if math.isfinite(low) and math.isfinite(high) and low < high else None


def _without_magnitude(e: sp.Expr) -> list[sp.Expr]:
    """|a| + b <= 0 as a + b <= 0 and -a + b <= 0."""
    inner = [p for p in sp.Add.make_args(e) if isinstance(p, magnitude)]
    if len(inner) != 1 or len(e.atoms(magnitude)) != 1:
        return [e]
    return [e - inner[0] + sign * inner[0].args[0] for sign in (1, -1)]


def _within(inner: Interval, outer: Interval) -> bool:
    return outer[0] <= inner[0] and inner[1] <= outer[1]


def _unit(system: System, name: str) -> str:
    return next(q.unit for q in system.states if q.name == name)
