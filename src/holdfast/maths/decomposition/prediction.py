"""Actuators that lag, taken out of a system by predicting what they have begun.

    T_j a_j' = s_j(u) - a_j,   q' = f(q, a)

In the coordinates z = q + s(q, a) the actuators a enter as little as possible:

    s_i = sum_j T_j (df_i/da_j) a_j             where a enters the rate of q_i: what it still gives
    s_k = T (f_k(q) - f_k(q with those q_i 0))  where such a q_i does: a step ahead by its effect

so that z' is f(z, s(u)) but for terms of the order T: of a double integrator with a lag, z = (x + T
v, v + T a) is a double integrator without. Both are first integrals of the fast motion to the
first order in T (P. Kokotovic, H. Khalil, J. O'Reilly, Singular Perturbation Methods in Control,
1986). Nothing is approximated here: what remains of a in z' is kept
as it is, and is bounded elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import Bounds, LinearImage
from holdfast.maths.definitions.quantity import TIME, Quantity
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import select, sgn, wrap
from holdfast.maths.expressions.traversal import derivatives, parts

JUMPS = (sgn, select, wrap, sp.sign, sp.floor, sp.ceiling, sp.Piecewise, sp.Heaviside)


@dataclass(frozen=True)
class Lag:
    """A state a with T a' = drive(u) - a: an actuator that follows its command late."""

    state: Quantity
    constant: sp.Expr
    drive: sp.Expr


@dataclass(frozen=True)
class Prediction:
    """A system with its lagged actuators predicted; every parameter has its number.

    states: those left. shift: state -> z - q, in the states and the actuators. back: state -> q in
    the z (by the same names) and the actuators. rates: of z, in z, the actuators and the inputs.
    actuators: the actuators; intervals: theirs, which they never leave. gain: k of the command
    s(u) = a + k (s(w) - a) by which the law's choice w acts, faster than the actuator alone.
    command: input -> the command u in w (by the names of the inputs) and the actuators.
    bounds: of w.
    """

    states: tuple[Quantity, ...]
    shift: Mapping[str, sp.Expr]
    back: Mapping[sp.Symbol, sp.Expr]
    rates: Mapping[str, sp.Expr]
    actuators: tuple[Quantity, ...]
    intervals: tuple[tuple[float, float], ...]
    gain: float
    command: Mapping[str, sp.Expr]
    bounds: Bounds


def lags(system: System) -> tuple[Lag, ...]:
    """The states of a system that follow a combination of its inputs with a first-order lag."""
    inputs = {q.symbol for q in system.inputs}
    allowed = inputs | {q.symbol for q in system.parameters}
    lagging = []
    for q in system.states:
        rate = sp.expand(system.rates[q.name])
        slope = sp.diff(rate, q.symbol)
        if slope == 0 or slope.free_symbols - allowed or slope.free_symbols & inputs:
            continue
        drive = sp.expand(-rate.xreplace({q.symbol: sp.S.Zero}) / slope)
        if not drive.free_symbols & inputs or drive.free_symbols - allowed:
            continue
        of = {s: sp.diff(drive, s) for s in drive.free_symbols & inputs}
        if all(not e.free_symbols & inputs for e in of.values()):
            lagging.append(Lag(q, -1 / slope, drive))
    return tuple(lagging)


