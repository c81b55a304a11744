"""Rates and inequalities made affine in some symbols, with a bound of what that leaves out.

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

from holdfast.errors import SimulationError
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.maths.expressions.functions import angle, length, select, sgn, wrap
from holdfast.maths.expressions.random_points import Sampler
from holdfast.maths.expressions.traversal import derivatives, parts

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
    found = {}
    for n, row in made.items():
        rest = math.fsum(weight * next(sizes) for weight, _ in row.bounds)
        if not math.isfinite(rest):
            raise SimulationError(
                f"nothing bounds what '{n}' changes by with {', '.join(map(str, swung))}",
                expected="rates that are finite over the box",
                remedy="take a smaller box",
            )
        found[n] = Affine(row.still, tuple(row.gains), rest * (1 + 1e-12))
    return found


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
    """The ends of the expressions over one box; NaN where nothing is known."""
    ends = np.array(list(box.values()), dtype=np.float64).reshape(len(box), 2)
    low, high = Enclosure(list(expressions), list(box)).over(ends[None, :, 0], ends[None, :, 1])
    return low[0], high[0]
