"""Verify that a problem is invariant under a reflection: half the grid then suffices.

    H(t, S q, S p) = H(t, q, p),   { c_j(S q) } = { c_j(q) },   S = diag(+-1)

Then V(S q) = V(q). The inputs need no reflection: H is already optimal over them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp

from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.region import Region
from holdfast.maths.games.hamiltonian import Hamiltonian


def check_symmetry(h: Hamiltonian, regions: Sequence[Region], signs: Mapping[str, int]) -> None:
    """Refuse a reflection (state -> -1, or 1) whose invariance cannot be shown.

    Raises `DefinitionError` that names the rate, the inequality or the players that change.
    """
    system = h.system
    if h.samples:
        raise DefinitionError(
            f"a symmetry of system '{system.name}' with {h.samples} samples cannot be shown",
            remedy="leave out the symmetry",
        )
    for name, sign in signs.items():
        if name not in system.state_names:
            raise DefinitionError(
                f"symmetry of '{name}', which is not a state",
                remedy=suggestion(name, system.state_names),
            )
        if isinstance(sign, bool) or sign not in (-1, 1):
            raise DefinitionError(f"symmetry of '{name}' is {sign!r}", expected="-1 or 1")
    if -1 not in signs.values():
        raise DefinitionError("the symmetry reflects no state", expected="-1 for one at least")
    of = [signs.get(n, 1) for n in system.state_names]
    states = {q.symbol: s * q.symbol for q, s in zip(system.states, of, strict=True)}
    costates = {p: s * p for p, s in zip(h.costates, of, strict=True)}
    still = {q.symbol: sp.S.Zero for q in (*system.inputs, *system.disturbances)}
    drift = [r.xreplace(still) for r in system.rates.values()]
    for name, sign, rate in zip(system.state_names, of, drift, strict=True):
        if not _same(rate.xreplace(states), sign * rate):
            raise _broken(f"the rate of '{name}'")
    steered = h.value - sum((p * f for p, f in zip(h.costates, drift, strict=True)), sp.S.Zero)
    if not _same(steered.xreplace(states | costates), steered):
        raise _broken("the effect of inputs and disturbances")
    for region in regions:
        every = [c.expression for c in region.inequalities]
        for c in region.inequalities:
            if not _same(c.expression.xreplace(states), *every):
                raise _broken(f"inequality '{c.name}' of region '{region.name}'")


def _broken(what: str) -> DefinitionError:
    return DefinitionError(
        f"{what} is not the same after the reflection, or it cannot be shown",
        remedy="reflect the states that belong together, or leave the symmetry out",
    )


def _same(one: sp.Expr, *others: sp.Expr) -> bool:
    """Whether it equals one of the others."""
    gaps = [sp.expand(sp.expand(one) - sp.expand(other)) for other in others]
    return any(gap == 0 for gap in gaps) or any(sp.simplify(gap) == 0 for gap in gaps)
