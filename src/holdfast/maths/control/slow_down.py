"""Inputs kept within their bounds by one factor for all of them: the path stays, the pace falls.

    u' = sigma u,   sigma = min(1, b_i / (n_i . u))  over half-spaces n_i . u <= b_i, n_i . u > 0

A system without drift, q' = G(q) u, follows the same path under sigma(q) u > 0 as under u, at
another pace. Limiting input by input would make it another path.
"""

from __future__ import annotations

from collections.abc import Mapping

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest, least


def can_stop(system: System) -> bool:
    """Whether the bounds of the inputs, if there are any, have 0 inside."""
    numbers = {p.symbol: p.value for p in system.parameters}
    rows = system.input_bounds.half_spaces() if system.input_bounds is not None else []
    return all(float(sp.sympify(limit).xreplace(numbers)) > 0 for _, limit in rows)


def slowed_down(system: System, inputs: Mapping[str, sp.Expr]) -> dict[str, sp.Expr]:
    """`inputs`, by name, times the largest factor up to 1 that keeps them within their bounds.

    A system without bounds gives the inputs as they are. Raises `DefinitionError` for bounds that
    are no polytope, or that do not have 0 inside.
    """
    if not can_stop(system):
        raise DefinitionError(
            f"the inputs of system '{system.name}' cannot be slowed down",
            expected="bounds with 0 inside: a vehicle that can stop",
        )
    rows = system.input_bounds.half_spaces() if system.input_bounds is not None else []
    values = [inputs[name] for name in system.input_names]
    share: sp.Expr = sp.S.One
    for normal, limit in rows:
        along = sp.Add(*(n * u for n, u in zip(normal, values, strict=True)))
        share = least(share, limit / greatest(limit, along))
    return {name: share * inputs[name] for name in system.input_names}
