"""A problem whose lagged actuators are predicted, with what remains of them as a disturbance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp

from holdfast.analysis.decomposition.remainders import Affine, affine_in
from holdfast.analysis.reachability.grid import TURN
from holdfast.errors import SimulationError
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.decomposition.prediction import Prediction, predicted
from holdfast.maths.definitions.bounds import Box, product
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.region import Inequality
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import magnitude

Interval = tuple[float, float]
REST = "rest_of_"
"""Before the name of a state: the disturbance that bounds what its rate leaves out."""
LATTICE, ON_FACE = 129, 20_000
"""Points along a state, and at an end of a box, at which it is looked whether a region goes on."""
TOUCHING = 1e-9
"""Share of the largest constraint by which a region may go on and still end there."""
NOTHING = 1e-12
"""Rests below this, in the unit of the rate, are left out."""


@dataclass(frozen=True)
class LagFree:
    """The problem in z: the actuators are disturbances within their intervals.

    coordinates: symbol of z -> z in the states of the whole. within: states that are kept in their
    intervals by inequalities of their own. domain: where the actuators begin.
    """

    system: System
    inequalities: tuple[Inequality, ...]
    coordinates: Mapping[sp.Symbol, sp.Expr]
    within: Mapping[str, Interval]
    domain: tuple[Inequality, ...]
    prediction: Prediction
    reasons: tuple[str, ...]


def lag_free(
    system: System,
    inequalities: Sequence[Inequality],
    share: float,
    box: Mapping[str, Interval],
    numbers: Mapping[sp.Symbol, sp.Expr],
) -> LagFree:
    """The problem without its lags.

    z' is affine in the actuators but for a rest that is bounded over the box, and so are the
    inequalities, which are to hold for every value of the actuators that z may stand for:

        z' = f(z, w) + G(z) a + rest,   c(z) + sum_k |dc/da_k| A_k + rest <= 0

    Raises `DefinitionError` for lags that cannot be predicted, and `SimulationError` for a box
    without an interval, or one that the inequalities do not keep.
    """
    found = predicted(system, share)
    names = [q.name for q in found.states]
    for name in names:
        if name not in box:
            raise SimulationError(
                f"the box has no interval for '{name}'",
                expected="intervals of all states but the actuators that lag",
            )
    over = {q.symbol: (float(box[q.name][0]), float(box[q.name][1])) for q in found.states}
    swung = dict(zip((a.symbol for a in found.actuators), found.intervals, strict=True))
    free = _ranges(system.inputs, found.bounds)
    felt = system.disturbance_bounds
    free |= _ranges(system.disturbances, felt.at(numbers) if felt is not None else None)
    rates = affine_in(found.rates, swung, free, over)
    moved = {c.name: c.expression.xreplace(dict(found.back)) for c in inequalities}
    fixed = {n: e.xreplace(dict(numbers)) for n, e in moved.items()}
    rows = affine_in(fixed, swung, {}, over)
    read = set().union(*(c.expression.free_symbols for c in inequalities))
    unread = [q for q in found.states if q.symbol not in read]
    tight = [_tightened(c, rows[c.name], swung) for c in inequalities]
    asked = [e.expression.xreplace(dict(numbers)) for e in (*tight, *_within(unread, over))]
    held = [q for q in found.states if q in unread or _goes_on(asked, q, over)]
    return LagFree(
        _system(system, found, rates, swung),
        (*tight, *_within(held, over)),
        {q.symbol: q.symbol + found.shift[q.name] for q in found.states},
        {q.name: over[q.symbol] for q in held},
        _domain(found),
        found,
        (_reason(found), *(_limited(q, over) for q in held if q not in unread)),
    )


def _ranges(members: Sequence[Quantity], bounds: object) -> dict[sp.Symbol, Interval]:
    ranges = bounds.ranges() if bounds is not None else []  # type: ignore[attr-defined]
    pairs = zip(members, ranges, strict=False)
    return {q.symbol: (float(low), float(high)) for q, (low, high) in pairs}


def _system(
    system: System,
    found: Prediction,
    rates: Mapping[str, Affine],
    swung: Mapping[sp.Symbol, Interval],
) -> System:
    """The system of z: the actuators and the rests are disturbances."""
    whole = {}
    rests: list[tuple[Quantity, float]] = []
    for q in found.states:
        row = rates[q.name]
        terms = [row.still]
        for (a, (low, high)), gain in zip(swung.items(), row.gains, strict=True):
            terms.append(gain * (a - sp.Float((low + high) / 2)))
        if row.rest > NOTHING:
            rest = Quantity(REST + q.name, f"{q.unit}/s", "what its rate leaves out")
            rests.append((rest, row.rest))
            terms.append(rest.symbol)
        whole[q.name] = sp.Add(*terms)
    ends = [*found.intervals, *((-size, size) for _, size in rests)]
    bounds = product(Box(tuple(a for a, _ in ends), tuple(b for _, b in ends)),
                     system.disturbance_bounds) if system.disturbances else Box(
        tuple(a for a, _ in ends), tuple(b for _, b in ends))  # fmt: skip
    return replace(
        system,
        name=f"{system.name}, predicted",
        states=found.states,
        rates=whole,
        parameters=(),
        input_bounds=found.bounds,
        disturbances=(*found.actuators, *(q for q, _ in rests), *system.disturbances),
        disturbance_bounds=bounds,
        pfaffian=(),
        measurements=(),
        flat_output=None,
    )


def _tightened(c: Inequality, row: Affine, swung: Mapping[sp.Symbol, Interval]) -> Inequality:
    """The inequality for every value of the actuators: less what they may make of it."""
    if row.rest <= NOTHING and not any(row.gains):
        return c
    widths = [(high - low) / 2 for low, high in swung.values()]
    more = [magnitude(g) * sp.Float(w) for g, w in zip(row.gains, widths, strict=True) if g != 0]
    return replace(c, expression=row.still + sp.Add(*more) + sp.Float(row.rest))


def _goes_on(
    constraints: Sequence[sp.Expr], state: Quantity, box: Mapping[sp.Symbol, Interval]
) -> bool:
    """Whether the constraints let a state beyond an end of its interval, the others in theirs.

    Those of a place read the predicted speeds too, and their region in z is sheared: it may be
    wider than that of the whole, which the box was given for.
    """
    low, high = box[state.symbol]
    if state.angle and high - low >= TURN * (1 - 1e-9):
        return False
    count = min(LATTICE, max(3, int(ON_FACE ** (1 / max(len(box) - 1, 1)))))
    sides = [(low, high) if s == state.symbol else np.linspace(*box[s], count) for s in box]
    points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(box))
    worst = Evaluator(constraints, list(box), ()).values(points).max(axis=1)
    return bool(worst.min() < -TOUCHING * np.abs(worst).max())


def _within(states: Sequence[Quantity], box: Mapping[sp.Symbol, Interval]) -> list[Inequality]:
    """These states kept within the box that the bounds hold in, but for whole turns of an angle.

    Those of which the inequalities keep z within need no more.
    """
    rows = []
    for q in states:
        low, high = box[q.symbol]
        if not (q.angle and high - low >= TURN * (1 - 1e-9)):
            away = (
                magnitude(q.symbol - sp.Float((low + high) / 2))
                if low + high
                else magnitude(q.symbol)
            )
            rows.append(Inequality(f"{q.name}_in_box", away - sp.Float((high - low) / 2), q.unit))
    return rows


def _domain(found: Prediction) -> tuple[Inequality, ...]:
    rows = []
    for a, (low, high) in zip(found.actuators, found.intervals, strict=True):
        rows.append(Inequality(f"{a.name}_low", sp.Float(low) - a.symbol, a.unit))
        rows.append(Inequality(f"{a.name}_high", a.symbol - sp.Float(high), a.unit))
    return tuple(rows)


def _limited(state: Quantity, box: Mapping[sp.Symbol, Interval]) -> str:
    low, high = box[state.symbol]
    return (
        f"predicted {state.name} is kept within its box, [{low:g}, {high:g}], beyond which the "
        "constraints would let it go"
    )


def _reason(found: Prediction) -> str:
    names = " and ".join(a.name for a in found.actuators)
    is_, it, its, does = (
        ("is", "it stays", "its", "it still does")
        if len(found.actuators) == 1
        else ("are", "they stay", "their", "they still do")
    )
    return (
        f"{names} {is_} predicted: {it} within the share of {its} range that the law uses, and "
        f"what {does} to the predicted states is a disturbance within proved bounds"
    )
