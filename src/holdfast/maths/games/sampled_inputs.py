"""Sampling of inputs and disturbances for which the Hamiltonian has no closed form.

    H = opt_i opp_j  p . f(t, q, u_i, d_j)   over the points u_i, d_j of the sets

opt comes first: the disturbance answers the input. With max_i min_j that is the lower value,
max min <= min max, which is guaranteed even against a disturbance that knows the input.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import Bounds, section
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import select, sgn, wrap

MOST = 400
"""Most pairs of an input point and a disturbance point; every node evaluates all of them."""

Point = dict[sp.Symbol, sp.Expr]


def dependences(system: System, symbol: sp.Symbol) -> list[set[sp.Symbol]]:
    """The symbols in the derivative of every rate by `symbol`: none for a constant gain.

    A rate that jumps in `symbol`, and so has no derivative there, depends on it.
    """
    found = []
    for rate in system.rates.values():
        jumps = any(e.has(symbol) for e in rate.atoms(sgn, wrap, select, sp.Piecewise))
        found.append(rate.diff(symbol).free_symbols | ({symbol} if jumps else set()))
    return found


def in_the_way(system: System, symbol: sp.Symbol, sampled: set[sp.Symbol]) -> list[set[sp.Symbol]]:
    """For every rate, the inputs and disturbances for which `symbol` has no closed form.

    A disturbance has one at every sampled input. An input is chosen first, without
    knowing the disturbance.
    """
    inputs = {q.symbol for q in system.inputs}
    disturbances = {q.symbol for q in system.disturbances}
    unknown = (inputs | disturbances) - sampled
    if symbol in inputs:
        unknown |= disturbances
    return [found & unknown for found in dependences(system, symbol)]


def without_closed_form(system: System) -> set[sp.Symbol]:
    """The inputs and disturbances to sample so that all others have a closed form.

    Members of a ball or an image go together. First those in which a rate is not affine; then the
    inputs that mix with disturbances; then those that mix among the inputs, or the disturbances.
    """
    groups = [
        group
        for bounds, members in (
            (system.input_bounds, system.inputs),
            (system.disturbance_bounds, system.disturbances),
        )
        for group in _groups(bounds, [q.symbol for q in members])
    ]
    disturbances = {q.symbol for q in system.disturbances}
    sampled: set[sp.Symbol] = set()
    for among in ("itself", "the disturbances", "all"):
        for group in groups:
            found = set().union(*(e for s in group for e in in_the_way(system, s, sampled)))
            if among == "itself":
                found &= set(group)
            elif among == "the disturbances":
                found &= disturbances
            if found:
                sampled |= set(group)
    return sampled


def points_of(bounds: Bounds | None, members: Sequence[sp.Symbol], which: set[sp.Symbol],
              samples: int) -> list[Point]:  # fmt: skip
    """The points of the members in `which`; one point without coordinates if it is empty."""
    part = section(bounds, [m in which for m in members])
    if part is None:
        return [{}]
    names = [m for m in members if m in which]
    return [dict(zip(names, point, strict=True)) for point in part.points(samples)]


def check_count(inputs: int, disturbances: int) -> None:
    if inputs * disturbances > MOST:
        raise DefinitionError(
            f"{inputs} points of the inputs times {disturbances} points of the disturbances "
            f"make {inputs * disturbances} pairs",
            expected=f"at most {MOST}",
            remedy="take fewer samples",
        )


def _groups(bounds: Bounds | None, members: Sequence[sp.Symbol]) -> list[Sequence[sp.Symbol]]:
    """The members of a set that can be chosen independently."""
    return [members] if bounds is None else bounds.groups(members)