def predicted(system: System, share: float) -> Prediction:
    """The system whose lagged actuators are predicted, with commands from a share of their range.

    share: of the range of the actuators, which they are kept within, above 0 and at most 1. The
    rest of the range hurries them: k = min(U - share L, share U - L) / (share (U - L)) for an
    actuator within [L, U], the most for which no command leaves [L, U].

    Raises `DefinitionError` for a system without lags or with other inputs beside them, and where
    the actuators do not fill a box around 0.
    """
    if not 0 < share <= 1:
        raise DefinitionError(
            f"a share of {share:g} of the actuators", expected="above 0, at most 1"
        )
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    lagging = lags(system)
    late = {lag.state.symbol for lag in lagging}
    names = [q.name for q in system.states if q.symbol not in late]
    rates = {n: system.rates[n].xreplace(numbers) for n in names}
    _check(system, lagging, rates)
    inputs = [q.symbol for q in system.inputs]
    constants = [float(lag.constant.xreplace(numbers)) for lag in lagging]
    drives = [lag.drive.xreplace(numbers) for lag in lagging]
    _check_lags(lagging, constants, drives, inputs)
    matrix = sp.Matrix([[sp.diff(d, u) for u in inputs] for d in drives])
    bounds = system.input_bounds
    assert bounds is not None
    sides, gain = _range(bounds.at(numbers), matrix, share)
    actuators = tuple(lag.state for lag in lagging)
    slow = [t / gain for t in constants]
    states = tuple(q for q in system.states if q.name in names)
    shift, back = _shifts(states, rates, [a.symbol for a in actuators], slow)
    moved = {}
    for n in names:
        slopes = derivatives(
            shift[n], [*(q.symbol for q in states), *(a.symbol for a in actuators)]
        )
        chase = [
            slopes[a.symbol] * (d - a.symbol) / t
            for a, d, t in zip(actuators, drives, slow, strict=True)
        ]
        carried = [slopes[q.symbol] * rates[q.name] for q in states if slopes[q.symbol] != 0]
        moved[n] = sp.Add(rates[n], *carried, *chase).xreplace(back)
    away = matrix.inv() * sp.Matrix([a.symbol for a in actuators])
    command = {
        q.name: sp.Float(gain) * q.symbol + sp.Float(1 - gain) * e
        for q, e in zip(system.inputs, away, strict=True)
    }
    image = LinearImage(
        sp.ImmutableMatrix(sp.Float(share) * sp.eye(len(inputs))), bounds.at(numbers)
    )
    return Prediction(states, shift, back, moved, actuators, tuple(sides), gain, command, image)


def _check_lags(
    lagging: Sequence[Lag],
    constants: Sequence[float],
    drives: Sequence[sp.Expr],
    inputs: Sequence[sp.Symbol],
) -> None:
    """Refuse actuators that run away from their commands, or that rest elsewhere than at 0."""
    for lag, t, drive in zip(lagging, constants, drives, strict=True):
        if not 0 < t < math.inf:
            raise DefinitionError(
                f"actuator '{lag.state.name}' does not follow its command: its time constant is "
                f"{t:g} s",
                expected="a time constant above 0",
            )
        rest = drive.xreplace(dict.fromkeys(inputs, sp.S.Zero))
        if sp.simplify(rest) != 0:
            raise DefinitionError(
                f"actuator '{lag.state.name}' rests at {float(rest):g} without a command",
                expected="an actuator that rests at 0",
                remedy="measure the actuator and its command from there",
            )


def _check(system: System, lagging: Sequence[Lag], rates: Mapping[str, sp.Expr]) -> None:
    owner = f"system '{system.name}'"
    if not lagging:
        raise DefinitionError(
            f"no state of {owner} follows the inputs with a first-order lag",
            expected="rates (s(u) - a) / T of actuators",
            remedy="leave out the share",
        )
    if system.input_bounds is None:
        raise DefinitionError(f"{owner} has no bounds for its inputs")
    if len(lagging) != len(system.inputs):
        raise DefinitionError(
            f"{owner} has {len(lagging)} actuators that lag and {len(system.inputs)} inputs",
            expected="as many of each",
        )
    inputs = {q.symbol for q in system.inputs}
    late = {lag.state.symbol for lag in lagging}
    states = {q.symbol for q in system.states}
    for name, rate in rates.items():
        if used := rate.free_symbols & (inputs | {TIME}):
            raise DefinitionError(
                f"the rate of '{name}' depends on '{min(map(str, used))}' itself",
                expected="inputs that act through actuators that lag, and no time",
            )
        slopes = derivatives(rate, sorted(late, key=str))
        others = set().union(*(e.free_symbols for e in slopes.values())) - states
        if others:
            raise DefinitionError(
                f"what an actuator does to '{name}' depends on '{min(map(str, others))}'",
                expected="effects that depend on states alone",
            )
        if any(slope.free_symbols & late for slope in slopes.values()):
            raise DefinitionError(
                f"the rate of '{name}' is not affine in the actuators", expected="affine rates"
            )


