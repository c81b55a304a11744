"""What a region's filter misses between samples: how far hostile commands drive a constraint out.

A condition is met at a sample, with an input that is held until the next, T later, and gains that T
bears (`maths/control/safety_filter.py`). What remains is how the derivative of the condition
changes meanwhile. With d2c/dt2 <= M, or d3c/dt3 <= J, along the holds beside the limit

    c(i+1) <= (1 - k1 T) c(i) + M T^2 / 2                 c <= M T / (2 k1)               order one
    d2c/dt2 <= -(k1 + k2) dc/dt - k1 k2 c + J t           c <= about J T / (2 k1 k2)      order two

Where M is the same at all states it bounds what is crossed (`crossings_of`). Else M and J over all
states and inputs are many times what they are where a condition binds, so that the number is
measured: closed loops from states at which the filter's promise begins, under commands
that push as far as the bounds of the inputs go, along the normal of the nearest condition or at
random corners.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from holdfast.analysis.online.filter_law import Made
from holdfast.analysis.simulation.simulate import simulate
from holdfast.errors import DefinitionError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.evaluate import Evaluator
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.maths.control.safety_filter import Asked
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, Quantity
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact

DRAWN = 20
"""States that are drawn for each run, of which those serve at which the promise begins."""
PACES = 3.0  # horizon of a run, in times of the slower gain
SAMPLES = 40  # at least
PUSHES = 5  # commands at random corners in a run


@dataclass(frozen=True)
class Overshoot:
    """How far constraints were crossed although an input met all conditions at every sample.

    crossed: inequality -> the most [its unit], 0 where none was. runs: how many count; relaxed: how
    many do not, since at some sample no input met all conditions. sample_time [s].
    """

    crossed: Mapping[str, float]
    runs: int
    relaxed: int
    sample_time: float

    def __str__(self) -> str:
        most = ", ".join(f"'{name}' by up to {value:.3g}" for name, value in self.crossed.items())
        return (
            f"in {self.runs} runs under hostile commands, held for {self.sample_time:g} s, "
            f"constraints are crossed: {most}; in {self.relaxed} more no input met all conditions"
        )


def crossings_of(
    made: Made, sample_time: float, margins: Mapping[str, float], uncertain: Sequence[str]
) -> dict[str, float]:
    """Inequality -> the most by which held inputs can cross it, in its unit: `math.inf` if unknown.

    An inequality is left out where the derivative that its condition bounds does not change during
    a hold, since nothing remains then. Where it is the first derivative, and its own does not
    depend on the states, M is its most over the bounds of inputs and disturbances, by intervals.
    """
    system, region = made.system, made.region
    if region is None or made.gains is None:
        return {}
    numbers = {p.symbol: float(p.value) for p in made.law.parameters if p.name not in uncertain}
    held: dict[str, float] = {}
    for piece in made.asked():
        c = piece.condition
        derivatives = [region.inequality(c.name).expression]
        for _ in range(max(piece.orders) + 1):
            derivatives.append(_along(system, derivatives[-1]))
        if sp.expand(derivatives[-1].xreplace(numbers)) == 0:
            continue
        most = math.inf
        if piece.orders == (1,):
            most = _most(system, derivatives[2].xreplace(numbers), numbers)
        crossed = max(0.0, most) * sample_time / (2 * made.gains[0]) - margins.get(c.name, 0.0)
        if crossed > 0:
            held[c.name] = max(held.get(c.name, 0.0), crossed)
    return held


def crossings_text(crossings: Mapping[str, float], sample_time: float) -> str:
    """What remains between samples, as a sentence; empty where nothing does."""
    if not crossings:
        return ""
    bounded = [f"'{n}' by at most {v:.3g}" for n, v in crossings.items() if math.isfinite(v)]
    others = ", ".join(f"'{n}'" for n, v in crossings.items() if not math.isfinite(v))
    if others:
        bounded.append(f"{others} by what SafetyFilter.overshoot(box) measures")
    return (
        f"between samples, {sample_time:g} s apart, constraints may be crossed: "
        f"{'; '.join(bounded)}; a margin of that size covers it"
    )


def _along(system: System, e: sp.Expr) -> sp.Expr:
    """The rate of an expression of t, the states and what is held."""
    rates = (e.diff(q.symbol) * system.rates[q.name] for q in system.states)
    return sp.Add(e.diff(TIME), *rates)


def _most(system: System, e: sp.Expr, numbers: Mapping[sp.Symbol, float]) -> float:
    """The most over the bounds of inputs and disturbances; infinite for what depends on others."""
    ends: dict[sp.Symbol, tuple[float, float]] = {}
    for members, bounds in (
        (system.inputs, system.input_bounds),
        (system.disturbances, system.disturbance_bounds),
    ):
        if bounds is None:
            continue
        for q, pair in zip(members, bounds.ranges(), strict=True):
            low, high = (sp.sympify(end).xreplace(numbers) for end in pair)
            if low.is_number and high.is_number:
                ends[q.symbol] = float(low), float(high)
    if e.free_symbols - set(ends) or not np.isfinite(list(ends.values())).all():
        return math.inf
    corners = np.array([list(ends.values())])
    try:
        _, (most,) = Enclosure([exact(e)], list(ends)).over(corners[:, :, 0], corners[:, :, 1])
    except DefinitionError:
        return math.inf
    return math.inf if np.isnan(most[0]) else float(most[0])


def overshoot_of(
    made: Made, box: Mapping[str, tuple[float, float]], sample_time: float, runs: int, seed: int
) -> Overshoot:
    """How far constraints are crossed because inputs are held: measured, in their units.

    It is the most of so many runs, from states of `box` with c <= 0 and dc/dt + k1 c <= 0, under
    commands that push as far as the bounds go; all states are measured, and there is no
    disturbance. A margin of that size covers it. box: the ends of every state in its unit; an angle
    that is left out is any.

    Raises `DefinitionError` for a filter that keeps a kernel, a state without ends, and a box
    in which no such state was found.
    """
    system, law, region = made.system, made.law, made.region
    if region is None or made.kernel is not None:
        raise DefinitionError("the filter keeps a kernel", expected="regions alone")
    numbers = {p.name: float(p.value) for p in law.parameters}
    starts = _starts(system, law, made.asked(), box, runs, seed)
    commands = _Hostile(system, law, len(starts), seed)
    samples = max(SAMPLES, math.ceil(PACES / (numbers["kappa1"] * sample_time)))
    commands.lasting = max(1, samples // PUSHES)
    commands.sample_time = sample_time
    result = simulate(
        system, law, starts=starts, region=region, horizon=samples * sample_time,
        sample_time=sample_time, record_every=samples * sample_time, substeps=10,
        command=commands,
    )  # fmt: skip
    data = result.arrays
    met = np.asarray(data["infeasible"].values == 0)
    worst = data["worst_constraint"].values[met]
    crossed = np.maximum(worst.max(axis=0, initial=0.0), 0.0)
    names = region.inequality_names
    return Overshoot(
        dict(zip(names, crossed.tolist(), strict=True)),
        int(met.sum()), int((~met).sum()), sample_time,
    )  # fmt: skip


def _starts(
    system: System,
    law: Law,
    pieces: Sequence[Asked],
    box: Mapping[str, tuple[float, float]],
    runs: int,
    seed: int,
) -> Array:
    """States of the box at which c + m <= 0 and what the first condition keeps below 0 is."""
    for name in box:
        if name not in system.state_names:
            raise DefinitionError(
                f"box: '{name}' is no state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    ends = np.array([_ends_of(q, box) for q in system.states])
    generator = np.random.default_rng(seed)
    drawn = ends[:, 0] + (ends[:, 1] - ends[:, 0]) * generator.random((DRAWN * runs, len(ends)))
    still = {q.symbol: sp.S.Zero for q in system.disturbances}
    levels = [e.xreplace(still) for piece in pieces for e in piece.kept]
    states = [q.symbol for q in system.states]
    values = Evaluator(levels, states, law.parameters).values(drawn)
    inside = drawn[(values <= 0).all(axis=1)]
    if not len(inside):
        raise DefinitionError(
            f"none of {len(drawn)} states of the box is one at which the filter's promise begins",
            expected="c <= 0 and dc/dt + k1 c <= 0 for every constraint",
        )
    return inside[:runs]


class _Hostile:
    """Commands that push as far as the bounds go; half the runs along the nearest condition."""

    lasting = 1
    sample_time = 1.0

    def __init__(self, system: System, law: Law, runs: int, seed: int) -> None:
        guard = law.safeguard
        assert guard is not None
        self.inputs, self.soft = len(system.inputs), len(guard.offsets) - guard.hard
        still = {q.symbol: sp.S.Zero for q in system.disturbances}
        rows = [
            e
            for j in range(guard.hard, len(guard.offsets))
            for e in (*(guard.normals[n][j] for n in system.input_names), guard.offsets[j])
        ]
        states = [q.symbol for q in system.states]
        self.rows = Evaluator([e.xreplace(still) for e in rows], states, law.parameters)
        values = {p.symbol: float(p.value) for p in law.parameters}
        scales = [float(guard.scales[n].xreplace(values)) for n in system.input_names]
        ranges = [(-sp.oo, sp.oo)] * self.inputs
        if system.input_bounds is not None:
            ranges = system.input_bounds.ranges()
        pairs = [[float(sp.sympify(e).xreplace(values)) for e in pair] for pair in ranges]
        ends = np.array(pairs)
        wide = np.array(scales)[:, np.newaxis] * np.array([-1.0, 1.0])
        self.ends = np.where(np.isfinite(ends), ends, 10.0 * wide)
        self.greedy = np.arange(runs) % 2 == 0
        self.generator = np.random.default_rng(seed + 1)
        self.pushes = self._corners(runs)

    def __call__(self, t: float, states: Array) -> Array:
        sample = round(t / self.sample_time)
        if sample % self.lasting == 0:
            self.pushes = self._corners(len(states))
        rows = self.rows.values(states).reshape(len(states), self.soft, self.inputs + 1)
        normals, offsets = rows[:, :, :-1], rows[:, :, -1]
        size = np.linalg.norm(normals * (self.ends[:, 1] - self.ends[:, 0]), axis=2)
        room = offsets / np.where(size > 0, size, math.inf)
        nearest = normals[np.arange(len(states)), room.argmin(axis=1)]
        along = np.where(nearest > 0, self.ends[:, 1], self.ends[:, 0])
        return np.where(self.greedy[:, np.newaxis], along, self.pushes)

    def _corners(self, runs: int) -> Array:
        upper = self.generator.random((runs, self.inputs)) < 0.5
        return np.where(upper, self.ends[:, 1], self.ends[:, 0])


def _ends_of(state: Quantity, box: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    if state.name not in box:
        if state.angle:
            return -math.pi, math.pi
        raise DefinitionError(
            f"box: '{state.name}' has no ends", expected="those of every state but angles"
        )
    low, high = (float(e) for e in box[state.name])
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise DefinitionError(
            f"box: the ends of '{state.name}' are {low:g} and {high:g}",
            expected="two finite numbers, the lower first",
        )
    return low, high
