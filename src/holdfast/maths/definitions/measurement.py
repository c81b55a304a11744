"""Measurements (output equations), and laws that know the states only through them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.expressions.canonical import canonical

if TYPE_CHECKING:
    from holdfast.maths.definitions.system import System


@checked
@dataclass(frozen=True)
class Measurement(Quantity):
    """A quantity that is measured: an expression of states and parameters."""

    expression: sp.Expr = sp.S.Zero

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "expression", canonical(self.expression))


def by_measurements(system: System, law: Law | Switching) -> Law | Switching:
    """`law` as a function of the states of `system`: measurements are replaced by expressions.

    A law reads only its `reads`. If these are measurements, the law knows nothing else of the
    states. A law that reads only states is returned unchanged.
    """
    told = {m.name: m for m in system.measurements}
    if not any(q.name in told for q in law.reads):
        return law
    known = {m.symbol: m.expression for m in system.measurements}

    def written_out(mode: Law) -> Law:
        read = [q for q in mode.reads if q.name in told]
        used = set().union(*(told[q.name].expression.free_symbols for q in read))
        others = [q for q in mode.reads if q.name not in told]
        states = [q for q in system.states if q.symbol in used and q not in others]
        return replace(
            mode,
            reads=(*others, *states),
            outputs={n: e.xreplace(known) for n, e in mode.outputs.items()},
            signals={n: e.xreplace(known) for n, e in mode.signals.items()},
            believed={n: e.xreplace(known) for n, e in mode.believed.items()},
            safeguard=mode.safeguard.subs(known) if mode.safeguard else None,
            lookup=mode.lookup.subs(known) if mode.lookup else None,
            parameters=(*mode.parameters, *(p for p in system.parameters if p.symbol in used)),
        )

    if isinstance(law, Law):
        return written_out(law)
    return replace(
        law.map_laws(written_out, law.name),
        transitions=tuple(
            Transition(t.source, t.target, t.when.xreplace(known)) for t in law.transitions
        ),
        signals={n: e.xreplace(known) for n, e in law.signals.items()},
    )