def _range(
    bounds: Bounds, matrix: sp.Matrix, share: float
) -> tuple[list[tuple[float, float]], float]:
    """The share of the interval of every actuator, and the gain k of its command."""
    if matrix.rank() < matrix.rows:
        raise DefinitionError(
            "the actuators that lag do not follow the inputs independently",
            expected="as many independent actuators as inputs",
        )
    inverse = matrix.inv()
    pairs = [bounds.range_along(list(matrix.row(i))) for i in range(matrix.rows)]
    sides = [(float(low), float(high)) for low, high in pairs]
    for corner in _corners(sides):
        if not bounds.contains([float(e) for e in inverse * sp.Matrix(corner)]):
            raise DefinitionError(
                "the actuators that lag cannot be chosen one by one",
                expected="inputs whose bounds are a box of the actuators",
            )
    if not all(low < 0 < high for low, high in sides):
        raise DefinitionError("an actuator that lags cannot be 0", expected="intervals around 0")
    gain = min(
        min(high - share * low, share * high - low) / (share * (high - low)) for low, high in sides
    )
    return [(share * low, share * high) for low, high in sides], gain


def _corners(sides: Sequence[tuple[float, float]]) -> list[list[float]]:
    corners: list[list[float]] = [[]]
    for side in sides:
        corners = [[*corner, end] for corner in corners for end in side]
    return corners


def _shifts(
    states: Sequence[Quantity],
    rates: Mapping[str, sp.Expr],
    actuators: Sequence[sp.Symbol],
    slow: Sequence[float],
) -> tuple[dict[str, sp.Expr], dict[sp.Symbol, sp.Expr]]:
    """z - q of every state, and q in z; a shift that cannot be undone in turn is left out."""
    symbols = [q.symbol for q in states]
    direct = {n: derivatives(rates[n], actuators) for n in rates}
    driven = {n for n in rates if any(e != 0 for e in direct[n].values())}
    still = {q.symbol: sp.S.Zero for q in states if q.name in driven}
    acted_on, step = set(still), sp.Float(math.fsum(slow) / len(slow))
    shift: dict[str, sp.Expr] = {}
    for n, rate in rates.items():
        first = [t * direct[n][a] * a for a, t in zip(actuators, slow, strict=True)]
        if any(e != 0 for e in first):
            shift[n] = sp.Add(*first)
            continue
        shift[n] = (
            step * (rate - rate.xreplace(still)) if rate.free_symbols & acted_on else sp.S.Zero
        )
        if shift[n].free_symbols - set(symbols):
            shift[n] = sp.S.Zero
    for n, e in shift.items():
        if any(isinstance(p, JUMPS) for p in parts([e])):
            raise DefinitionError(
                f"the prediction of '{n}' jumps: {sp.sstr(e)[:120]}",
                expected="rates without jumps where actuators act",
            )
    back: dict[sp.Symbol, sp.Expr] = {}
    waiting = dict(zip(rates, symbols, strict=True))
    while waiting:
        ready = [n for n, s in waiting.items() if not _reads(shift[n]) & set(waiting.values())]
        if not ready:  # in a circle: the weaker of them are not shifted
            weaker = [n for n in waiting if n not in driven] or list(waiting)
            for n in weaker:
                shift[n] = sp.S.Zero
            continue
        for n in ready:
            s = waiting.pop(n)
            back[s] = s - shift[n].xreplace(back)
    return shift, back


def _reads(e: sp.Expr) -> set[sp.Symbol]:
    return set(e.free_symbols)
