"""Adversarial disturbances for closed-loop validation: state feedback, or along a schedule.

With state feedback the disturbance lowers the value along its gradient, or the margin of the
constraints. Both are greedy, and the first relies on the value under test. The schedules do not:
every coordinate of a bound follows

    amplitude clip(gain (sin(pace t + phase) + bias), -1, 1)

which is a constant extreme at pace 0, switches between extremes if the gain is large, and
swings if it is 1. Numbers are drawn for every run; paces are spread evenly over their logarithm,
from one change per horizon to one every few samples, so that no unit of time is preferred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import sympy as sp

from holdfast.maths.definitions.quantity import TIME, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.functions import clip

Range = tuple[float, float]

STEEP = 1e6
"""The gain of a switching schedule."""

CONSTANT, INSIDE = "constant extremes", "constants within the bounds"
SWITCHING, SWINGING = "switching extremes", "random swings"


@dataclass(frozen=True)
class Schedules:
    """Disturbances along a schedule: one set of expressions for all kinds, and the draws.

    coordinates: the kind of bound of each coordinate, "box" or "ball".
    """

    expressions: dict[str, sp.Expr]
    coordinates: tuple[str, ...]

    def drawn(self, kind: str, horizon: float, sample_time: float) -> Varied:
        """The draws of every run for a kind, one of CONSTANT, INSIDE, SWITCHING, SWINGING."""
        paces = (math.log(math.pi / horizon), math.log(math.pi / (5.0 * sample_time)))
        if kind in (CONSTANT, INSIDE):
            paces = (-700.0, -700.0)  # exp(-700) t is constant
        gain = 1.0 if kind == SWINGING else STEEP
        draws: dict[str, Range] = {"schedule_gain": (gain, gain)}
        for number, bound in enumerate(self.coordinates):
            either = kind == INSIDE or (bound == "ball" and kind != SWINGING)
            least = -1.0 if either else 1.0
            draws[f"schedule_amplitude_{number}"] = (least, 1.0)
            draws[f"schedule_pace_{number}"] = (paces[0], max(paces))
            draws[f"schedule_phase_{number}"] = (-math.pi, math.pi)
            draws[f"schedule_bias_{number}"] = (-0.9, 0.9) if kind == SWITCHING else (0.0, 0.0)
        used = {s.name for e in self.expressions.values() for s in e.free_symbols}
        draws = {n: ends for n, ends in draws.items() if n in used}
        return Varied(draws, {}, {}, dict.fromkeys(draws, "1"))


def schedules(system: System) -> Schedules:
    """The disturbances of the system along schedules that stay within their bounds."""
    coordinates: list[str] = []

    def wave(bound: str) -> sp.Expr:
        number = len(coordinates)
        coordinates.append(bound)
        amplitude, pace, phase, bias = (
            symbol(f"schedule_{name}_{number}") for name in ("amplitude", "pace", "phase", "bias")
        )
        swing = sp.sin(sp.exp(pace) * TIME + phase) + bias
        return amplitude * clip(symbol("schedule_gain") * swing, sp.S(-1), sp.S(1))

    assert system.disturbance_bounds is not None
    moved = system.disturbance_bounds.moving(wave)
    expressions = dict(zip(system.disturbance_names, moved, strict=True))
    read = set().union(*(r.free_symbols for r in system.rates.values()))
    for q in system.disturbances:
        if q.symbol not in read:  # no rate depends on it
            expressions[q.name] = sp.S.Zero
    return Schedules(expressions, tuple(coordinates))
