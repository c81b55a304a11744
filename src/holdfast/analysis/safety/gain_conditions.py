"""Gain conditions of a law at every corner of what varies: where each of them is nearest to fail.

A condition value < limit is judged by its slack, (limit - value) / max(|value|, |limit|): above 0
it is met, and 0.1 leaves a tenth of the larger number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.definitions.law import GainCondition
from holdfast.maths.definitions.quantity import DELAY, SAMPLE_TIME, symbol
from holdfast.maths.definitions.variation import MOST_VERTICES, Varied
from holdfast.maths.expressions.numeric import evaluated

INTERIOR = 16
"""Random points inside the ranges that are tried beside the corners."""

Point = Mapping[str, float]


@dataclass(frozen=True)
class JudgedCondition:
    """A condition where it is nearest to fail.

    value, limit: its two sides there; slack: their relative distance, negative where it fails.
    corner: the varied numbers of that place; vehicle: whether they are those of the simulated
    vehicle, which its law does not know.
    """

    condition: str
    value: float
    limit: float
    slack: float
    corner: Point
    vehicle: bool
    consequence: str
    source: str

    @property
    def where(self) -> str:
        """The corner in words."""
        if not self.corner:
            return "for the simulated vehicle" if self.vehicle else "everywhere"
        shown = ", ".join(f"{n} = {v:.4g}" for n, v in self.corner.items())
        return f"at {shown}" + (" of the vehicle" if self.vehicle else "")


@dataclass(frozen=True)
class Corners:
    """Every corner of the draws, and places inside: the numbers that differ there, by symbol.

    of: the draws at each place; known: what the law knows there; real: what the vehicle has.
    """

    of: tuple[Point, ...]
    known: tuple[dict[sp.Symbol, float], ...]
    real: tuple[dict[sp.Symbol, float], ...]


def corners_of(
    varied: Varied, plant: Mapping[str, float], parameters: Mapping[str, float], seed: int
) -> Corners:
    """All 2^k corners of the k draws, then `INTERIOR` random places inside.

    plant: numbers of the simulated vehicle that its law does not know. parameters: all others.
    Raises `DefinitionError` for more than ten draws.
    """
    names, ends = [*varied.draws], [*varied.draws.values()]
    if 2 ** len(names) > MOST_VERTICES:
        raise DefinitionError(
            f"{len(names)} draws have {2 ** len(names):,} corners",
            expected=f"at most {MOST_VERTICES:,}",
            remedy="give the draws that do not matter one value",
        )
    places = [[]] if not names else _places(ends, seed)
    of, of_law, real = [], [], []
    for place in places:
        drawn = dict(zip(names, place, strict=True))
        numbers = {symbol(n): v for n, v in {**parameters, **drawn}.items()}
        for name, expression in varied.values.items():
            (numbers[symbol(name)],) = evaluated([expression], numbers)
        law_values = {symbol(n): numbers[symbol(n)] for n in varied.names if n not in varied.cases}
        of.append(drawn)
        of_law.append(law_values)
        figures = dict(zip(varied.plant, evaluated(varied.plant.values(), numbers), strict=True))
        real.append(law_values | {symbol(n): v for n, v in {**plant, **figures}.items()})
    return Corners(tuple(of), tuple(of_law), tuple(real))


def _places(ends: Sequence[tuple[float, float]], seed: int) -> list[list[float]]:
    corners = np.array(np.meshgrid(*ends, indexing="ij")).reshape(len(ends), -1).T
    low, high = np.array(ends, dtype=np.float64).T
    inside = low + np.random.default_rng(seed).random((INTERIOR, len(ends))) * (high - low)
    return [*corners.tolist(), *inside.tolist()]


def judged(
    conditions: Iterable[GainCondition],
    parameters: Mapping[str, float],
    corners: Corners,
    settings: Settings,
) -> tuple[JudgedCondition, ...]:
    """Every condition where its slack is least: as the law knows the numbers, and as they are.

    parameters: of law and vehicle, with their values. Raises `DefinitionError` for a condition
    that has no value.
    """
    timing = {
        SAMPLE_TIME: 0.0 if settings.continuous else settings.sample_time,
        DELAY: settings.delay,
    }
    fixed = {symbol(n): v for n, v in parameters.items()} | timing
    return tuple(_worst(condition, fixed, corners) for condition in conditions)


def _worst(
    condition: GainCondition, fixed: Mapping[sp.Symbol, float], corners: Corners
) -> JudgedCondition:
    involved = (condition.value + condition.limit).free_symbols
    tried: dict[tuple[float, ...], tuple[float, float]] = {}
    worst: JudgedCondition | None = None
    for vehicle, table in ((False, corners.known), (True, corners.real)):
        for drawn, numbers in zip(corners.of, table, strict=True):
            there = {s: numbers.get(s, fixed[s]) for s in involved}
            key = tuple(there.values())
            if key in tried:
                continue
            tried[key] = pair = _sides(condition, there)
            slack = relative_slack(*pair)
            if worst is None or slack < worst.slack:
                matters = bool(involved & set(numbers))
                worst = JudgedCondition(
                    _name(condition), *pair, slack, dict(drawn) if matters else {}, vehicle,
                    condition.consequence, condition.source,
                )  # fmt: skip
    assert worst is not None
    return worst


def _name(condition: GainCondition) -> str:
    """The value, and with a value that is a number the limit: 0.6402 < k2."""
    value, limit = (
        str(e.xreplace({f: sp.Float(f, 4) for f in e.atoms(sp.Float)}))
        for e in (condition.value, condition.limit)
    )
    return f"{value} < {limit}" if condition.value.is_number else value


def _sides(condition: GainCondition, numbers: Mapping[sp.Symbol, float]) -> tuple[float, float]:
    value, limit = evaluated([condition.value, condition.limit], numbers)
    if not (math.isfinite(value) and math.isfinite(limit)):
        raise DefinitionError(
            f"the condition {condition.value} < {condition.limit} has no value",
            expected="finite numbers on both sides, at every corner",
        )
    return value, limit


def relative_slack(value: float, limit: float) -> float:
    """(limit - value) over the larger of both sizes; 0 where both are 0."""
    size = max(abs(value), abs(limit))
    return (limit - value) / size if size else 0.0
